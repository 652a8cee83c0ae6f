"""The variance of each part's mean, from the main run and from what the pilot saw of it.

A variance of 16 randomisations is uncertain by a third, and so is what follows from it. The pilot saw the same parts
with other random numbers and fewer sight lines: smoothed over the plan (:mod:`twin.smooth_variance`) and carried over
to the main run's number its variances are an estimate as good or better, but for what is wrong with the power of that
number. How wrong it is shows in all geometries of a plan together:
in the mean and in the scatter of the ratio of both variances, beyond chance (Smyth, "Linear models and empirical Bayes
methods for assessing differential expression", Stat. Appl. Genet. Mol. Biol. 3, 2004). So the pilot counts by as many
degrees of freedom as it deserves. Few geometries cannot tell; there it does not count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from instrument.angles import FloatArray
from twin.sampling_plan import RATE, Tally
from twin.smooth_variance import ENOUGH, smoothed
from twin.tracer import RANDOMISATIONS, Part

_OWN = RANDOMISATIONS - 1
#: Degrees of freedom that the pilot's smoothed variances count by at most.
_MOST = 3 * _OWN


@dataclass(frozen=True)
class Expected:
    """What the pilot says of the main run's variances.

    Attributes
    ----------
    variances, shape (part, point)
        Of the main run's means.
    degrees, shape (part,)
        Degrees of freedom that they count by; 0 where nothing is known.
    """

    variances: FloatArray
    degrees: FloatArray

    def pooled(self, found: FloatArray, degrees: int = _OWN) -> tuple[FloatArray, FloatArray]:
        """Join variances that were found to what was expected.

        Parameters
        ----------
        found, shape (part, point, ...)
            Variances of the main run's means.
        degrees
            Of freedom of each of them.

        Returns
        -------
        variances, shape (part, point, ...)
        degrees, shape (part,)
        """
        more = (1,) * (found.ndim - 2)
        expected = self.variances.reshape(self.variances.shape + more)
        weight = self.degrees.reshape((-1, 1, *more))
        return np.asarray((degrees * found + weight * expected) / (degrees + weight)), degrees + self.degrees


def nothing_expected(points: int) -> Expected:
    """Where there was no pilot."""
    return Expected(np.zeros((len(Part), points)), np.zeros(len(Part)))


def expected(seen: Tally, main: Tally) -> Expected:
    """Carry the pilot's variances over to the main run."""
    found, before = main.variances(), smoothed(seen.values())
    variances, degrees = np.zeros_like(found), np.zeros(len(Part))
    total = main.means().sum(axis=0)
    for part in Part:
        some = (found[part] > 0) & (before[part] > 0) & (total > 0)
        if some.sum() < ENOUGH:
            continue
        lines = seen.done[part][some] / main.done[part][some]
        carried = before[part][some] * lines ** (2 * RATE[part])
        ratio = found[part][some] / carried
        relative = carried / total[some] ** 2
        variances[part, some] = carried * np.sum(ratio * relative) / np.sum(relative)
        degrees[part] = min(_degrees(float(np.log(ratio).var(ddof=1)) - _scatter(_OWN)), _MOST)
    return Expected(variances, degrees)


def _scatter(degrees: float) -> float:
    """Variance of the logarithm of a variance with so many degrees of freedom."""
    from scipy.special import polygamma

    return float(polygamma(1, degrees / 2))


def _degrees(scatter: float) -> float:
    """Degrees of freedom for which the logarithm of a variance scatters so much: the inverse of :func:`_scatter`."""
    low, high = 1e-3, 1e6
    if scatter <= _scatter(high):
        return high
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if _scatter(middle) > scatter else (low, middle)
    return low
