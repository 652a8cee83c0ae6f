"""The compiled sums of the quadrature of light reflected once (:mod:`twin.diagnosis.direct_light`)."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from instrument.angles import FloatArray


@njit(cache=True, fastmath=True, inline="always")
def ramp(x: float) -> float:
    """0 below -1/2, 1 above 1/2, linear between."""
    return min(1.0, max(0.0, 0.5 + x))


@njit(cache=True, fastmath=True)
def bracket(nodes: FloatArray, x: float) -> tuple[int, float]:
    low, high = 0, len(nodes) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= x:
            low = middle
        else:
            high = middle
    return low, min(1.0, max(0.0, (x - nodes[low]) / (nodes[low + 1] - nodes[low])))


@njit(cache=True, fastmath=True)
def table_value(
    cos_o: FloatArray,
    phis: FloatArray,
    cos_i: FloatArray,
    table: FloatArray,
    n: tuple[float, float, float],
    o: tuple[float, float, float],
    i: tuple[float, float, float],
) -> float:
    """BRDF in 1/sr for light from i seen from o, by the table; zero unless both are above the surface."""
    co = n[0] * o[0] + n[1] * o[1] + n[2] * o[2]
    ci = n[0] * i[0] + n[1] * i[1] + n[2] * i[2]
    if co <= 0 or ci <= 0:
        return 0.0
    cosine = o[0] * i[0] + o[1] * i[1] + o[2] * i[2] - co * ci
    cross_x, cross_y, cross_z = i[1] * o[2] - i[2] * o[1], i[2] * o[0] - i[0] * o[2], i[0] * o[1] - i[1] * o[0]
    sine = n[0] * cross_x + n[1] * cross_y + n[2] * cross_z
    phi = np.arctan2(sine, cosine)
    if phi < 0:
        phi += 2 * np.pi
    a, fa = bracket(cos_o, co)
    b, fb = bracket(phis, phi)
    c, fc = bracket(cos_i, ci)
    value = 0.0
    for p in range(2):
        for q in range(2):
            near, far = table[a + p, b + q, c], table[a + p, b + q, c + 1]
            value += (fa if p else 1 - fa) * (fb if q else 1 - fb) * (near + fc * (far - near))
    return value


@njit(cache=True, fastmath=True, inline="always")
def irradiance(
    x: float,
    y: float,
    z: float,
    beam: FloatArray,
    light: FloatArray,
    axis: FloatArray,
    radius: float,
    decay: float,
    edge: float,
) -> float:
    """Irradiance normal to the light over that on the beam's axis; the profile is that across the axis."""
    a, b, c = x - beam[0], y - beam[1], z - beam[2]
    along = a * axis[0] + b * axis[1] + c * axis[2]
    along /= light[0] * axis[0] + light[1] * axis[1] + light[2] * axis[2]
    u, v, w = a - along * light[0], b - along * light[1], c - along * light[2]
    squared = u * u + v * v + w * w
    inside = ramp((radius - np.sqrt(squared)) / edge)
    return inside * np.exp(-decay * squared) if inside > 0 else 0.0


@njit(cache=True, fastmath=True)
def target_normal(along: FloatArray, across: FloatArray, view: FloatArray) -> tuple[float, float, float]:
    """Normal of the target's plane, on the sensor's side."""
    x = along[1] * across[2] - along[2] * across[1]
    y = along[2] * across[0] - along[0] * across[2]
    z = along[0] * across[1] - along[1] * across[0]
    size = np.sqrt(x * x + y * y + z * z)
    if x * view[0] + y * view[1] + z * view[2] < 0:
        size = -size
    return x / size, y / size, z / size


