"""The tracer: rays leave one bundle, light every surface they meet, and every such point is joined to other bundles.

With the beam as emitter the rays are photons, and one set of them serves every sensor direction; with the sensor
as emitter they are sight lines, which an unbounded beam needs. The coating is reciprocal, so both are the same
integral.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.stats import qmc

from instrument.angles import FloatArray
from sim_fixtures.reality.bundle import DIRECTIONS, FAR_DISC, PARALLEL, SQUARE, Bundle
from sim_fixtures.reality.coating import Reflection, grain_factor, reflectance_factor
from sim_fixtures.reality.scene import (
    BORE,
    CAVITY,
    ESCAPED,
    FLOOR,
    LEDGE,
    LOST,
    OUTSIDE,
    TOP,
    UNDERSIDE,
    WALL,
    Scene,
    follow,
    sees_out,
    surface_factor,
)
from sim_fixtures.reality.transport import diffused, diffusion_step

#: Columns of :attr:`Vertices.values`: point, normal, direction towards the emitter, weight.
_COLUMNS: Final = 10
#: Low-discrepancy dimensions of a ray: place on the disc, far end, direction after the first hit.
_DIMENSIONS: Final = 6
_DEEPEST: Final = 100
#: First of the draws for light inside the coating, beyond all others of a ray.
_APART: Final = 1_000
_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)


class Vertices(NamedTuple):
    """Lit points of a scene.

    Attributes
    ----------
    values
        Shape (vertex, 10): point (mm), unit normal, unit direction back towards where the light came from, weight.
    surface, hole
        Shape (vertex,): what was met, and in which hole (-1: none).
    escaped, lost
        Weight that left upwards, and that missed the sample.
    """

    values: FloatArray
    surface: NDArray[np.int64]
    hole: NDArray[np.int64]
    escaped: float
    lost: float


def trace(scene: Scene, reflection: Reflection, emitter: Bundle, rays: int, seed: int) -> Vertices:
    """Send rays from a bundle into a scene.

    Parameters
    ----------
    rays
        Number of rays, a power of two.
    seed
        Of the scrambling and of every later draw; the same seed gives the same vertices.

    Raises
    ------
    ValueError
        If the emitter is unbounded, or ``rays`` no power of two.
    """
    if not np.isfinite(emitter.extent):
        raise ValueError("an unbounded bundle cannot emit; let the other one do it")
    if rays < 1 or rays & (rays - 1):
        raise ValueError(f"the number of rays must be a power of two, found {rays}")
    sobol = qmc.Sobol(_DIMENSIONS, scramble=True, rng=np.random.default_rng(seed))
    points = sobol.random_base2(int(rays).bit_length() - 1)
    capacity = 4 * rays + 64
    while True:
        values = np.empty((capacity, _COLUMNS))
        surface, hole = np.empty(capacity, dtype=np.int64), np.empty(capacity, dtype=np.int64)
        count, escaped, lost = _trace(
            scene, reflection, emitter, emitter.total / rays, points, np.uint64(seed), values, surface, hole
        )
        if count <= capacity:
            return Vertices(values[:count].copy(), surface[:count].copy(), hole[:count].copy(), escaped, lost)
        capacity *= 2


def collect(scene: Scene, reflection: Reflection, vertices: Vertices, receiver: Bundle, seed: int) -> float:
    """What a bundle receives from lit points: the mean radiance over the target where it is a sensor.

    In units of the beam's peak irradiance, 1/sr.
    """
    return float(
        _collect(scene, reflection, vertices.values, vertices.surface, vertices.hole, receiver, np.uint64(seed))
    )


@njit(cache=True, nogil=True)
def _mix(word: np.uint64) -> np.uint64:
    """Finaliser of splitmix64 (Steele, Lea and Flood 2014): a counter becomes 64 random bits."""
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return word ^ (word >> np.uint64(31))


@njit(cache=True, nogil=True)
def _uniform(seed: np.uint64, ray: int, draw: int) -> float:
    """Draw number ``draw`` of a ray, in [0, 1): a function of its arguments alone."""
    word = _mix(_mix(seed + _GOLDEN * np.uint64(ray + 1)) + _GOLDEN * np.uint64(draw + 1))
    return float(word >> np.uint64(11)) * 1.1102230246251565e-16


@njit(cache=True, nogil=True)
def _towards_far_end(
    bundle: Bundle, x: float, y: float, z: float, s: float, t: float
) -> tuple[float, float, float, float]:
    """Unit vector from a point towards a sampled far end of the bundle, and the distance to it (0: infinite)."""
    f = bundle.frame
    if bundle.far == PARALLEL:
        return f[0, 0], f[0, 1], f[0, 2], 0.0
    if bundle.far == FAR_DISC:
        radius = bundle.far_radius * np.sqrt(s)
        along = bundle.far_distance
    else:
        radius = np.tan(bundle.spread_rad * np.sqrt(-2.0 * np.log(1.0 - s)))
        along = 1.0
    a, b = radius * np.cos(2.0 * np.pi * t), radius * np.sin(2.0 * np.pi * t)
    dx = along * f[0, 0] + a * f[1, 0] + b * f[2, 0]
    dy = along * f[0, 1] + a * f[1, 1] + b * f[2, 1]
    dz = along * f[0, 2] + a * f[1, 2] + b * f[2, 2]
    if bundle.far == FAR_DISC:
        dx, dy, dz = dx + bundle.centre[0] - x, dy + bundle.centre[1] - y, dz + bundle.centre[2] - z
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx / length, dy / length, dz / length, 0.0 if bundle.far == DIRECTIONS else length


@njit(cache=True, nogil=True)
def _start(bundle: Bundle, s: float, t: float) -> tuple[float, float, float]:
    """A point of a bundle's disc, drawn by its weight."""
    if bundle.shape == SQUARE:
        a, b = (2.0 * s - 1.0) * bundle.extent, (2.0 * t - 1.0) * bundle.extent
    else:
        if bundle.waist > 0.0:
            inside = 1.0 - np.exp(-2.0 * (bundle.extent / bundle.waist) ** 2)
            radius = bundle.waist * np.sqrt(-0.5 * np.log(1.0 - s * inside))
        else:
            radius = bundle.extent * np.sqrt(s)
        a, b = radius * np.cos(2.0 * np.pi * t), radius * np.sin(2.0 * np.pi * t)
    c, f = bundle.centre, bundle.frame
    return (
        c[0] + a * f[4, 0] + b * f[5, 0],
        c[1] + a * f[4, 1] + b * f[5, 1],
        c[2] + a * f[4, 2] + b * f[5, 2],
    )


