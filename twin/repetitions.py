"""Repetitions of a main run whose error came out larger than wanted, and what it comes to with them.

A randomisation is repeated by what the others scatter, never by its own value: were it so, a skewed run that came out
high would be repeated and one that came out low not, and the mean would be low (leave-one-out, as in the jackknife). So
the mean has no bias, whatever the number of sight lines and the distribution of their values. How long the repetition
is may depend on everything, for that does not shift its mean.

Only where a single randomisation is so far off that the wanted error cannot be reached without repeating it by its own
value, one prediction in some hundred, all are repeated alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from instrument.angles import FloatArray
from twin.pooled_variance import Expected
from twin.sampling_plan import COST, LIMIT, RATE, Block, IntArray, Tally, blocks, total_and_error
from twin.tracer import RANDOMISATIONS, Part

#: How long repetitions may be, over the main run.
_STEPS = np.concatenate([[0.0], 2.0 ** np.arange(-2, 7)])
#: A variance falls with this power of the length, shape (part, 1).
_RATE2 = np.array([[2 * RATE[part]] for part in Part])
#: Where that leaves more than this part of the wanted error, repetitions get twice the length, so often at most.
_MARGIN, _MOST_LONGER = 0.998, 3
#: Sight lines of a repetition at least.
_LEAST = 256
#: Part of the wanted error that is aimed at: a randomisation that is repeated less than others raises it a little.
_AIM = 0.99


@dataclass(frozen=True)
class Repetitions:
    """How much of a main run is repeated.

    Attributes
    ----------
    main, expected
        The main run, and what the pilot says of its variances.
    weight, shape (part, point, RANDOMISATIONS)
        Of the repetitions over that of the main run, in each randomisation; as the variances of both are expected.
    longer, shape (point,)
        So many times twice as long as the weight asks for. Their length, unlike the weight, may depend on everything
        that the main run has shown.
    """

    main: Tally
    expected: Expected
    weight: FloatArray
    longer: IntArray

    def lines(self) -> IntArray:
        """Sight lines that are repeated, shape (part, point): powers of two, so that launches are few."""
        share = self.weight.max(axis=-1, initial=0.0) ** (1 / _RATE2)
        least = np.maximum(share * self.main.done, np.minimum(_LEAST, self.main.done))
        lines = 2 ** (np.ceil(np.log2(np.maximum(least, 1))).astype(np.int64) + self.longer)
        return np.asarray(np.where(share > 0, np.minimum(lines, LIMIT), 0))

    def blocks(self) -> Iterator[Block]:
        """What is traced again."""
        for part, wanted in zip(Part, self.lines(), strict=True):
            yield from blocks(part, np.zeros_like(wanted), wanted)

    def result(self, again: Tally) -> tuple[FloatArray, FloatArray]:
        """The whole reading and its standard uncertainty, shape (point,) each, with what was traced again."""
        values = self.main.values()
        values += self.weight / (1 + self.weight) * (again.values() - values)
        return total_and_error(values.mean(axis=-1), *self.variances())

    def variances(self) -> tuple[FloatArray, FloatArray]:
        """Variance of each part's mean, shape (part, point), and its degrees of freedom, shape (part,)."""
        length = self.lines() / np.maximum(self.main.done, 1)
        variances, degrees = self.expected.pooled(self.main.variances())
        return variances * _left(self.weight, length[..., None] ** _RATE2[..., None]).mean(axis=-1), degrees


def no_repetitions(main: Tally, expected: Expected) -> Repetitions:
    """The main run alone."""
    return Repetitions(main, expected, np.zeros(main.sums.shape), np.zeros(main.done.shape[1], dtype=np.int64))


def repetitions(main: Tally, expected: Expected, standard_error: float) -> Repetitions:
    """How much is repeated for a wanted relative standard error, spent where the error falls most for the time."""
    values = main.values()
    others = (values.sum(axis=-1, keepdims=True) - values) / (RANDOMISATIONS - 1)
    # The squares of all but one, about their own mean.
    squares = np.sum((values - values.mean(axis=-1, keepdims=True)) ** 2, axis=-1, keepdims=True)
    scatter = squares - (values - others) ** 2 * ((RANDOMISATIONS - 1) / RANDOMISATIONS)
    found = np.maximum(scatter, 0.0) / ((RANDOMISATIONS - 2) * RANDOMISATIONS)
    variances, degrees = expected.pooled(found, RANDOMISATIONS - 2)
    parts = len(values)
    cost = np.array([COST[part] for part in Part])[:, None] * np.maximum(main.done, 1)
    cost = np.repeat(cost, RANDOMISATIONS, axis=1)
    step = _enough(others.reshape(parts, -1), variances.reshape(parts, -1), degrees, cost, standard_error)
    weight: FloatArray = _STEPS[step].reshape(values.shape) ** _RATE2[..., None]
    repeats = replace(no_repetitions(main, expected), weight=weight)
    for _ in range(_MOST_LONGER):
        total, error = total_and_error(main.means(), *repeats.variances())
        repeats = replace(repeats, longer=repeats.longer + (error > _MARGIN * standard_error * total))
    return _all_alike(repeats, standard_error)


def _all_alike(repeats: Repetitions, standard_error: float) -> Repetitions:
    """Let all randomisations weigh more where a single one far off would else leave the error too large."""
    least = np.zeros(repeats.main.done.shape, dtype=np.int64)
    means = repeats.main.means()
    for _ in range(len(Part) * len(_STEPS)):
        variances, degrees = repeats.variances()
        total, error = total_and_error(means, variances, degrees)
        over = np.flatnonzero((total > 0) & (error > _MARGIN * standard_error * total))
        if not len(over):
            break
        worst = np.argmax(variances[:, over], axis=0)
        least[worst, over] = np.minimum(least[worst, over] + 1, len(_STEPS) - 1)
        weight = np.maximum(repeats.weight, (_STEPS[least] ** _RATE2)[..., None])
        repeats = replace(repeats, weight=weight)
    return repeats


def _enough(
    means: FloatArray, variances: FloatArray, degrees: FloatArray, cost: FloatArray, standard_error: float
) -> IntArray:
    """Which of the steps is enough, shape (part, n), for means and variances of parts, shape (part, n)."""
    target = _AIM * standard_error * means.sum(axis=0)
    left = _left(_STEPS**_RATE2, _STEPS**_RATE2)
    step = np.zeros(means.shape, dtype=np.int64)
    row = np.arange(len(Part))[:, None]
    short = np.flatnonzero(target > 0)
    while True:
        some = step[:, short]
        error = total_and_error(means[:, short], variances[:, short] * left[row, some], degrees)[1]
        open_ = (error > target[short]) & (some.max(axis=0, initial=0) < len(_STEPS) - 1)
        if not np.any(open_):
            return step
        short, some = short[open_], some[:, open_]
        gain = (left[row, some] - left[row, some + 1]) / (_STEPS[some + 1] - _STEPS[some])
        best = np.argmax(gain * variances[:, short] / cost[:, short], axis=0)
        step[best, short] += 1


def _left(weight: FloatArray, gain: FloatArray) -> FloatArray:
    """What repetitions with a weight leave of the variance; theirs is smaller than the main run's by a factor."""
    return np.asarray((1 + weight**2 / np.where(gain > 0, gain, 1.0)) / (1 + weight) ** 2)