@njit(cache=True, fastmath=True, inline="always")
def sight_line(x, y, mirror, sensor, edge):  # type: ignore[no-untyped-def]
    """Share of the sensor's rays for a unit of area at (x, y, 0) by way of a mirror point, and its unit vector."""
    target, along, across, view, mirror_along, mirror_across, inverse, normal = sensor
    g0, g1, g2 = target[0] - x, target[1] - y, target[2]
    d0 = view[0] + inverse * (mirror[0] * mirror_along[0] + mirror[1] * mirror_across[0] + g0)
    d1 = view[1] + inverse * (mirror[0] * mirror_along[1] + mirror[1] * mirror_across[1] + g1)
    d2 = view[2] + inverse * (mirror[0] * mirror_along[2] + mirror[1] * mirror_across[2] + g2)
    facing = d0 * normal[0] + d1 * normal[1] + d2 * normal[2]
    if d2 <= 1e-6 or facing <= 1e-6:
        return 0.0, 0.0, 0.0, 1.0
    step = (g0 * normal[0] + g1 * normal[1] + g2 * normal[2]) / facing
    p0, p1, p2 = step * d0 - g0, step * d1 - g1, step * d2 - g2
    size = along[0] ** 2 + along[1] ** 2 + along[2] ** 2
    u = (p0 * along[0] + p1 * along[1] + p2 * along[2]) / size
    v = (p0 * across[0] + p1 * across[1] + p2 * across[2]) / size
    seen = ramp((1 - np.sqrt(u * u + v * v)) * np.sqrt(size) / edge)
    weight = seen * d2 / facing * (1 - step * inverse) ** 2 / (np.pi * size)
    length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    return weight, d0 / length, d1 / length, d2 / length


@njit(cache=True, fastmath=True, inline="always")
def to_floor(  # type: ignore[no-untyped-def]
    fx, fy, ls0, ls1, centre, hole, chamfer, thickness, depth, half, nearest, edge
):  # fmt: skip
    """Share of the light that reaches a place of the floor through the hole on its way."""
    tx, ty = fx + ls0 * (depth - thickness), fy + ls1 * (depth - thickness)
    ix, iy = int((tx + half[0]) / 0.3), int((ty + half[1]) / 0.3)
    if len(hole) == 0 or not (0 <= ix < nearest.shape[0] and 0 <= iy < nearest.shape[1]):
        return 0.0
    g = nearest[ix, iy]
    r, c = hole[g], chamfer[g]
    clear = ramp((r - np.hypot(tx - centre[g, 0], ty - centre[g, 1])) / edge)
    if clear > 0:
        tx, ty = fx + ls0 * depth, fy + ls1 * depth
        clear = min(clear, ramp((r + c - np.hypot(tx - centre[g, 0], ty - centre[g, 1])) / edge))
        if c > 0:
            tx, ty = tx - ls0 * c, ty - ls1 * c
            clear = min(clear, ramp((r - np.hypot(tx - centre[g, 0], ty - centre[g, 1])) / edge))
    return clear


@njit(cache=True, fastmath=True, parallel=True)
def map_floor(  # type: ignore[no-untyped-def]
    result, xs, ys, light, beam, radius, decay, centre, hole, chamfer, thickness, depth, half, nearest, edge
):  # fmt: skip
    slope0, slope1 = light[0] / light[2], light[1] / light[2]
    for i in prange(len(xs)):
        for j in range(len(ys)):
            shine = irradiance(xs[i], ys[j], -depth, beam, light, light, radius, decay, edge)
            if shine > 0:
                clear = to_floor(
                    xs[i], ys[j], slope0, slope1, centre, hole, chamfer, thickness, depth, half, nearest, edge
                )
                result[i, j] = shine * clear * light[2]


@njit(cache=True, fastmath=True, parallel=True)
def sum_all(  # type: ignore[no-untyped-def]
    result, target, along, across, view, mirror_along, mirror_across, inverse, light, light_u, light_v, beam, radius,
    decay, table, centre, hole, chamfer, thickness, depth, half, nearest, cos_o, phis, cos_i, brdf, factor, disc, spot,
    mirror, turn,
):  # fmt: skip
    for point in prange(len(result)):
        result[point] = sum_one(
            target[point], along[point], across[point], view[point], mirror_along[point], mirror_across[point],
            inverse[point], light[point], light_u[point], light_v[point], beam[point], radius[point], decay[point],
            centre, hole, chamfer, thickness, depth, half, nearest, cos_o, phis, cos_i, brdf[table[point]], factor,
            disc, spot, mirror, turn,
        )  # fmt: skip


