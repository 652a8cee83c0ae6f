"""The budget of a run: every component with its correlation and degrees of freedom, combined and expanded.

Attributes follow the obsarray convention (``unc_comps``, ``pdf_shape``, ``err_corr_1_*``); ``degrees_of_freedom`` and
``source`` are this program's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.budget import COMPONENTS, combined, point_budget
from instrument.calibration import standard_error
from instrument.drift import COMPONENT as DRIFT
from instrument.errors import InputError
from instrument.facility import Facility
from instrument.quality.coverage import PROBABILITY, coverage_factor, effective_degrees_of_freedom
from instrument.quality.slopes import ANGLES, AngleTerm, Slope, angle_terms
from instrument.reference_standard import at_wavelength

#: Forms of the rows that ``facility.toml`` says nothing of; of instrument stability nobody knows how a day's
#: remounting correlates over the points of a scan.
_RANDOM, _UNSTATED = ("measurement_noise",), ("instrument_stability",)
#: Up to so many points the signs of an angle's errors are written out as a matrix.
MATRIX_POINTS = 2000
REFERENCE_NOISE = "u_brf_reference_noise"
NOISE_FREEDOM = "brf_noise_degrees_of_freedom"
#: Names of what the components add up to.
EXPANDED, COVERAGE, FREEDOM = "brf_expanded_uncertainty", "brf_coverage_factor", "brf_effective_degrees_of_freedom"


def add_budget(dataset: xr.Dataset, facility: Facility, slopes: Mapping[str, Slope] | None = None) -> None:
    """Put the components, ``u_brf`` and the expanded uncertainty into a run that has its ``brf``.

    Parameters
    ----------
    dataset
        Changed in place.
    slopes
        Slopes of the reflectance factor along the angles; those of the run itself where it is None.

    Raises
    ------
    InputError
        If a row is left to samples that are not there.
    """
    terms = angle_terms(facility, geometry_columns(dataset), dataset["brf"].values, slopes)
    found: dict[str, FloatArray] = {angle: np.abs(term.signed) for angle, term in terms.items()}
    noise = facility.budget.measurement_noise == "samples"
    if noise:
        found["measurement_noise"] = _sample_noise(dataset)
    brf, illumination, sensor = (dataset[n].values for n in ("brf", "illumination_zenith", "sensor_zenith"))
    components = point_budget(facility.budget, illumination, sensor, brf, found)
    components["u_brf_reference"] = _reference_material(dataset, facility, components["u_brf_reference"])
    for row, name in COMPONENTS.items():
        dataset[name] = ("point", components[name], _attributes(facility, row))
        if row in terms:
            say_slope(dataset, name, terms[row])
    if noise:
        components[REFERENCE_NOISE] = _reference_noise(dataset, found["measurement_noise"])
        dataset[REFERENCE_NOISE] = ("point", components[REFERENCE_NOISE], _of_reference(dataset))
        dataset["u_brf_noise"].attrs |= {
            "source": "standard error of the samples",
            "degrees_of_freedom_variable": NOISE_FREEDOM,
        }
    if DRIFT in dataset:
        components[DRIFT] = dataset[DRIFT].values
    dataset["brf"].attrs["unc_comps"] = list(components)
    dataset["u_brf"] = ("point", combined(components))
    add_coverage(dataset)


def add_coverage(dataset: xr.Dataset, probability: float = PROBABILITY) -> None:
    """Effective degrees of freedom, coverage factor and expanded uncertainty, from the components and what they say."""
    names = [str(name) for name in dataset["brf"].attrs["unc_comps"]]
    freedom = effective_degrees_of_freedom(
        [dataset[name].values for name in names], [component_freedom(dataset, name) for name in names]
    )
    factor = coverage_factor(freedom, probability)
    for name, values, what in (
        (FREEDOM, freedom, "effective degrees of freedom of u_brf (Welch-Satterthwaite)"),
        (COVERAGE, factor, "coverage factor of the expanded uncertainty (Student)"),
        (EXPANDED, factor * dataset["u_brf"].values, "expanded uncertainty of brf"),
    ):
        dataset[name] = ("point", values, {"units": "1", "long_name": what, "coverage_probability": probability})


def component_freedom(dataset: xr.Dataset, name: str) -> FloatArray:
    """Degrees of freedom of a component, shape () or (point,); infinite where the file does not say."""
    attributes = dataset[name].attrs
    variable = attributes.get("degrees_of_freedom_variable")
    if variable is not None and str(variable) in dataset:
        return np.asarray(dataset[str(variable)].values, dtype=float)
    return np.asarray(attributes.get("degrees_of_freedom", np.inf), dtype=float)


def geometry_columns(dataset: xr.Dataset) -> dict[str, np.ndarray]:
    """Everything that the points of a run differ in on purpose, shape (point,) each."""
    known = (*ANGLES, "wavelength", "illumination_azimuth", "sample_rotation", "polarization")
    return {name: dataset[name].values for name in known if name in dataset.variables}


def correlated(form: str | None, matrix: str | None = None) -> dict[str, Any]:
    """Attributes of the obsarray convention; none of them where nobody stated a correlation."""
    attributes: dict[str, Any] = {"pdf_shape": "gaussian"}
    if form is not None:
        attributes |= {
            "err_corr_1_dim": "point",
            "err_corr_1_form": form,
            "err_corr_1_params": [matrix] if matrix else np.zeros(0),
            "err_corr_1_units": np.zeros(0),
        }
    return attributes


def _attributes(facility: Facility, row: str) -> dict[str, Any]:
    usual = None if row in _UNSTATED else "random" if row in _RANDOM else "systematic"
    freedom = getattr(facility.degrees_of_freedom, row)
    return correlated(getattr(facility.correlation, row) or usual) | {
        "degrees_of_freedom": np.inf if freedom is None else freedom
    }


def say_slope(dataset: xr.Dataset, name: str, term: AngleTerm, whose: str = "") -> None:
    """Say where an angle's component comes from; its error raises some points and lowers others: the correlation."""
    attributes = dataset[name].attrs
    attributes["source"] = whose + term.source
    opposite = np.any(term.signed < 0) and np.any(term.signed > 0)
    if attributes.get("err_corr_1_form") != "systematic" or not opposite:
        return
    if dataset.sizes["point"] > MATRIX_POINTS:
        for key in [key for key in attributes if key.startswith("err_corr")]:
            del attributes[key]
        attributes["source"] += "; errors of points whose slopes differ in sign are opposite"
        return
    matrix = f"err_corr_{name}"
    attributes |= correlated("err_corr_matrix", matrix)
    dataset[matrix] = (("point", "point_2"), term.correlation, {"long_name": f"correlation of {name} between points"})


