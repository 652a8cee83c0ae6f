"""A prediction with the uncertainty of its inputs, in the form of the data contract."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from instrument.events import Geometry
from twin.input_uncertainty import find_input_uncertainty
from twin.optics import sample_columns
from twin.prediction import Twin
from twin.propagation import DRAW_SAMPLES, Progress, Propagation, by_draws, by_sensitivities
from twin.propagation_render import PlanRenderer
from twin.state_vector import StateVector

#: Name of the ray tracer's row among the sources.
RAY_TRACER = "ray tracer"
#: Suffix of the variable that holds the correlation between points.
_CORRELATION = "err_corr_u_brf_inputs"


def propagate(
    state: StateVector,
    geometries: Sequence[Geometry] | xr.Dataset,
    *,
    standard_error: float = 0.001,
    tolerance: float = 0.1,
    draws: int = 0,
    samples: int = DRAW_SAMPLES,
    seed: int = 1,
    keep: bool = False,
    address: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Predict a plan with all its uncertainties.

    Parameters
    ----------
    state
        Nominal inputs and their uncertainties.
    geometries
        As for :meth:`twin.prediction.Twin.predict`.
    standard_error
        Relative Monte Carlo error of the prediction itself.
    tolerance
        Relative standard error of the uncertainty at the median point, by sensitivities.
    draws, samples
        Monte Carlo draws instead (0: none), and sight lines of a point in each; only sensitivities tell sources
        apart.
    seed
        Of all random numbers.
    keep
        Use what is known of the sensitivities of these geometries, or keep what is found
        (:mod:`twin.input_uncertainty`); these have random numbers of their own, whatever the seed.
    address, workers
        Where the plan is evaluated: as of :func:`twin.cluster.spread`.
    progress
        Told what is being done, how much of it is done, and how much there is.

    Returns
    -------
    Dataset
        As :func:`with_input_uncertainty`.
    """
    nominal = state.nominal_inputs
    twin = Twin(state.facility, nominal.artifact, state.nominal_material, seed=seed)
    prediction = twin.predict(geometries, standard_error=standard_error, setup=nominal.setup)
    where: dict[str, Any] = {"address": address, "workers": workers, "progress": progress}
    if keep and not draws:
        result = find_input_uncertainty(state, geometries, tolerance=tolerance, **where).result
        return with_input_uncertainty(prediction, result, state)
    renderer = PlanRenderer(state, sample_columns(geometries), seed=seed)
    if draws:
        result = by_draws(renderer, draws=draws, samples=samples, seed=seed, **where)
    else:
        result = by_sensitivities(renderer, tolerance=tolerance, seed=seed, **where)
    return with_input_uncertainty(prediction, result, state)


def with_input_uncertainty(prediction: xr.Dataset, result: Propagation, state: StateVector) -> xr.Dataset:
    """Join a prediction and what its inputs add to its uncertainty.

    Returns
    -------
    Dataset
        ``brf`` and ``u_brf_monte_carlo`` of the prediction; ``u_brf_inputs`` (with the correlation between points,
        ``err_corr_u_brf_inputs``), ``u_brf`` of both; ``variance_share(point, source)``, whose rows add up to 1;
        ``sensitivity(point, parameter)`` in brf over the unit of the parameter, with the ray tracer's standard error
        ``u_sensitivity``; ``mean_shift``, the expected value over
        the inputs less ``brf`` (not applied); ``u_brf_relative_error``, how well ``u_brf_inputs`` is known.
    """
    tracing = np.asarray(prediction["u_brf_monte_carlo"].values)
    u = result.u
    total = np.hypot(u, tracing)
    shares = {**result.variance, RAY_TRACER: tracing**2}
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(total[:, None] > 0, np.stack(list(shares.values()), axis=1) / total[:, None] ** 2, 0.0)
    dataset = prediction.copy()
    dataset["u_brf"] = ("point", total, dict(prediction["u_brf"].attrs))
    dataset["u_brf_monte_carlo"] = (
        "point",
        tracing,
        {**prediction["u_brf_monte_carlo"].attrs, **_correlated("random")},
    )
    dataset["u_brf_inputs"] = (
        "point",
        u,
        _described("standard uncertainty (k=1) of brf from all inputs", **_correlated("err_corr_matrix")),
    )
    dataset[_CORRELATION] = (
        ("point", "point_2"),
        result.correlation().astype(np.float32),
        _described("correlation of the errors of brf from the inputs"),
    )
    dataset["variance_share"] = (
        ("point", "source"),
        share,
        _described("share of the variance of brf; an estimate near 0 can be negative"),
    )
    dataset["mean_shift"] = (
        "point",
        result.mean_shift,
        _described("expected value of brf over the inputs less brf"),
    )
    dataset["u_brf_relative_error"] = (
        "point",
        np.where(np.isfinite(result.u_error), result.u_error, 1.0),
        _described("relative standard error of u_brf_inputs"),
    )
    dataset = dataset.assign_coords(source=list(shares))
    if result.sensitivity:
        slopes = np.stack(list(result.sensitivity.values()), axis=1)
        dataset["sensitivity"] = (
            ("point", "parameter"),
            slopes,
            {"long_name": "change of brf over that of a parameter"},
        )
        dataset["u_sensitivity"] = (
            ("point", "parameter"),
            np.stack([result.sensitivity_error[label] for label in result.sensitivity], axis=1),
            {"long_name": "standard error of sensitivity by the ray tracer (k=1)"},
        )
        known = dict(zip(state.labels, state.standard_uncertainty, strict=True))
        dataset = dataset.assign_coords(
            parameter=list(result.sensitivity),
            parameter_units=("parameter", [result.units[label] for label in result.sensitivity]),
            parameter_u=("parameter", [float(known[label]) for label in result.sensitivity]),
        )
    dataset["brf"].attrs["unc_comps"] = ["u_brf_inputs", "u_brf_monte_carlo"]
    dataset.attrs["u_brf_contains"] = f"{len(state)} uncertain inputs and the ray tracer's standard error"
    dataset.attrs["u_brf_notes"] = "; ".join(state.notes)
    dataset.attrs["evaluations"] = result.evaluations
    return dataset


def _correlated(form: str) -> dict[str, Any]:
    """Attributes after obsarray."""
    matrix = form == "err_corr_matrix"
    return {
        "pdf_shape": "gaussian",
        "err_corr_1_dim": "point",
        "err_corr_1_form": form,
        "err_corr_1_params": [_CORRELATION] if matrix else np.zeros(0),
        "err_corr_1_units": np.zeros(0),
    }


def _described(long_name: str, **attributes: Any) -> dict[str, Any]:
    return {"units": "1", "long_name": long_name, **attributes}
