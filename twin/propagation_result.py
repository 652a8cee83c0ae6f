"""What a propagation of uncertainties has found, and how noise of the ray tracer is kept out of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray


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


def left_out(effects: FloatArray) -> FloatArray:
    """The variance of :func:`squares` without one randomisation after the other, shape (randomisation, point).

    Parameters
    ----------
    effects, shape (component, point, randomisation)
    """
    count = effects.shape[-1]
    total, square = effects.sum(axis=-1, keepdims=True), np.sum(effects**2, axis=-1, keepdims=True)
    others = (total - effects) ** 2 - (square - effects**2)
    return np.asarray(np.sum(others, axis=0).T / ((count - 1) * (count - 2)))


def jackknife_error(without: FloatArray) -> FloatArray:
    """Standard error of an estimate by the ray tracer's noise, shape (point,).

    Whatever part of the noise the components have in common counts fully, because leaving a randomisation out changes
    all of them together.

    Parameters
    ----------
    without, shape (randomisation, point)
        The estimate without one randomisation after the other.
    """
    count = len(without)
    return np.asarray(np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0)))


def variance_error(effects: FloatArray) -> FloatArray:
    """Standard error of the variance of :func:`squares` by the ray tracer's noise, shape (point,)."""
    return jackknife_error(left_out(effects))


def relative_error(error: FloatArray, variance: FloatArray) -> FloatArray:
    """Relative standard error of a standard uncertainty from the error of its square."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(variance > 0, error / (2 * variance), np.where(error > 0, np.inf, 0.0))