def _sample_noise(dataset: xr.Dataset) -> FloatArray:
    """Standard error of brf from the samples of the point itself; its degrees of freedom go into the file."""
    if dataset.sizes["sample"] < 2:
        raise InputError("facility: budget.measurement_noise: 'samples' needs at least 2 samples a point, found 1")
    volts = dataset["signal"].values
    light = np.abs(volts.mean(axis=-1) - dataset["dark"].values)
    parts, freedom = [standard_error(volts) / light], [volts.shape[-1] - 1.0]
    if dataset.sizes.get("dark_sample", 0) > 1:
        parts.append(standard_error(dataset["dark_signal"].values) / light)
        freedom.append(dataset.sizes["dark_sample"] - 1.0)
    dataset[NOISE_FREEDOM] = (
        "point",
        effective_degrees_of_freedom(parts, freedom),
        {"units": "1", "long_name": "effective degrees of freedom of u_brf_noise"},
    )
    return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)) * np.abs(dataset["brf"].values))


def _reference_noise(dataset: xr.Dataset, noise: FloatArray) -> FloatArray:
    """What the scatter of the reference readings adds: common to all points of a calibration."""
    both = dataset["brf_standard_error"].values
    return np.asarray(np.sqrt(np.maximum(both**2 - noise**2, 0.0)))


def _reference_material(dataset: xr.Dataset, facility: Facility, stated: FloatArray) -> FloatArray:
    """What the certificate of the reference says at each wavelength; the budget's row where there is none."""
    if facility.reference.standard is None:
        return stated
    wavelengths, inverse = np.unique(dataset["wavelength"].values, return_inverse=True)
    relative = np.array([at_wavelength(facility, float(nm)).reference.u_relative for nm in wavelengths])
    return np.asarray(relative[inverse] * np.abs(dataset["brf"].values))


def _of_reference(dataset: xr.Dataset) -> dict[str, Any]:
    readings = min(np.unique(dataset["reference_set"].values, return_counts=True)[1])
    wavelengths = len(np.unique(dataset["reference_wavelength"].values))
    freedom = max(1, readings // wavelengths) * (dataset.sizes["sample"] - 1.0)
    what = "standard uncertainty (k=1) of brf: noise of the reference readings"
    return correlated("systematic") | {"degrees_of_freedom": freedom, "long_name": what, "units": "1"}
