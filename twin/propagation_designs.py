"""At which values of the inputs the twin is evaluated to find its sensitivities, and what follows from the differences.

A single parameter is varied both ways. Parameters of one source that are many (holes, points of the coupon) are varied
together along the rows of a Hadamard matrix with random signs: the variance over the rows is their summed variance,
exactly where the response is linear and the parameters are fewer than the rows, and without bias where they are more
(parameters that share a column are then told apart by their random signs only). The first column, which is constant, is
left out, so the nominal rendering is not needed and its noise enters nowhere.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import hadamard

from instrument.angles import FloatArray
from twin.state_vector import StateVector

#: Rows of a weighing design at most, a power of two.
ROWS = 32
_STEP = np.sqrt(3.0)
Squares = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class Design(ABC):
    """Evaluations for some parameters of one source.

    Attributes
    ----------
    name
        The parameter, or the source.
    source
        Row of the budget.
    values
        Where to evaluate, shape (parameter of the whole vector,) each.
    """

    name: str
    source: str
    values: list[FloatArray]

    @property
    def aliasing(self) -> float:
        """Relative standard error of the variance because parameters share columns."""
        return 0.0

    @abstractmethod
    def effects(self, differences: FloatArray) -> FloatArray:
        """Effects of independent errors of variance 1, shape (component, point, randomisation).

        Their squares add up to the variance.

        Parameters
        ----------
        differences, shape (evaluation, point, randomisation)
            From the nominal rendering.
        """

    @abstractmethod
    def shift(self, mean: FloatArray) -> FloatArray:
        """Expected value less nominal value, shape (point,), from mean effects (component, point)."""

    @abstractmethod
    def slopes(self, mean: FloatArray) -> dict[str, FloatArray]:
        """Sensitivities by parameter, shape (point,)."""

    @abstractmethod
    def curvature(self, squares: Squares, effects: FloatArray) -> float | None:
        """Quadratic over linear effect, root mean square over the points; None where it is not known."""


@dataclass(frozen=True)
class BothWays(Design):
    """One parameter, sqrt(3) standard uncertainties up and down.

    With the differences a and b of the two evaluations, (a - b)/(2 sqrt 3) multiplies z and (a + b)/6 multiplies z^2 of
    a standard normal z; z and (z^2 - 1)/sqrt 2 are uncorrelated with variance 1.
    """

    standard_uncertainty: float

    def effects(self, differences: FloatArray) -> FloatArray:
        up, down = differences
        return np.stack([(up - down) / (2 * _STEP), np.sqrt(2.0) * (up + down) / 6])

    def shift(self, mean: FloatArray) -> FloatArray:
        return np.asarray(mean[1] / np.sqrt(2.0))

    def slopes(self, mean: FloatArray) -> dict[str, FloatArray]:
        return {self.name: mean[0] / self.standard_uncertainty}

    def curvature(self, squares: Squares, effects: FloatArray) -> float | None:
        (linear, noise), (quadratic, _) = (squares(effects[k : k + 1]) for k in (0, 1))
        if np.mean(linear) <= np.mean(noise):
            return None
        return float(np.sqrt(max(0.0, float(np.mean(quadratic))) / np.mean(linear)))


@dataclass(frozen=True)
class Together(Design):
    """All parameters of a source along orthogonal rows of signs, shape (row, parameter)."""

    signs: FloatArray
    labels: tuple[str, ...]
    standard_uncertainty: FloatArray

    @property
    def aliasing(self) -> float:
        rows, parameters = self.signs.shape
        return float(np.sqrt(2 / rows)) if parameters >= rows else 0.0

    def effects(self, differences: FloatArray) -> FloatArray:
        return (differences - differences.mean(axis=0)) / np.sqrt(len(self.signs))

    def shift(self, mean: FloatArray) -> FloatArray:
        return np.zeros(mean.shape[1])

    def slopes(self, mean: FloatArray) -> dict[str, FloatArray]:
        rows, parameters = self.signs.shape
        if parameters >= rows:
            return {}
        slope = self.signs.T @ mean / np.sqrt(rows) / self.standard_uncertainty[:, None]
        return dict(zip(self.labels, slope, strict=True))

    def curvature(self, squares: Squares, effects: FloatArray) -> float | None:
        return None


def designs(state: StateVector, seed: int) -> list[Design]:
    """Cover every parameter that has an uncertainty once."""
    result: list[Design] = []
    u, nominal, labels = state.standard_uncertainty, state.nominal, state.labels
    generator = np.random.default_rng(seed)
    for source in state.sources:
        members = state.of_source(source)
        members = members[u[members] > 0]
        if all(len(block) == 1 for block in state.blocks if block.source == source):
            for member in members:
                step = np.zeros(len(nominal))
                step[member] = _STEP * u[member]
                result.append(BothWays(labels[member], source, [nominal + step, nominal - step], float(u[member])))
            continue
        rows = min(ROWS, 1 << int(np.ceil(np.log2(len(members) + 1))))
        flips = generator.choice([-1.0, 1.0], len(members))
        signs = hadamard(rows)[:, 1 + np.arange(len(members)) % (rows - 1)] * flips
        values = []
        for row in signs:
            value = nominal.copy()
            value[members] += row * u[members]
            values.append(value)
        result.append(Together(source, source, values, signs, tuple(labels[m] for m in members), u[members]))
    return result
