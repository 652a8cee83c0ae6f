"""Light that travels sideways inside the coating before it leaves: what that changes of light reflected once.

A share of the light that a place reflects leaves it a step away: in any direction along the surface, with a length that
is exponentially distributed (the kernel exp(-r/L)/(2 pi r L), whose Fourier transform is 1/sqrt(1 + (q L)^2)). A
uniformly lit flat surface looks the same; what changes are the edges of light and shadow:

- on the plate's top the beam's edge spreads, and near a hole light is lost down its wall, as the coating goes on around
  the edge: the wall is unfolded into the plane of the top, with the irradiance that it has at its upper end;
- the wall gets that light back below the edge, spread as the kernel's tail;
- on the floor the spots under the holes spread into the shadows.

The scattered light, some per cent of a reading, is left as it is.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.optics import Layout
from twin.diagnosis.direct_light import (
    NODES,
    PiercedPlate,
    floor_light,
    mirror_points,
    sunflower,
)
from twin.diagnosis.direct_light_kernels import irradiance, ramp, sight_line, table_value, target_normal
from twin.material import Material

#: Spacing of the maps and how far they reach beyond the beam, mm.
_STEP_MM, _BEYOND_MM = 0.08, 4.0


def transported(
    plate: PiercedPlate, material: Material, layout: Layout, table_index: NDArray[np.int64], length_mm: float
) -> FloatArray:
    """Change of :func:`~twin.diagnosis.direct_light.once_reflected` if all light went sideways, shape (point,).

    Parameters
    ----------
    length_mm
        Mean length of a step.
    """
    result = np.empty(len(layout))
    columns = (layout.light, layout.light_u, layout.beam, layout.radius[:, None], layout.decay[:, None])
    table = np.round(np.concatenate(columns, axis=1), 9)
    _, first, group = np.unique(table, axis=0, return_index=True, return_inverse=True)
    for number in range(len(first)):
        rows = np.flatnonzero(group.reshape(-1) == number)
        result[rows] = _of_illumination(plate, material, layout.take(rows), table_index[rows], length_mm)
    return result


def _of_illumination(
    plate: PiercedPlate, material: Material, layout: Layout, table_index: NDArray[np.int64], length_mm: float
) -> FloatArray:
    light, beam = layout.light[0], layout.beam[0]
    radius, decay = float(layout.radius[0]), float(layout.decay[0])
    slope = light[:2] / light[2]
    half = radius / light[2] + _BEYOND_MM
    count = int(2 ** np.ceil(np.log2(2 * half / _STEP_MM)))
    axis = (np.arange(count) - count / 2 + 0.5) * _STEP_MM
    on_top, under = beam[:2] - slope * beam[2], beam[:2] - slope * (beam[2] + plate.depth)
    top, whole = np.empty((count, count)), np.empty((count, count))
    _map_top(
        top, whole, axis + on_top[0], axis + on_top[1], light, beam, radius, decay, plate.centre, plate.radius,
        plate.chamfer, _STEP_MM,
    )  # fmt: skip
    floor = floor_light(plate, axis + under[0], axis + under[1], light, beam, radius, decay, _STEP_MM)
    spread_top, spread_floor = _spread(top, length_mm), _spread(floor, length_mm)
    tail = _edge_tail(length_mm, plate.thickness)
    mirror = mirror_points()
    turn = np.random.default_rng(5).permutation(np.arange(max(NODES, count)) % len(mirror))
    result = np.empty(len(layout))
    reflectance = np.array(
        [float(np.ravel(material.directional_reflectance(light[2], k))[0]) / np.pi for k in range(len(material.brdf))]
    )
    _sum_all(
        result, layout.target, layout.along, layout.across, layout.view, layout.mirror_along, layout.mirror_across,
        layout.inverse_distance, light, beam, radius, decay, np.asarray(table_index, dtype=np.int64), plate.centre,
        plate.radius, plate.chamfer, plate.thickness, plate.depth, material.cos_o, material.phi_rad, material.cos_i,
        np.ascontiguousarray(material.brdf), reflectance, (spread_top - top) * whole, spread_floor - floor,
        axis + on_top[0], axis + on_top[1], under - count / 2 * _STEP_MM, _STEP_MM, tail, sunflower(NODES), mirror,
        turn,
    )  # fmt: skip
    return result


def _spread(light: FloatArray, length_mm: float) -> FloatArray:
    """A map of light after one step in every direction."""
    frequency = 2 * np.pi * np.fft.fftfreq(len(light), _STEP_MM)
    q2 = frequency[:, None] ** 2 + (2 * np.pi * np.fft.rfftfreq(len(light), _STEP_MM)) ** 2
    return np.asarray(np.fft.irfft2(np.fft.rfft2(light) / np.sqrt(1 + q2 * length_mm**2), s=light.shape))


def _edge_tail(length_mm: float, thickness: float) -> FloatArray:
    """Share of the light of a half-plane that a step takes so far beyond its edge: depths, shares; shape (2, n)."""
    from scipy.special import iti0k0

    depth = np.concatenate([[0.0], np.geomspace(1e-3 * length_mm, max(10 * length_mm, thickness), 60)])
    return np.stack([depth, 0.5 - iti0k0(depth / length_mm)[1] / np.pi])


@njit(cache=True, fastmath=True, parallel=True)
def _map_top(top, whole, xs, ys, light, beam, radius, decay, centre, hole, chamfer, step):  # fmt: skip
    """Irradiance of the plane of the top, with the walls unfolded into the holes, and the share of the plate in it."""
    for i in prange(len(xs)):
        for j in range(len(ys)):
            x, y = xs[i], ys[j]
            shine = irradiance(x, y, 0.0, beam, light, light, radius, decay, step)
            open_share, wall = 0.0, 0.0
            for h in range(len(hole)):
                a, b = x - centre[h, 0], y - centre[h, 1]
                wide = hole[h] + chamfer[h]
                if abs(a) < wide + step and abs(b) < wide + step:
                    rho = np.sqrt(a * a + b * b)
                    open_share = ramp((wide - rho) / step)
                    wall = max(0.0, -(a * light[0] + b * light[1]) / (rho + 1e-9))
                    break
            whole[i, j] = 1 - open_share
            top[i, j] = shine * ((1 - open_share) * light[2] + open_share * wall)


@njit(cache=True, fastmath=True, parallel=True)
def _sum_all(
    result, target, along, across, view, mirror_along, mirror_across, inverse, light, beam, radius, decay, table,
    centre, hole, chamfer, thickness, depth, cos_o, phis, cos_i, brdf, reflectance, top, floor, xs, ys, corner, step,
    tail, disc, mirror, turn,
):  # fmt: skip
    for point in prange(len(result)):
        sensor = (
            target[point], along[point], across[point], view[point], mirror_along[point], mirror_across[point],
            inverse[point], target_normal(along[point], across[point], view[point]),
        )  # fmt: skip
        result[point] = np.pi * sum_one(
            sensor, light, beam, radius, decay, centre, hole, chamfer, thickness, depth, cos_o, phis, cos_i,
            brdf[table[point]], reflectance[table[point]], top, floor, xs, ys, corner, step, tail, disc, mirror, turn,
        )  # fmt: skip


@njit(cache=True, fastmath=True)
def sum_one(
    sensor, light, beam, radius, decay, centre, hole, chamfer, thickness, depth, cos_o, phis, cos_i, brdf, reflectance,
    top, floor, xs, ys, corner, step, tail, disc, mirror, turn,
):  # fmt: skip
    source = (light[0], light[1], light[2])
    view = sensor[3]
    flat = table_value(cos_o, phis, cos_i, brdf, (0.0, 0.0, 1.0), (view[0], view[1], view[2]), source)
    total = 0.0
    for i in range(len(xs)):
        for j in range(len(ys)):
            if top[i, j] != 0:
                weight = sight_line(xs[i], ys[j], mirror[turn[(i * 7 + j * 3) % len(turn)]], sensor, step)[0]
                total += weight * step * step * flat * top[i, j]
    for h in range(len(hole)):
        wide = hole[h] + chamfer[h]
        if np.hypot(centre[h, 0] - beam[0], centre[h, 1] - beam[1]) > 0.5 * step * len(xs):
            continue
        area = np.pi * wide * wide / len(disc)
        for k in range(len(disc)):
            x0, y0 = wide * disc[k, 0], wide * disc[k, 1]
            weight, d0, d1, d2 = sight_line(centre[h, 0] + x0, centre[h, 1] + y0, mirror[turn[k]], sensor, 0.15)
            if weight <= 0:
                continue
            weight *= area
            s0, s1 = d0 / d2, d1 / d2
            xt, yt = x0 - s0 * thickness, y0 - s1 * thickness
            slope = np.sqrt(s0 * s0 + s1 * s1)
            blur = min(0.15, 0.5 * thickness * slope) + 1e-6
            open_share = ramp((hole[h] - np.sqrt(xt * xt + yt * yt)) / blur)
            if open_share > 0:
                fx = (centre[h, 0] + x0 - s0 * depth - corner[0]) / step - 0.5
                fy = (centre[h, 1] + y0 - s1 * depth - corner[1]) / step - 0.5
                i, j = int(np.floor(fx)), int(np.floor(fy))
                if 0 <= i < floor.shape[0] - 1 and 0 <= j < floor.shape[1] - 1:
                    u, v = fx - i, fy - j
                    near = (1 - v) * floor[i, j] + v * floor[i, j + 1]
                    far = (1 - v) * floor[i + 1, j] + v * floor[i + 1, j + 1]
                    total += weight * open_share * flat * ((1 - u) * near + u * far)
            if open_share < 1 and slope > 1e-9:
                xs0 = x0 * s0 + y0 * s1
                root = np.sqrt(max(0.0, xs0 * xs0 - slope * slope * (x0 * x0 + y0 * y0 - hole[h] * hole[h])))
                z = (xs0 + root) / (slope * slope)
                qx, qy = x0 - s0 * z, y0 - s1 * z
                z = min(thickness, max(0.0, z))
                share = np.interp(z, tail[0], tail[1])
                if share > 1e-6:
                    px, py = centre[h, 0] + qx, centre[h, 1] + qy
                    shine = irradiance(px, py, 0.0, beam, light, light, radius, decay, step)
                    own = max(0.0, -(qx * light[0] + qy * light[1]) / hole[h])
                    gained = share * shine * light[2] * reflectance
                    n = (-qx / hole[h], -qy / hole[h], 0.0)
                    lost = share * shine * own * table_value(cos_o, phis, cos_i, brdf, n, (d0, d1, d2), source)
                    total += weight * (1 - open_share) * (gained - lost)
    return total
