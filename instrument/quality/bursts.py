"""What the samples of one burst say about themselves: outliers among them, and a trend through them.

Both are looked for and reported; no sample is ever left out of a mean because of them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from instrument.angles import FloatArray

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
    shape, count = values.shape, values.shape[-1]
    values = values.reshape(-1, count)
    found = np.zeros(values.shape, dtype=bool)
    if count < most + 2:
        return found.reshape(shape)
    set_aside, rows = np.zeros(values.shape, dtype=bool), np.arange(len(values))
    floor = _ROUNDING * np.max(np.abs(values), axis=-1, initial=0.0)
    for critical in critical_values(count, most, significance):
        left = ~set_aside
        number = left.sum(axis=-1)
        mean = np.sum(values, axis=-1, where=left) / number
        distance = np.where(left, np.abs(values - mean[:, None]), -1.0)
        deviation = np.sqrt(np.sum(distance**2, axis=-1, where=left) / (number - 1))
        farthest = distance.argmax(axis=-1)
        set_aside[rows, farthest] = True
        beyond = distance[rows, farthest] > critical * np.maximum(deviation, floor)
        found[beyond] = set_aside[beyond]
    return found.reshape(shape)


def trend(samples: ArrayLike) -> tuple[float, float]:
    """Straight line through the samples of one burst: its change over the burst, and that over its standard error.

    Returns
    -------
    change
        From the first sample to the last, in the unit of the samples.
    significance
        Student's t of the slope, with two degrees of freedom less than samples; 0 with fewer than four.
    """
    values: FloatArray = np.asarray(samples, dtype=float)
    count = values.size
    if count < 4:
        return 0.0, 0.0
    moment = np.arange(count) - (count - 1) / 2
    spread = float(np.sum(moment**2))
    slope = float(np.sum(moment * values)) / spread
    rest = values - values.mean() - slope * moment
    error = float(np.sqrt(np.sum(rest**2) / (count - 2) / spread))
    floor = _ROUNDING * float(np.max(np.abs(values)))
    return slope * (count - 1), slope / max(error, floor) if slope else 0.0