@njit(cache=True, fastmath=True)
def sum_one(  # type: ignore[no-untyped-def]
    target, along, across, view, mirror_along, mirror_across, inverse, light, light_u, light_v, beam, radius, decay,
    centre, hole, chamfer, thickness, depth, half, nearest, cos_o, phis, cos_i, brdf, factor, disc, spot, mirror, turn,
):  # fmt: skip
    up = (0.0, 0.0, 1.0)
    source = (light[0], light[1], light[2])
    ls0, ls1 = light[0] / light[2], light[1] / light[2]
    vs0, vs1 = view[0] / view[2], view[1] / view[2]
    sensor = (target, along, across, view, mirror_along, mirror_across, inverse, target_normal(along, across, view))
    tops = np.empty(len(mirror))
    for m in range(len(mirror)):
        u, v = mirror[m, 0] * inverse, mirror[m, 1] * inverse
        d0 = view[0] + u * mirror_along[0] + v * mirror_across[0]
        d1 = view[1] + u * mirror_along[1] + v * mirror_across[1]
        d2 = view[2] + u * mirror_along[2] + v * mirror_across[2]
        length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        tops[m] = table_value(cos_o, phis, cos_i, brdf, up, (d0 / length, d1 / length, d2 / length), source)
    total = 0.0
    edge = radius * np.sqrt(np.pi / len(spot))
    axis = np.cross(light_u, light_v)
    facing = axis[0] * light[0] + axis[1] * light[1] + axis[2] * light[2]
    area = np.pi * radius * radius / len(spot) * facing / light[2]
    for k in range(len(spot)):
        q0, q1 = radius * spot[k, 0], radius * spot[k, 1]
        z = beam[2] + q0 * light_u[2] + q1 * light_v[2]
        x = beam[0] + q0 * light_u[0] + q1 * light_v[0] - ls0 * z
        y = beam[1] + q0 * light_u[1] + q1 * light_v[1] - ls1 * z
        weight = sight_line(x, y, mirror[turn[k]], sensor, edge)[0]
        if weight > 0:
            shine = np.exp(-decay * radius * radius * (spot[k, 0] ** 2 + spot[k, 1] ** 2))
            total += weight * area * factor[0] * tops[turn[k]] * light[2] * shine
    widest = 0.0
    for h in range(len(hole)):
        widest = max(widest, hole[h])
    deep = min(depth, 2.2 * widest / max(1e-6, np.hypot(vs0, vs1)))
    for h in range(len(hole)):
        r, c = hole[h], chamfer[h]
        wide = r + c
        closest = 1e30
        for step in range(7):
            z = deep * step / 6
            x, y = centre[h, 0] + (ls0 - vs0) * z - beam[0], centre[h, 1] + (ls1 - vs1) * z - beam[1]
            s = x * light[0] + y * light[1] - beam[2] * light[2]
            closest = min(closest, x * x + y * y + beam[2] ** 2 - s * s)
        if closest > (radius + wide + 0.6) ** 2:
            continue
        count = len(disc)
        spacing = wide * np.sqrt(np.pi / count)
        area = np.pi * wide * wide / count
        for k in range(count):
            x0, y0 = wide * disc[k, 0], wide * disc[k, 1]
            x, y = centre[h, 0] + x0, centre[h, 1] + y0
            # Other pairs of node and mirror point in every hole: what they get wrong together evens out.
            m = turn[(k + 89 * h) % len(turn)]
            weight, d0, d1, d2 = sight_line(x, y, mirror[m], sensor, spacing)
            if weight <= 0:
                continue
            weight *= area
            towards = (d0, d1, d2)
            s0, s1 = d0 / d2, d1 / d2
            flat = tops[m] * light[2]
            total -= weight * factor[0] * flat * irradiance(x, y, 0.0, beam, light, axis, radius, decay, spacing)

            # Down through the chamfer.
            xc, yc = x0 - s0 * c, y0 - s1 * c
            ss, xs = s0 * s0 + s1 * s1, x0 * s0 + y0 * s1
            if c > 0 and xc * xc + yc * yc > r * r:
                # |x0 - s z| = wide - z
                a2, b2, c2 = ss - 1, xs - wide, x0 * x0 + y0 * y0 - wide * wide
                if abs(a2) < 1e-9:
                    z = c2 / (2 * b2)
                else:
                    root = np.sqrt(max(0.0, b2 * b2 - a2 * c2))
                    z1, z2 = (b2 - root) / a2, (b2 + root) / a2
                    low, high = min(z1, z2), max(z1, z2)
                    z = low if low >= 0 else high
                z = min(c, max(0.0, z))
                qx, qy = x0 - s0 * z, y0 - s1 * z
                rho = np.sqrt(qx * qx + qy * qy) + 1e-12
                n = (-qx / rho * np.sqrt(0.5), -qy / rho * np.sqrt(0.5), np.sqrt(0.5))
                ci = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
                if ci > 0:
                    lx, ly = qx + ls0 * z, qy + ls1 * z
                    clear = ramp((wide - np.sqrt(lx * lx + ly * ly)) / spacing + 0.5)
                    px, py = centre[h, 0] + qx, centre[h, 1] + qy
                    shine = irradiance(px, py, -z, beam, light, axis, radius, decay, spacing)
                    if clear * shine > 0:
                        f = table_value(cos_o, phis, cos_i, brdf, n, towards, source)
                        total += weight * factor[1] * f * ci * clear * shine
                continue

            # Past the wall to the floor, or to the wall.
            xt, yt = x0 - s0 * thickness, y0 - s1 * thickness
            slope = np.sqrt(ss)
            blur = min(spacing, 0.5 * thickness * slope) + 1e-6
            open_share = ramp((r - np.sqrt(xt * xt + yt * yt)) / blur)
            if open_share > 0:
                fx, fy = x - s0 * depth, y - s1 * depth
                shine = irradiance(fx, fy, -depth, beam, light, axis, radius, decay, spacing)
                if shine > 0:
                    clear = to_floor(fx, fy, ls0, ls1, centre, hole, chamfer, thickness, depth, half, nearest, spacing)
                    total += weight * open_share * factor[4] * flat * clear * shine
            if open_share < 1 and slope > 1e-9:
                root = np.sqrt(max(0.0, xs * xs - ss * (x0 * x0 + y0 * y0 - r * r)))
                z = (xs + root) / ss
                qx, qy = x0 - s0 * z, y0 - s1 * z
                z = min(thickness, max(c, z))
                n = (-qx / r, -qy / r, 0.0)
                ci = n[0] * light[0] + n[1] * light[1]
                if ci > 0:
                    lx, ly = qx + ls0 * z, qy + ls1 * z
                    clear = ramp((wide - np.sqrt(lx * lx + ly * ly)) / spacing)
                    if c > 0:
                        lx, ly = lx - ls0 * c, ly - ls1 * c
                        clear = min(clear, ramp((r - np.sqrt(lx * lx + ly * ly)) / spacing))
                    if clear > 0:
                        shine = irradiance(
                            centre[h, 0] + qx, centre[h, 1] + qy, -z, beam, light, axis, radius, decay, spacing
                        )
                        if shine > 0:
                            f = table_value(cos_o, phis, cos_i, brdf, n, towards, source)
                            total += weight * (1 - open_share) * factor[1] * f * ci * clear * shine
    return total * np.pi
