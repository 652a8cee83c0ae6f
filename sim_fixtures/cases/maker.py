"""Making a case: a run with something wrong, and the truth about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.facility import Facility
from instrument.forms import read_form
from instrument.plan import Direction, Plan, PlanForm, make_plan
from sim_fixtures.cases.effects import Effect, Parameters, known_effects
from sim_fixtures.cases.families import FAMILIES
from sim_fixtures.cases.readings import Clean, Laboratory, Light, clean, light, noisy
from sim_fixtures.cases.world import World
from sim_fixtures.examples.coupon import Points, run_dataset
from sim_fixtures.reality import Coating, Imperfections

_TOLERANCE = 0.02  # of the severity found
_TRIALS = 6
_SMALLEST = 1e-3  # amplitude

#: Fields of the budget's errors that grow with ``nuisance``.
_NUISANCES = (
    "sample_tilt_x_deg",
    "sample_tilt_y_deg",
    "sample_azimuth_deg",
    "sample_height_mm",
    "sample_offset_x_mm",
    "sample_offset_y_mm",
    "illumination_zenith_offset_deg",
    "sensor_zenith_offset_deg",
    "sensor_azimuth_offset_deg",
    "beam_divergence_deg",
    "dimension_errors",
    "polarization",
)


@dataclass(frozen=True)
class Truth:
    """What was wrong in a case.

    Attributes
    ----------
    effects
        Parameters of every effect by its name, as added to the errors of the budget.
    outside
        Names of those that belong to no library.
    brf_true
        What a noise-free instrument reads, with the budget's errors and the effects, shape (point,).
    delta
        Relative change by the effects alone, shape (point,).
    gap_over_u
        Root mean square of ``delta`` over the relative combined standard uncertainty.
    where
        Points at which ``delta`` exceeds that uncertainty.
    asked
        Severity that was asked for; None for given parameters. Amplitudes end at physical caps: ``gap_over_u`` may
        be less.
    amplitudes
        Of every effect, in units of its draw; empty for given parameters.
    noise_family, scan_direction, nuisance, seed
        As given.
    budget_errors
        What was drawn within the budget.
    """

    effects: dict[str, Parameters]
    outside: tuple[str, ...]
    brf_true: FloatArray
    delta: FloatArray
    gap_over_u: float
    where: tuple[int, ...]
    asked: float | None
    amplitudes: dict[str, float]
    noise_family: str
    scan_direction: str
    nuisance: float
    seed: int
    budget_errors: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """For a file of labels."""
        fields = asdict(self)
        fields["brf_true"] = [round(float(value), 7) for value in self.brf_true]
        fields["delta"] = [round(float(value), 7) for value in self.delta]
        return fields


@dataclass(frozen=True)
class _Chosen:
    """An effect with the parameters of this case."""

    effect: Effect
    parameters: Parameters
    amplitude: float | None = None

    def apply(self, world: World) -> World:
        return self.effect.apply(world, self.parameters)


def make_case(
    facility: Facility,
    artifact: ArtifactDimensions,
    coating: Coating,
    plan: Plan,
    effects: Mapping[str, Mapping[str, float] | None] | Sequence[str] = (),
    severity: float | None = None,
    *,
    seed: int,
    noise_family: str = "independent",
    scan_direction: Direction | None = None,
    nuisance: float = 1.0,
    rays: int = 16384,
) -> tuple[xr.Dataset, Truth]:
    """Measure an artifact with something wrong.

    Parameters
    ----------
    facility, artifact, coating, plan
        What is stated, and the true coating of the sound sample.
    effects
        Names, with parameters or without; without, they are drawn.
    severity
        Root mean square of the noise-free gap over the combined standard uncertainty, for every effect by itself;
        the parameters are then scaled. None: they are as given, or as drawn.
    seed
        Of every draw.
    noise_family
        Key of :data:`~sim_fixtures.cases.families.FAMILIES`.
    scan_direction
        ``unidirectional`` or ``serpentine``; None: the plan's own.
    nuisance
        Multiple of the errors that the budget allows.
    rays
        See :class:`~sim_fixtures.cases.readings.Laboratory`; 16384 leave 0.15 % (median over the points).

    Returns
    -------
    dataset, truth
        The run file of the data contract, all variables.

    Raises
    ------
    KeyError
        If an effect or a noise family is unknown.
    """
    laboratory = Laboratory(facility, artifact, coating, _swept(plan, facility, scan_direction), rays)
    return CaseMaker(laboratory).make(effects, severity, seed=seed, noise_family=noise_family, nuisance=nuisance)


class CaseMaker:
    """Makes cases of one laboratory.

    Parameters
    ----------
    laboratory
        Shared by the cases.
    """

    def __init__(self, laboratory: Laboratory) -> None:
        self.laboratory = laboratory

    def make(
        self,
        effects: Mapping[str, Mapping[str, float] | None] | Sequence[str] = (),
        severity: float | None = None,
        *,
        seed: int,
        noise_family: str = "independent",
        nuisance: float = 1.0,
    ) -> tuple[xr.Dataset, Truth]:
        """As :func:`make_case`."""
        family = FAMILIES[noise_family]
        laboratory = self.laboratory
        base = World(budget_errors(laboratory.facility, seed, nuisance))
        sound_light = light(laboratory, base, seed)
        sound = clean(laboratory, base, sound_light)
        generator = np.random.default_rng((seed, 11))
        search = _Search(laboratory, base, sound_light, sound, seed)
        given = effects if isinstance(effects, Mapping) else dict.fromkeys(effects)
        chosen = [search.choose(known_effects()[name], p, severity, generator) for name, p in given.items()]
        true = search.read(chosen)
        stability = laboratory.facility.budget.instrument_stability
        size = max(stability) if isinstance(stability, tuple) else stability
        drift = size * family(laboratory.moments, np.random.default_rng((seed, 12)))
        readings, reference, brf = noisy(laboratory, true, drift, np.random.default_rng((seed, 13)))
        points = Points.of(laboratory.plan)
        dataset = run_dataset(laboratory.facility, laboratory.plan, points, readings, reference, brf)
        return dataset, self._truth(chosen, true, sound, severity, noise_family, nuisance, seed, base)

    def _truth(
        self,
        chosen: list[_Chosen],
        true: Clean,
        sound: Clean,
        severity: float | None,
        noise_family: str,
        nuisance: float,
        seed: int,
        base: World,
    ) -> Truth:
        delta = true.brf / sound.brf - 1.0
        in_u = delta / self.laboratory.relative_uncertainty
        return Truth(
            effects={one.effect.name: one.parameters for one in chosen},
            outside=tuple(one.effect.name for one in chosen if one.effect.outside),
            brf_true=true.brf,
            delta=delta,
            gap_over_u=float(np.sqrt(np.mean(in_u**2))),
            where=tuple(int(i) for i in np.flatnonzero(np.abs(in_u) > 1.0)),
            asked=severity,
            amplitudes={one.effect.name: one.amplitude for one in chosen if one.amplitude is not None},
            noise_family=noise_family,
            scan_direction=self.laboratory.plan.direction,
            nuisance=nuisance,
            seed=seed,
            budget_errors=asdict(base.optics),
        )


class _Search:
    """Looks for amplitudes; keeps the light of the last world that was traced."""

    def __init__(self, laboratory: Laboratory, base: World, lit: Light, sound: Clean, seed: int) -> None:
        self._laboratory, self._base, self._sound_light, self._sound, self._seed = laboratory, base, lit, sound, seed
        self._last: tuple[World, Clean] | None = None

    def choose(
        self, effect: Effect, given: Mapping[str, float] | None, severity: float | None, generator: np.random.Generator
    ) -> _Chosen:
        """The effect with its parameters, scaled where a severity is asked for."""
        drawn = dict(given) if given is not None else effect.draw(generator)
        if severity is None:
            return _Chosen(effect, drawn)
        amplitude, trials = min(severity, effect.cap), []
        for _ in range(_TRIALS):
            one = _Chosen(effect, effect.scaled(drawn, amplitude), amplitude)
            found = self._severity(self.read([one]))
            trials.append((amplitude, found))
            if abs(found / severity - 1.0) < _TOLERANCE or (amplitude == effect.cap and found < severity):
                break
            amplitude = _next_amplitude(trials, severity, effect.cap)
        best = min(trials, key=lambda trial: abs(trial[1] - severity))[0]
        return _Chosen(effect, effect.scaled(drawn, best), best)

    def read(self, chosen: Sequence[_Chosen]) -> Clean:
        """Noise-free readings with effects."""
        if not chosen:
            return self._sound
        world = self._base
        for one in chosen:
            world = one.apply(world)
        key = replace(world, laws=())
        if not any(one.effect.optical for one in chosen):
            return clean(self._laboratory, world, self._sound_light)
        if len(chosen) == 1 and self._last is not None and self._last[0] == key:
            return self._last[1]
        result = clean(self._laboratory, world, light(self._laboratory, world, self._seed))
        self._last = (key, result) if len(chosen) == 1 else None
        return result

    def _severity(self, true: Clean) -> float:
        delta = true.brf / self._sound.brf - 1.0
        return float(np.sqrt(np.mean((delta / self._laboratory.relative_uncertainty) ** 2)))


def _next_amplitude(trials: list[tuple[float, float]], severity: float, cap: float) -> float:
    """By the power law through the last two trials, or in proportion after one."""
    amplitude, found = trials[-1]
    power = 1.0
    if len(trials) > 1:
        before, found_before = trials[-2]
        if before != amplitude and found > 0 and found_before > 0 and found != found_before:
            slope = np.log(found / found_before) / np.log(amplitude / before)
            power = float(np.clip(slope, 0.3, 4.0))
    step = (severity / max(found, 1e-9)) ** (1.0 / power)
    return float(np.clip(amplitude * np.clip(step, 0.1, 10.0), _SMALLEST, cap))


def budget_errors(facility: Facility, seed: int, nuisance: float = 1.0) -> Imperfections:
    """Errors of instrument, reference and placement that the budget allows, times ``nuisance``; no instability."""
    drawn = Imperfections.within_budget(facility, seed)
    scaled = {name: nuisance * getattr(drawn, name) for name in _NUISANCES}
    reference = 1.0 + nuisance * (drawn.reference_reflectance - 1.0)
    return replace(drawn, **scaled, reference_reflectance=reference, stability=0.0, stability_kind="none")


def _swept(plan: Plan, facility: Facility, direction: Direction | None) -> Plan:
    """The plan swept as asked."""
    if direction is None or direction == plan.direction:
        return plan
    form = read_form(Path(plan.source), PlanForm).model_copy(update={"direction": direction})
    return make_plan(form, facility, plan.source)
