"""How uncertain a prediction is because its inputs are: by sensitivities, and by Monte Carlo draws of all inputs.

Both ways evaluate the real twin with common random numbers and remove what is left of the ray tracer's noise: with
independent randomisations r and s of the same quantity, the mean of d_r d_s over r != s estimates its square without
bias, where the square of the mean would be too large by the squared standard error. So the uncertainty from the inputs
holds no Monte Carlo error, however few sight lines were traced.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.cluster import spread
from twin.propagation_designs import ROWS, STEP, Design, designs
from twin.propagation_render import Evaluation, PlanRenderer
from twin.propagation_result import Propagation, jackknife_error, left_out, relative_error, squares, variance_error

__all__ = ["DRAW_SAMPLES", "Progress", "Propagation", "by_draws", "by_sensitivities", "evaluate", "squares"]

#: Sight lines of a point in the first round, and at most.
_FIRST, _MOST = 256, 2**17
#: Each round gives the designs that limit the accuracy so many times more sight lines.
_MORE = 4
#: Points whose own error is so many times the tolerance are rendered anew, alone and with more sight lines each time: a
#: few joints of much weight can spoil a point while the median is good. So often, and at most this part of all points.
_WEAK, _MENDS, _FEW = 2.0, 3, 0.25
#: Draws that are evaluated in one go.
_CHUNK = 10
#: Sight lines of a point in a draw. The ray tracer's noise then adds a third to the scatter of the variance, nothing to
#: its mean; with twice as many the same time would hold a third fewer draws.
DRAW_SAMPLES = 512
#: Told what is being done, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class _Found:
    """What one design has shown: linear effects, and the quadratic one (both may be empty)."""

    effects: FloatArray
    curved: FloatArray
    noisy_curvature: bool

    @property
    def counted(self) -> FloatArray:
        """Effects whose squares make the variance: a quadratic one only where it stands out of the noise."""
        return self.effects if self.noisy_curvature else np.concatenate([self.effects, self.curved])

    def with_points(self, points: NDArray[np.int64], design: Design, differences: FloatArray) -> _Found:
        """With what other differences, shape (evaluation, len(points), randomisation), have shown for some points."""
        effects, curved = self.effects.copy(), self.curved.copy()
        effects[:, points] = design.effects(differences)
        quadratic = design.curved(differences)
        if quadratic is not None:
            curved[:, points] = quadratic
        return replace(self, effects=effects, curved=curved)


def by_sensitivities(
    renderer: PlanRenderer,
    *,
    tolerance: float = 0.05,
    seed: int = 1,
    rows: int = ROWS,
    step: float = STEP,
    address: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Propagation:
    """Propagate with finite differences of the twin.

    Single parameters are varied by sqrt(3) standard uncertainties both ways, which gives linear and quadratic effect
    (the three-point Gauss-Hermite rule: exact for a normal parameter up to the fourth moment); several of one source
    together along the orthogonal directions of a weighing design. Where the quadratic effect, over all points, is less
    than twice the ray tracer's noise in it, it counts as none.

    Parameters
    ----------
    renderer
        The plan and its state vector.
    tolerance
        Relative standard error of the uncertainty to reach at the median point, by more sight lines for the parameters
        that limit it, and twice that at the others, by more for those points.
    seed
        Of the signs in the weighing designs.
    rows, step
        As of :func:`~twin.propagation_designs.designs`.
    address, workers
        As of :func:`twin.cluster.spread`.
    progress
        Told what is being done.

    Notes
    -----
    GUM E.4.3: 200 draws know a standard uncertainty to 5 %.
    """
    plans = designs(renderer.state, seed, rows=rows, step=step)
    samples = dict.fromkeys(range(len(plans)), _FIRST)
    where = {"address": address, "workers": workers}
    found: dict[int, _Found] = {}
    todo, evaluations, turn, finest = list(samples), 0, 0, 0
    brf = np.zeros(renderer.points)
    while todo:
        turn += 1
        for level in sorted({samples[n] for n in todo}):
            chosen = [n for n in todo if samples[n] == level]
            told = None if progress is None else _telling(progress, f"sensitivities, round {turn}")
            nominal, differences = _vary(renderer, [plans[n] for n in chosen], level, told, where)
            evaluations += 1 + sum(map(len, differences))
            if level > finest:
                finest, brf = level, nominal
            found |= {n: _find(plans[n], d, nominal) for n, d in zip(chosen, differences, strict=True)}
        todo = _limiting(plans, found, samples, tolerance)
        samples |= {n: samples[n] * _MORE for n in todo}
    for turn in range(1, _MENDS + 1):
        weak = np.flatnonzero(_tracing_error(found) > _WEAK * tolerance)
        if not 0 < len(weak) <= _FEW * renderer.points:
            break
        some = renderer.take(weak, seed=renderer.seed + turn)
        for level in sorted(set(samples.values())):
            chosen = [n for n in samples if samples[n] == level]
            told = None if progress is None else _telling(progress, f"sensitivities, noisy points {turn}")
            more = min(_MOST, level * _MORE**turn)
            nominal, differences = _vary(some, [plans[n] for n in chosen], more, told, where)
            for n, own in zip(chosen, differences, strict=True):
                found[n] = found[n].with_points(weak, plans[n], own)
        brf[weak] = nominal
    return _collect(renderer, plans, found, brf, evaluations)


def _vary(
    renderer: PlanRenderer,
    plans: list[Design],
    samples: int,
    progress: Callable[[int, int], None] | None,
    where: dict[str, Any],
) -> tuple[FloatArray, list[FloatArray]]:
    """Reflectance factors at the nominal inputs, and the differences from them of every design."""
    values = [renderer.state.nominal, *(value for design in plans for value in design.values)]
    rendered = evaluate(renderer, values, samples, progress=progress, **where)
    ends = np.cumsum([len(design.values) for design in plans])
    return rendered[0].mean(axis=-1), np.split(rendered[1:] - rendered[0], ends[:-1])


def by_draws(
    renderer: PlanRenderer,
    *,
    draws: int = 500,
    samples: int = DRAW_SAMPLES,
    seed: int = 1,
    address: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Propagation:
    """Propagate by Monte Carlo: the whole plan for draws of the whole state vector (GUM Supplement 1).

    Parameters
    ----------
    draws
        At least 2.
    samples
        Sight lines of a point and draw.
    seed
        Of the draws.
    address, workers
        As of :func:`twin.cluster.spread`.
    """
    if draws < 2:
        raise ValueError(f"draws: found {draws}; expected at least 2")
    values = [renderer.state.nominal, *renderer.state.draw(seed, draws)]
    told = None if progress is None else _telling(progress, "draws")
    nominal, *others = evaluate(renderer, values, samples, address=address, workers=workers, progress=told)
    rendered = np.array(others)
    shift = rendered.mean(axis=0) - nominal
    deviations = (rendered - rendered.mean(axis=0)) / np.sqrt(draws - 1)
    variance, noise = squares(deviations)
    # Of a variance from so many draws, and of the tracer's noise, of which all draws have a part in common.
    error = np.hypot(np.sqrt(2 / (draws - 1)) * np.maximum(variance, 0), variance_error(deviations))
    return Propagation(
        {"all inputs": variance},
        deviations.mean(axis=-1).T,
        noise,
        relative_error(error, variance),
        shift.mean(axis=-1),
        nominal.mean(axis=-1),
        evaluations=draws + 1,
    )


def evaluate(
    renderer: PlanRenderer,
    values: list[FloatArray],
    samples: int,
    *,
    address: str | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FloatArray:
    """Reflectance factors at values of the whole vector, shape (evaluation, point, RANDOMISATIONS).

    Parameters
    ----------
    values, samples
        As of :meth:`~twin.propagation_render.PlanRenderer.render`.
    address, workers
        Where: as of :func:`twin.cluster.spread`.
    progress
        Told how many evaluations are done, and how many there are.
    """
    alike, others = renderer.alike(values)
    chunks = [alike[k : k + renderer.batch] for k in range(0, len(alike), renderer.batch)]
    chunks += [others[k : k + _CHUNK] for k in range(0, len(others), _CHUNK)]
    sizes = np.array([len(chunk) for chunk in chunks])

    def tell(done: int) -> None:
        if progress is not None:
            progress(round(done / len(chunks) * int(sizes.sum())), int(sizes.sum()))

    items = [[values[n] for n in chunk] for chunk in chunks]
    parts = spread(Evaluation(renderer, samples), items, address=address, workers=workers, done=tell)
    result = np.empty((len(values), *parts[0].shape[1:]))
    for chunk, part in zip(chunks, parts, strict=True):
        result[chunk] = part
    return result


def _telling(progress: Progress, what: str) -> Callable[[int, int], None]:
    return lambda done, total: progress(what, done, total)


def _find(design: Design, differences: FloatArray, brf: FloatArray) -> _Found:
    effects, curved = design.effects(differences), design.curved(differences)
    if curved is None:
        return _Found(effects, np.zeros((0, *effects.shape[1:])), True)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.where(brf > 0, 1 / brf**2, 0.0)
    total = float(np.sum(squares(curved)[0] * weight))
    error = float(np.sqrt(np.sum((variance_error(curved) * weight) ** 2)))
    return _Found(effects, curved, total <= 2 * error)


def _limiting(plans: list[Design], found: dict[int, _Found], samples: dict[int, int], tolerance: float) -> list[int]:
    """Designs that need more sight lines; none when the tolerance is reached or nothing more can be done."""
    total = np.maximum(sum(squares(f.counted)[0] for f in found.values()), 0.0) if found else np.zeros(0)
    usable = total > 0
    if not np.any(usable) or np.median(_tracing_error(found)[usable]) <= tolerance:
        return []
    errors = np.array([variance_error(found[n].counted) for n in sorted(found)])
    weight = np.median(errors[:, usable] / (2 * total[usable]), axis=1) ** 2
    # Leave out the designs that together matter less than a quarter of the tolerance squared.
    order = np.argsort(weight)
    small = np.cumsum(weight[order]) < (tolerance / 2) ** 2
    return sorted(int(n) for n in order[~small] if samples[int(n)] * _MORE <= _MOST)


def _tracing_error(found: dict[int, _Found]) -> FloatArray:
    """Relative standard error of the combined uncertainty by the ray tracer's noise, shape (point,)."""
    if not found:
        return np.zeros(0)
    counted = [f.counted for f in found.values()]
    error = jackknife_error(np.asarray(sum(map(left_out, counted))))
    return relative_error(error, np.asarray(sum(squares(effects)[0] for effects in counted)))


