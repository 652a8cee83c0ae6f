"""How probable a run is, given what an effect does to it, under every structure of the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import log_sum
from twin.diagnosis.covariance import Structure


@dataclass(frozen=True)
class Normal:
    """A normal distribution of the run's logarithmic residuals about zero, under one structure of the errors.

    Attributes
    ----------
    name, log_weight
        Of the structure; logarithm of its prior probability.
    covariance, shape (point, point)
    """

    name: str
    log_weight: float
    covariance: FloatArray

    @cached_property
    def _factor(self) -> FloatArray:
        return np.asarray(linalg.cholesky(self.covariance, lower=True, check_finite=False))

    @cached_property
    def whitener(self) -> FloatArray:
        """W with W' W the inverse of the covariance, shape (point, point)."""
        return np.asarray(linalg.solve_triangular(self._factor, np.eye(len(self._factor)), lower=True))

    @cached_property
    def log_norm(self) -> float:
        """Logarithm of the density at zero."""
        return float(-np.sum(np.log(np.diag(self._factor))) - 0.5 * len(self._factor) * np.log(2 * np.pi))

    def white(self, rows: FloatArray) -> FloatArray:
        """Rows of shape (..., point) with independent errors of unit variance."""
        return np.asarray(rows @ self.whitener.T)

    def log_density(self, residual: FloatArray) -> float:
        """Of one residual, shape (point,)."""
        white = linalg.solve_triangular(self._factor, residual, lower=True, check_finite=False)
        return float(-0.5 * white @ white) + self.log_norm


def normals(found: Sequence[Structure], common: FloatArray, own: FloatArray) -> list[Normal]:
    """Distributions of the residuals: every structure with what all of them share.

    Parameters
    ----------
    common, shape (point, parameter)
        Relative change of the prediction by one standard uncertainty of each input of the budget.
    own, shape (point,)
        Relative standard error of the prediction at each point, from the ray tracer.
    """
    shared = common @ common.T + np.diag(own**2)
    return [Normal(s.name, float(np.log(s.weight)), s.covariance + shared) for s in found]


@dataclass(frozen=True)
class Compressed:
    """Rows of a table as a few whitened components, to weigh many of them quickly.

    Attributes
    ----------
    coefficients, shape (row, component)
    basis, shape (component, point)
        Orthonormal at first; at some of the points it need not be.
    """

    coefficients: FloatArray
    basis: FloatArray

    @classmethod
    def of(cls, table: FloatArray, tolerance: float = 1e-5) -> Compressed:
        """Compress; what is left out is below the tolerance (logarithmic ratio) at every point."""
        if not len(table):
            return cls(np.zeros((0, 0)), np.zeros((0, table.shape[1])))
        # Eigenvectors of table' table are its right singular vectors: half of the digits are enough for the tolerance.
        squared, vectors = linalg.eigh(table.T @ table, check_finite=False)
        rest = np.sqrt(np.cumsum(np.maximum(squared, 0.0)))[::-1]
        kept = max(1, int(np.sum(rest > tolerance)))
        basis = np.ascontiguousarray(vectors[:, ::-1][:, :kept].T)
        return cls(table @ basis.T, basis)

    def log_density(self, residual: FloatArray, normal: Normal) -> FloatArray:
        """Of the residual less each row, shape (row,)."""
        basis, white = normal.white(self.basis), normal.white(residual)
        gram, cross = basis @ basis.T, basis @ white
        c = self.coefficients
        squared = white @ white - 2 * c @ cross + np.sum((c @ gram) * c, axis=1)
        return np.asarray(normal.log_norm - 0.5 * squared)


def marginal(log_values: FloatArray | Sequence[float], members: Sequence[Normal]) -> float:
    """Logarithm of the mean over structures of densities, shape (structure,)."""
    return float(log_sum(np.asarray(log_values) + np.array([m.log_weight for m in members])))
