"""Uncertainty of a prediction from its inputs, worked out once for a plan and kept by content.

It depends on facility, artifact, material and geometries, not on what is measured: while a scan runs it is worked out
in idle time (:class:`UncertainTwin`, in a process of its own), and every later scan or comparison with the same inputs
finds it in the user's cache folder.
"""

from __future__ import annotations

import json
import logging
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.events import Geometry
from instrument.files import replacing
from twin.content import cache_folder, content_digest
from twin.matching import GEOMETRY
from twin.optics import sample_columns
from twin.propagation import Propagation, by_sensitivities
from twin.propagation_render import PlanRenderer
from twin.state_vector import StateVector, state_vector_from_files

_LOG = logging.getLogger(__name__)
#: Counts up when the computation changes: what older programs kept is not used then.
_VERSION = 4
#: Relative standard error of the uncertainty to reach at the median point.
TOLERANCE = 0.1
#: Of the signs in the designs.
SEED = 1
#: Decimals of angles and wavelengths by which geometries are told apart.
_DECIMALS = 6


@dataclass(frozen=True)
class InputUncertainty:
    """What the inputs add to the uncertainty of predictions.

    Attributes
    ----------
    geometry, shape (point, 5)
        In the order of :data:`~twin.matching.GEOMETRY`.
    result
        By source, with correlations and sensitivities.
    inputs
        Number of uncertain inputs.
    notes
        What was assumed, and what is not propagated.
    """

    geometry: FloatArray
    result: Propagation
    inputs: int
    notes: tuple[str, ...] = ()

    @property
    def variance(self) -> FloatArray:
        """Squared standard uncertainties (k = 1), shape (source, point); an estimate near 0 can be negative."""
        return np.array(list(self.result.variance.values())).reshape(-1, len(self.geometry))

    @property
    def sources(self) -> tuple[str, ...]:
        """Rows of the budget."""
        return tuple(self.result.variance)

    @property
    def u_error(self) -> FloatArray:
        """Relative standard error of ``u``, shape (point,)."""
        return np.where(np.isfinite(self.result.u_error), self.result.u_error, 1.0)

    @property
    def u(self) -> FloatArray:
        """Standard uncertainty (k = 1) of brf from all inputs, shape (point,)."""
        return self.result.u

    @property
    def contains(self) -> str:
        """What a ``u_brf`` that includes it holds, for its attribute ``u_brf_contains``."""
        return f"{self.inputs} uncertain inputs and the ray tracer's standard error"

    def of(self, rows: FloatArray) -> InputUncertainty | None:
        """That of some geometries, shape (row, 5); None if one of them is missing."""
        place = {row.tobytes(): number for number, row in enumerate(_rounded(self.geometry))}
        wanted = [place.get(row.tobytes(), -1) for row in _rounded(rows)]
        if min(wanted, default=0) < 0:
            return None
        return InputUncertainty(rows, self.result.take(np.array(wanted, dtype=np.int64)), self.inputs, self.notes)


def find_input_uncertainty(
    state: StateVector,
    geometries: Sequence[Geometry] | xr.Dataset,
    *,
    folder: Path | None = None,
    tolerance: float = TOLERANCE,
    begin: Callable[[], None] | None = None,
    **where: Any,
) -> InputUncertainty:
    """What the inputs add to the uncertainty of predictions, from the cache or by sensitivities.

    Parameters
    ----------
    state
        Nominal inputs and their uncertainties.
    geometries
        A plan, or points of it: what is known of a plan serves every part of it.
    folder
        Where results are kept; None for the user's cache folder.
    tolerance
        Relative standard error of the uncertainty to reach at the median point.
    begin
        Called before a computation, which takes its time.
    where
        ``address``, ``workers``, ``progress`` as of :func:`~twin.propagation.by_sensitivities`.
    """
    store = UncertaintyStore(state, cache_folder() if folder is None else folder, tolerance)
    columns = sample_columns(geometries)
    rows = np.stack([columns[name] for name in GEOMETRY], axis=1)
    known = store.find(rows)
    if known is not None:
        return known
    if begin is not None:
        begin()
    distinct, place = np.unique(_rounded(rows), axis=0, return_inverse=True)
    found = _compute(state, distinct, tolerance, where)
    store.keep(found)
    return InputUncertainty(rows, found.result.take(place.reshape(-1)), found.inputs, found.notes)


def with_inputs(prediction: xr.Dataset, known: InputUncertainty) -> xr.Dataset:
    """A prediction whose ``u_brf`` holds the uncertainty of its inputs too; ``u_brf_inputs`` is that alone."""
    dataset = prediction.copy()
    total = np.hypot(known.u, prediction["u_brf_monte_carlo"].values)
    dataset["u_brf"] = ("point", total, dict(prediction["u_brf"].attrs))
    dataset["u_brf_inputs"] = (
        "point",
        known.u,
        {"units": "1", "long_name": "standard uncertainty (k=1) of brf from all inputs"},
    )
    dataset.attrs["u_brf_contains"] = known.contains
    dataset.attrs["u_brf_notes"] = "; ".join(known.notes)
    return dataset


