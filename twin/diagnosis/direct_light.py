"""Light reflected once by a pierced plate over a floor, by quadrature: what a ray tracer's noise would hide.

More than nine tenths of a reading is light that met one surface. For round holes in a flat plate it is an integral over
the plate's top: a whole top, less the top that the holes lack, plus what is seen through each hole, its wall, its
chamfer or the floor. The whole top is summed over nodes that move with the beam, the rest over nodes that are fixed to
each hole. Edges of beam, target, shadow and view run across the nodes as ramps as wide as the nodes lie apart. So the
sum follows small changes of any input smoothly, which differences need more than a small error: that of the sum is some
0.1 % of the reading, and nearly the same for like scenes.
"""

# The arguments of compiled functions are what the compiler makes of them.
# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.optics import Layout
from twin.artifact import Surface
from twin.material import Material

#: Nodes of a hole and of the beam, and points of the mirror that they take turns with.
NODES, _BEAM_NODES, _MIRROR = 320, 3072, 12
#: Parallel beams that stand for a divergent one.
_BEAMS = 7
_GOLDEN = np.pi * (3 - np.sqrt(5))
_CELL_MM = 0.3


@dataclass(frozen=True)
class PiercedPlate:
    """Round holes in a plate at z = 0 over a level floor; lengths in mm, arrays of shape (hole,).

    Attributes
    ----------
    centre, shape (hole, 2)
    chamfer
        Width of the 45 degree chamfer at the upper edges.
    thickness, depth
        Of the plate, and of the floor below the plate's top.
    nearest, shape (x, y)
        The hole nearest to each cell of a grid over the plate that begins at ``-half``.
    """

    centre: FloatArray
    radius: FloatArray
    chamfer: FloatArray
    thickness: float
    depth: float
    half: FloatArray
    nearest: NDArray[np.int64]


def pierced_plate(artifact: ArtifactDimensions, chamfer_mm: float = 0.0) -> PiercedPlate | None:
    """The plate of these dimensions, without holes for a flat sample; None for a mesh or a floor that is not level."""
    form, holes = artifact.form, artifact.holes
    if artifact.mesh is not None or any(form.floor_slope):
        return None
    from scipy.spatial import cKDTree

    centre = np.stack([holes.x, holes.y], axis=1)
    half = np.asarray(form.outline, dtype=float) / 2
    x, y = (np.arange(-h + _CELL_MM / 2, h, _CELL_MM) for h in half)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    nearest = cKDTree(centre).query(places)[1] if len(holes) else np.zeros(places.shape[:2])
    return PiercedPlate(
        centre,
        np.asarray(holes.diameter, dtype=float) / 2,
        artifact.chamfers + chamfer_mm,
        form.plate_thickness,
        form.cavity_depth,
        half,
        np.asarray(nearest, dtype=np.int64),
    )


def served(layout: Layout) -> bool:
    """Whether the quadrature knows this instrument: a round beam from afar, a round target and no field stop."""
    round_beam = np.all(layout.iris[:, 0] == layout.iris[:, 1]) and np.all(layout.falloff[:, 0] == layout.falloff[:, 1])
    plain = layout.picture is None and not layout.square and np.all(layout.inverse_source == 0)
    bounded = np.all(np.isfinite(layout.radius))
    return bool(round_beam and plain and bounded and np.all(np.isinf(layout.stop[:, 0])))


def once_reflected(
    plate: PiercedPlate,
    material: Material,
    layout: Layout,
    table_index: NDArray[np.int64],
    surface_factor: dict[Surface, float] | None = None,
    *,
    nodes: int = NODES,
) -> FloatArray:
    """Mean radiance over the sensor's rays of light reflected once, times pi over the beam's irradiance on its axis.

    Parameters
    ----------
    layout
        Beam and sensor in the frame of the sample, :func:`served`; ``table_index`` the material's table of each point.
    surface_factor
        Reflectance of surfaces over the material's.

    Returns
    -------
    array, shape (point,)
    """
    diverging = np.flatnonzero(layout.divergence_rad > 0)
    result = _of_parallel(plate, material, layout, table_index, surface_factor, nodes)
    if len(diverging):
        some, total = layout.take(diverging), np.zeros(len(diverging))
        for deviation in _deviations():
            beam = _deviated(some, deviation)
            total += _of_parallel(plate, material, beam, table_index[diverging], surface_factor, nodes)
        result[diverging] = total / _BEAMS
    return result


