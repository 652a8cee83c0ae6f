"""One run (or several) beside its nominal prediction: everything that the questions of the diagnosis are asked of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import Signature
from twin.diagnosis.covariance import Structure, smooth_gap, structures
from twin.diagnosis.fit import Component
from twin.diagnosis.likelihood import Normal, normals
from twin.diagnosis.observation import Observation
from twin.diagnosis.posterior import Posterior, Progress, weigh


@dataclass(frozen=True)
class Problem:
    """A run, its prediction, its budget and the library of effects.

    Attributes
    ----------
    run
        The measurement.
    nominal, shape (point,)
        Predicted reflectance factor.
    u_nominal, shape (point,)
        Relative standard error of the prediction, from the ray tracer.
    budget, shape (point, column)
        Relative change of the reading by one standard uncertainty of each input.
    structures
        How noise and stability may be correlated.
    gaps
        Correlation of gaps of unknown cause.
    components
        The library of effects.
    """

    run: Observation
    nominal: FloatArray
    u_nominal: FloatArray
    budget: FloatArray
    structures: Sequence[Structure]
    gaps: Sequence[tuple[str, FloatArray]]
    components: Sequence[Component]

    @classmethod
    def of(
        cls,
        run: Observation,
        nominal: FloatArray,
        u_nominal: FloatArray,
        budget: FloatArray,
        signatures: Sequence[Signature],
    ) -> Problem:
        """Collect a problem."""
        components = [Component.of(signature, run.relative_u) for signature in signatures]
        return cls(run, nominal, u_nominal, budget, structures(run), smooth_gap(run), components)

    @property
    def residual(self) -> FloatArray:
        """Logarithm of measurement over prediction, shape (point,)."""
        return np.asarray(np.log(self.run.brf / self.nominal))

    @cached_property
    def members(self) -> list[Normal]:
        """Distributions of the residual without an effect."""
        return normals(self.structures, self.budget, self.u_nominal)

    def posterior(self, progress: Progress | None = None) -> Posterior:
        """Weigh every explanation."""
        return weigh(self.residual, self.components, self.members, self.gaps, self.run.relative_u, progress)

    def at(self, rows: NDArray[np.int64], kept: Sequence[int] | None = None) -> Problem:
        """The problem at some points, with some of the structures."""
        chosen = range(len(self.structures)) if kept is None else kept
        block = np.ix_(rows, rows)
        some = [Structure(s.name, s.weight, s.covariance[block]) for s in (self.structures[k] for k in chosen)]
        return Problem(
            self.run.take(rows),
            self.nominal[rows],
            self.u_nominal[rows],
            self.budget[rows],
            some,
            [(name, shape[block]) for name, shape in self.gaps],
            [component.at(rows) for component in self.components],
        )

    def component(self, name: str) -> Component:
        """An effect of the library."""
        return next(c for c in self.components if c.name == name)
