"""How large an effect may be, before looking: broad in its severity, bounded by what is physically possible.

An effect inside the budget is no cause to be named: the budget already contains it. So the prior of a *named* effect is
a slab in the logarithm of its severity, the root mean square of its relative change over the relative
uncertainty of the run, equal in all directions of its parameters, and cut at the physical cap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import gamma, pi
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray

#: Severities between which the prior is flat in the logarithm; beyond, it falls as a power.
LOWEST, HIGHEST = 0.5, 6.0
_FALL = 4.0
#: Radii along a direction, and directions of two or more parameters.
_RADII, _DIRECTIONS = 36, 24
_LIMITS = (0.15, 12.0)
#: Typical amplitudes that no effect exceeds.
_FARTHEST = 60.0


class Parameter(Protocol):
    """A parameter of an effect."""

    @property
    def name(self) -> str:
        """As in the data contract."""
        ...

    @property
    def nominal(self) -> float:
        """Value that means no effect."""
        ...

    @property
    def typical(self) -> float:
        """Change of about one combined standard uncertainty."""
        ...

    @property
    def cap(self) -> tuple[float, float]:
        """Lowest and highest possible value."""
        ...

    @property
    def shape(self) -> bool:
        """Whether it says how the effect looks, not how large it is."""
        ...


class Signature(Protocol):
    """What an effect does to the readings of one run."""

    @property
    def name(self) -> str:
        """As in the data contract."""
        ...

    @property
    def parameters(self) -> Sequence[Parameter]:
        """What it depends on."""
        ...

    @property
    def catalogued(self) -> bool:
        """Whether it may be named; another is told as a suspicion."""
        ...

    @property
    def shapes(self) -> int:
        """Values of every parameter of shape from which fits start."""
        ...

    @property
    def form_error(self) -> float:
        """Relative error of the response where its law is only one of several."""
        ...

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """Logarithm of the reading with the effect over that without, shape (value, point); values (value, p)."""
        ...


@dataclass(frozen=True)
class Nodes:
    """Values of an effect's parameters that cover its prior.

    Attributes
    ----------
    values, shape (node, p)
    log_mass, shape (node,)
        Logarithm of the prior probability of each node.
    table, shape (node, point)
        Logarithm of the ratio there.
    inside
        Probability that the cap leaves of the prior.
    """

    values: FloatArray
    log_mass: FloatArray
    table: FloatArray
    inside: float


class AmplitudePrior:
    """Prior of an effect's parameters in one run.

    Parameters of shape are uniform within their caps; the others follow the slab.

    Parameters
    ----------
    signature
        The effect.
    relative_u, shape (point,)
        Of the run: the unit of severity.
    """

    def __init__(self, signature: Signature, relative_u: FloatArray) -> None:
        self.signature = signature
        self._relative_u = relative_u
        parameters = signature.parameters
        self.nominal = np.array([p.nominal for p in parameters])
        self.scale = np.array([abs(p.typical) for p in parameters])
        self.low = np.array([p.cap[0] for p in parameters])
        self.high = np.array([p.cap[1] for p in parameters])
        self.sized = np.array([not p.shape for p in parameters])
        count = int(self.sized.sum())
        self._sphere = 2 * pi ** (count / 2) / gamma(count / 2)
        self._shape_density = -float(np.sum(np.log((self.high - self.low)[~self.sized])))
        self._inside = 1.0

    def at(self, rows: NDArray[np.int64]) -> AmplitudePrior:
        """The same prior where only some points of the run are looked at."""
        some = AmplitudePrior(AtRows(self.signature, rows), self._relative_u[rows])
        some._inside = self._inside
        return some

    def severity(self, table: FloatArray) -> FloatArray:
        """Of rows of logarithmic ratios, shape (..., point)."""
        return np.asarray(np.sqrt(np.mean((np.expm1(table) / self._relative_u) ** 2, axis=-1)))

    def log_density(self, value: FloatArray, table: FloatArray) -> float:
        """Logarithm of the density at a value, shape (p,), whose logarithmic ratio is known; -inf beyond the cap."""
        if np.any(value < self.low) or np.any(value > self.high):
            return -np.inf
        scale = self.scale[self.sized]
        radius = float(np.linalg.norm((value - self.nominal)[self.sized] / scale))
        severity = float(self.severity(table))
        if radius == 0 or severity == 0:
            return -np.inf
        jacobian = len(scale) * np.log(radius) + np.sum(np.log(scale)) + np.log(self._sphere)
        inside = np.log(max(self._inside, 1e-12))
        return float(log_slab(np.array(severity)) - jacobian + self._shape_density - inside)

    def nodes(self) -> Nodes:
        """Cover the prior: shapes, directions, and along each direction severities in a geometric row."""
        rows, masses, tables = [], [], []
        shapes, directions = self._shapes(), _directions(int(self.sized.sum()))
        for shape in shapes:
            for way in directions:
                step = np.zeros(len(self.nominal))
                step[self.sized] = way
                radii, log_mass, table = self._along(shape, step * self.scale)
                if len(radii):
                    rows.append(shape + radii[:, None] * step * self.scale)
                    masses.append(log_mass - np.log(len(directions) * len(shapes)))
                    tables.append(table)
        if not rows:
            empty = np.zeros((0, len(self.nominal)))
            return Nodes(empty, np.zeros(0), np.zeros((0, len(self._relative_u))), 0.0)
        log_mass = np.concatenate(masses)
        self._inside = float(np.sum(np.exp(log_mass)))
        normalised = log_mass - np.log(self._inside)
        return Nodes(np.concatenate(rows), normalised, np.concatenate(tables), min(1.0, self._inside))

    def _shapes(self) -> FloatArray:
        """Nominal values with the parameters of shape at evenly spread ones, shape (shape, p)."""
        count = self.signature.shapes
        share = (np.arange(count) + 0.5) / count
        axes = [
            np.array([self.nominal[k]]) if self.sized[k] else self.low[k] + share * (self.high[k] - self.low[k])
            for k in range(len(self.nominal))
        ]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=-1)

    def _along(self, origin: FloatArray, step: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Radii along a direction up to the cap, the logarithm of the prior mass of each, and the tables."""
        nothing = np.zeros(0), np.zeros(0), np.zeros((0, len(self._relative_u)))
        with np.errstate(divide="ignore", invalid="ignore"):
            up, down = (self.high - origin) / step, (self.low - origin) / step
            bounds = np.where(step > 0, up, np.where(step < 0, down, np.inf))
        longest = min(float(np.min(bounds)), _FARTHEST)
        if longest <= 0:
            return nothing
        probe = np.geomspace(longest * 1e-3, longest, 32)
        found = self.signature.log_ratio(origin + probe[:, None] * step)
        severity = np.maximum.accumulate(self.severity(found)) * (1 + 1e-9 * np.arange(len(probe)))
        top = min(severity[-1], _LIMITS[1])
        if top <= _LIMITS[0]:
            return nothing
        edges = np.geomspace(_LIMITS[0], top, _RADII + 1)
        centres = np.sqrt(edges[1:] * edges[:-1])
        radii = np.exp(np.interp(np.log(centres), np.log(np.maximum(severity, 1e-12)), np.log(probe)))
        table = self.signature.log_ratio(origin + radii[:, None] * step)
        return radii, log_slab(centres) + np.log(np.log(edges[1:] / edges[:-1])), table


