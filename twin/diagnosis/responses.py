"""What an effect does to the readings of a run, for any values of its parameters.

Effects that are rendered are tabulated on nodes and interpolated by splines through the logarithm of the ratio to the
nominal twin; an effect on the reading is computed. All have the form :class:`Response`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects import (
    AzimuthEffect,
    Effect,
    Known,
    Parameter,
    ReadingEffect,
    SceneEffect,
    ZenithEffect,
    library,
)
from twin.diagnosis.renders import Rendered, RenderStore
from twin.diagnosis.variation import Variation
from twin.diagnosis.workbench import Progress, Workbench
from twin.optics import Setup

#: Errors of the sensor zenith that are rendered, degree; closer near 0, where most effects are.
ZENITH_NODES = np.array([-5.0, -3.0, -1.8, -0.9, 0.0, 0.9, 1.8, 3.0, 5.0])
#: Errors of the sensor azimuth that are rendered, degree.
AZIMUTH_NODES = np.array([-15.0, -7.5, 0.0, 7.5, 15.0])
#: Least relative reading: the logarithm of nothing is no number.
_LEAST = 1e-5
_STEP = 1e-3
IntArray = NDArray[np.int64]


class Response(Protocol):
    """One effect in one run."""

    @property
    def effect(self) -> Effect:
        """The effect."""
        ...

    @property
    def name(self) -> str:
        """Of the effect."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, with budgets and caps for these inputs."""
        ...

    @property
    def catalogued(self) -> bool:
        """Whether the data contract names the effect."""
        ...

    @property
    def shapes(self) -> int:
        """Values of every parameter of shape from which fits start."""
        ...

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """Logarithm of the reading with the effect over that without, shape (n, point); values (n, parameter)."""
        ...

    def apply(self, brf: FloatArray, values: FloatArray) -> FloatArray:
        """Reading with the effect, where without it ``brf`` (..., point) is read; values (..., parameter)."""
        ...


@dataclass(frozen=True)
class _Common:
    effect: Effect
    parameters: tuple[Parameter, ...]

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def catalogued(self) -> bool:
        """Of the effect."""
        return self.effect.catalogued

    @property
    def shapes(self) -> int:
        """Of the effect."""
        return self.effect.shapes

    @property
    def nominal(self) -> FloatArray:
        """Values without effect, shape (parameter,)."""
        return np.array([parameter.nominal for parameter in self.parameters])

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """Logarithm of the ratio, shape (n, point), at values of shape (n, parameter)."""
        raise NotImplementedError

    def relative(self, values: FloatArray) -> FloatArray:
        """Relative change of the reading, shape (n, point), at values of shape (n, parameter)."""
        return np.asarray(np.expm1(self.log_ratio(values)))

    def apply(self, brf: FloatArray, values: FloatArray) -> FloatArray:
        """Reading with the effect, shape (..., point)."""
        flat = np.reshape(values, (-1, len(self.parameters)))
        ratio = np.exp(self.log_ratio(flat))
        return np.asarray(brf * ratio.reshape(*np.shape(values)[:-1], ratio.shape[-1]))

    def derivative(self) -> FloatArray:
        """Derivative of :meth:`log_ratio` at the nominal values, shape (parameter, point), a unit of each parameter.

        One-sided where the nominal value is a cap. A parameter of shape has none where the effect vanishes.
        """
        rows = []
        for number, parameter in enumerate(self.parameters):
            step = _STEP * parameter.typical
            values = np.tile(self.nominal, (2, 1))
            values[0, number] = min(parameter.nominal + step, parameter.cap[1])
            values[1, number] = max(parameter.nominal - step, parameter.cap[0])
            high, low = self.log_ratio(values)
            rows.append((high - low) / (values[0, number] - values[1, number]))
        return np.array(rows)


