"""From a model in closed form to a table, with the error of doing so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from instrument.angles import FloatArray

#: BRDF in 1/sr of (cos_o, phi_rad, cos_i), which broadcast.
BrdfFunction = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Grid:
    """Nodes of a table, as of :class:`~twin.material.Material`."""

    cos_o: FloatArray
    phi_rad: FloatArray
    cos_i: FloatArray

    def values(self, function: BrdfFunction) -> FloatArray:
        """A function at every node, shape (o, phi, i); mirror symmetry is taken for granted."""
        half = len(self.phi_rad) // 2 + 1
        shape = (len(self.cos_o), half, len(self.cos_i))
        values = np.broadcast_to(
            function(self.cos_o[:, None, None], self.phi_rad[None, :half, None], self.cos_i[None, None, :]), shape
        )
        return np.concatenate([values, values[:, half - 2 :: -1]], axis=1)


def zenith_grid(zenith_deg: ArrayLike, phi_deg: ArrayLike) -> Grid:
    """Grid of the same zenith angles for both directions, and azimuth differences from 0 to 180 mirrored beyond.

    Parameters
    ----------
    zenith_deg
        Ascending, from 0 to 90.
    phi_deg
        Ascending, from 0 to 180.
    """
    cosines = np.cos(np.deg2rad(np.asarray(zenith_deg, dtype=float)))[::-1]
    cosines[np.abs(cosines) < 1e-12] = 0.0
    half = np.deg2rad(np.asarray(phi_deg, dtype=float))
    return Grid(cosines, np.concatenate([half, 2 * np.pi - half[-2::-1]]), cosines.copy())


@dataclass(frozen=True)
class GriddingError:
    """How far a table is from what it was made of.

    Attributes
    ----------
    relative_rms
        Root mean square of the difference over that of the model, both over directions weighted as a Lambertian
        surface under light from everywhere weights them.
    largest
        Largest difference among the directions tried, in 1/sr.
    where
        (emergent zenith, azimuth difference, incident zenith) of the largest, degree.
    """

    relative_rms: float
    largest: float
    where: tuple[float, float, float]


def gridding_error(
    grid: Grid, values: FloatArray, function: BrdfFunction, *, ridge_rad: float | None = None, seed: int = 0
) -> GriddingError:
    """Compare a table with its model between the nodes, at directions drawn at random.

    Parameters
    ----------
    values, shape (o, phi, i)
        The table.
    function
        The model.
    ridge_rad
        Azimuth difference at which a lobe is narrow about equal zenith angles: there the largest difference is looked
        for too.
    seed
        Of the directions.
    """
    random = np.random.default_rng(seed)
    cos_o, cos_i = np.sqrt(random.uniform(0, 1, (2, 20000)))
    phi = random.uniform(0, 2 * np.pi, 20000)
    if ridge_rad is not None:
        along = np.cos(np.deg2rad(np.linspace(0.5, 85.0, 2000)))
        cos_o, cos_i = np.append(cos_o, along), np.append(cos_i, along)
        phi = np.append(phi, np.full(2000, ridge_rad))
    exact = np.broadcast_to(function(cos_o, phi, cos_i), cos_o.shape)
    difference = interpolate(grid, values, cos_o, phi, cos_i) - exact
    worst = int(np.argmax(np.abs(difference)))
    power, lost = (float(np.mean(x[:20000] ** 2)) for x in (exact, difference))
    angles = np.rad2deg([np.arccos(cos_o[worst]), phi[worst], np.arccos(cos_i[worst])])
    relative = np.sqrt(lost / power) if power > 0 else 0.0
    return GriddingError(float(relative), float(np.abs(difference[worst])), tuple(map(float, angles)))  # type: ignore[arg-type]


def interpolate(grid: Grid, values: FloatArray, cos_o: FloatArray, phi: FloatArray, cos_i: FloatArray) -> FloatArray:
    """Values between the nodes, as the ray tracer takes them; shape of the arguments."""
    from scipy.interpolate import RegularGridInterpolator

    axes = (grid.cos_o, grid.phi_rad, grid.cos_i)
    inside = [np.clip(x, axis[0], axis[-1]) for x, axis in zip((cos_o, phi, cos_i), axes, strict=True)]
    return np.asarray(RegularGridInterpolator(axes, values)(np.stack(inside, axis=-1)))
