"""Means of several results whose scatter is more than their uncertainties explain: the variance between them.

Result i of quantity j is mu_j + b_ij + e_ij: e_ij with the variance u_ij^2 that is known, b_ij with one variance tau^2
that is not. With one quantity this is the mean of an interlaboratory comparison; with many the b have a variance in
common, so that few runs over many points suffice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from instrument.angles import FloatArray


@dataclass(frozen=True)
class Pooled:
    """Weighted means and the variance between.

    Attributes
    ----------
    mean, shape (quantity,)
        Weighted with 1/(u^2 + tau^2).
    u, shape (quantity,)
        Standard uncertainty of the mean: one over the root of the sum of the weights.
    weights, shape (result, quantity)
        Add up to 1 over the results; 0 where there is none.
    tau
        Standard deviation between results.
    q
        Cochran's statistic: sum of (x - mean)^2/u^2 with the mean for tau = 0; ``expected`` of it without any tau.
    """

    mean: FloatArray
    u: FloatArray
    weights: FloatArray
    tau: float
    q: float
    expected: int


def mandel_paule(results: ArrayLike, u: ArrayLike) -> Pooled:
    """tau^2 such that the sum of (x - mean)^2/(u^2 + tau^2) is as expected: the number of results less that of means.

    Parameters
    ----------
    results, u
        Results and their known standard uncertainties, shape (result, quantity); nan where there is no result.

    Raises
    ------
    ValueError
        If no quantity has two results, or an uncertainty is not above 0.

    References
    ----------
    R. C. Paule, J. Mandel, Consensus values and weighting factors, J. Res. Natl. Bur. Stand. 87 (1982) 377.
    """
    x, variance = _checked(results, u)
    freedom = _freedom(x)
    q = _excess(0.0, x, variance)
    if q <= freedom:
        return _pooled(x, variance, 0.0, q, freedom)
    highest = float(np.nanmax((x - np.nanmean(x, axis=0)) ** 2)) * x.shape[0]
    while _excess(highest, x, variance) > freedom:
        highest *= 2
    tau2 = float(brentq(lambda t: _excess(t, x, variance) - freedom, 0.0, highest, xtol=1e-16 * highest, rtol=1e-12))
    return _pooled(x, variance, tau2, q, freedom)


def dersimonian_laird(results: ArrayLike, u: ArrayLike) -> Pooled:
    """tau^2 from Cochran's Q by the method of moments; parameters and errors as :func:`mandel_paule`.

    References
    ----------
    R. DerSimonian, N. Laird, Meta-analysis in clinical trials, Control. Clin. Trials 7 (1986) 177.
    """
    x, variance = _checked(results, u)
    freedom, q = _freedom(x), _excess(0.0, x, variance)
    weights = np.where(np.isnan(x), 0.0, 1 / variance)
    total = weights.sum(axis=0)
    several = np.sum(~np.isnan(x), axis=0) > 1
    scale = float(np.sum((total - np.sum(weights**2, axis=0) / total)[several]))
    return _pooled(x, variance, max(0.0, (q - freedom) / scale), q, freedom)


def _checked(results: ArrayLike, u: ArrayLike) -> tuple[FloatArray, FloatArray]:
    x, known = np.array(results, dtype=float), np.array(u, dtype=float)
    x, known = (array[:, None] if array.ndim == 1 else array for array in (x, known))
    there = ~np.isnan(x)
    if not np.all(known[there] > 0):
        raise ValueError("expected standard uncertainties above 0")
    if not np.all(there.any(axis=0)):
        raise ValueError("a quantity has no result")
    if _freedom(x) == 0:
        raise ValueError("no quantity has two results; nothing tells their scatter")
    return x, np.where(there, known, 1.0) ** 2


def _freedom(x: FloatArray) -> int:
    return int(np.sum(~np.isnan(x))) - x.shape[1]


def _weights(tau2: float, x: FloatArray, variance: FloatArray) -> FloatArray:
    return np.where(np.isnan(x), 0.0, 1 / (variance + tau2))


def _excess(tau2: float, x: FloatArray, variance: FloatArray) -> float:
    weights, values = _weights(tau2, x, variance), np.nan_to_num(x)
    mean = np.sum(weights * values, axis=0) / weights.sum(axis=0)
    return float(np.sum(weights * (values - mean) ** 2))


def _pooled(x: FloatArray, variance: FloatArray, tau2: float, q: float, freedom: int) -> Pooled:
    weights = _weights(tau2, x, variance)
    total = weights.sum(axis=0)
    mean = np.sum(weights * np.nan_to_num(x), axis=0) / total
    return Pooled(mean, 1 / np.sqrt(total), weights / total, float(np.sqrt(tau2)), q, freedom)