class UncertaintyStore:
    """Files of uncertainties, named by the content of the inputs and of the geometries.

    Parameters
    ----------
    state
        Nominal inputs and their uncertainties.
    folder
        Of the cache; made when needed.
    """

    def __init__(self, state: StateVector, folder: Path, tolerance: float = TOLERANCE) -> None:
        self._folder = folder / "input-uncertainty" / inputs_digest(state, tolerance)[:40]

    def find(self, rows: FloatArray) -> InputUncertainty | None:
        """What is known of all these geometries, shape (row, 5)."""
        own = self._path(rows)
        others = (path for path in sorted(self._folder.glob("*.npz")) if path != own)
        for path in (own, *others):
            kept = _load(path)
            found = None if kept is None else kept.of(rows)
            if found is not None:
                return found
        return None

    def keep(self, result: InputUncertainty) -> None:
        """Write a result for later; a cache that cannot be written costs the next computation, not this one."""
        path = self._path(result.geometry)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as part, part.open("wb") as handle:
                np.savez_compressed(handle, **_packed(result))
        except OSError as error:
            _LOG.warning("%s: cannot be kept: %s", path, error.strerror)

    def _path(self, rows: FloatArray) -> Path:
        distinct = np.unique(_rounded(rows), axis=0)
        return self._folder / f"{content_digest(distinct)[:40]}.npz"


class UncertainTwin:
    """What a worker process asks for uncertainties (:meth:`twin.worker.PredictionWorker.uncertainty`)."""

    def __init__(self, state: StateVector) -> None:
        self._state = state

    @classmethod
    def from_files(cls, facility: Path, artifact: Path, material: Path) -> UncertainTwin:
        """Read the twin's three files; an :class:`~instrument.errors.InputError` names what is wrong."""
        return cls(state_vector_from_files(facility, artifact, material))

    def uncertainty(self, geometries: Sequence[Geometry]) -> InputUncertainty:
        """Of predictions for these geometries."""
        return find_input_uncertainty(self._state, geometries)


def inputs_digest(state: StateVector, tolerance: float) -> str:
    """Tells apart all that changes the uncertainty of a geometry."""
    blocks = [
        (block.labels, block.source, block.unit, block.nominal, block.standard_uncertainty) for block in state.blocks
    ]
    parts = [_VERSION, tolerance, SEED, state.facility, state.nominal_inputs, state.nominal_material]
    return content_digest(*parts, state.coupon, blocks, state.notes)


def _compute(state: StateVector, rows: FloatArray, tolerance: float, where: dict[str, Any]) -> InputUncertainty:
    columns = {name: rows[:, k].copy() for k, name in enumerate(GEOMETRY)}
    renderer = PlanRenderer(state, columns, seed=SEED)
    result = by_sensitivities(renderer, tolerance=tolerance, seed=SEED, **where)
    return InputUncertainty(rows, result, len(state), state.notes)


#: Arrays of a result that are kept as they are; those by name are kept side by side, (name, point).
_ARRAYS = ("factor", "noise", "u_error", "mean_shift", "brf", "factor_error")
_BY_NAME = ("variance", "sensitivity", "sensitivity_error")


def _packed(known: InputUncertainty) -> dict[str, Any]:
    result, points = known.result, len(known.geometry)
    named: dict[str, Any] = {name: list(getattr(result, name)) for name in _BY_NAME}
    named |= {"units": result.units, "curvature": result.curvature, "components": list(result.component_sources)}
    named |= {"evaluations": result.evaluations, "inputs": known.inputs, "notes": list(known.notes)}
    arrays = {name: getattr(result, name) for name in _ARRAYS}
    arrays |= {name: np.array(list(getattr(result, name).values())).reshape(-1, points) for name in _BY_NAME}
    return {"geometry": known.geometry, **arrays, "named": np.array(json.dumps(named))}


def _unpacked(data: Mapping[str, Any]) -> InputUncertainty:
    """Raises a ValueError where the parts do not belong together."""
    named, geometry = json.loads(str(data["named"])), data["geometry"]
    arrays = {name: data[name] for name in _ARRAYS}
    if any(len(array) != len(geometry) for name, array in arrays.items() if name != "factor_error"):
        raise ValueError("arrays of other lengths than the geometries")
    by_name: dict[str, Any] = {name: dict(zip(named[name], data[name], strict=True)) for name in _BY_NAME}
    if any(value.shape != (len(geometry),) for values in by_name.values() for value in values.values()):
        raise ValueError("values by name of other lengths than the geometries")
    result = Propagation(
        **arrays,
        **by_name,
        units=named["units"],
        curvature=named["curvature"],
        component_sources=tuple(named["components"]),
        evaluations=int(named["evaluations"]),
    )
    return InputUncertainty(geometry, result, int(named["inputs"]), tuple(named["notes"]))


def _load(path: Path) -> InputUncertainty | None:
    """A kept result; None, and a word in the log, where the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            return _unpacked(data)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as problem:
        _LOG.warning("%s: cannot be read (%s); it is computed again", path, problem)
        return None


def _rounded(rows: FloatArray) -> NDArray[np.float64]:
    return np.ascontiguousarray(np.round(np.nan_to_num(rows, nan=0.0), _DECIMALS) + 0.0)
