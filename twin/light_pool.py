"""Light inside the cavity, followed once for all sensor directions.

Light scattered in the cavity is a small part of a reading and hard to find from the sensor: a path that starts there
rarely meets the few lit places. So the light is followed from the openings that it enters by, every place that it
meets is kept, and the ends of the sight lines are joined to such places, near ones more often (bidirectional path
tracing, Veach 1997, chapter 10, with one reflection on the sensor's side). Places depend on the illumination alone; the
geometries that share it share them, in each randomisation others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.kernel_math import cosine_hemisphere, larger, smaller
from twin.paths import Meeting, Paths, Share
from twin.plate import NEIGHBOURS, Plate, nearest_openings, neighbours
from twin.plate_sight import PlateLane
from twin.sequence import Points

#: Places kept of one path: the first of them always, and one of the later ones at random for all those.
KEPT = 4
#: Numbers of a kept place: position, direction to where the light came from, flux.
_NUMBERS = 7
_PER_BOUNCE, _BOUNCE_DIMENSION = 4, 2
#: Shares of the joints to places under the opening nearest to the sight line's end, and under those around it.
_OWN, _AROUND = 0.45, 0.35
_JOINT_DIMENSION, _PER_JOINT = 4, 5
#: How often faces near the end of a sight line are looked for.
_LOOK_NEAR = 0.1
#: Bound of the factor of form: that of places this part of an opening's radius apart, face to face.
_NEAREST = 0.5
#: Above this cosine a face looks up, below its negative down.
_LEVEL = 0.7
#: Points this little above each other's face, mm, see nothing of each other but rounding errors.
_FLAT_MM = 1e-5


class LightPaths:
    """Kernels that follow the light, and that join sight lines to it."""

    def __init__(self, mi: Any, dr: Any, paths: Paths, points: Points, plate: Plate, faces: FloatArray) -> None:
        self._mi, self._dr, self._paths, self._points = mi, dr, paths, points
        self._normal_z = faces
        self._map = nearest_openings(plate)
        index, number, reach = neighbours(plate)
        self._half = plate.half
        self._openings = len(plate.radius)
        self._neighbour = mi.UInt32(index.ravel())
        # An entry more than openings: Dr.Jit compiles arrays of one entry differently.
        self._number = mi.UInt32(np.append(number, np.uint32(0)))
        self._grid = _Grid(mi, dr, plate, self._map)
        x, y = plate.centre.T
        nearest = _NEAREST * float(np.median(plate.radius))
        self._near, self._bound = dr.opaque(mi.Float, nearest), dr.opaque(mi.Float, 1 / nearest**2)
        self._x, self._y, self._far = (mi.Float(np.append(column, 0.0)) for column in (x, y, reach))

    def move(self, plate: Plate, faces: FloatArray) -> None:
        """Go on with another mesh of the same openings, a little elsewhere.

        The openings' map and their neighbours stay: they say where light is looked for, not where it is.
        """
        if len(plate.radius) != self._openings or plate.half != self._half:
            raise ValueError(f"openings: found {len(plate.radius)}; expected the {self._openings} of the plate so far")
        self._normal_z = faces

    def follow(self, sensor: PlateLane, index: Any, seeds: Any) -> tuple[FloatArray, NDArray[np.uint32]]:
        """Follow one path a lane to its end.

        Returns
        -------
        places, shape (lane, KEPT, 7)
            Position, direction to where the light came from, flux; the flux is 0 where nothing is kept.
        faces, shape (lane, KEPT)
            Where they lie.
        """
        mi, dr = self._mi, self._dr
        lanes = dr.width(index)
        lane = dr.arange(mi.UInt32, lanes)
        places, faces = dr.zeros(mi.Float, lanes * KEPT * _NUMBERS), dr.zeros(mi.UInt32, lanes * KEPT)
        origin, heading, flux = sensor.light_ray(index, seeds, True)
        state = (flux > 0, dr.zeros(mi.UInt32, lanes), origin, heading, flux)

        def step(alive: Any, depth: Any, origin: Any, heading: Any, flux: Any) -> tuple[Any, ...]:
            met = self._paths.meet(sensor, origin, heading, alive)
            alive = met.found & ~met.exposed
            dimension = _BOUNCE_DIMENSION + depth * _PER_BOUNCE
            u, v, w, lot = (self._points.coordinate(index, dimension + k, seeds, alive) for k in range(4))
            later = mi.Float(dr.select(depth >= KEPT, depth - (KEPT - 2), 1))
            keep = alive & (lot * later < 1.0)
            slot = lane * KEPT + dr.minimum(depth, KEPT - 1)
            for k, value in enumerate((*met.place, *met.towards, flux)):
                dr.scatter(places, value, slot * _NUMBERS + k, keep)
            dr.scatter(faces, met.face, slot, keep)
            heading = mi.Frame3f(met.normal).to_world(cosine_hemisphere(mi, dr, u, v))
            factor = dr.pi * self._paths.lookup.between(met.table, met.normal, heading, met.towards, alive)
            survival = smaller(dr, factor, 1.0)
            alive &= w < survival
            flux *= factor / larger(dr, survival, 1e-20)
            return alive, dr.select(met.found & ~met.exposed, depth + 1, depth), met.place, heading, flux

        _, depth, *_ = dr.while_loop(state, lambda alive, *_: alive, step, label="light")
        dr.eval(places, faces, depth)  # at once, or the loop would run twice
        kept = np.array(places).reshape(lanes, KEPT, _NUMBERS)
        kept[:, -1, -1] *= np.maximum(np.array(depth).astype(float) - (KEPT - 1), 0.0)
        return kept, np.array(faces).reshape(lanes, KEPT)

    def sort(self, places: FloatArray, faces: NDArray[np.uint32], cells: int) -> Places:
        """Sort kept places by cell (a randomisation), nearest opening and which way they face.

        Parameters
        ----------
        places, faces
            From :meth:`follow`, as many paths for each cell, one cell after the other.
        """
        each = len(places) // cells
        flat, face = places.reshape(-1, _NUMBERS), faces.ravel()
        full = np.flatnonzero(flat[:, -1] > 0)
        cell = full // (each * KEPT)
        grid, size = self._map
        column, row = (
            np.clip((flat[full, k] + half) * (n / (2 * half)), 0, n - 1).astype(np.int64)
            for k, (n, half) in enumerate(zip(size, self._half, strict=True))
        )
        opening = grid[column, row].astype(np.int64)
        normal = self._normal_z[face[full]]
        kind = np.where(normal > _LEVEL, 0, np.where(normal < -_LEVEL, 2, 1))
        bins = (cell * self._openings + opening) * 3 + kind
        order = np.argsort(bins, kind="stable")
        starts = np.searchsorted(bins[order], np.arange(cells * self._openings * 3 + 1))
        which = np.stack([face[full], opening], axis=1)[order]
        return Places(flat[full[order]].astype(np.float32), which.astype(np.uint32), starts, each)

    def pool(self, places: Sequence[Places], blocks: range, block: int, randomisations: int) -> Pool:
        """Places for the kernel: of several illuminations, each with all its blocks of sight lines."""
        return Pool(self._mi, self._dr, places, self._openings, blocks, block, randomisations)

    def joined(self, sensor: PlateLane, seeds: Any, share: Share, pool: Pool, group: Any, randomisation: Any) -> Any:
        """Sum over a lane's sight lines of the light that is reflected at least twice.

        One turn of the loop joins the end of a sight line to a place. What the bound of the factor of form leaves out
        is made up for by looking for faces near the end and joining those (Kollig and Keller, "Illumination in the
        presence of weak singularities", 2004).

        Parameters
        ----------
        group, randomisation
            Illumination in the pool and randomisation of each lane.
        """
        mi, dr = self._mi, self._dr
        lanes = dr.width(share.start)
        number = dr.zeros(mi.UInt32, lanes)
        state = (
            number,  # sight lines begun
            dr.zeros(mi.Bool, lanes),  # near faces are being looked for
            number,  # number in the sequence
            number,  # near faces found
            dr.zeros(mi.Point3f, lanes),
            dr.zeros(mi.Vector3f, lanes),
            dr.zeros(mi.Float, lanes),  # cosine at the origin
            dr.zeros(mi.Float, lanes),  # weight
            dr.zeros(mi.Float64, lanes),
        )

        def going(begun: Any, near: Any, *_: Any) -> Any:
            return near | (begun < share.count)

        def step(
            begun: Any,
            near: Any,
            index: Any,
            depth: Any,
            origin: Any,
            heading: Any,
            cosine: Any,
            weight: Any,
            total: Any,
        ) -> tuple[Any, ...]:
            fresh = ~near & (begun < share.count)
            index = dr.select(fresh, share.index(mi, dr, begun, fresh), index)
            begun, depth = dr.select(fresh, begun + 1, begun), dr.select(fresh, 0, depth)
            new_origin, new_heading, new_weight = sensor.sight_line(index, seeds, fresh)
            origin, heading = dr.select(fresh, new_origin, origin), dr.select(fresh, new_heading, heading)
            weight = dr.select(fresh, new_weight, weight)

            reach = dr.select(fresh, mi.Float(dr.inf), self._near)
            end = self._paths.meet(sensor, origin, heading, (near | fresh) & (weight > 0), reach)
            alive = end.found & ~end.exposed
            # What the joint before left out: the excess of the factor of form over its bound.
            gap = dr.squared_norm(end.place - origin)
            other = dr.dot(end.normal, end.towards)
            left_out = larger(dr, 1.0 - self._bound * gap / larger(dr, cosine * other, 1e-12), 0.0)
            weight = dr.select(near, weight * left_out, weight)
            alive &= weight > 0
            again = alive & near
            total += mi.Float64(
                dr.select(again, weight * self._paths.lit(sensor, end, index, depth, seeds, again), 0.0)
            )

            dimension = _JOINT_DIMENSION + depth * _PER_JOINT
            u, v, a, b, w = (self._points.coordinate(index, dimension + k, seeds, alive) for k in range(_PER_JOINT))
            cell = pool.cell(group, index, randomisation)
            total += mi.Float64(weight * self._joint(sensor, end, pool, cell, u, v, alive))

            local = cosine_hemisphere(mi, dr, a, b)
            heading = mi.Frame3f(end.normal).to_world(local)
            near = alive & (w < _LOOK_NEAR)
            factor = self._paths.lookup.between(end.table, end.normal, end.towards, heading, near)
            weight *= factor * (dr.pi / _LOOK_NEAR)
            return begun, near, index, depth + 1, end.place, heading, local.z, weight, total

        return dr.while_loop(state, going, step, label="joined")[-1]

    def _joint(self, sensor: PlateLane, end: Meeting, pool: Pool, cell: Any, u: Any, v: Any, active: Any) -> Any:
        """Radiance along a sight line by joining its end to one place of the pool."""
        mi, dr = self._mi, self._dr
        opening = self._grid.at(end.place, active)
        number = dr.gather(mi.UInt32, self._number, opening, active)
        around = dr.select(number > 0, mi.Float(_AROUND), 0.0)
        is_own, is_around = u < _OWN, (u >= _OWN) & (u < _OWN + around)
        step = smaller(dr, (u - _OWN) / _AROUND, 1.0 - 2.0**-24) * mi.Float(number)
        beside = dr.gather(
            mi.UInt32, self._neighbour, opening * NEIGHBOURS + mi.UInt32(larger(dr, step, 0.0)), active & is_around
        )
        near = is_own | is_around
        # A face that looks up hardly sees one that looks up, a wall one that looks down: those only by chance.
        skip, take = dr.select(end.normal.z > _LEVEL, mi.UInt32(1), 0), mi.UInt32(2)
        base = cell * pool.openings
        bin_start = (base + dr.select(is_own, opening, beside)) * 3 + skip
        low = dr.select(near, pool.start(bin_start, active), pool.start(base * 3, active))
        high = dr.select(near, pool.start(bin_start + take, active), pool.start((base + pool.openings) * 3, active))
        active = active & (high > low)  # in place it would change the caller's
        place = low + dr.minimum(mi.UInt32(v * mi.Float(high - low)), dr.select(active, high - low - 1, 0))
        position, towards, flux, face, its = pool.place(place, active)
        # The density of the choice, at the place chosen.
        its_bin = (base + its) * 3 + skip
        first, last = pool.start(its_bin, active), pool.start(its_bin + take, active)
        among = mi.Float(last - first)
        favoured = (place >= first) & (place < last)
        x, y, own_x, own_y = (
            dr.gather(mi.Float, array, which, active) for which in (its, opening) for array in (self._x, self._y)
        )
        reach = dr.gather(mi.Float, self._far, opening, active)
        close = (x - own_x) * (x - own_x) + (y - own_y) * (y - own_y) <= reach * reach
        rate = dr.select(its == opening, _OWN, dr.select(close, around / larger(dr, mi.Float(number), 1.0), 0.0))
        whole = mi.Float(pool.start((base + pool.openings) * 3, active) - pool.start(base * 3, active))
        density = (1.0 - _OWN - around) / larger(dr, whole, 1.0)
        density += dr.select(favoured, rate / larger(dr, among, 1.0), 0.0)
        normal, mark = self._paths.face(face, active)
        surface = self._paths.surface(sensor.table, mark, active)
        value = self._seen(end, position, normal, towards, surface, active)
        return dr.select(active, value * flux / (density * pool.paths), 0.0)

    def _seen(self, end: Meeting, position: Any, normal: Any, towards: Any, surface: Any, active: Any) -> Any:
        """Radiance along a sight line that a unit of flux arriving at a place makes, 1/mm2.

        The factor of form is bounded, or a place next to the end would outshine all others.
        """
        mi, dr = self._mi, self._dr
        gap = mi.Vector3f(position - end.place)
        squared = larger(dr, dr.squared_norm(gap), 1e-12)
        distance = dr.sqrt(squared)
        direction = gap / distance
        cosine, other = dr.dot(end.normal, direction), -dr.dot(normal, direction)
        seen = active & (cosine * distance > _FLAT_MM) & (other * distance > _FLAT_MM)
        ray = mi.Ray3f(end.place, direction)
        ray.maxt = distance * (1 - 1e-4)
        seen &= ~self._paths.scene.ray_test(ray, active=seen)
        value = self._paths.lookup.between(end.table, end.normal, end.towards, direction, seen)
        value *= self._paths.lookup.between(surface, normal, -direction, towards, seen)
        return dr.select(seen, value * smaller(dr, cosine * other / squared, self._bound), 0.0)


@dataclass(frozen=True)
class Places:
    """Where the light of one illumination was met.

    Attributes
    ----------
    numbers, shape (place, 7)
        Position, direction to where the light came from, flux.
    which, shape (place, 2)
        Face and nearest opening.
    starts
        First place of every bin (randomisation, opening, way of facing), and their number.
    paths
        Of each randomisation.
    """

    numbers: NDArray[np.float32]
    which: NDArray[np.uint32]
    starts: NDArray[np.int64]
    paths: int


class Pool:
    """Places where light of some illuminations was met, in a kernel's arrays."""

    def __init__(
        self,
        mi: Any,
        dr: Any,
        places: Sequence[Places],
        openings: int,
        blocks: range,
        block: int,
        randomisations: int,
    ) -> None:
        self._mi, self._dr = mi, dr
        pad = np.zeros(2 * _NUMBERS)
        self._places = mi.Float(np.concatenate([*(p.numbers.ravel() for p in places), pad]))
        self._which = mi.UInt32(np.concatenate([*(p.which.ravel() for p in places), np.zeros(4, dtype=np.uint32)]))
        first = np.cumsum([0, *(len(p.which) for p in places)])
        starts = [p.starts[:-1] + offset for p, offset in zip(places, first, strict=False)]
        self._starts = mi.UInt32(np.concatenate([*starts, first[-1:]]).astype(np.uint32))
        self._blocks, self._first, self._block, self._randomisations = (
            dr.opaque(mi.UInt32, number) for number in (len(blocks), blocks.start, block, randomisations)
        )
        self.openings, self.paths = dr.opaque(mi.UInt32, openings), dr.opaque(mi.Float, places[0].paths)

    def cell(self, group: Any, index: Any, randomisation: Any) -> Any:
        """Which part of the pool a sight line is joined to."""
        return (group * self._blocks + (index // self._block - self._first)) * self._randomisations + randomisation

    def start(self, index: Any, active: Any) -> Any:
        """Where the places of a bin start."""
        return self._dr.gather(self._mi.UInt32, self._starts, index, active)

    def place(self, index: Any, active: Any) -> tuple[Any, Any, Any, Any, Any]:
        """Position, direction to where the light came from, flux, face, nearest opening."""
        mi, dr = self._mi, self._dr
        x, y, z, a, b, c, flux = (
            dr.gather(mi.Float, self._places, index * _NUMBERS + k, active) for k in range(_NUMBERS)
        )
        face, opening = (dr.gather(mi.UInt32, self._which, index * 2 + k, active) for k in range(2))
        return mi.Point3f(x, y, z), mi.Vector3f(a, b, c), flux, face, opening


class _Grid:
    """Which opening is about the nearest, in a kernel."""

    def __init__(self, mi: Any, dr: Any, plate: Plate, nearest: tuple[NDArray[np.uint32], tuple[int, int]]) -> None:
        index, size = nearest
        self._mi, self._dr = mi, dr
        self._index = mi.UInt32(index.ravel())
        self._scale = [dr.opaque(mi.Float, n / (2 * half)) for n, half in zip(size, plate.half, strict=True)]
        self._half = [dr.opaque(mi.Float, half) for half in plate.half]
        self._last = [dr.opaque(mi.UInt32, n - 1) for n in size]

    def at(self, place: Any, active: Any) -> Any:
        mi, dr = self._mi, self._dr
        x, y = (
            dr.minimum(mi.UInt32(larger(dr, (value + half) * scale, 0.0)), last)
            for value, half, scale, last in zip((place.x, place.y), self._half, self._scale, self._last, strict=True)
        )
        return dr.gather(mi.UInt32, self._index, x * (self._last[1] + 1) + y, active)
