"""How uncertain a prediction is because its inputs are: by sensitivities, and by Monte Carlo draws of all inputs.

Both ways evaluate the real twin with common random numbers and remove what is left of the ray tracer's noise: with
independent randomisations r and s of the same quantity, the mean of d_r d_s over r != s estimates its square without
bias, where the square of the mean would be too large by the squared standard error. So the uncertainty from the inputs
holds no Monte Carlo error, however few sight lines were traced.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.cluster import spread
from twin.propagation_designs import ROWS, STEP, Design, designs
from twin.propagation_render import Evaluation, PlanRenderer

#: Sight lines of a point in the first round, and at most.
_FIRST, _MOST = 256, 2**17
#: Each round gives the designs that limit the accuracy so many times more sight lines.
_MORE = 4
#: Draws that are evaluated in one go.
_CHUNK = 10
#: Told what is being done, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Propagation:
    """Uncertainty of the reflectance factors from the inputs.

    Attributes
    ----------
    variance
        By source, shape (point,) each: squared standard uncertainties (k = 1), free of Monte Carlo error in the mean.
        Estimates of a variance near 0 can be negative.
    factor, shape (point, component)
        The covariance between points is ``factor @ factor.T``, less ``noise`` on its diagonal.
    noise, shape (point,)
        What the ray tracer adds to the diagonal.
    u_error, shape (point,)
        Relative standard error of ``u``.
    mean_shift, shape (point,)
        Expected value over the inputs less the value at the nominal inputs.
    brf, shape (point,)
        At the nominal inputs, with the ray tracer's noise.
    sensitivity, sensitivity_error
        Change of the reflectance factor over that of a parameter, shape (point,), by parameter, of those that can be
        told apart; and its standard error.
    units
        Of the parameters in ``sensitivity``.
    curvature
        Root mean square over the points of the quadratic effect of a parameter over its linear one, at one standard
        uncertainty; of those where the quadratic one could be told from the ray tracer's noise.
    component_sources, factor_error
        Source of every component of ``factor``, and its standard error, shape (point, component); empty where the
        components mix all sources.
    evaluations
        How often the plan was rendered.
    """

    variance: dict[str, FloatArray]
    factor: FloatArray
    noise: FloatArray
    u_error: FloatArray
    mean_shift: FloatArray
    brf: FloatArray = field(default_factory=lambda: np.zeros(0))
    sensitivity: dict[str, FloatArray] = field(default_factory=dict)
    sensitivity_error: dict[str, FloatArray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    curvature: dict[str, float] = field(default_factory=dict)
    component_sources: tuple[str, ...] = ()
    factor_error: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    evaluations: int = 0

    @property
    def u(self) -> FloatArray:
        """Standard uncertainty (k = 1) from all inputs, shape (point,)."""
        return np.sqrt(np.maximum(sum(self.variance.values(), np.zeros(len(self.noise))), 0.0))

    def take(self, chosen: NDArray[np.int64]) -> Propagation:
        """That of some points, by their numbers; a number may come again."""

        def some(values: dict[str, FloatArray]) -> dict[str, FloatArray]:
            return {name: value[chosen] for name, value in values.items()}

        return replace(
            self,
            variance=some(self.variance),
            factor=self.factor[chosen],
            noise=self.noise[chosen],
            u_error=self.u_error[chosen],
            mean_shift=self.mean_shift[chosen],
            brf=self.brf[chosen],
            sensitivity=some(self.sensitivity),
            sensitivity_error=some(self.sensitivity_error),
            factor_error=self.factor_error[chosen] if self.factor_error.size else self.factor_error,
        )

    def covariance(self) -> FloatArray:
        """Covariance of the errors between points, shape (point, point): symmetric, without negative eigenvalues."""
        covariance = self.factor @ self.factor.T
        covariance[np.diag_indices_from(covariance)] -= self.noise
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(root @ root.T)

    def correlation(self) -> FloatArray:
        """Correlation of the errors between points, shape (point, point): symmetric, positive, ones on the diagonal."""
        covariance = self.covariance()
        length = np.sqrt(np.diag(covariance))
        scale = np.where(length > 0, 1 / np.where(length > 0, length, 1.0), 0.0)
        result: FloatArray = covariance * scale * scale[:, None]
        np.fill_diagonal(result, 1.0)
        return result


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
        Relative standard error of the uncertainty to reach at the median point; more sight lines go to the
        parameters that limit it.
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
    found: dict[int, _Found] = {}
    todo, evaluations, turn, finest = list(samples), 0, 0, 0
    brf = np.zeros(renderer.points)
    while todo:
        turn += 1
        for level in sorted({samples[n] for n in todo}):
            chosen = [n for n in todo if samples[n] == level]
            values = [renderer.state.nominal, *(value for n in chosen for value in plans[n].values)]
            told = None if progress is None else _telling(progress, f"sensitivities, round {turn}")
            rendered = evaluate(renderer, values, level, address=address, workers=workers, progress=told)
            evaluations += len(values)
            nominal, start = rendered[0], 1
            if level > finest:
                finest, brf = level, nominal.mean(axis=-1)
            for n in chosen:
                stop = start + len(plans[n].values)
                found[n] = _find(plans[n], rendered[start:stop] - nominal, nominal.mean(axis=-1))
                start = stop
        todo = _limiting(plans, found, samples, tolerance)
        samples |= {n: samples[n] * _MORE for n in todo}
    return _collect(renderer, plans, found, brf, evaluations)


def by_draws(
    renderer: PlanRenderer,
    *,
    draws: int = 500,
    samples: int = 1024,
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
    # Of a variance from so many draws, and of the tracer's noise in each.
    error = np.sqrt(2 / (draws - 1)) * (np.maximum(variance, 0) + noise)
    return Propagation(
        {"all inputs": variance},
        deviations.mean(axis=-1).T,
        noise,
        _relative(error, variance),
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


def squares(effects: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sums of squared effects without the noise of their estimates, and the noise removed.

    Parameters
    ----------
    effects, shape (component, point, randomisation)

    Returns
    -------
    variance, noise, shape (point,)
    """
    count = effects.shape[-1]
    mean = effects.mean(axis=-1)
    noise = np.asarray(np.sum(effects.var(axis=-1, ddof=1), axis=0) / count)
    return np.asarray(np.sum(mean**2, axis=0) - noise), noise


