"""How every point of a plan answers to every uncertain input: the Jacobian, for whoever reasons about differences.

Columns are relative changes of the reflectance factors. Parameters that can be told apart have a column each. The
many small ones of a kind (dimensions of the holes, random errors of the coupon) are reduced to a few columns along
which they vary together: these have the covariance of all of them, in the mean over the random signs that mix them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.events import Geometry
from twin.optics import sample_columns
from twin.propagation import Propagation, by_sensitivities
from twin.propagation_designs import ROWS
from twin.propagation_render import PlanRenderer
from twin.state_vector import StateVector


@dataclass(frozen=True)
class Sensitivities:
    """First-order response of a plan to its uncertain inputs.

    Attributes
    ----------
    brf, shape (point,)
        At the nominal inputs, with a Monte Carlo error of about the size of ``error``.
    names, sources, units, shape (column,)
        Of each column: parameter, row of the uncertainty budget, unit of the parameter. A reduced column has the name
        of its source and a number, and the unit 1.
    standard_uncertainty, shape (column,)
        k = 1, in the unit; 1 for reduced columns. Parameters are independent and normal.
    jacobian, error, shape (point, column)
        Relative change of the reflectance factor over that of the parameter, and its standard error by the ray tracer.
    reduced, shape (column,)
        Which columns are reduced.
    """

    brf: FloatArray
    names: tuple[str, ...]
    sources: tuple[str, ...]
    units: tuple[str, ...]
    standard_uncertainty: FloatArray
    jacobian: FloatArray
    error: FloatArray
    reduced: np.ndarray

    def factor(self) -> FloatArray:
        """Relative errors by one standard uncertainty of each column, shape (point, column)."""
        return np.asarray(self.jacobian * self.standard_uncertainty)

    def covariance(self) -> FloatArray:
        """Relative covariance of the errors between points, shape (point, point).

        What the ray tracer's noise in the columns would add to the diagonal is taken off; no eigenvalue is negative.
        """
        factor = self.factor()
        covariance = factor @ factor.T
        covariance[np.diag_indices_from(covariance)] -= np.sum((self.error * self.standard_uncertainty) ** 2, axis=1)
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(root @ root.T)

    def only(self, sources: Collection[str]) -> Sensitivities:
        """The columns of some rows of the budget.

        Raises
        ------
        InputError
            For a source that there is not.
        """
        unknown = sorted(set(sources) - set(self.sources))
        if unknown:
            raise InputError(f"source: found {', '.join(unknown)}; expected some of {', '.join(self.all_sources)}")
        return self._take(np.array([source in sources for source in self.sources], dtype=bool))

    def without(self, sources: Collection[str]) -> Sensitivities:
        """The columns of all rows of the budget but some; names that occur in none are passed over."""
        return self._take(np.array([source not in sources for source in self.sources], dtype=bool))

    @property
    def all_sources(self) -> tuple[str, ...]:
        """Rows of the budget, in order."""
        return tuple(dict.fromkeys(self.sources))

    def _take(self, keep: np.ndarray) -> Sensitivities:
        chosen = np.flatnonzero(keep)
        words: dict[str, Any] = {
            key: tuple(getattr(self, key)[k] for k in chosen) for key in ("names", "sources", "units")
        }
        return replace(
            self,
            **words,
            standard_uncertainty=self.standard_uncertainty[chosen],
            jacobian=self.jacobian[:, chosen],
            error=self.error[:, chosen],
            reduced=self.reduced[chosen],
        )


def sensitivities(
    state: StateVector,
    geometries: Sequence[Geometry] | xr.Dataset,
    *,
    tolerance: float = 0.1,
    seed: int = 1,
    rows: int = ROWS,
    **where: Any,
) -> Sensitivities:
    """Find the response of every point to every uncertain input.

    Parameters
    ----------
    state
        From :func:`~twin.state_vector.state_vector` or :func:`~twin.state_vector.state_vector_from_files`.
    geometries
        As for :meth:`twin.prediction.Twin.predict`.
    tolerance
        Relative standard error of the combined uncertainty to reach at the median point.
    rows
        Columns that many small parameters of a kind are reduced to, a power of two; covariances between their errors
        are then known to one part in its root.
    where
        ``address``, ``workers``, ``progress`` as of :func:`~twin.propagation.by_sensitivities`.

    Examples
    --------
    >>> s = sensitivities(state_vector_from_files(facility, artifact, material), run)  # doctest: +SKIP
    >>> run_u = s.without(["material reference"]).covariance()  # doctest: +SKIP
    """
    renderer = PlanRenderer(state, sample_columns(geometries), seed=seed)
    return of_propagation(state, by_sensitivities(renderer, tolerance=tolerance, seed=seed, rows=rows, **where))


def of_propagation(state: StateVector, result: Propagation) -> Sensitivities:
    """The columns of a propagation by sensitivities."""
    source_of = {label: block.source for block in state.blocks for label in block.labels}
    u_of = dict(zip(state.labels, state.standard_uncertainty, strict=True))
    scale = np.where(result.brf > 0, 1 / np.where(result.brf > 0, result.brf, 1.0), 0.0)[:, None]
    alone = list(result.sensitivity)
    told_apart = {source_of[label] for label in alone}
    mixed = np.array([source not in told_apart for source in result.component_sources], dtype=bool)
    columns = [np.stack([part[label] for label in alone], axis=1) if alone else np.zeros((len(result.brf), 0))
               for part in (result.sensitivity, result.sensitivity_error)]  # fmt: skip
    numbers: dict[str, int] = {}
    names, sources = alone.copy(), [source_of[label] for label in alone]
    for k in np.flatnonzero(mixed):
        source = result.component_sources[int(k)]
        names.append(f"{source}, column {numbers.setdefault(source, 0)}")
        sources.append(source)
        numbers[source] += 1
    count = int(mixed.sum())
    return Sensitivities(
        result.brf,
        tuple(names),
        tuple(sources),
        (*(result.units[label] for label in alone), *("1",) * count),
        np.array([*(u_of[label] for label in alone), *np.ones(count)], dtype=float),
        np.concatenate([columns[0], result.factor[:, mixed]], axis=1) * scale,
        np.concatenate([columns[1], result.factor_error[:, mixed]], axis=1) * scale,
        np.arange(len(names)) >= len(alone),
    )
