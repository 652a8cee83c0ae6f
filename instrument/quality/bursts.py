"""What the samples of one burst say about themselves: outliers among them, and a trend through them.

Both are looked for and reported; no sample is ever left out of a mean because of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

#: Significance of the outlier test; nine normal samples are accused in 1.4 % of bursts (the test's own approximation).
SIGNIFICANCE = 0.01
#: How many samples of a burst may be outliers: with one, two that agree with each other hide one another.
MOST = 2
#: Below this relative spread a burst says nothing: rounding of the volts themselves.
_ROUNDING = 1e-12


@lru_cache(maxsize=256)
def critical_values(samples: int, most: int, significance: float) -> tuple[float, ...]:
    """Critical values of the generalised extreme studentised deviate test (Rosner 1983, equation 2.5).

    The first is that of Grubbs's two-sided test, and exact.

    Raises
    ------
    ValueError
        If there are too few samples for so many outliers.
    """
    if samples < most + 2:
        raise ValueError(f"{samples} samples; expected at least {most + 2} to look for {most} outliers")
    values = []
    for step in range(most):
        left = samples - step
        t = float(special.stdtrit(left - 2, 1 - significance / (2 * left)))
        values.append((left - 1) * t / float(np.sqrt((left - 2 + t * t) * left)))
    return tuple(values)


def outliers(samples: ArrayLike, most: int = MOST, significance: float = SIGNIFICANCE) -> np.ndarray:
    """Which samples are outliers of their burst, by the generalised extreme studentised deviate test.

    Up to ``most`` times the sample that is farthest from the mean is set aside; the outliers are those set aside up
    to the last time that its distance, in standard deviations of what was left, was beyond the critical value.

    Parameters
    ----------
    samples
        Shape (..., sample). Bursts of fewer than ``most`` + 2 samples have no outliers.

    Returns
    -------
    array of bool, shape (..., sample)

    References
    ----------
    B. Rosner, Percentage points for a generalized ESD many-outlier procedure, Technometrics 25 (1983) 165.
    NIST/SEMATECH e-Handbook of Statistical Methods, section 1.3.5.17.3.
    """
    values = np.asarray(samples, dtype=float)
    found = np.zeros(values.shape, dtype=bool)
    count = values.shape[-1]
    if count >= most + 2:
        critical = critical_values(count, most, significance)
        flat = found.reshape(-1, count)
        for row, burst in enumerate(values.reshape(-1, count).tolist()):
            flat[row, outlying(burst, critical)] = True
    return found


def outlying(burst: Sequence[float], critical: Sequence[float]) -> list[int]:
    """Numbers of the outliers of one burst, for its :func:`critical_values`; plain numbers cost the engine least."""
    left = dict(enumerate(burst))
    floor = _ROUNDING * max(map(abs, burst))
    set_aside: list[int] = []
    beyond = 0
    for limit in critical:
        mean = sum(left.values()) / len(left)
        deviation = math.sqrt(sum((value - mean) ** 2 for value in left.values()) / (len(left) - 1))
        farthest = max(left, key=lambda number: abs(left[number] - mean))
        set_aside.append(farthest)
        if abs(left.pop(farthest) - mean) > limit * max(deviation, floor):
            beyond = len(set_aside)
    return set_aside[:beyond]


def trend(samples: Sequence[float]) -> tuple[float, float]:
    """Straight line through the samples of one burst: its change over the burst, and that over its standard error.

    Returns
    -------
    change
        From the first sample to the last, in the unit of the samples.
    significance
        Student's t of the slope, with two degrees of freedom less than samples; 0 with fewer than four.
    """
    count = len(samples)
    if count < 4:
        return 0.0, 0.0
    middle, mean = (count - 1) / 2, sum(samples) / count
    spread = count * (count**2 - 1) / 12
    slope = sum((number - middle) * value for number, value in enumerate(samples)) / spread
    rest = sum((value - mean - slope * (number - middle)) ** 2 for number, value in enumerate(samples))
    error = math.sqrt(rest / (count - 2) / spread)
    return slope * (count - 1), slope / max(error, _ROUNDING * max(map(abs, samples))) if slope else 0.0