def variance_error(effects: FloatArray) -> FloatArray:
    """Standard error of the variance of :func:`squares` by the ray tracer's noise, shape (point,)."""
    single = effects.var(axis=-1, ddof=1) / effects.shape[-1]
    tracing = np.sum(4 * np.maximum(effects.mean(axis=-1) ** 2 - single, 0) * single + 2 * single**2, axis=0)
    return np.asarray(np.sqrt(tracing))


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
    errors = np.array([variance_error(found[n].counted) for n in sorted(found)])
    if not len(errors) or not np.any(total > 0):
        return []
    usable = total > 0
    relative = errors[:, usable] / (2 * total[usable])
    if np.median(np.sqrt(np.sum(relative**2, axis=0))) <= tolerance:
        return []
    weight = np.median(relative, axis=1) ** 2
    # Leave out the designs that together matter less than a quarter of the tolerance squared.
    order = np.argsort(weight)
    small = np.cumsum(weight[order]) < (tolerance / 2) ** 2
    return sorted(int(n) for n in order[~small] if samples[int(n)] * _MORE <= _MOST)


def _collect(
    renderer: PlanRenderer, plans: list[Design], found: dict[int, _Found], brf: FloatArray, evaluations: int
) -> Propagation:
    state, points = renderer.state, renderer.points
    variance = {source: np.zeros(points) for source in state.sources}
    noise, error2, shift = np.zeros(points), np.zeros(points), np.zeros(points)
    factors, scatter, sources = [np.zeros((points, 0))], [np.zeros((points, 0))], []
    sensitivity, errors, curvature, units = {}, {}, {}, {}
    unit_of = {label: block.unit for block in state.blocks for label in block.labels}
    for n, design in enumerate(plans):
        effects = found[n].counted
        own, own_noise = squares(effects)
        variance[design.source] += own
        noise += own_noise
        error2 += variance_error(effects) ** 2 + (design.aliasing * np.maximum(own, 0)) ** 2
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
        _relative(np.sqrt(error2), total),
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


def _relative(error: FloatArray, variance: FloatArray) -> FloatArray:
    """Relative standard error of a standard uncertainty from the error of its square."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(variance > 0, error / (2 * variance), np.where(error > 0, np.inf, 0.0))
