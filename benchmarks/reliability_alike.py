"""Whether readings of interrupted scans are those of uninterrupted ones, as far as their noise lets one see.

Two readings of one point never agree: each is the mean of nine noisy samples. So several uninterrupted scans are
made first. Their scatter has to be the noise that the facility states, and with it, and the number of readings that
are compared, follows how far the farthest of them may lie off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

#: Chance that a trial of sound scans is called wrong, by each of the three tests.
CHANCE = 0.01


@dataclass(frozen=True)
class Uninterrupted:
    """Scans that nobody interrupted.

    Attributes
    ----------
    mean
        Photocurrent by index of the point, A.
    u
        Relative standard deviation of one reading as the facility states it, by index.
    scans
        How many were averaged.
    scatter
        Standard deviation of their readings in units of ``u``, about the mean of each point; 0 of a single scan.
    """

    mean: dict[int, float]
    u: dict[int, float]
    scans: int
    scatter: float

    @property
    def freedom(self) -> int:
        """Degrees of freedom of ``scatter``."""
        return (self.scans - 1) * len(self.mean)

    def off(self, readings: Mapping[int, float]) -> dict[int, float]:
        """How far readings lie from the mean, in units of what such a difference scatters by."""
        unit = np.sqrt(1.0 + 1.0 / self.scans)
        return {i: float((readings[i] / self.mean[i] - 1.0) / (self.u[i] * unit)) for i in self.mean if i in readings}

    def wrong(self) -> list[str]:
        """What is wrong where the scatter is not the stated noise (chi-squared, two-sided)."""
        if not self.freedom:
            return []
        low, high = np.sqrt(chi2.ppf([CHANCE / 2, 1 - CHANCE / 2], self.freedom) / self.freedom)
        if low <= self.scatter <= high:
            return []
        return [f"uninterrupted scans scatter {self.scatter:.2f} times as stated, outside {low:.2f} to {high:.2f}"]


def uninterrupted(scans: Sequence[Mapping[int, float]], u: Mapping[int, float]) -> Uninterrupted:
    """What scans of the same points have in common.

    Parameters
    ----------
    scans
        Photocurrents (A) by index of the point, one mapping a scan.
    u
        Stated relative standard deviation of a reading by index.
    """
    points = sorted(scans[0])
    readings = np.array([[scan[index] for index in points] for scan in scans])
    mean = readings.mean(axis=0)
    stated = np.array([u[index] for index in points])
    freedom = (len(scans) - 1) * len(points)
    squares = np.sum(((readings / mean - 1.0) / stated) ** 2)
    scatter = float(np.sqrt(squares / freedom)) if freedom else 0.0
    return Uninterrupted(dict(zip(points, mean.tolist(), strict=True)), dict(u), len(scans), scatter)


def farthest_allowed(comparisons: int) -> float:
    """How far the farthest of so many readings may lie off, in units of what differences scatter by (Bonferroni)."""
    return float(norm.isf(CHANCE / 2 / comparisons))


def together_wrong(off: Sequence[float], scans: int, points: int) -> list[str]:
    """What is wrong where readings lie to one side on the whole: the sharper test, where there are many.

    Parameters
    ----------
    off
        Of all readings (:meth:`Uninterrupted.off`).
    scans, points
        Uninterrupted scans whose mean they were compared with, and its points: an error common to all readings.
    """
    unit = np.sqrt(1.0 + 1.0 / scans)
    mean = float(np.mean(off)) * unit
    allowed = norm.isf(CHANCE / 2) * np.sqrt(1.0 / len(off) + 1.0 / (scans * points))
    if abs(mean) <= allowed:
        return []
    return [f"resumed scans read {mean:+.2f} stated standard deviations off on the whole, allowed {allowed:.2f}"]