def _collect(
    renderer: PlanRenderer, plans: list[Design], found: dict[int, _Found], brf: FloatArray, evaluations: int
) -> Propagation:
    state, points = renderer.state, renderer.points
    variance = {source: np.zeros(points) for source in state.sources}
    noise, aliased, shift = np.zeros(points), np.zeros(points), np.zeros(points)
    factors, scatter, sources = [np.zeros((points, 0))], [np.zeros((points, 0))], []
    sensitivity, errors, curvature, units = {}, {}, {}, {}
    unit_of = {label: block.unit for block in state.blocks for label in block.labels}
    for n, design in enumerate(plans):
        effects = found[n].counted
        own, own_noise = squares(effects)
        variance[design.source] += own
        noise += own_noise
        aliased += (design.aliasing * np.maximum(own, 0)) ** 2
        factors.append(effects.mean(axis=-1).T)
        scatter.append(effects.std(axis=-1, ddof=1).T / np.sqrt(effects.shape[-1]))
        sources += [design.source] * len(effects)
        for label, slope in design.slopes(found[n].effects).items():
            sensitivity[label], units[label] = slope.mean(axis=-1), unit_of[label]
            errors[label] = slope.std(axis=-1, ddof=1) / np.sqrt(slope.shape[-1])
        if not found[n].noisy_curvature:
            shift += found[n].curved[0].mean(axis=-1) / np.sqrt(2.0)
            (linear, _), (quadratic, _) = squares(found[n].effects), squares(found[n].curved)
            curvature[design.name] = float(np.sqrt(max(0.0, quadratic.mean()) / max(linear.mean(), 1e-300)))
    total = sum(variance.values(), np.zeros(points))
    return Propagation(
        variance,
        np.concatenate(factors, axis=1),
        noise,
        np.hypot(_tracing_error(found) if found else 0.0, relative_error(np.sqrt(aliased), total)),
        shift,
        brf,
        sensitivity,
        errors,
        units,
        curvature,
        tuple(sources),
        np.concatenate(scatter, axis=1),
        evaluations,
    )
