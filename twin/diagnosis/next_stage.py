"""Geometries that a next scan may read: what the twin predicts there, and what effects and budget do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray, direction
from twin.diagnosis.acquisition import Acquisition, acquisition_of, travel_direction
from twin.diagnosis.coupon_run import prepare_coupon, table_errors
from twin.diagnosis.covariance import INDEPENDENT
from twin.diagnosis.effects import Effect
from twin.diagnosis.joint import OF_A_MOUNTING, OF_A_RUN
from twin.diagnosis.observation import Observation
from twin.diagnosis.plausible import flat_reflectance
from twin.diagnosis.preparation import model_error
from twin.diagnosis.response import AnyResponse, Response
from twin.diagnosis.turned import alike, rotation
from twin.diagnosis.white_reference import prepare_white

if TYPE_CHECKING:
    from instrument.facility import Facility
    from twin.diagnosis.preparation import Bench, Prepared

IntArray = NDArray[np.int64]
#: What may lie on the stage in place of the sample.
WHITE, COUPON = "white reference", "flat coupon"
#: Slack of the rule for points in the shadow of the detector head, degree.
_SLACK = 1e-6


@dataclass(frozen=True)
class Stage:
    """Geometries of which everything is known that a scan of them depends on.

    Attributes
    ----------
    observation, shape (point,)
        What would be read if nothing were wrong; the first ``of_run`` points are those of the run.
    acquisition
        How these points would be taken; a scan of some of them has its own order.
    responses
        Of every effect at these points.
    labelled
        Columns of the budget that belong to one input each.
    unlabelled, shape (point, column)
        The other columns: errors of the coupon and of the reflection model, the same in all scans.
    u_nominal, shape (point,)
        Relative standard error of the prediction by the ray tracer.
    of_run
        How many of the points the run has read.
    sample
        What lies on the stage in place of the run's sample; empty for the sample itself.
    """

    observation: Observation
    acquisition: Acquisition
    responses: dict[str, AnyResponse]
    labelled: dict[str, FloatArray]
    unlabelled: FloatArray
    u_nominal: FloatArray
    of_run: int
    sample: str = ""

    @classmethod
    def of(cls, prepared: Prepared, facility: Facility, of_run: int | None = None) -> Stage:
        """The geometries of a prepared run, of which the first so many (all by default) were read."""
        problem = prepared.problem
        return cls(
            problem.run,
            acquisition_of(problem.run, facility),
            prepared.responses.found,
            prepared.budget,
            problem.budget[:, len(prepared.budget) :],
            problem.u_nominal,
            len(problem.run) if of_run is None else of_run,
        )

    @property
    def shared_labels(self) -> tuple[str, ...]:
        """Labels of the columns whose errors are the same in the run and in a scan after it."""
        return tuple(label for label in self.labelled if not label.startswith(OF_A_RUN + OF_A_MOUNTING))

    def shared(self, labels: Sequence[str], width: int) -> FloatArray:
        """Columns of these labels and so many unlabelled ones, zeros where there are none, shape (point, column)."""
        nothing = np.zeros(len(self.observation))
        columns = np.zeros((len(self.observation), len(labels) + width))
        for number, label in enumerate(labels):
            columns[:, number] = self.labelled.get(label, nothing)
        columns[:, len(labels) : len(labels) + self.unlabelled.shape[1]] = self.unlabelled
        return columns

    def own(self, labels: Sequence[str]) -> FloatArray:
        """Columns of all other labels: errors that are drawn anew for every scan, such as those of the placement."""
        kept = [column for label, column in self.labelled.items() if label not in labels]
        return np.stack(kept, axis=1) if kept else np.zeros((len(self.observation), 0))


def wider(
    bench: Bench, run: Observation, columns: dict[str, FloatArray], effects: Sequence[Effect] | None = None
) -> Stage:
    """The geometries of a run and others, rendered where they are not known yet.

    Parameters
    ----------
    columns
        Commanded geometries that the run lacks.
    effects
        By default the whole library.
    """
    prepared = bench.prepare(extended(run, columns, bench), effects=effects)
    return Stage.of(prepared, bench.facility, len(run))


def white_stage(bench: Bench, run: Observation, effects: Sequence[Effect]) -> Stage:
    """The white reference at the run's sensor directions, one illumination zenith; nothing is rendered."""
    some = run.take(one_illumination(run))
    factor = bench.facility.reference.reflectance_factor
    reading = _reads(some, np.full(len(some), factor))
    prepared = prepare_white(bench, reading, effects)
    found = Stage.of(prepared, bench.facility, 0)
    return replace(found, unlabelled=np.zeros((len(some), 0)), sample=WHITE)


def coupon_stage(bench: Bench, run: Observation, shown: Iterable[Response]) -> Stage:
    """The flat coupon at the run's sensor directions, one illumination zenith.

    Errors of the coupon run that the material was made from count as new ones, which only lessens what is expected.

    Parameters
    ----------
    shown
        Effects in question, as the run of the sample shows them.
    """
    some = run.take(one_illumination(run))
    reading = _reads(some, flat_reflectance(bench.material, some))
    prepared = prepare_coupon(bench.flat(), reading, shown)
    errors = [change for _, change in table_errors(bench, reading)]
    columns = [*errors, *model_error(reading).T]
    own = {f"scale and form of the table {number}": column for number, column in enumerate(columns)}
    found = Stage.of(prepared, bench.facility, 0)
    return replace(found, labelled=found.labelled | own, unlabelled=np.zeros((len(some), 0)), sample=COUPON)


