"""At which values of the inputs the twin is evaluated to find its sensitivities, and what follows from the differences.

A single parameter is varied both ways. Parameters of one source that are several (holes, points of the coupon) are
varied together along the rows of a Hadamard matrix with random signs: the variance over the rows is their summed
variance, exactly where the response is linear and the parameters are fewer than the rows, and without bias where they
are more (parameters that share a column are then told apart by their random signs only). The first column, which is
constant, is left out, so the nominal rendering is not needed and its noise enters nowhere.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy.linalg import hadamard

from instrument.angles import FloatArray
from twin.state_vector import StateVector

#: Rows of a weighing design of parameters that are told apart, at most, and of one of more parameters; powers of two.
RESOLVED_ROWS, ROWS = 32, 16
#: Both ways of a single parameter, in standard uncertainties.
STEP = float(np.sqrt(3.0))


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
    def curved(self, differences: FloatArray) -> FloatArray | None:
        """The quadratic effect, shape (1, point, randomisation), scaled like :meth:`effects`; None where not known."""

    @abstractmethod
    def slopes(self, effects: FloatArray) -> dict[str, FloatArray]:
        """Sensitivities by parameter, shape (point, randomisation), of parameters that are told apart."""


@dataclass(frozen=True)
class BothWays(Design):
    """One parameter, some standard uncertainties up and down.

    With the differences a and b of the two evaluations at +-h standard uncertainties, (a - b)/(2 h) multiplies z and
    (a + b)/(2 h^2) multiplies z^2 of a standard normal z; z and (z^2 - 1)/sqrt 2 are uncorrelated with variance 1. With
    h^2 = 3 this is the three-point Gauss-Hermite rule, exact up to the fourth moment.
    """

    standard_uncertainty: float
    step: float = STEP

    def effects(self, differences: FloatArray) -> FloatArray:
        up, down = differences
        return np.asarray((up - down)[None] / (2 * self.step))

    def curved(self, differences: FloatArray) -> FloatArray:
        up, down = differences
        return np.asarray(np.sqrt(2.0) * (up + down)[None] / (2 * self.step**2))

    def slopes(self, effects: FloatArray) -> dict[str, FloatArray]:
        return {self.name: effects[0] / self.standard_uncertainty}


@dataclass(frozen=True)
class Together(Design):
    """All parameters of a source along orthogonal rows of signs, shape (row, parameter)."""

    signs: FloatArray
    labels: tuple[str, ...]
    standard_uncertainty: FloatArray

    @property
    def resolved(self) -> bool:
        """Whether every parameter has a column of its own."""
        rows, parameters = self.signs.shape
        return parameters < rows

    @property
    def aliasing(self) -> float:
        return 0.0 if self.resolved else float(np.sqrt(2 / len(self.signs)))

    def effects(self, differences: FloatArray) -> FloatArray:
        rows = len(self.signs)
        if not self.resolved:
            return np.asarray((differences - differences.mean(axis=0)) / np.sqrt(rows))
        return np.asarray(np.einsum("rk,rpn->kpn", self.signs, differences, optimize=True) / rows)

    def curved(self, differences: FloatArray) -> None:
        return None

    def slopes(self, effects: FloatArray) -> dict[str, FloatArray]:
        if not self.resolved:
            return {}
        return dict(zip(self.labels, effects / self.standard_uncertainty[:, None, None], strict=True))


def designs(state: StateVector, seed: int, *, rows: int = ROWS, step: float = STEP) -> list[Design]:
    """Cover every parameter that has an uncertainty once.

    Parameters
    ----------
    seed
        Of the random signs.
    rows
        Of the designs whose parameters are too many to be told apart, a power of two; with as many rows as there are
        parameters, and one, they are.
    step
        Of single parameters, in standard uncertainties.
    """
    result: list[Design] = []
    u, nominal, labels = state.standard_uncertainty, state.nominal, state.labels
    generator = np.random.default_rng(seed)
    for source in state.sources:
        members = state.of_source(source)
        members = members[u[members] > 0]
        if all(len(block) == 1 for block in state.blocks if block.source == source):
            for member in members:
                change = np.zeros(len(nominal))
                change[member] = step * u[member]
                values = [nominal + change, nominal - change]
                result.append(BothWays(labels[member], source, values, float(u[member]), step))
            continue
        needed = 1 << int(np.ceil(np.log2(len(members) + 1)))
        number = needed if needed <= max(RESOLVED_ROWS, rows) else rows
        flips = generator.choice([-1.0, 1.0], len(members))
        signs = hadamard(number)[:, 1 + np.arange(len(members)) % (number - 1)] * flips
        values = []
        for row in signs:
            value = nominal.copy()
            value[members] += row * u[members]
            values.append(value)
        result.append(Together(source, source, values, signs, tuple(labels[m] for m in members), u[members]))
    return result
