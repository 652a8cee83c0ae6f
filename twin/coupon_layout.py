"""The grid behind a coupon run, and the paper's table on it: gaps filled linearly, the nearest value beyond.

Which reading belongs to which entry depends on the geometry alone and is kept, because many sets of readings share one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.reflection_models.smooth import Directions

#: Directions this close to retro-reflection cannot be measured; only there may points be missing. Degree.
RETRO_GAP = 5.0 + 1e-6
_GRID = 1e-6


@dataclass(frozen=True)
class CosineTable:
    """One wavelength's table of reflectance factors over the axes of a :class:`~twin.material.Material`.

    ``brf`` has shape (o, phi, i); ``filled`` counts of ``entries``, those up to 180 degrees of azimuth.
    """

    cos_o: FloatArray
    phi_rad: FloatArray
    cos_i: FloatArray
    brf: FloatArray
    filled: dict[str, int]
    entries: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Layout:
    """Where the readings of a run stand on its grid.

    Attributes
    ----------
    theta_o, phi, theta_i
        Ascending nodes, degree; phi from 0 to 180.
    weights, shape (entry, reading)
        Readings averaged into each entry of the table (o, phi, i); zero rows where none is.
    retro, shape (gap, 4)
        Flat entry, flat entries of its neighbours in zenith, and the fraction of the way between them.
    neighbours, shape (reading, 3)
        The same for a reading as if it were missing; entry -1 where it has no neighbours.
    """

    theta_o: FloatArray
    phi: FloatArray
    theta_i: FloatArray
    weights: FloatArray
    retro: FloatArray
    neighbours: FloatArray

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the table."""
        return len(self.theta_o), len(self.phi), len(self.theta_i)

    @property
    def grid_key(self) -> tuple[tuple[float, ...], ...]:
        """Equal for equal grids."""
        return tuple(self.theta_o), tuple(self.phi), tuple(self.theta_i)

    @property
    def last(self) -> tuple[float, float]:
        """Largest incident and emergent zenith, degree."""
        return float(self.theta_i[-1]), float(self.theta_o[-1])

    @property
    def azimuths(self) -> tuple[float, ...]:
        """Azimuth differences, degree."""
        return tuple(float(a) for a in self.phi)

    @property
    def zeniths(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Incident and emergent zeniths, degree."""
        return tuple(map(float, self.theta_i)), tuple(map(float, self.theta_o))

    @property
    def measured(self) -> np.ndarray:
        """Which entries hold a reading, shape (o, phi, i)."""
        return np.any(self.weights != 0, axis=1).reshape(self.shape)

    def nodes(self, brf: FloatArray, name: str) -> FloatArray:
        """The table (o, phi, i) of readings, gaps at retro-reflection interpolated linearly in zenith.

        Raises
        ------
        InputError
            For gaps elsewhere.
        """
        table = np.where(self.measured.ravel(), self.weights @ brf, np.nan)
        if len(self.retro):
            gap, low, high = self.retro[:, :3].astype(int).T
            table[gap] = table[low] + (table[high] - table[low]) * self.retro[:, 3]
        table = table.reshape(self.shape)
        gaps = np.argwhere(np.isnan(table))
        if len(gaps):
            o, p, i = gaps[0]
            raise InputError(
                f"{name}: the table has {len(gaps)} gaps of {table.size} entries that are not at retro-reflection, the"
                f" first at illumination_zenith {self.theta_i[i]:g}, sensor_zenith {self.theta_o[o]:g}, azimuth"
                f" difference {self.phi[p]:g} degrees; expected every combination (the plan of the paper's Table III)"
            )
        return table

    def from_neighbours(self, brf: FloatArray) -> FloatArray:
        """Each reading as its neighbours in zenith predict it, NaN where it lacks one; shape (reading,)."""
        table = np.where(self.measured.ravel(), self.weights @ brf, np.nan)
        low, high = self.neighbours[:, :2].astype(int).T
        guess = table[low] + (table[high] - table[low]) * self.neighbours[:, 2]
        return np.where(low >= 0, guess, np.nan)


def lay_out(theta_i: FloatArray, theta_o: FloatArray, phi: FloatArray, name: str) -> Layout:
    """Find the grid of readings at folded angles in degree (phi 0 to 180).

    Raises
    ------
    InputError
        If the azimuth differences do not reach from 0 to 180 degrees.
    """
    return _lay_out(Directions(theta_i, theta_o, phi).key(), name)


@lru_cache(maxsize=16)
def _lay_out(key: tuple[bytes, bytes, bytes], name: str) -> Layout:
    given = Directions.of_key(key)
    theta_i, theta_o, phi = given.incident_rad, given.emergent_rad, given.phi_rad  # degrees, here
    grid_i, grid_o = np.unique(np.round(theta_i, 6)), np.unique(np.round(theta_o, 6))
    grid_phi = _plane_azimuths(phi, theta_i, theta_o, name)
    o, p, i = (
        np.argmin(np.abs(g[:, None] - x), axis=0)
        for g, x in zip((grid_o, grid_phi, grid_i), (theta_o, phi, theta_i), strict=True)
    )
    shape = (len(grid_o), len(grid_phi), len(grid_i))
    weights = np.zeros((int(np.prod(shape)), len(phi)))
    # Along a normal the azimuth has no meaning: such a reading belongs to all of them.
    free = (theta_o < _GRID) | (theta_i < _GRID)
    for plane in range(len(grid_phi)):
        rows = np.flatnonzero(free | (p == plane))
        weights[np.ravel_multi_index((o[rows], np.full(len(rows), plane), i[rows]), shape), rows] = 1.0
    count = weights.sum(axis=1, keepdims=True)
    weights /= np.where(count > 0, count, 1.0)
    lines = _Lines(grid_o, grid_phi, shape, count[:, 0] > 0)
    retro = [
        (np.ravel_multi_index((a, b, c), shape), *between)
        for a, b, c in np.argwhere(~lines.known.reshape(shape))
        if _from_retro(grid_i[c], grid_o[a], grid_phi[b]) < RETRO_GAP and (between := lines.around(a, b, c))
    ]
    neighbours = [lines.around(*place) or (-1, -1, 0.0) for place in zip(o, p, i, strict=True)]
    return Layout(grid_o, grid_phi, grid_i, weights, np.array(retro).reshape(-1, 4), np.array(neighbours))


class _Lines:
    """Lines of readings through the normal: a plane of azimuth and the opposite one, along signed zenith."""

    def __init__(self, theta_o: FloatArray, phi: FloatArray, shape: tuple[int, int, int], known: np.ndarray) -> None:
        self.theta_o, self.shape, self.known = theta_o, shape, known
        distance = np.abs(phi[:, None] - (180.0 - phi))
        self.opposite = np.where(np.min(distance, axis=0) < _GRID, np.argmin(distance, axis=0), -1)

    def around(self, o: int, p: int, i: int) -> tuple[int, int, float] | None:
        """Entries with readings on both sides of one along its line, and the fraction of the way between them."""
        if self.opposite[p] < 0:
            return None
        ahead = np.ravel_multi_index((np.arange(len(self.theta_o)), p, i), self.shape)
        behind = np.ravel_multi_index((np.arange(len(self.theta_o)), int(self.opposite[p]), i), self.shape)
        at = self.theta_o[o]
        zenith = np.concatenate([-self.theta_o[::-1], self.theta_o])
        entry = np.concatenate([behind[::-1], ahead])
        known = self.known[entry] & (np.abs(zenith - at) > _GRID)
        below, above = known & (zenith < at), known & (zenith > at)
        if not (np.any(below) and np.any(above)):
            return None
        low, high = np.flatnonzero(below)[-1], np.flatnonzero(above)[0]
        return int(entry[low]), int(entry[high]), float((at - zenith[low]) / (zenith[high] - zenith[low]))


def paper_table(layout: Layout, nodes: FloatArray) -> CosineTable:
    """The paper's table: mirrored to the whole circle, the nearest value at grazing angles that were not measured."""
    phi = np.concatenate([layout.phi, 360.0 - layout.phi[-2::-1]])
    values = np.concatenate([nodes, nodes[:, -2::-1]], axis=1)[::-1, :, ::-1]
    cos_o, cos_i = np.cos(np.deg2rad(layout.theta_o[::-1])), np.cos(np.deg2rad(layout.theta_i[::-1]))
    filled = {"retroreflection": len(layout.retro)}
    half = len(layout.phi)
    if cos_o[0] > _GRID:
        cos_o, values = np.concatenate([[0.0], cos_o]), np.concatenate([values[:1], values])
        filled["grazing emergence"] = half * len(layout.theta_i)
    if cos_i[0] > _GRID:
        cos_i, values = np.concatenate([[0.0], cos_i]), np.concatenate([values[:, :, :1], values], axis=2)
        filled["grazing incidence"] = half * len(cos_o)
    if cos_i[-1] < 1 - _GRID:
        cos_i, values = np.concatenate([cos_i, [1.0]]), np.concatenate([values, values[:, :, -1:]], axis=2)
    if cos_o[-1] < 1 - _GRID:
        cos_o, values = np.concatenate([cos_o, [1.0]]), np.concatenate([values, values[-1:]])
    return CosineTable(cos_o, np.deg2rad(phi), cos_i, values, filled, len(cos_o) * half * len(cos_i))


def _plane_azimuths(phi: FloatArray, theta_i: FloatArray, theta_o: FloatArray, name: str) -> FloatArray:
    """Azimuth differences of the grid, 0 to 180 degrees."""
    meaningful = (theta_i > _GRID) & (theta_o > _GRID)
    grid = np.unique(np.round(phi[meaningful] if np.any(meaningful) else np.array([0.0, 180.0]), 4))
    if grid[0] > _GRID or abs(grid[-1] - 180.0) > _GRID:
        raise InputError(
            f"{name}: sensor_azimuth: the azimuth differences run from {grid[0]:g} to {grid[-1]:g} degrees;"
            " expected 0 to 180 (sensor_azimuth 0 with negative and positive sensor_zenith)"
        )
    return grid


def _from_retro(theta_i: float, theta_o: float, phi: float) -> float:
    """Angle between emergence and retro-reflection, degree."""
    i, o, p = np.deg2rad([theta_i, theta_o, phi])
    cosine = np.cos(i) * np.cos(o) + np.sin(i) * np.sin(o) * np.cos(p)
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