def one_illumination(run: Observation) -> IntArray:
    """Points of the usual rotation of the sample, and of the illumination zenith with most of them."""
    light, usual = run.columns["illumination_zenith"], rotation(run.columns) == usual_rotation(run)
    values, counts = np.unique(np.round(light[usual], 6), return_counts=True)
    return np.flatnonzero(usual & (np.abs(light - values[np.argmax(counts)]) < 1e-6))


def usual_rotation(run: Observation) -> float:
    """How far the sample was turned at most of the points, degree."""
    values, counts = np.unique(rotation(run.columns), return_counts=True)
    return float(values[np.argmax(counts)])


def _reads(run: Observation, brf: FloatArray) -> Observation:
    """Another sample at the points of a run, as uncertain relative to its readings."""
    ratio = brf / run.brf
    components = {name: u * ratio for name, u in run.components.items()}
    return replace(run, brf=brf, u_brf=run.u_brf * ratio, components=components, signal_v=None)


def extended(run: Observation, columns: dict[str, FloatArray], bench: Bench) -> Observation:
    """The run, and behind it other geometries that read what is predicted, as uncertain as the run's most like them.

    Most like are points of the nearest sensor zenith without its sign: budgets grow towards grazing views. The gain is
    that of the run's point with the nearest predicted signal.
    """
    count, more = len(run), len(columns["sensor_zenith"])
    here, there = alike([run.columns, columns])
    everywhere = {name: np.concatenate([column, there[name]]) for name, column in here.items()}
    zenith = np.abs(run.columns["sensor_zenith"])
    like = np.argmin(np.abs(zenith[:, None] - np.abs(columns["sensor_zenith"])), axis=0)
    blank = Observation(
        run.name,
        np.arange(count + more),
        everywhere,
        np.ones(count + more),
        np.ones(count + more),
        {},
    )
    brf = bench.nominal(blank)[0]
    # Readings of the run itself stay: what is plausible is judged by them.
    brf[:count] = run.brf

    def relative(u: FloatArray) -> FloatArray:
        return np.concatenate([u, brf[count:] * (u / run.brf)[like]])

    found = replace(
        blank,
        brf=brf,
        u_brf=relative(run.u_brf),
        components={name: relative(u) for name, u in run.components.items()},
        seconds=_following(run.seconds, more),
        reference_v=run.reference_v,
        reference_gain=run.reference_gain,
    )
    if run.gain is None:
        return found
    signal = brf * acquisition_of(found, bench.facility).signal_per_brf
    near = np.argmin(np.abs(np.log(signal[:count, None] / signal[count:])), axis=0)
    return replace(found, gain=np.concatenate([run.gain, run.gain[near]]))


def _following(seconds: FloatArray | None, more: int) -> FloatArray | None:
    if seconds is None:
        return None
    each = float(np.median(np.diff(np.sort(seconds)))) if len(seconds) > 1 else 1.0
    return np.concatenate([seconds, seconds.max() + each * np.arange(1, more + 1)])


def unshadowed(columns: dict[str, FloatArray], half_angle: float) -> dict[str, FloatArray]:
    """Geometries at which the detector head leaves the beam free."""
    light = direction(columns["illumination_zenith"], columns["illumination_azimuth"])
    view = direction(columns["sensor_zenith"], columns["sensor_azimuth"])
    angle = np.rad2deg(2 * np.arcsin(np.clip(np.linalg.norm(light - view, axis=1) / 2, 0.0, 1.0)))
    free = angle >= half_angle - _SLACK
    return {name: column[free] for name, column in columns.items()}


def read_again(stage: Stage, rows: IntArray, light: float = 1.0) -> Observation:
    """What a scan of some of the points reads if nothing is wrong; a detector's noise stays where the light is less."""
    chosen = stage.observation.take(rows)
    components = dict(chosen.components)
    if INDEPENDENT in components:
        components[INDEPENDENT] = components[INDEPENDENT] / light
    return replace(chosen, components=components, seconds=np.arange(len(rows), dtype=float), signal_v=None)


def taken_again(stage: Stage, rows: IntArray, light: float = 1.0) -> Acquisition:
    """How a scan of some of the points is taken, in this order."""
    whole, count = stage.acquisition, len(rows)
    columns = {name: column[rows] for name, column in whole.columns.items()}
    order = np.arange(count)
    current = whole.reference_current
    return replace(
        whole,
        columns=columns,
        signal_per_brf=whole.signal_per_brf[rows],
        previous=np.concatenate([order[:1], order[:-1]]),
        travel=travel_direction(columns, order),
        progress=None if whole.progress is None else np.linspace(0.0, 1.0, count),
        gain=None if whole.gain is None else whole.gain[rows],
        reference_current=None if current is None else current * light,
    )


def geometries(
    wavelength: float, lights: Sequence[float], azimuths: Sequence[float], zeniths: FloatArray
) -> dict[str, FloatArray]:
    """Every combination, the sensor zenith fastest, as columns."""
    grid = np.meshgrid([wavelength], lights, [0.0], azimuths, zeniths, indexing="ij")
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_azimuth", "sensor_zenith")
    return {name: np.asarray(axis.ravel(), dtype=float) for name, axis in zip(names, grid, strict=True)}
