"""Makes a run ready for the diagnosis: prediction, responses to every effect, and what the budget allows.

All of it depends on the configuration and the geometries alone, and is kept on disk by content: a second run of the
same plan needs no ray.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr

from instrument.angles import FloatArray, direction
from instrument.artifact import ArtifactDimensions, read_artifact, without_holes
from instrument.errors import InputError
from instrument.facility import Facility, read_facility
from twin.diagnosis.acquisition import acquisition_of
from twin.diagnosis.covariance import over_directions
from twin.diagnosis.effects import Effect
from twin.diagnosis.nuisance import budget_columns
from twin.diagnosis.observation import Observation
from twin.diagnosis.plausible import check_plausible, flat_reflectance
from twin.diagnosis.problem import Problem
from twin.diagnosis.renders import RenderStore
from twin.diagnosis.responses import Responses, responses
from twin.diagnosis.store import PointStore
from twin.diagnosis.turned import from_sample
from twin.diagnosis.workbench import Workbench
from twin.input_uncertainty import find_input_uncertainty
from twin.material import read_material
from twin.prediction import Twin
from twin.propagation_result import Propagation
from twin.state_vector import StateVector, coupon_of, state_vector

#: Relative Monte Carlo error of the nominal prediction.
STANDARD_ERROR = 0.001
#: Components of the inputs' covariance that are kept; the rest counts as independent.
_COMPONENTS = 40
#: Relative standard deviation of what interpolation between the coupon's geometries leaves, and over how many degrees.
MODEL_ERROR, MODEL_LENGTH = 0.002, 20.0
#: The same at exact retro-reflection (what held-out readings there show), and the angle at which it has fallen to 1/e.
RETRO_ERROR, RETRO_LENGTH = 0.01, 8.0
#: Raised whenever the same inputs would give other nominal predictions.
VERSION = 2
#: Relative standard error of the inputs' part of the uncertainty.
_TOLERANCE = 0.2
_PREDICTED = ("brf", "u_brf_monte_carlo")
#: Sources of errors of the sample that no effect's response stands for.
_UNPLACED = ("hole dimensions", "edge chamfer", "block tilt")
#: How sources and blocks are named that are errors of the coupon.
COATING = "material"
Told = Callable[[str, float], None]


@dataclass(frozen=True)
class Inputs:
    """Files of the nominal twin."""

    facility: Path
    artifact: Path
    material: Path


@dataclass(frozen=True)
class Prepared:
    """A run made ready, and how every effect acts on it.

    Attributes
    ----------
    budget
        Columns of the problem's budget that come from effects, by label.
    inputs, facility
        Files of the twin, and its instrument; None where it came from elsewhere, the instrument also for several runs.
    """

    problem: Problem
    responses: Responses
    budget: dict[str, FloatArray]
    inputs: Inputs | None = None
    facility: Facility | None = None


class Bench:
    """Prepares runs of one configuration.

    Parameters
    ----------
    inputs
        Files of the nominal twin.
    cache
        Folder in which renderings are kept.
    artifact
        In place of that of the file.

    Raises
    ------
    InputError
        For a file that is wrong, or a sample of several materials.
    """

    def __init__(self, inputs: Inputs, cache: Path, artifact: ArtifactDimensions | None = None) -> None:
        self.inputs, self.cache = inputs, cache
        self.facility = read_facility(inputs.facility)
        self.artifact = artifact or read_artifact(inputs.artifact)
        self.material = read_material(inputs.material)
        if self.material.materials > 1:
            raise InputError(
                f"{inputs.material}: found {self.material.materials} materials on the sample's surfaces; expected one"
                " for all of them: responses of effects to several are not known"
            )
        self.workbench = Workbench(self.facility, self.artifact, self.material)
        self.store = RenderStore(self.workbench, cache)
        self._predictions = PointStore(cache / "nominal", _PREDICTED)

    def flat(self) -> Bench:
        """The same for a flat sample of the same material: its coupon."""
        return Bench(self.inputs, self.cache, without_holes(self.artifact))

    def prepare(
        self, run: Observation, told: Told | None = None, *, effects: Iterable[Effect] | None = None
    ) -> Prepared:
        """Predict a run, and find out what effects and budget do to it.

        Parameters
        ----------
        effects
            By default the whole library.

        Raises
        ------
        InputError
            For a run of another sample, or in another unit.
        """
        tell = told or (lambda what, share: None)
        tell("nominal prediction", 0.0)
        nominal, u_nominal = self.nominal(run)
        check_plausible(run, nominal, flat_reflectance(self.material, run))
        covariance = self.input_covariance(run, lambda what, share: tell(what, 0.1 + 0.3 * share))
        tell("what every effect does", 0.4)

        def step(done: int, total: int) -> None:
            tell(f"what every effect does: {done} of {total} scenes", 0.4 + 0.6 * done / max(total, 1))

        acquisition = acquisition_of(run, self.facility)
        found = responses(acquisition, nominal, self.store, effects=effects, progress=step)
        columns = budget_columns(found.found, run)
        factor, rest = low_rank(covariance)
        budget = np.concatenate([np.stack(list(columns.values()), axis=1), factor, model_error(run)], axis=1)
        u_own = np.sqrt(u_nominal**2 + rest)
        problem = Problem.of(run, nominal, u_own, budget, list(found.found.values()))
        return Prepared(problem, found, columns, self.inputs, self.facility)

    def nominal(self, run: Observation) -> tuple[FloatArray, FloatArray]:
        """Predicted reflectance factors and their relative standard error by the ray tracer, shape (point,) each."""

        def predict(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
            twin = Twin(self.facility, self.artifact, self.material)
            found = twin.predict(_dataset(columns), standard_error=STANDARD_ERROR)
            return {name: np.asarray(found[name].values, dtype=float) for name in _PREDICTED}

        content = f"{VERSION} {STANDARD_ERROR} {self.workbench.digest()}"
        brf, u_brf = self._predictions.get(content, from_sample(run.columns), predict).values()
        return brf, u_brf / brf

    def input_covariance(self, run: Observation, told: Told | None = None) -> FloatArray:
        """Relative covariance of the prediction from the errors of coupon and holes, shape (point, point)."""
        found = self.input_errors(run, told)
        if found is None:
            return np.zeros((len(run), len(run)))
        return np.asarray(found.covariance() / np.outer(found.brf, found.brf))

    def input_errors(self, run: Observation, told: Told | None = None) -> Propagation | None:
        """What the errors of coupon and holes do to the prediction; None where none are stated."""
        state = self.state()
        if not state.blocks:
            return None
        tell = told or (lambda what, share: None)

        def step(what: str, done: int, total: int) -> None:
            tell(f"what the inputs' uncertainties do: {what}", done / max(total, 1))

        return find_input_uncertainty(
            state, _dataset(from_sample(run.columns)), folder=self.cache, tolerance=_TOLERANCE, progress=step
        ).result

    def state(self) -> StateVector:
        """The uncertain inputs that have no response of their own: coupon and single holes."""
        coupon = coupon_of(self.inputs.material)
        return unplaced(state_vector(self.facility, self.artifact, self.material, coupon, by_direction=True))


def unplaced(state: StateVector) -> StateVector:
    """The state vector without what has a response of its own: placement, instrument, and dimensions of all holes."""
    kept = (block for block in state.blocks if block.source in _UNPLACED or block.name.startswith(COATING))
    return replace(state, blocks=tuple(kept))


def model_error(run: Observation) -> FloatArray:
    """What the twin's reflection model leaves: columns, shape (point, column).

    Smooth over directions, and more towards retro-reflection, where no coupon can be measured. A coating that reflects
    alike all around has the same error where the sample is turned.
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


def _dataset(columns: dict[str, FloatArray]) -> xr.Dataset:
    return xr.Dataset(coords={name: ("point", column) for name, column in columns.items()})


__all__ = ["Bench", "Inputs", "Prepared", "low_rank", "unplaced"]
