"""How many sight lines each part of a reading gets for a wanted standard error, and what they come to.

Numbers are never chosen by the values that enter the mean. A sequence that is stopped once its own scatter looks small
states too small an error (12 % too small with 8 randomisations), and errs to the low side where values are skewed.

1. A pilot with random numbers of its own estimates the variance of every part (:class:`~twin.tracer.Part`) of every
   geometry; in a plan of many they are smoothed (:mod:`twin.smooth_variance`).
2. The numbers of sight lines follow from the pilot, spent where the error falls most for the time.
3. Where the error of that main run is larger than wanted, repetitions of a part with other random numbers are averaged
   with it (:mod:`twin.repetitions`). The stated error then is the main run's times what their number leaves of it,
   whatever those scatter: after Stein ("A two-sample test for a linear hypothesis whose power is independent of the
   variance", Ann. Math. Statist. 16, 1945) the deviation over the stated error keeps the distribution that it has
   without repetitions, because mean and scatter of normal values are independent.

The stated error rests on the main run's scatter and, in a plan of many geometries, on the pilot's
(:mod:`twin.pooled_variance`), whose values are not part of the mean.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.smooth_variance import smoothed
from twin.tracer import RANDOMISATIONS, Part

IntArray = NDArray[np.int64]
#: Sight lines of each part in the pilot of a relative error of 0.1 %, a geometry and randomisation.
_PILOT = {Part.PLATE_TOP: 128, Part.REFLECTED_ONCE: 128, Part.SCATTERED: 64}
#: Least number in the pilot.
_LEAST_PILOT = 32
#: Least numbers: of fewer the means are so skewed that their scatter states too small an error where they are low.
_LEAST = {Part.PLATE_TOP: 32, Part.REFLECTED_ONCE: 64, Part.SCATTERED: 256}
#: CPU time of a sight line in microseconds on one core of 2.5 GHz: only the ratios matter.
COST = {Part.PLATE_TOP: 0.07, Part.REFLECTED_ONCE: 0.28, Part.SCATTERED: 0.85}
#: The error of a part falls with this power of its sight lines.
RATE = {Part.PLATE_TOP: 0.82, Part.REFLECTED_ONCE: 0.68, Part.SCATTERED: 0.57}
#: The main run aims at this part of the wanted error: with less, fewer geometries need repetitions.
_AIM = 0.95
LIMIT = 2**20
_MOST_STEPS = 60


@dataclass(frozen=True)
class Block:
    """Sight lines ``first`` to ``first + samples`` of a part, for the chosen geometries."""

    part: Part
    first: int
    samples: int
    chosen: IntArray


class Tally:
    """Sums over the sight lines of every part, in every randomisation."""

    def __init__(self, points: int) -> None:
        self.sums = np.zeros((len(Part), points, RANDOMISATIONS))
        self.done = np.zeros((len(Part), points), dtype=np.int64)

    def add(self, block: Block, means: FloatArray) -> None:
        """Count a block's means, shape (chosen, randomisation)."""
        self.sums[block.part, block.chosen] += means * block.samples
        self.done[block.part, block.chosen] += block.samples

    def values(self) -> FloatArray:
        """Means of the parts, shape (part, point, randomisation)."""
        return np.asarray(self.sums / np.maximum(self.done, 1)[..., None])

    def means(self) -> FloatArray:
        """Mean of each part, shape (part, point)."""
        return np.asarray(self.values().mean(axis=-1))

    def variances(self) -> FloatArray:
        """Variance of each part's mean, shape (part, point)."""
        return np.asarray(self.values().var(axis=-1, ddof=1) / RANDOMISATIONS)