@dataclass(frozen=True)
class AtRows:
    """An effect, at some points of a run."""

    of: Signature
    rows: NDArray[np.int64]

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.of.name

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Of the effect."""
        return self.of.parameters

    @property
    def catalogued(self) -> bool:
        """Of the effect."""
        return self.of.catalogued

    @property
    def shapes(self) -> int:
        """Of the effect."""
        return self.of.shapes

    @property
    def form_error(self) -> float:
        """Of the effect."""
        return self.of.form_error

    def log_ratio(self, values: FloatArray) -> FloatArray:
        """As of the effect, shape (value, row)."""
        return np.asarray(self.of.log_ratio(values)[:, self.rows])


def log_slab(severity: FloatArray) -> FloatArray:
    """Logarithm of the prior density in the logarithm of the severity; integrates to 1."""
    width = np.log(HIGHEST / LOWEST) + 2 / _FALL
    beyond = np.maximum(np.log(LOWEST / severity), 0) + np.maximum(np.log(severity / HIGHEST), 0)
    return np.asarray(-_FALL * beyond - np.log(width))


def _directions(count: int) -> FloatArray:
    """Unit vectors evenly over the sphere in so many dimensions."""
    if count == 1:
        return np.array([[1.0], [-1.0]])
    if count == 2:
        angle = 2 * pi * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    from scipy.stats import norm, qmc

    points = norm.ppf(qmc.Sobol(count, scramble=True, rng=11).random(64) * (1 - 2e-9) + 1e-9)
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def log_sum(values: FloatArray, axis: int | None = None) -> FloatArray:
    """Logarithm of the sum of exponentials, -inf of nothing."""
    from scipy.special import logsumexp

    return np.asarray(logsumexp(values, axis=axis)) if values.size else np.array(-np.inf)