def _deviations() -> FloatArray:
    """Directions of parallel beams that stand for a divergent one, in standard deviations, shape (beam, 2)."""
    k = np.arange(_BEAMS)
    radius = np.sqrt(-2 * np.log1p(-(k + 0.5) / _BEAMS))
    normal = np.stack([radius * np.cos(k * _GOLDEN), radius * np.sin(k * _GOLDEN)], axis=1)
    centred = normal - normal.mean(axis=0)
    # Mean and covariance exact: what a small divergence does depends on them alone.
    return np.asarray(np.linalg.solve(np.linalg.cholesky(np.cov(centred.T, bias=True)), centred.T).T)


def _deviated(layout: Layout, deviation: FloatArray) -> Layout:
    """The same beams, turned about where they cross the sample's plane."""
    spread = layout.divergence_rad[:, None] * deviation
    light = layout.light + spread[:, :1] * layout.light_u + spread[:, 1:] * layout.light_v
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    light_u = layout.light_u - light * np.sum(light * layout.light_u, axis=1, keepdims=True)
    light_u /= np.linalg.norm(light_u, axis=1, keepdims=True)
    return replace(layout, light=light, light_u=light_u, light_v=np.cross(light, light_u))


def _of_parallel(
    plate: PiercedPlate,
    material: Material,
    layout: Layout,
    table_index: NDArray[np.int64],
    surface_factor: dict[Surface, float] | None,
    nodes: int,
) -> FloatArray:
    factor = np.ones(len(Surface))
    for surface, value in (surface_factor or {}).items():
        factor[surface] = value
    disc = sunflower(nodes)
    mirror = mirror_points()
    spot = sunflower(_BEAM_NODES)
    turn = np.random.default_rng(5).permutation(np.arange(max(nodes, _BEAM_NODES)) % _MIRROR)
    result = np.empty(len(layout))
    _sum_all(
        result,
        layout.target,
        layout.along,
        layout.across,
        layout.view,
        layout.mirror_along,
        layout.mirror_across,
        layout.inverse_distance,
        layout.light,
        layout.light_u,
        layout.light_v,
        layout.beam,
        layout.radius,
        layout.decay,
        np.asarray(table_index, dtype=np.int64),
        plate.centre,
        plate.radius,
        plate.chamfer,
        plate.thickness,
        plate.depth,
        plate.half,
        plate.nearest,
        material.cos_o,
        material.phi_rad,
        material.cos_i,
        np.ascontiguousarray(material.brdf),
        factor,
        disc,
        spot,
        mirror,
        turn,
    )
    return result


def mirror_points() -> FloatArray:
    """Points of the mirror's disc that nodes take turns with, shape (point, 2)."""
    return sunflower(_MIRROR)


def sunflower(count: int) -> FloatArray:
    """Points spread evenly over the unit disc, shape (count, 2)."""
    k = np.arange(count)
    radius = np.sqrt((k + 0.5) / count)
    return np.stack([radius * np.cos(k * _GOLDEN), radius * np.sin(k * _GOLDEN)], axis=1)


@njit(cache=True, fastmath=True, inline="always")
def _ramp(x: float) -> float:
    """0 below -1/2, 1 above 1/2, linear between."""
    return min(1.0, max(0.0, 0.5 + x))


@njit(cache=True, fastmath=True)
def _bracket(nodes: FloatArray, x: float) -> tuple[int, float]:
    low, high = 0, len(nodes) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= x:
            low = middle
        else:
            high = middle
    return low, min(1.0, max(0.0, (x - nodes[low]) / (nodes[low + 1] - nodes[low])))


