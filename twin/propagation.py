"""How uncertain a prediction is because its inputs are: by sensitivities, and by Monte Carlo draws of all inputs.

Both ways evaluate the real twin with common random numbers and remove what is left of the ray tracer's noise: with
independent randomisations r and s of the same quantity, the mean of d_r d_s over r != s estimates its square without
bias, where the square of the mean would be too large by the squared standard error. So the uncertainty from the inputs
holds no Monte Carlo error, however few sight lines were traced.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from instrument.angles import FloatArray
from twin.propagation_designs import Design, designs
from twin.propagation_render import PlanRenderer

#: Sight lines of a point in the first round, and at most.
_FIRST, _MOST = 1024, 2**17
#: Each round gives the designs that limit the accuracy so many times more sight lines.
_MORE = 4
Progress = Callable[[str], None]


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
    sensitivity
        Change of the reflectance factor over that of a parameter, shape (point,), by parameter; of those that were
        varied one by one.
    units
        Of the parameters in ``sensitivity``.
    curvature
        Root mean square over the points of the quadratic effect of a parameter over its linear one, at one standard
        uncertainty.
    evaluations
        How often the plan was rendered.
    """

    variance: dict[str, FloatArray]
    factor: FloatArray
    noise: FloatArray
    u_error: FloatArray
    mean_shift: FloatArray
    sensitivity: dict[str, FloatArray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    curvature: dict[str, float] = field(default_factory=dict)
    evaluations: int = 0

    @property
    def u(self) -> FloatArray:
        """Standard uncertainty (k = 1) from all inputs, shape (point,)."""
        return np.sqrt(np.maximum(sum(self.variance.values(), np.zeros(len(self.noise))), 0.0))

    def correlation(self) -> FloatArray:
        """Correlation of the errors between points, shape (point, point): symmetric, positive, ones on the diagonal."""
        covariance = self.factor @ self.factor.T
        covariance[np.diag_indices_from(covariance)] -= self.noise
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        length = np.linalg.norm(root, axis=1, keepdims=True)
        root = np.where(length > 0, root / np.where(length > 0, length, 1.0), 0.0)
        result: FloatArray = root @ root.T
        np.fill_diagonal(result, 1.0)
        return result


def by_sensitivities(
    renderer: PlanRenderer, *, tolerance: float = 0.05, seed: int = 1, progress: Progress | None = None
) -> Propagation:
    """Propagate with finite differences of the twin.

    Single parameters are varied by sqrt(3) standard uncertainties both ways, which gives linear and quadratic effect
    (the three-point Gauss-Hermite rule: exact for a normal parameter up to the fourth moment); many of one source
    together along the orthogonal directions of a weighing design.

    Parameters
    ----------
    renderer
        The plan and its state vector.
    tolerance
        Relative standard error of the uncertainty to reach at the median point; more sight lines go to the
        parameters that limit it.
    seed
        Of the signs in the weighing designs.
    progress
        Told in words what is being done.

    Notes
    -----
    GUM E.4.3: 200 draws know a standard uncertainty to 5 %.
    """
    plans = designs(renderer.state, seed)
    samples = dict.fromkeys(range(len(plans)), _FIRST)
    effects: dict[int, FloatArray] = {}
    todo, evaluations = list(samples), 0
    while todo:
        if progress is not None:
            progress(f"{sum(len(plans[n].values) for n in todo)} evaluations of the plan")
        for level in sorted({samples[n] for n in todo}):
            chosen = [n for n in todo if samples[n] == level]
            values = [renderer.state.nominal, *(value for n in chosen for value in plans[n].values)]
            rendered = renderer.render(values, level)
            evaluations += len(values)
            start = 1
            for n in chosen:
                stop = start + len(plans[n].values)
                effects[n] = plans[n].effects(rendered[start:stop] - rendered[0])
                start = stop
        todo = _limiting(plans, effects, samples, tolerance)
        samples |= {n: samples[n] * _MORE for n in todo}
    return _collect(renderer, plans, effects, evaluations)


def by_draws(
    renderer: PlanRenderer,
    *,
    draws: int = 500,
    samples: int = 2 * _FIRST,
    seed: int = 1,
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
    """
    if draws < 2:
        raise ValueError(f"draws: found {draws}; expected at least 2")
    values = renderer.state.draw(seed, draws)
    done = 0

    def count(number: int) -> None:
        nonlocal done
        done += number
        if progress is not None and done % 10 == 0:
            progress(f"{done} of {draws} draws")

    rendered = renderer.render(values, samples, count)
    nominal = renderer.render([renderer.state.nominal], samples)[0]
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
        evaluations=draws + 1,
    )


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


def _variance_error(design: Design, effects: FloatArray) -> FloatArray:
    """Standard error of a design's variance, shape (point,)."""
    count = effects.shape[-1]
    single = effects.var(axis=-1, ddof=1) / count
    tracing = np.sum(4 * np.maximum(effects.mean(axis=-1) ** 2 - single, 0) * single + 2 * single**2, axis=0)
    return np.asarray(np.sqrt(tracing))


def _limiting(
    plans: list[Design], effects: dict[int, FloatArray], samples: dict[int, int], tolerance: float
) -> list[int]:
    """Designs that need more sight lines; none when the tolerance is reached or nothing more can be done."""
    total = np.maximum(sum(squares(e)[0] for e in effects.values()), 0.0) if effects else np.zeros(0)
    errors = np.array([_variance_error(plans[n], effects[n]) for n in sorted(effects)])
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
    renderer: PlanRenderer, plans: list[Design], effects: dict[int, FloatArray], evaluations: int
) -> Propagation:
    state, points = renderer.state, renderer.points
    variance = {source: np.zeros(points) for source in state.sources}
    noise, error2, shift = np.zeros(points), np.zeros(points), np.zeros(points)
    factors: list[FloatArray] = [np.zeros((points, 0))]
    sensitivity, curvature, units = {}, {}, {}
    unit_of = {label: block.unit for block in state.blocks for label in block.labels}
    for n, design in enumerate(plans):
        own, own_noise = squares(effects[n])
        variance[design.source] += own
        noise += own_noise
        error2 += _variance_error(design, effects[n]) ** 2 + (design.aliasing * np.maximum(own, 0)) ** 2
        mean = effects[n].mean(axis=-1)
        factors.append(mean.T)
        shift += design.shift(mean)
        for label, slope in design.slopes(mean).items():
            sensitivity[label], units[label] = slope, unit_of[label]
        ratio = design.curvature(squares, effects[n])
        if ratio is not None:
            curvature[design.name] = ratio
    total = sum(variance.values(), np.zeros(points))
    return Propagation(
        variance,
        np.concatenate(factors, axis=1),
        noise,
        _relative(np.sqrt(error2), total),
        shift,
        sensitivity,
        units,
        curvature,
        evaluations,
    )


def _relative(error: FloatArray, variance: FloatArray) -> FloatArray:
    """Relative standard error of a standard uncertainty from the error of its square."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(variance > 0, error / (2 * variance), np.where(error > 0, np.inf, 0.0))