def total_and_error(
    means: FloatArray, variances: FloatArray, degrees: FloatArray | float = RANDOMISATIONS - 1
) -> tuple[FloatArray, FloatArray]:
    """The whole reading and its standard uncertainty, shape (point,) each.

    Parameters
    ----------
    means, variances, shape (part, point)
        Of independent parts.
    degrees, shape (part,)
        Of freedom of the variances.

    Notes
    -----
    The degrees of freedom of the sum are Welch and Satterthwaite's (GUM G.4.1); the standard deviation of Student's t
    is sqrt(nu/(nu - 2)) times the standard error (GUM Supplement 1, 6.4.9).
    """
    variance = variances.sum(axis=0)
    each = np.broadcast_to(degrees, len(variances))[:, None]
    whole = np.divide(
        variance**2, np.sum(variances**2 / each, axis=0), out=np.full_like(variance, 3.0), where=variance > 0
    )
    return np.asarray(means.sum(axis=0)), np.sqrt(variance * whole / (whole - 2))


def fixed(points: int, samples: dict[Part, int]) -> Iterator[Block]:
    """The same number of sight lines for every geometry."""
    everything = np.arange(points)
    for part in Part:
        yield Block(part, 0, samples[part], everything)


def pilot(points: int, standard_error: float) -> Iterator[Block]:
    """Sight lines enough to plan for a relative standard error."""
    scale = (0.001 / standard_error) ** 1.5
    return fixed(points, {part: power_of_two(_PILOT[part] * scale, _LEAST_PILOT) for part in Part})


def planned(seen: Tally, standard_error: float) -> Iterator[Block]:
    """The main run's blocks, from what the pilot has seen."""
    wanted = _wanted(seen, standard_error)
    for part in Part:
        yield from blocks(part, np.zeros_like(wanted[part]), wanted[part])


def power_of_two(number: float, least: int = 1) -> int:
    """The power of two not below a number, within the limits."""
    return min(LIMIT, max(least, 1 << max(0, int(np.ceil(np.log2(max(number, 1.0)))))))


def _wanted(seen: Tally, standard_error: float) -> IntArray:
    """How many sight lines each part should have, shape (part, point)."""
    means, variances = seen.means(), smoothed(seen.values())
    total, error = total_and_error(means, variances)
    # In proportion to the whole error, Student's factor included.
    whole = variances.sum(axis=0)
    variances = variances * np.divide(error**2, whole, out=np.zeros_like(whole), where=whole > 0)
    least, cost, rate = (np.array([table[part] for part in Part])[:, None] for table in (_LEAST, COST, RATE))
    number = np.broadcast_to(least, variances.shape).astype(np.int64)
    goal = (_AIM * standard_error * total) ** 2
    for _ in range(_MOST_STEPS):
        now = variances * (seen.done / number) ** (2 * rate)
        following = next_number(number)
        gain = now * (1 - (number / following) ** (2 * rate)) / (cost * (following - number))
        gain = np.where(following > LIMIT, 0.0, gain)
        step = (total > 0) & (np.sum(now, axis=0) > goal) & (np.max(gain, axis=0) > 0)
        if not np.any(step):
            break
        where = np.flatnonzero(step)
        best = np.argmax(gain[:, where], axis=0)
        number[best, where] = following[best, where]
    return number


def next_number(number: IntArray) -> IntArray:
    """The next of the numbers 2^k and 3 * 2^k: half as many again, or a third."""
    lowest = number & -number
    return np.asarray(number + np.where(lowest == number, np.maximum(number // 2, 1), lowest))


def blocks(part: Part, done: IntArray, wanted: IntArray) -> Iterator[Block]:
    """Cut what is wanted into blocks that start at a multiple of their length, a power of two."""
    while np.any(wanted > done):
        lowest = done & -done
        highest = 1 << np.floor(np.log2(np.maximum(wanted, 1))).astype(np.int64)
        length = np.where(done == 0, highest, np.where(done + lowest > wanted, done // 2, lowest))
        for first, samples in np.unique(np.stack([done, length], axis=1)[wanted > done], axis=0):
            chosen = np.flatnonzero((wanted > done) & (done == first) & (length == samples))
            yield Block(part, int(first), int(samples), chosen)
        done = np.where(wanted > done, done + length, done)