@njit(cache=True, nogil=True)
def _scatter(nx: float, ny: float, nz: float, s: float, t: float) -> tuple[float, float, float]:
    """A direction about a normal, drawn by its cosine; basis after Duff et al. 2017."""
    sign = 1.0 if nz >= 0.0 else -1.0
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    r, up = np.sqrt(s), np.sqrt(1.0 - s)
    u, v = r * np.cos(2.0 * np.pi * t), r * np.sin(2.0 * np.pi * t)
    return (
        u * (1.0 + sign * nx * nx * a) + v * b + up * nx,
        u * sign * b + v * (sign + ny * ny * a) + up * ny,
        -u * sign * nx - v * ny + up * nz,
    )


@njit(cache=True, nogil=True)
def _trace(
    scene: Scene,
    reflection: Reflection,
    emitter: Bundle,
    start_weight: float,
    points: FloatArray,
    seed: np.uint64,
    values: FloatArray,
    surfaces: NDArray[np.int64],
    holes: NDArray[np.int64],
) -> tuple[int, float, float]:
    """Fill the vertices; returns how many there are (more than fit: call again with more room)."""
    count, escaped, lost = 0, 0.0, 0.0
    for ray in range(points.shape[0]):
        x, y, z = _start(emitter, points[ray, 0], points[ray, 1])
        wx, wy, wz, _ = _towards_far_end(emitter, x, y, z, points[ray, 2], points[ray, 3])
        place, hole, weight = OUTSIDE, -1, start_weight
        for bounce in range(_DEEPEST):
            surface, place, hole, x, y, z, nx, ny, nz = follow(scene, place, hole, x, y, z, -wx, -wy, -wz)
            if surface == ESCAPED:
                escaped += weight
                break
            if surface == LOST:
                lost += weight
                break
            if reflection.diffusion[0] > 0.0 and _uniform(seed, ray, _APART + 4 * bounce) < reflection.diffusion[0]:
                surface, place, hole, x, y, z, nx, ny, nz, wx, wy, wz = _diffuse(
                    scene, reflection, seed, ray, bounce, surface, place, hole, x, y, z, nx, ny, nz, wx, wy, wz
                )
            if count < values.shape[0]:
                row = values[count]
                row[0], row[1], row[2], row[3], row[4], row[5] = x, y, z, nx, ny, nz
                row[6], row[7], row[8], row[9] = wx, wy, wz, weight
                surfaces[count], holes[count] = surface, hole
            count += 1
            if bounce == 0:
                s, t = points[ray, 4], points[ray, 5]
            else:
                s, t = _uniform(seed, ray, 3 * bounce), _uniform(seed, ray, 3 * bounce + 1)
            ox, oy, oz = _scatter(nx, ny, nz, s, t)
            cos_in, cos_out = wx * nx + wy * ny + wz * nz, ox * nx + oy * ny + oz * nz
            reflected = surface_factor(scene, surface, x, y) * reflectance_factor(
                reflection, cos_in, cos_out, wx * ox + wy * oy + wz * oz
            )
            if surface in (TOP, FLOOR, UNDERSIDE):
                reflected *= grain_factor(reflection, wx, wy, ox, oy)
            # The first reflection only weighs; later ones also decide whether the ray lives on, at equal mean.
            if bounce == 0:
                weight *= reflected
            else:
                survival = min(1.0, reflected)
                if _uniform(seed, ray, 3 * bounce + 2) >= survival:
                    break
                weight *= reflected / survival
            wx, wy, wz = -ox, -oy, -oz
    return count, escaped, lost