@njit(cache=True, fastmath=True)
def _brdf(
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
    a, fa = _bracket(cos_o, co)
    b, fb = _bracket(phis, phi)
    c, fc = _bracket(cos_i, ci)
    value = 0.0
    for p in range(2):
        for q in range(2):
            near, far = table[a + p, b + q, c], table[a + p, b + q, c + 1]
            value += (fa if p else 1 - fa) * (fb if q else 1 - fb) * (near + fc * (far - near))
    return value


@njit(cache=True, fastmath=True, inline="always")
def _profile(
    x: float,
    y: float,
    z: float,
    beam: FloatArray,
    light: FloatArray,
    radius: float,
    decay: float,
    edge: float,
) -> float:
    """Irradiance normal to the beam over that on its axis."""
    a, b, c = x - beam[0], y - beam[1], z - beam[2]
    along = a * light[0] + b * light[1] + c * light[2]
    squared = max(0.0, a * a + b * b + c * c - along * along)
    inside = _ramp((radius - np.sqrt(squared)) / edge)
    return inside * np.exp(-decay * squared) if inside > 0 else 0.0


@njit(cache=True, fastmath=True)
def _target_normal(along: FloatArray, across: FloatArray, view: FloatArray) -> tuple[float, float, float]:
    """Normal of the target's plane, on the sensor's side."""
    x = along[1] * across[2] - along[2] * across[1]
    y = along[2] * across[0] - along[0] * across[2]
    z = along[0] * across[1] - along[1] * across[0]
    size = np.sqrt(x * x + y * y + z * z)
    if x * view[0] + y * view[1] + z * view[2] < 0:
        size = -size
    return x / size, y / size, z / size


@njit(cache=True, fastmath=True, inline="always")
def _sight(x, y, mirror, sensor, edge):
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
    seen = _ramp((1 - np.sqrt(u * u + v * v)) * np.sqrt(size) / edge)
    weight = seen * d2 / facing * (1 - step * inverse) ** 2 / (np.pi * size)
    length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    return weight, d0 / length, d1 / length, d2 / length


@njit(cache=True, fastmath=True, inline="always")
def _to_floor(
    fx, fy, ls0, ls1, centre, hole, chamfer, thickness, depth, half, nearest, edge
):  # fmt: skip
    """Share of the light that reaches a place of the floor through the hole on its way."""
    tx, ty = fx + ls0 * (depth - thickness), fy + ls1 * (depth - thickness)
    ix, iy = int((tx + half[0]) / 0.3), int((ty + half[1]) / 0.3)
    if len(hole) == 0 or not (0 <= ix < nearest.shape[0] and 0 <= iy < nearest.shape[1]):
        return 0.0
    g = nearest[ix, iy]
    r, c = hole[g], chamfer[g]
    clear = _ramp((r - np.hypot(tx - centre[g, 0], ty - centre[g, 1])) / edge)
    if clear > 0:
        tx, ty = fx + ls0 * depth, fy + ls1 * depth
        clear = min(clear, _ramp((r + c - np.hypot(tx - centre[g, 0], ty - centre[g, 1])) / edge))
        if c > 0:
            tx, ty = tx - ls0 * c, ty - ls1 * c
            clear = min(clear, _ramp((r - np.hypot(tx - centre[g, 0], ty - centre[g, 1])) / edge))
    return clear


def floor_light(
    plate: PiercedPlate,
    xs: FloatArray,
    ys: FloatArray,
    light: FloatArray,
    beam: FloatArray,
    radius: float,
    decay: float,
    edge_mm: float,
) -> FloatArray:
    """Irradiance of the floor straight from the beam, over that on the beam's axis, shape (x, y)."""
    result = np.zeros((len(xs), len(ys)))
    _map_floor(
        result, xs, ys, light, beam, radius, decay, plate.centre, plate.radius, plate.chamfer, plate.thickness,
        plate.depth, plate.half, plate.nearest, edge_mm,
    )  # fmt: skip
    return result


@njit(cache=True, fastmath=True, parallel=True)
def _map_floor(
    result, xs, ys, light, beam, radius, decay, centre, hole, chamfer, thickness, depth, half, nearest, edge
):  # fmt: skip
    slope0, slope1 = light[0] / light[2], light[1] / light[2]
    for i in prange(len(xs)):
        for j in range(len(ys)):
            shine = _profile(xs[i], ys[j], -depth, beam, light, radius, decay, edge)
            if shine > 0:
                clear = _to_floor(
                    xs[i], ys[j], slope0, slope1, centre, hole, chamfer, thickness, depth, half, nearest, edge
                )
                result[i, j] = shine * clear * light[2]


@njit(cache=True, fastmath=True, parallel=True)
def _sum_all(
    result, target, along, across, view, mirror_along, mirror_across, inverse, light, light_u, light_v, beam, radius,
    decay, table, centre, hole, chamfer, thickness, depth, half, nearest, cos_o, phis, cos_i, brdf, factor, disc, spot,
    mirror, turn,
):  # fmt: skip
    for point in prange(len(result)):
        result[point] = _sum_one(
            target[point], along[point], across[point], view[point], mirror_along[point], mirror_across[point],
            inverse[point], light[point], light_u[point], light_v[point], beam[point], radius[point], decay[point],
            centre, hole, chamfer, thickness, depth, half, nearest, cos_o, phis, cos_i, brdf[table[point]], factor,
            disc, spot, mirror, turn,
        )  # fmt: skip


@njit(cache=True, fastmath=True)
def _sum_one(
    target, along, across, view, mirror_along, mirror_across, inverse, light, light_u, light_v, beam, radius, decay,
    centre, hole, chamfer, thickness, depth, half, nearest, cos_o, phis, cos_i, brdf, factor, disc, spot, mirror, turn,
):  # fmt: skip
    up = (0.0, 0.0, 1.0)
    source = (light[0], light[1], light[2])
    ls0, ls1 = light[0] / light[2], light[1] / light[2]
    vs0, vs1 = view[0] / view[2], view[1] / view[2]
    sensor = (target, along, across, view, mirror_along, mirror_across, inverse, _target_normal(along, across, view))
    tops = np.empty(len(mirror))
    for m in range(len(mirror)):
        u, v = mirror[m, 0] * inverse, mirror[m, 1] * inverse
        d0 = view[0] + u * mirror_along[0] + v * mirror_across[0]
        d1 = view[1] + u * mirror_along[1] + v * mirror_across[1]
        d2 = view[2] + u * mirror_along[2] + v * mirror_across[2]
        length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        tops[m] = _brdf(cos_o, phis, cos_i, brdf, up, (d0 / length, d1 / length, d2 / length), source)
    total = 0.0
    edge = radius * np.sqrt(np.pi / len(spot))
    area = np.pi * radius * radius / len(spot) / light[2]
    for k in range(len(spot)):
        q0, q1 = radius * spot[k, 0], radius * spot[k, 1]
        z = beam[2] + q0 * light_u[2] + q1 * light_v[2]
        x = beam[0] + q0 * light_u[0] + q1 * light_v[0] - ls0 * z
        y = beam[1] + q0 * light_u[1] + q1 * light_v[1] - ls1 * z
        weight = _sight(x, y, mirror[turn[k]], sensor, edge)[0]
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
            m = turn[k]
            weight, d0, d1, d2 = _sight(x, y, mirror[m], sensor, spacing)
            if weight <= 0:
                continue
            weight *= area
            towards = (d0, d1, d2)
            s0, s1 = d0 / d2, d1 / d2
            flat = tops[m] * light[2]
            total -= weight * factor[0] * flat * _profile(x, y, 0.0, beam, light, radius, decay, spacing)

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
                    clear = _ramp((wide - np.sqrt(lx * lx + ly * ly)) / spacing + 0.5)
                    shine = _profile(centre[h, 0] + qx, centre[h, 1] + qy, -z, beam, light, radius, decay, spacing)
                    if clear * shine > 0:
                        f = _brdf(cos_o, phis, cos_i, brdf, n, towards, source)
                        total += weight * factor[1] * f * ci * clear * shine
                continue

            # Past the wall to the floor, or to the wall.
            xt, yt = x0 - s0 * thickness, y0 - s1 * thickness
            slope = np.sqrt(ss)
            blur = min(spacing, 0.5 * thickness * slope) + 1e-6
            open_share = _ramp((r - np.sqrt(xt * xt + yt * yt)) / blur)
            if open_share > 0:
                fx, fy = x - s0 * depth, y - s1 * depth
                shine = _profile(fx, fy, -depth, beam, light, radius, decay, spacing)
                if shine > 0:
                    clear = _to_floor(fx, fy, ls0, ls1, centre, hole, chamfer, thickness, depth, half, nearest, spacing)
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
                    clear = _ramp((wide - np.sqrt(lx * lx + ly * ly)) / spacing)
                    if c > 0:
                        lx, ly = lx - ls0 * c, ly - ls1 * c
                        clear = min(clear, _ramp((r - np.sqrt(lx * lx + ly * ly)) / spacing))
                    if clear > 0:
                        shine = _profile(centre[h, 0] + qx, centre[h, 1] + qy, -z, beam, light, radius, decay, spacing)
                        if shine > 0:
                            f = _brdf(cos_o, phis, cos_i, brdf, n, towards, source)
                            total += weight * (1 - open_share) * factor[1] * f * ci * clear * shine
    return total * np.pi
