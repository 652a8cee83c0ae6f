"""Several runs of one sample, put back on the stage before each: their mean, and the variance between them.

What is new in every reading (components with random correlation) averages out; what stays the same from run to run
(the reference, the arms' zeros ...) does not. Between the runs there is what remounting and the day do, of which the
budget's instrument stability is the expectation: it is found from how the runs scatter (``docs/measurement.md``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.budget import combined
from instrument.drift import COMPONENT as DRIFT
from instrument.errors import InputError
from instrument.quality.random_effects import Pooled, dersimonian_laird, mandel_paule
from instrument.run_budget import REFERENCE_NOISE, add_coverage, correlated, geometry_columns
from instrument.run_check import component_names
from instrument.run_schema import OVERLOAD, REQUIRED, SATURATED, SHADOWED
from instrument.run_write import described

Stability = Literal["found", "stated", "larger"]
Method = Literal["mandel-paule", "dersimonian-laird"]
STABILITY = "u_brf_stability"
_METHODS: dict[str, Callable[..., Pooled]] = {"mandel-paule": mandel_paule, "dersimonian-laird": dersimonian_laird}
_USELESS = SATURATED | OVERLOAD | SHADOWED
#: Relative uncertainty that stands for a reading without any noise, where a weight needs one.
_LEAST = 1e-6
#: Components that a run has only where its plan asked for them; one without has none of that error.
_OCCASIONAL = (DRIFT, REFERENCE_NOISE)
#: What has to agree for the runs to be of one sample, and what may rest in the file where it agrees.
_SAME = (
    "sample",
    "reference_standard",
    "reference_reflectance_factor",
    "reference_illumination_zenith",
    "reference_sensor_zenith",
)
_KEPT = (*_SAME, "scan_direction", "facility")


@dataclass(frozen=True)
class _Table:
    """Runs by point: brf and components, shape (run, point); nan where a run lacks a point."""

    keys: dict[str, np.ndarray]
    brf: FloatArray
    components: dict[str, FloatArray]
    left_out: int


def merge_runs(
    runs: Mapping[str, xr.Dataset], *, stability: Stability = "found", method: Method = "mandel-paule"
) -> xr.Dataset:
    """One run of several.

    Parameters
    ----------
    runs
        At least two, by name. Points that a run lacks are merged from the others; repeated points count with their
        mean; flagged ones (saturated, overload, shadowed) are left out.
    stability
        Where ``u_brf_stability`` comes from: the scatter found between the runs, the runs' own budget, or the larger.

    Returns
    -------
    xarray.Dataset
        A run file with ``run_count(point)``, and ``run_brf``, ``run_weight`` along (run, point).

    Raises
    ------
    InputError
        If there are fewer than two, they are of different samples or references, lack components, or share no point.
    """
    if len(runs) < 2:
        raise InputError(f"runs merge: found {len(runs)} run; expected at least two of one sample")
    _require_same(runs)
    names = _components(runs)
    random = [name for name in names if _form(runs, name) == "random"]
    table = _joined(runs, names)
    level = np.nanmean(table.brf, axis=0)
    if np.any(table.brf == 0) or np.any(level == 0):
        raise InputError("runs merge: brf is 0 at a point; expected a reflectance factor")
    noise = combined({name: table.components[name] for name in random}) if random else np.zeros_like(table.brf)
    # Over the run's own value: over the mean, a run that reads low would weigh more because it does.
    relative_noise = np.maximum(noise / np.abs(table.brf), _LEAST)
    try:
        pooled = _METHODS[method](table.brf / level, np.where(np.isnan(table.brf), np.nan, relative_noise))
    except ValueError:
        raise InputError("runs merge: no geometry is in two of the runs; nothing tells how they scatter") from None
    result = xr.Dataset({name: ("point", values) for name, values in table.keys.items()})
    brf = pooled.mean * level
    result["brf"] = ("point", brf)
    _add_components(result, runs, table, pooled, random, stability)
    result["u_brf"] = ("point", combined({name: result[name].values for name in result["brf"].attrs["unc_comps"]}))
    add_coverage(result)
    _add_runs(result, table, pooled)
    result.attrs = _attributes(runs, table, pooled, stability, method)
    return described(result.set_coords(list(table.keys)), REQUIRED)


def run_factors(merged: xr.Dataset) -> FloatArray:
    """Mean of every run over the merged values at its points, shape (run,): what a run differs in as a whole."""
    return np.asarray(np.nanmean(merged["run_brf"].values / merged["brf"].values, axis=1))


def _require_same(runs: Mapping[str, xr.Dataset]) -> None:
    for attribute in _SAME:
        found = {name: str(run.attrs[attribute]) for name, run in runs.items() if attribute in run.attrs}
        if len(set(found.values())) > 1:
            said = "; ".join(f"{name}: {value}" for name, value in found.items())
            raise InputError(f"runs merge: {attribute}: expected one for all runs, found {said}")


def _components(runs: Mapping[str, xr.Dataset]) -> list[str]:
    names: list[str] | None = None
    for name, run in runs.items():
        own = component_names(run)
        if not own:
            raise InputError(
                f"{name}: no uncertainty components; expected them, since what the runs have in common is not averaged"
            )
        differing = set() if names is None else (set(own) ^ set(names)) - set(_OCCASIONAL)
        if differing:
            said = ", ".join(sorted(differing))
            raise InputError(f"{name}: the components differ from those of the runs before it: {said}")
        names = list(dict.fromkeys([*(names or []), *own]))
    return names or []


def _form(runs: Mapping[str, xr.Dataset], name: str) -> str | None:
    forms = {run[name].attrs.get("err_corr_1_form") for run in runs.values() if name in run}
    return forms.pop() if len(forms) == 1 else None


def _joined(runs: Mapping[str, xr.Dataset], names: Sequence[str]) -> _Table:
    columns: dict[tuple[Any, ...], int] = {}
    rows: list[list[int]] = []
    kept: list[xr.Dataset] = []
    left_out = 0
    axes = list(dict.fromkeys(axis for run in runs.values() for axis in geometry_columns(run)))
    for run in runs.values():
        flags = run["quality_flag"].values if "quality_flag" in run else np.zeros(run.sizes["point"], dtype=int)
        good = run.isel(point=(flags.astype(int) & _USELESS) == 0)
        left_out += run.sizes["point"] - good.sizes["point"]
        kept.append(good)
        rows.append([columns.setdefault(key, len(columns)) for key in _keys(good, axes)])
    if not columns:
        raise InputError("runs merge: no point is left; expected some without a flag")
    values = list(columns)
    keys = {axis: np.array([key[i] for key in values]) for i, axis in enumerate(axes)}
    number = len(columns)
    brf = np.stack([_mean_by(r, run["brf"].values, number) for r, run in zip(rows, kept, strict=True)])
    components = {}
    for name in names:
        power = 2.0 if _form(runs, name) == "random" else 1.0
        parts = []
        for r, run in zip(rows, kept, strict=True):
            values_of_run = run[name].values if name in run else np.zeros(run.sizes["point"])
            mean = _mean_by(r, values_of_run**power, number)
            counts = np.maximum(np.bincount(r, minlength=number), 1) if power == 2.0 else 1.0
            parts.append((mean / counts) ** (1 / power))
        components[name] = np.stack(parts)
    return _Table(keys, brf, components, left_out)


def _keys(run: xr.Dataset, axes: Sequence[str]) -> list[tuple[Any, ...]]:
    count = run.sizes["point"]
    columns = [run[axis].values if axis in run.variables else np.zeros(count) for axis in axes]
    plain = [np.round(column, 4).tolist() if column.dtype.kind in "iuf" else column.tolist() for column in columns]
    return list(zip(*plain, strict=True))


def _mean_by(rows: Sequence[int], values: FloatArray, number: int) -> FloatArray:
    """Mean of what shares a column, nan where nothing does."""
    total, count = np.bincount(rows, weights=values, minlength=number), np.bincount(rows, minlength=number)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _add_components(
    result: xr.Dataset,
    runs: Mapping[str, xr.Dataset],
    table: _Table,
    pooled: Pooled,
    random: Sequence[str],
    stability: Stability,
) -> None:
    names = list(table.components)
    for name in names:
        u = np.nan_to_num(table.components[name])
        values = np.sqrt(np.sum((pooled.weights * u) ** 2, axis=0)) if name in random else np.sum(pooled.weights * u, 0)
        known = next(run[name].attrs for run in runs.values() if name in run)
        attributes = {k: v for k, v in known.items() if k in ("long_name", "degrees_of_freedom", "units")}
        form = _form(runs, name)
        # A matrix belongs to the points of its own run.
        result[name] = ("point", values, attributes | correlated(None if form == "err_corr_matrix" else form))
    stated = table.components.get(STABILITY)
    result[STABILITY] = ("point", *_between(result["brf"].values, pooled, stated, stability))
    result["brf"].attrs["unc_comps"] = names if STABILITY in names else [*names, STABILITY]


def _between(
    brf: FloatArray, pooled: Pooled, stated: FloatArray | None, stability: Stability
) -> tuple[FloatArray, dict[str, Any]]:
    """Standard uncertainty that the differences between runs leave in their mean, with its attributes."""
    squares = np.sum(pooled.weights**2, axis=0)
    found = np.sqrt(squares) * pooled.tau * np.abs(brf)
    expected = found * 0 if stated is None else np.sqrt(np.sum((pooled.weights * np.nan_to_num(stated)) ** 2, axis=0))
    if stated is None and stability == "stated":
        raise InputError(f"runs merge: the runs have no {STABILITY}; expected it where the stated one is to be used")
    count = np.sum(pooled.weights > 0, axis=0)
    # All points of a run share its mounting: however many there are, the runs alone count.
    freedom = float(max(1, int(count.max()) - 1))
    choice = {"found": found, "stated": expected, "larger": np.maximum(found, expected)}[stability]
    is_found = stability == "found" or (stability == "larger" and bool(np.all(found >= expected)))
    attributes = {
        "long_name": "standard uncertainty (k=1) of brf: instrument stability, from the differences between the runs",
        "units": "1",
        "degrees_of_freedom": freedom if is_found else np.inf,
        "source": {
            "found": "scatter between the runs",
            "stated": "budget of the runs",
            "larger": "the larger of the scatter between the runs and their budget",
        }[stability],
    }
    return choice, correlated(None) | attributes


def _add_runs(result: xr.Dataset, table: _Table, pooled: Pooled) -> None:
    count = np.sum(pooled.weights > 0, axis=0)
    result["run_count"] = ("point", count, {"units": "1", "long_name": "runs that a point was measured in"})
    result["run_brf"] = (("run", "point"), table.brf, {"units": "1", "long_name": "brf of each run"})
    result["run_weight"] = (("run", "point"), pooled.weights, {"units": "1", "long_name": "weight of each run"})


def _attributes(
    runs: Mapping[str, xr.Dataset], table: _Table, pooled: Pooled, stability: str, method: str
) -> dict[str, Any]:
    first = next(iter(runs.values())).attrs
    attributes: dict[str, Any] = {
        "title": f"{first.get('title', 'scan')}: mean of {len(runs)} runs",
        "merged_runs": list(runs),
        "merged_journal_digests": [str(run.attrs.get("journal_digest", "")) for run in runs.values()],
        "between_run_method": method,
        "between_run_stability": stability,
        "between_run_standard_deviation": pooled.tau,
        "between_run_q": pooled.q,
        "between_run_q_expected": pooled.expected,
        "points_left_out": table.left_out,
    }
    for name in _KEPT:
        values = [run.attrs.get(name) for run in runs.values()]
        if values[0] is not None and all(value == values[0] for value in values):
            attributes[name] = values[0]
    return attributes