@njit(cache=True, nogil=True)
def _diffuse(
    scene: Scene,
    reflection: Reflection,
    seed: np.uint64,
    ray: int,
    bounce: int,
    surface: int,
    place: int,
    hole: int,
    x: float,
    y: float,
    z: float,
    nx: float,
    ny: float,
    nz: float,
    wx: float,
    wy: float,
    wz: float,
) -> tuple[int, int, int, float, float, float, float, float, float, float, float, float]:
    """Move light inside the coating; on another face it forgets where it came from, and leaves as if lit from above."""
    draw = _APART + 4 * bounce
    s, t, w = _uniform(seed, ray, draw + 1), _uniform(seed, ray, draw + 2), _uniform(seed, ray, draw + 3)
    u, v = diffusion_step(reflection.diffusion[1], s, t, w)
    before = surface
    surface, place, hole, x, y, z = diffused(scene, surface, place, hole, x, y, z, u, v)
    if surface == WALL:
        mx, my = (scene.x[hole] - x) / scene.radius[hole], (scene.y[hole] - y) / scene.radius[hole]
        if before == WALL:
            cosine, sine = mx * nx + my * ny, nx * my - ny * mx
            wx, wy = cosine * wx - sine * wy, sine * wx + cosine * wy
        nx, ny, nz = mx, my, 0.0
    elif surface == TOP and before != TOP:
        nx, ny, nz = 0.0, 0.0, 1.0
    elif surface == UNDERSIDE and before != UNDERSIDE:
        nx, ny, nz = 0.0, 0.0, -1.0
    if surface != before:
        wx, wy, wz = nx, ny, nz
    return surface, place, hole, x, y, z, nx, ny, nz, wx, wy, wz


@njit(cache=True, nogil=True)
def _collect(
    scene: Scene,
    reflection: Reflection,
    values: FloatArray,
    surfaces: NDArray[np.int64],
    holes: NDArray[np.int64],
    receiver: Bundle,
    seed: np.uint64,
) -> float:
    """Join every vertex to the receiver by one ray.

    With p where the ray from vertex x to far end m crosses the disc: d(area at p) = d(area at x) cos(x)
    |p - m|^2/(|x - m|^2 cos(p)), both cosines taken against the ray.
    """
    c, f = receiver.centre, receiver.frame
    total = 0.0
    for i in range(values.shape[0]):
        row = values[i]
        x, y, z = row[0], row[1], row[2]
        s, t = 0.0, 0.0
        if receiver.far != PARALLEL:
            s, t = _uniform(seed, i, 0), _uniform(seed, i, 1)
        dx, dy, dz, length = _towards_far_end(receiver, x, y, z, s, t)
        cos_out = dx * row[3] + dy * row[4] + dz * row[5]
        if cos_out <= 0.0:
            continue
        cos_disc = dx * f[3, 0] + dy * f[3, 1] + dz * f[3, 2]
        ahead = ((c[0] - x) * f[3, 0] + (c[1] - y) * f[3, 1] + (c[2] - z) * f[3, 2]) / cos_disc
        px, py, pz = x + ahead * dx - c[0], y + ahead * dy - c[1], z + ahead * dz - c[2]
        a = px * f[4, 0] + py * f[4, 1] + pz * f[4, 2]
        b = px * f[5, 0] + py * f[5, 1] + pz * f[5, 2]
        if receiver.shape == SQUARE:
            if max(abs(a), abs(b)) > receiver.extent:
                continue
        elif a * a + b * b > receiver.extent * receiver.extent:
            continue
        surface = surfaces[i]
        place = CAVITY
        if surface == TOP:
            place = OUTSIDE
        elif surface in (WALL, LEDGE):
            place = BORE
        if not sees_out(scene, place, holes[i], x, y, z, dx, dy, dz):
            continue
        stretch = 1.0 if length == 0.0 else ((length - ahead) / length) ** 2
        profile = 1.0 if receiver.waist == 0.0 else np.exp(-2.0 * (a * a + b * b) / receiver.waist**2)
        cos_in = row[6] * row[3] + row[7] * row[4] + row[8] * row[5]
        cos_between = row[6] * dx + row[7] * dy + row[8] * dz
        value = (
            row[9]
            * surface_factor(scene, surface, x, y)
            * reflectance_factor(reflection, cos_in, cos_out, cos_between)
            * cos_out
            * stretch
            / cos_disc
            * profile
        )
        if surface in (TOP, FLOOR, UNDERSIDE):
            value *= grain_factor(reflection, row[6], row[7], dx, dy)
        total += value
    return total * receiver.density / np.pi
