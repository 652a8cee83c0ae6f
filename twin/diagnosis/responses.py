"""What every effect does to the readings of a run, for any values of its parameters.

Effects that are rendered are tabulated on nodes and interpolated by splines through the logarithm of the ratio to the
nominal twin; an effect on the reading is computed. All have the form :class:`~twin.diagnosis.response.Response`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects import (
    AzimuthEffect,
    Effect,
    JoinedEffect,
    Known,
    Parameter,
    ReadingEffect,
    SceneEffect,
    TopEffect,
    ZenithEffect,
    effect,
    library,
)
from twin.diagnosis.renders import Rendered, RenderStore
from twin.diagnosis.response import (
    AZIMUTH_NODES,
    ZENITH_NODES,
    AnyResponse,
    AzimuthResponse,
    ComputedResponse,
    JoinedResponse,
    TabulatedResponse,
    TopResponse,
    ZenithResponse,
)
from twin.diagnosis.top_light import top_light
from twin.diagnosis.turned import from_sample, rotation, seen_turned, turns
from twin.diagnosis.variation import Variation
from twin.diagnosis.workbench import Progress, Workbench
from twin.optics import Setup
from twin.surface_mesh import Surface

#: Reflectance of the plate's top over nominal that tells which share of a reading it sends.
_DIMMED = 0.8


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
    for one in chosen:
        missing = one.missing(run)
        reason = one.not_applicable(known) or (f"the run says nothing of {', '.join(missing)}" if missing else "")
        if reason:
            ruled_out[one.name] = reason
        else:
            usable.append(one)
    plans = {one.name: _Plan.of(one, known, run) for one in usable}
    parts = {plan.part: _Plan.of(effect(plan.part), known, run) for plan in plans.values() if plan.part}
    groups = {plan.table: plan.variations for plan in (*plans.values(), *parts.values()) if plan.variations}
    rendered = _rendered(store, groups, run, progress)

    def response(plan: _Plan) -> AnyResponse:
        return _response(plan, rendered, run, brf, store.workbench)

    found = {name: response(plan) for name, plan in plans.items()}
    for name, plan in plans.items():
        if plan.part:
            found[name] = _joined(found[name], response(parts[plan.part]))
    return Responses(found, ruled_out)


@dataclass(frozen=True)
class _Table:
    """Logarithm of the readings over the nominal ones, and its standard error, shape (variation, point) each."""

    log_ratio: FloatArray
    u: FloatArray


@dataclass(frozen=True)
class _Batch:
    """Variations by table, to be rendered at the same points."""

    groups: dict[str, list[Variation]]
    rows: NDArray[np.int64]
    columns: dict[str, FloatArray]


def _rendered(
    store: RenderStore,
    groups: dict[str, list[Variation]],
    run: Acquisition,
    progress: Callable[[int, int], None] | None,
) -> dict[str, _Table]:
    """Tables by name. Geometries are rendered as the sample sees them, with what it sees of each variation."""
    batches = _batches(groups, run)
    total, done = 0, 0
    if progress is not None:
        total = sum(store.missing(list(batch.groups.values()), batch.columns) for batch in batches)

    def step(count: int) -> None:
        nonlocal done
        done += count
        assert progress is not None
        progress(min(done, total), total)

    counting: Progress | None = None if progress is None else step
    parts: dict[str, list[tuple[NDArray[np.int64], Rendered, FloatArray]]] = {name: [] for name in groups}
    for batch in batches:
        found = store.get(list(batch.groups.values()), batch.columns, counting)
        for name, one in zip(batch.groups, found, strict=True):
            parts[name].append((batch.rows, one, one.log_ratio(batch.columns)))
    tables = {}
    for name, some in parts.items():
        log_ratio, u = (np.empty((len(groups[name]), len(run))) for _ in range(2))
        for rows, one, logarithm in some:
            log_ratio[:, rows], u[:, rows] = logarithm, one.u
        tables[name] = _Table(log_ratio, u)
    return tables


def _batches(groups: dict[str, list[Variation]], run: Acquisition) -> list[_Batch]:
    """All points together; for each rotation of the sample its own points, where it sees other variations."""
    seen, turned = from_sample(run.columns), rotation(run.columns)
    angles = np.unique(turned)
    apart = [name for name, some in groups.items() if any(map(turns, some))] if np.any(angles) else []
    together = {name: some for name, some in groups.items() if name not in apart}
    found = [_Batch(together, np.arange(len(run)), seen)] if together else []
    for angle in angles if apart else ():
        rows = np.flatnonzero(turned == angle)
        mine = {name: [seen_turned(variation, float(angle)) for variation in groups[name]] for name in apart}
        found.append(_Batch(mine, rows, {name: column[rows] for name, column in seen.items()}))
    return found


@dataclass(frozen=True)
class _Plan:
    """What an effect needs rendered."""

    effect: Effect
    parameters: tuple[Parameter, ...]
    axes: tuple[FloatArray, ...]
    variations: list[Variation]
    table: str

    @property
    def part(self) -> str:
        """Name of the effect that it brings with it."""
        return self.effect.part if isinstance(self.effect, JoinedEffect) else ""

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
        if isinstance(effect, TopEffect):
            dimmed = Variation(surface_factor=((Surface.PLATE_TOP, _DIMMED),))
            return cls(effect, parameters, (), [dimmed], "plate top")
        return cls(effect, parameters, (), [], "")


def _joined(own: AnyResponse, part: AnyResponse) -> JoinedResponse:
    assert isinstance(own, TabulatedResponse)
    assert isinstance(part, TabulatedResponse)
    return JoinedResponse(own.effect, own.parameters, own.axes, own.table, own.u_table, part)


def _response(
    plan: _Plan, rendered: dict[str, _Table], run: Acquisition, brf: FloatArray, workbench: Workbench
) -> AnyResponse:
    if isinstance(plan.effect, ReadingEffect):
        return ComputedResponse(plan.effect, plan.parameters, run, brf)
    own = rendered[plan.table]
    log_ratio = own.log_ratio
    if isinstance(plan.effect, ZenithEffect):
        change = workbench.reference_change
        return ZenithResponse(plan.effect, plan.parameters, run, log_ratio, own.u, change)
    if isinstance(plan.effect, AzimuthEffect):
        return AzimuthResponse(plan.effect, plan.parameters, run, log_ratio, own.u)
    if isinstance(plan.effect, TopEffect):
        share = -np.expm1(log_ratio[0]) / (1 - _DIMMED)
        return TopResponse(plan.effect, plan.parameters, share, *top_light(workbench.known, from_sample(run.columns)))
    shape = [len(axis) for axis in plan.axes]
    reference = np.array([np.log(workbench.reference_change(v.reference_setup())) for v in plan.variations])
    table = (log_ratio - reference[:, None]).reshape(*shape, -1)
    return TabulatedResponse(plan.effect, plan.parameters, plan.axes, table, own.u.reshape(*shape, -1))