@dataclass(frozen=True)
class TabulatedResponse(_Common):
    """An effect that is rendered on nodes.

    Attributes
    ----------
    axes
        Nodes of each parameter.
    table, u_table, shape (node, ..., node, point)
        Logarithm of the ratio to the nominal twin, and the ray tracer's standard error.
    """

    axes: tuple[FloatArray, ...]
    table: FloatArray
    u_table: FloatArray

    def log_ratio(self, values: FloatArray) -> FloatArray:
        weights = [spline(column) for spline, column in zip(self._splines, self._inside(values).T, strict=True)]
        result = weights[0] @ self.table.reshape(len(self.axes[0]), -1)
        for weight in weights[1:]:
            result = result.reshape(len(values), weight.shape[1], -1)
            result = np.einsum("nk,nkm->nm", weight, result)
        return np.asarray(result.reshape(len(values), -1))

    def _inside(self, values: FloatArray) -> FloatArray:
        low, high = np.array([parameter.cap for parameter in self.parameters]).T
        return np.clip(values, low, high)

    def again(self, run: Acquisition, rows: IntArray) -> TabulatedResponse:
        """The response where some of the points are read again."""
        return replace(self, table=self.table[..., rows], u_table=self.u_table[..., rows])

    @cached_property
    def _splines(self) -> list[BSpline]:
        return [cardinal_spline(axis) for axis in self.axes]


@dataclass(frozen=True)
class ZenithResponse(_Common):
    """An effect that moves the sensor arm: every point is looked up at its own error.

    Attributes
    ----------
    table, shape (node, point)
        Over :data:`ZENITH_NODES`.
    reference
        Change of the reference reading by a setup.
    """

    run: Acquisition
    table: FloatArray
    u_table: FloatArray
    reference: Callable[[Setup], float]

    def log_ratio(self, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, ZenithEffect)
        error = np.clip(self.effect.zenith_error(self.run, values), ZENITH_NODES[0], ZENITH_NODES[-1])
        weights = cardinal_spline(ZENITH_NODES)(error)
        result = np.einsum("npk,kp->np", weights, self.table)
        return np.asarray(result - self._reference_log(values)[:, None])

    def again(self, run: Acquisition, rows: IntArray) -> ZenithResponse:
        """The response where some of the points are read again, in their order in ``run``."""
        return replace(self, run=run, table=self.table[:, rows], u_table=self.u_table[:, rows])

    def _reference_log(self, values: FloatArray) -> FloatArray:
        """Logarithm of the change of the reference reading, shape (n,)."""
        assert isinstance(self.effect, ZenithEffect)
        setups = [self.effect.reference_setup(row, self.run.reference_zenith) for row in values]
        errors = np.array([float(setup.sensor_zenith_deg) for setup in setups])
        return np.asarray(self._reference_spline(np.clip(errors, ZENITH_NODES[0], ZENITH_NODES[-1])))

    @cached_property
    def _reference_spline(self) -> BSpline:
        logs = [np.log(self.reference(Setup(sensor_zenith_deg=float(node)))) for node in ZENITH_NODES]
        return make_interp_spline(ZENITH_NODES, np.array(logs), k=3)


@dataclass(frozen=True)
class AzimuthResponse(_Common):
    """An effect that turns the sensor: every point is looked up at its own error.

    The reference counts as read alike from every azimuth.

    Attributes
    ----------
    table, shape (node, point)
        Over :data:`AZIMUTH_NODES`.
    """

    run: Acquisition
    table: FloatArray
    u_table: FloatArray

    def log_ratio(self, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, AzimuthEffect)
        error = np.clip(self.effect.azimuth_error(self.run, values), AZIMUTH_NODES[0], AZIMUTH_NODES[-1])
        return np.asarray(np.einsum("npk,kp->np", cardinal_spline(AZIMUTH_NODES)(error), self.table))

    def again(self, run: Acquisition, rows: IntArray) -> AzimuthResponse:
        """The response where some of the points are read again, in their order in ``run``."""
        return replace(self, run=run, table=self.table[:, rows], u_table=self.u_table[:, rows])


@dataclass(frozen=True)
class ComputedResponse(_Common):
    """An effect on the reading.

    Attributes
    ----------
    brf, shape (point,)
        What the nominal twin reads.
    """

    run: Acquisition
    brf: FloatArray

    def again(self, run: Acquisition, rows: IntArray) -> ComputedResponse:
        """The response where some of the points are read again, in their order in ``run``."""
        return replace(self, run=run, brf=self.brf[rows])

    def apply(self, brf: FloatArray, values: FloatArray) -> FloatArray:
        assert isinstance(self.effect, ReadingEffect)
        return self.effect.reading(self.run, brf, values)

    def log_ratio(self, values: FloatArray) -> FloatArray:
        ratio = self.apply(self.brf, values) / self.brf
        return np.asarray(np.log(np.maximum(ratio, _LEAST)))


AnyResponse = TabulatedResponse | ZenithResponse | AzimuthResponse | ComputedResponse


