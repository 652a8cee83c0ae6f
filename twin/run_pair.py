"""Two measured runs, geometry by geometry: their ratio, what of its uncertainty both have in common, and agreement.

An error that both runs have alike (the reference's reflectance factor, the arms' zeros) cancels in their ratio, as far
as it is equally large in both; everything else adds up. Which components those are is decided by name and correlation
(:func:`shared_components`) and said in the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.drift import COMPONENT as DRIFT
from instrument.errors import InputError
from instrument.run_budget import REFERENCE_NOISE
from instrument.run_check import component_names
from twin import metrics
from twin.comparison import UNUSABLE_FLAGS
from twin.matching import GEOMETRY, describe_geometry, find_points, geometry_table

REFERENCE = "u_brf_reference"
#: Systematic within a run, and new with every calibration against the reference.
_OF_ONE_RUN = (DRIFT, REFERENCE_NOISE)
#: Rows in the file, kept while points are taken out.
_ROW = "row_in_file"
_SYSTEMATIC = ("systematic", "err_corr_matrix")


@dataclass(frozen=True)
class PairComparison:
    """The outcome of :func:`compare_runs`.

    Attributes
    ----------
    points
        One row per matched geometry: the coordinates; ``row_a``, ``row_b``; ``a``, ``u_a``, ``b``, ``u_b``; ``ratio``
        (b over a) and ``u_ratio``, of which ``u_independent`` and ``u_shared`` are the parts; ``t``,
        ``level_of_agreement``.
    shared, independent
        Components by how they were taken.
    only_a, only_b
        Usable points without a partner.
    mean_ratio, u_mean_ratio
        Over all points, with what is common to the points of a run left in.
    notes
        What a reader of the numbers must know.
    """

    points: xr.Dataset
    shared: tuple[str, ...]
    independent: tuple[str, ...]
    only_a: int
    only_b: int
    mean_ratio: float
    u_mean_ratio: float
    notes: tuple[str, ...] = ()

    @property
    def rms_t(self) -> float:
        """Root mean square of t: 1 where the runs differ as their uncertainties say."""
        return metrics.root_mean_square(self.points["t"].values)

    @property
    def level_of_agreement(self) -> float:
        """Mean n'."""
        return float(self.points["level_of_agreement"].mean())

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        columns = {str(name): self.points[name].values.tolist() for name in self.points.variables}
        return {
            "points": self.points.sizes["point"],
            "only_a": self.only_a,
            "only_b": self.only_b,
            "mean_ratio": self.mean_ratio,
            "u_mean_ratio": self.u_mean_ratio,
            "rms_t": self.rms_t,
            "level_of_agreement": self.level_of_agreement,
            "shared": list(self.shared),
            "independent": list(self.independent),
            "notes": list(self.notes),
            "matched": [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
        }


def compare_runs(
    a: xr.Dataset, b: xr.Dataset, *, shared: Sequence[str] = (), independent: Sequence[str] = ()
) -> PairComparison:
    """Compare two runs of one sample.

    Parameters
    ----------
    a, b
        Run form. Points flagged saturated, overloaded or shadowed are left out.
    shared, independent
        Components (``u_brf_reference`` or ``reference``) taken so whatever the rule says.

    Raises
    ------
    InputError
        If no geometry is in both, brf is 0 somewhere, or a component is named that the runs do not have.
    """
    a, b = _usable(_numbered(a)), _usable(_numbered(b))
    rows_a, rows_b = _matched(a, b)
    if not len(rows_a):
        raise InputError(
            f"the runs have no geometry in common; the first has {_first(a)}, the second {_first(b)} among others"
        )
    one, other = a.isel(point=rows_a), b.isel(point=rows_b)
    common, notes = shared_components(one, other, shared, independent)
    names = _names(one, other)
    parts_a, parts_b = _relative(one, names), _relative(other, names)
    left_a = _rest(one, parts_a, notes, "first")
    left_b = _rest(other, parts_b, notes, "second")
    own_a = np.sqrt(left_a**2 + _squares(parts_a, set(names) - set(common)))
    own_b = np.sqrt(left_b**2 + _squares(parts_b, set(names) - set(common)))
    cancelling = np.sqrt(np.sum([(parts_a[n] - parts_b[n]) ** 2 for n in common], axis=0)) if common else 0 * own_a
    points = _table(one, other, own_a, own_b, cancelling)
    only_b = b.sizes["point"] - len(np.unique(rows_b))
    if len(np.unique(rows_b)) < len(rows_b):
        notes.append("some points of the first run share one point of the second, which measured it once")
    mean, u_mean = _mean_ratio(points, one, other, parts_a, parts_b, common, (left_a, left_b))
    rest = tuple(name for name in names if name not in common)
    only_a = a.sizes["point"] - len(rows_a)
    return PairComparison(points, tuple(common), rest, only_a, only_b, mean, u_mean, tuple(notes))


def shared_components(
    a: xr.Dataset, b: xr.Dataset, shared: Sequence[str] = (), independent: Sequence[str] = ()
) -> tuple[list[str], list[str]]:
    """Components whose error is the same in both runs, and notes on the choice.

    Those are the systematic ones where both runs state the same facility; of different facilities only the reference's,
    where both name the same standard. Noise, stability (what the day and the mounting do), drift and the noise of the
    reference readings belong to one run.
    """
    names = _names(a, b)
    forced = {word: [_full(name, names) for name in given] for word, given in (("+", shared), ("-", independent))}
    both = [name for name in names if all(run[name].attrs.get("err_corr_1_form") in _SYSTEMATIC for run in (a, b))]
    both = [name for name in both if name not in _OF_ONE_RUN]
    notes: list[str] = []
    if not names:
        notes.append("no uncertainty components in one of the runs: nothing is taken to be common to both")
    if _same(a, b, "facility"):
        found = both
    else:
        same_standard = _same(a, b, "reference_standard")
        found = [name for name in both if name == REFERENCE and same_standard]
        common = "but the reference standard" if found else "no error"
        notes.append(f"the runs state no common facility: {common} is taken to be the same in both")
    chosen = [name for name in names if (name in found or name in forced["+"]) and name not in forced["-"]]
    return chosen, notes


def _same(a: xr.Dataset, b: xr.Dataset, attribute: str) -> bool:
    return bool(a.attrs.get(attribute)) and a.attrs.get(attribute) == b.attrs.get(attribute)


def _full(name: str, known: Sequence[str]) -> str:
    full = name if name.startswith("u_brf_") else f"u_brf_{name}"
    if full not in known:
        raise InputError(f"component {name}: not in both runs; found {', '.join(known) or 'none'}")
    return full


def _names(a: xr.Dataset, b: xr.Dataset) -> list[str]:
    own = component_names(a)
    return [name for name in own if name in component_names(b)]


def _numbered(run: xr.Dataset) -> xr.Dataset:
    return run.assign({_ROW: ("point", np.arange(run.sizes["point"]))})


def _usable(run: xr.Dataset) -> xr.Dataset:
    if "quality_flag" not in run:
        return run
    return run.isel(point=(run["quality_flag"].values.astype(int) & UNUSABLE_FLAGS) == 0)


def _first(run: xr.Dataset) -> str:
    return describe_geometry(geometry_table(run)[0]) if run.sizes["point"] else "no usable point"


def _matched(a: xr.Dataset, b: xr.Dataset) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of both with the same directions as seen from the sample, in the same light."""
    light_a, light_b = _light(a), _light(b)
    pairs: list[NDArray[np.int64]] = []
    for code in np.unique(light_a):
        of_a, of_b = np.flatnonzero(light_a == code), np.flatnonzero(light_b == code)
        found = find_points(a.isel(point=of_a), b.isel(point=of_b))
        kept = found >= 0
        pairs.append(np.stack([of_a[kept], of_b[found[kept]]]))
    joined = np.concatenate(pairs, axis=1)
    order = np.argsort(joined[0], kind="stable")
    return joined[0][order], joined[1][order]


def _light(run: xr.Dataset) -> NDArray[np.int64]:
    if "polarization" not in run:
        return np.zeros(run.sizes["point"], dtype=np.int64)
    return np.asarray(run["polarization"].values, dtype=np.int64)


def _relative(run: xr.Dataset, names: Sequence[str]) -> dict[str, FloatArray]:
    brf = np.abs(run["brf"].values)
    if np.any(brf == 0):
        raise InputError("brf is 0 at a point; expected a reflectance factor, a ratio has no meaning there")
    return {name: np.asarray(run[name].values / brf) for name in names}


def _rest(run: xr.Dataset, parts: Mapping[str, FloatArray], notes: list[str], which: str) -> FloatArray:
    """Relative uncertainty that the components in common to both runs do not make up."""
    total = (run["u_brf"].values / run["brf"].values) ** 2
    left = total - _squares(parts, parts)
    if parts and np.any(left > 1e-6 * total):
        notes.append(f"the {which} run has uncertainty that no component of both accounts for; it is taken as its own")
    return np.sqrt(np.maximum(left, 0.0))


def _squares(parts: Mapping[str, FloatArray], names: Any) -> FloatArray:
    return np.asarray(sum((parts[name] ** 2 for name in names), start=np.zeros(1)))


def _table(
    one: xr.Dataset,
    other: xr.Dataset,
    own_a: FloatArray,
    own_b: FloatArray,
    cancelling: FloatArray,
) -> xr.Dataset:
    brf_a, brf_b = one["brf"].values, other["brf"].values
    ratio = brf_b / brf_a
    u_independent = np.abs(ratio) * np.hypot(own_a, own_b)
    u_shared = np.abs(ratio) * cancelling
    u_ratio = np.hypot(u_independent, u_shared)
    if np.any(u_ratio == 0):
        raise InputError("the ratio has no uncertainty at a point: everything is taken to be common to both runs")
    t = (ratio - 1) / u_ratio
    # The second run's samples scatter about the first's value with what is not the first's own.
    level = metrics.level_of_agreement(t, np.hypot(own_b, cancelling), own_a)
    columns = {
        "row_a": one[_ROW].values,
        "row_b": other[_ROW].values,
        "a": brf_a,
        "u_a": one["u_brf"].values,
        "b": brf_b,
        "u_b": other["u_brf"].values,
        "ratio": ratio,
        "u_ratio": u_ratio,
        "u_independent": u_independent,
        "u_shared": u_shared,
        "t": t,
        "level_of_agreement": level,
    }
    table = geometry_table(one)
    coordinates = {name: ("point", table[:, column]) for column, name in enumerate(GEOMETRY)}
    return xr.Dataset({name: ("point", values) for name, values in columns.items()}, coords=coordinates)


def _mean_ratio(
    points: xr.Dataset,
    one: xr.Dataset,
    other: xr.Dataset,
    parts_a: Mapping[str, FloatArray],
    parts_b: Mapping[str, FloatArray],
    common: Sequence[str],
    left: tuple[FloatArray, FloatArray],
) -> tuple[float, float]:
    """Mean ratio and its uncertainty: noise averages out over points, what is common to a run's points does not.

    Components whose correlation nobody stated count as common to all points, the safe side for a mean.
    """
    ratio = points["ratio"].values
    variance = sum(float(np.mean(ratio * part)) ** 2 for part in left)
    for name in parts_a:
        if name in common:
            pairs = [(parts_a[name] - parts_b[name], one)]
        else:
            pairs = [(parts_a[name], one), (parts_b[name], other)]
        for part, run in pairs:
            variance += _variance_of_mean(ratio * part, name, run)
    return float(np.mean(ratio)), float(np.sqrt(variance))


def _variance_of_mean(part: FloatArray, name: str, run: xr.Dataset) -> float:
    form = run[name].attrs.get("err_corr_1_form")
    if form == "random":
        return float(np.sum(part**2)) / len(part) ** 2
    params = [str(p) for p in np.atleast_1d(run[name].attrs.get("err_corr_1_params", []))]
    if form == "err_corr_matrix" and params and params[0] in run:
        rows = run[params[0]].values
        # Points were taken along the first axis; the second still holds all of the file.
        return float(part @ rows[:, run[_ROW].values] @ part) / len(part) ** 2
    return float(np.mean(part)) ** 2
