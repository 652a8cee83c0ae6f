"""Makes a run ready for the diagnosis: prediction, responses to every effect, and what the budget allows.

All of it depends on the configuration and the geometries alone, and is kept on disk by content: a second run of the
same plan needs no ray.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray, direction
from instrument.artifact import read_artifact
from instrument.facility import read_facility
from twin.diagnosis.acquisition import acquisition_of
from twin.diagnosis.covariance import over_directions
from twin.diagnosis.nuisance import budget_columns
from twin.diagnosis.observation import Observation
from twin.diagnosis.problem import Problem
from twin.diagnosis.renders import RenderStore
from twin.diagnosis.responses import Responses, responses
from twin.diagnosis.workbench import Workbench
from twin.material import read_material
from twin.optics import COORDINATES
from twin.state_vector import StateVector, coupon_of, state_vector

#: Relative Monte Carlo error of the nominal prediction.
STANDARD_ERROR = 0.001
#: Components of the inputs' covariance that are kept; the rest counts as independent.
_COMPONENTS = 40
#: Relative standard deviation of what interpolation between the coupon's geometries leaves, and over how many degrees.
MODEL_ERROR, MODEL_LENGTH = 0.002, 20.0
#: The same at exact retro-reflection (what held-out readings there show), and the angle at which it has fallen to 1/e.
RETRO_ERROR, RETRO_LENGTH = 0.01, 8.0
#: Raised whenever the same inputs would give other numbers.
VERSION = 1
Told = Callable[[str, float], None]


@dataclass(frozen=True)
class Inputs:
    """Files of the nominal twin."""

    facility: Path
    artifact: Path
    material: Path


@dataclass(frozen=True)
class Prepared:
    """A run made ready, and how every effect acts on it."""

    problem: Problem
    responses: Responses
    budget: dict[str, FloatArray]


class Bench:
    """Prepares runs of one configuration.

    Parameters
    ----------
    inputs
        Files of the nominal twin.
    cache
        Folder in which renderings are kept; None keeps none.
    """

    def __init__(self, inputs: Inputs, cache: Path | None) -> None:
        self.inputs, self.cache = inputs, cache
        self.facility = read_facility(inputs.facility)
        self.artifact = read_artifact(inputs.artifact)
        self.material = read_material(inputs.material)
        self.workbench = Workbench(self.facility, self.artifact, self.material)
        self.store = RenderStore(self.workbench, cache)

    def prepare(self, run: Observation, told: Told | None = None) -> Prepared:
        """Predict a run, and find out what effects and budget do to it."""
        tell = told or (lambda what, share: None)
        tell("nominal prediction", 0.0)
        nominal, u_nominal = self._kept("nominal", run, self._predict)
        tell("what the inputs' uncertainties do", 0.1)
        covariance, _ = self._kept("inputs", run, self._input_covariance)
        tell("what every effect does", 0.4)

        def step(done: int, total: int) -> None:
            tell(f"what every effect does: {done} of {total} scenes", 0.4 + 0.6 * done / max(total, 1))

        found = responses(acquisition_of(run, self.facility), nominal, self.store, progress=step)
        columns = budget_columns(found.found, run)
        factor, rest = low_rank(covariance)
        budget = np.concatenate([np.stack(list(columns.values()), axis=1), factor, model_error(run)], axis=1)
        u_own = np.sqrt(u_nominal**2 + rest)
        problem = Problem.of(run, nominal, u_own, budget, list(found.found.values()))
        return Prepared(problem, found, columns)

    def _predict(self, run: Observation) -> tuple[FloatArray, FloatArray]:
        from twin.prediction import Twin

        twin = Twin(self.facility, self.artifact, self.material)
        prediction = twin.predict(_dataset(run), standard_error=STANDARD_ERROR)
        brf = np.asarray(prediction["brf"].values, dtype=float)
        return brf, np.asarray(prediction["u_brf_monte_carlo"].values / brf, dtype=float)

    def _input_covariance(self, run: Observation) -> tuple[FloatArray, FloatArray]:
        """Relative covariance of the prediction from the errors of coupon and holes, shape (point, point)."""
        from twin.propagation import by_sensitivities
        from twin.propagation_render import PlanRenderer

        state = unplaced(state_vector(self.facility, self.artifact, self.material, coupon_of(self.inputs.material)))
        count = len(run)
        if not state.blocks:
            return np.zeros((count, count)), np.zeros(0)
        found = by_sensitivities(PlanRenderer(state, run.columns, seed=3), tolerance=0.2)
        return np.asarray(found.covariance() / np.outer(found.brf, found.brf)), np.zeros(0)

    def _kept(
        self, what: str, run: Observation, make: Callable[[Observation], tuple[FloatArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray]:
        """Two arrays that depend on configuration and geometries; computed for each geometry once."""
        if self.cache is None:
            return make(run)
        table = np.round(np.stack([run.columns[name] for name in COORDINATES], axis=1), 6) + 0.0
        unique, inverse = np.unique(table, axis=0, return_inverse=True)
        digest = hashlib.sha256(f"{VERSION} {what} {self.workbench.digest()} {self._coupon()}".encode())
        digest.update(unique.tobytes())
        file = self.cache / f"{what}-{digest.hexdigest()[:32]}.npz"
        arrays = _load(file)
        if arrays is None:
            _, first = np.unique(table, axis=0, return_index=True)
            arrays = make(run.take(first))
            _save(file, arrays)
        rows = np.ravel(inverse)
        return _at(arrays[0], rows), _at(arrays[1], rows)

    def _coupon(self) -> str:
        return hashlib.sha256(self.inputs.material.read_bytes()).hexdigest() + self.facility.model_dump_json()


def unplaced(state: StateVector) -> StateVector:
    """The state vector without placement and instrument, whose effects have responses of their own."""
    kept = tuple(block for block in state.blocks if block.source == "hole dimensions" or _of_material(block.name))
    return replace(state, blocks=kept)


def _of_material(name: str) -> bool:
    return name.startswith("material")


def model_error(run: Observation) -> FloatArray:
    """What the twin's reflection model leaves: columns, shape (point, column).

    Smooth over directions, and more towards retro-reflection, where no coupon can be measured.
    """
    columns = run.columns
    view = direction(columns["sensor_zenith"], columns["sensor_azimuth"])
    light = direction(columns["illumination_zenith"], columns["illumination_azimuth"])
    gap = np.rad2deg(np.arccos(np.clip(np.sum(view * light, axis=1), -1.0, 1.0)))
    smooth = low_rank(MODEL_ERROR**2 * over_directions(run, MODEL_LENGTH))[0]
    return np.concatenate([smooth, (RETRO_ERROR * np.exp(-gap / RETRO_LENGTH))[:, None]], axis=1)


def low_rank(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factor (point, component) of the main part of a covariance, and the variances of the rest, shape (point,)."""
    values, vectors = np.linalg.eigh(covariance)
    kept = np.argsort(-values)[:_COMPONENTS]
    factor = vectors[:, kept] * np.sqrt(np.maximum(values[kept], 0.0))
    rest = np.diag(covariance) - np.sum(factor**2, axis=1)
    return np.asarray(factor), np.maximum(rest, 0.0)


def _at(array: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    if array.ndim == 2:
        return np.asarray(array[np.ix_(rows, rows)])
    return np.asarray(array[rows]) if array.size else array


def _load(file: Path) -> tuple[FloatArray, FloatArray] | None:
    """What was kept; None where nothing was, or where the file cannot be read."""
    import zipfile

    try:
        with np.load(file) as found:
            return np.asarray(found["first"], dtype=float), np.asarray(found["second"], dtype=float)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _save(file: Path, arrays: Sequence[FloatArray]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=file.parent, suffix=".npz")
    with os.fdopen(handle, "wb") as stream:
        np.savez_compressed(stream, first=arrays[0], second=arrays[1])
    os.replace(name, file)


def _dataset(run: Observation) -> xr.Dataset:
    return xr.Dataset(coords={name: ("point", column) for name, column in run.columns.items()})


__all__ = ["Bench", "Inputs", "Prepared", "low_rank", "unplaced"]