@dataclass(frozen=True)
class Responses:
    """Responses of a run to all effects that it can show.

    Attributes
    ----------
    found
        By name of the effect.
    ruled_out
        Why an effect has none: what the run's file lacks, or why the sample or the instrument cannot have it.
    """

    found: dict[str, AnyResponse]
    ruled_out: dict[str, str]


def responses(
    run: Acquisition,
    brf: FloatArray,
    store: RenderStore,
    *,
    effects: Iterable[Effect] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Responses:
    """Responses of a run's points to effects.

    Parameters
    ----------
    brf, shape (point,)
        What the nominal twin predicts.
    effects
        By default the whole library.
    progress
        Told how many variations of how many are rendered.
    """
    chosen = list(library().values() if effects is None else effects)
    known, ruled_out, usable = store.workbench.known, {}, []
    for effect in chosen:
        missing = effect.missing(run)
        reason = effect.not_applicable(known) or (f"the run says nothing of {', '.join(missing)}" if missing else "")
        if reason:
            ruled_out[effect.name] = reason
        else:
            usable.append(effect)
    plans = {effect.name: _Plan.of(effect, known, run) for effect in usable}
    groups = {plan.table: plan.variations for plan in plans.values() if plan.variations}
    rendered = dict(zip(groups, _get(store, list(groups.values()), run, progress), strict=True))
    found = {plan.effect.name: _response(plan, rendered, run, brf, store.workbench) for plan in plans.values()}
    return Responses(found, ruled_out)


def _get(
    store: RenderStore, groups: list[list[Variation]], run: Acquisition, progress: Callable[[int, int], None] | None
) -> list[Rendered]:
    total, done = store.missing(groups, run.columns) if progress is not None else 0, 0

    def step(count: int) -> None:
        nonlocal done
        done += count
        assert progress is not None
        progress(min(done, total), total)

    counting: Progress | None = None if progress is None else step
    return store.get(groups, run.columns, counting)


@dataclass(frozen=True)
class _Plan:
    """What an effect needs rendered."""

    effect: Effect
    parameters: tuple[Parameter, ...]
    axes: tuple[FloatArray, ...]
    variations: list[Variation]
    table: str

    @classmethod
    def of(cls, effect: Effect, known: Known, run: Acquisition) -> _Plan:
        parameters = effect.resolve(known, run)
        if isinstance(effect, SceneEffect):
            axes = effect.axes(parameters)
            return cls(
                effect, parameters, axes, [effect.variation(np.array(row)) for row in product(*axes)], effect.name
            )
        if isinstance(effect, ZenithEffect):
            zenith = [Variation(Setup(sensor_zenith_deg=float(node)), reference=Setup()) for node in ZENITH_NODES]
            return cls(effect, parameters, (), zenith, "sensor zenith")
        if isinstance(effect, AzimuthEffect):
            azimuth = [Variation(Setup(sensor_azimuth_deg=float(node))) for node in AZIMUTH_NODES]
            return cls(effect, parameters, (), azimuth, "sensor azimuth")
        return cls(effect, parameters, (), [], "")


def _response(
    plan: _Plan, rendered: dict[str, Rendered], run: Acquisition, brf: FloatArray, workbench: Workbench
) -> AnyResponse:
    if isinstance(plan.effect, ReadingEffect):
        return ComputedResponse(plan.effect, plan.parameters, run, brf)
    own = rendered[plan.table]
    log_ratio = own.log_ratio(run.columns)
    if isinstance(plan.effect, ZenithEffect):
        change = workbench.reference_change
        return ZenithResponse(plan.effect, plan.parameters, run, log_ratio, own.u, change)
    if isinstance(plan.effect, AzimuthEffect):
        return AzimuthResponse(plan.effect, plan.parameters, run, log_ratio, own.u)
    shape = [len(axis) for axis in plan.axes]
    reference = np.array([np.log(workbench.reference_change(v.reference_setup())) for v in plan.variations])
    table = (log_ratio - reference[:, None]).reshape(*shape, -1)
    return TabulatedResponse(plan.effect, plan.parameters, plan.axes, table, own.u.reshape(*shape, -1))


def cardinal_spline(nodes: FloatArray) -> BSpline:
    """Splines through 1 at one node and 0 at the others, one a node; cubic where there are nodes enough.

    Calling it with x of shape (...) gives the weights of the nodes, shape (..., node).
    """
    return make_interp_spline(nodes, np.eye(len(nodes)), k=min(3, len(nodes) - 1))
