"""Light inside the cavity, followed once for all sensor directions.

Light scattered in the cavity is a small part of a reading and hard to find from the sensor: a path that starts there
rarely meets the few lit places. So the light is followed from the openings that it enters by, every place that it
meets is kept, and the ends of the sight lines are joined to such places, near ones more often (bidirectional path
tracing, Veach 1997, chapter 10, with one reflection on the sensor's side). Places depend on the illumination alone; the
geometries that share it share them, in each randomisation others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.kernel_math import cosine_hemisphere, larger, smaller
from twin.light_places import BINS, LEVEL_RATE, NUMBERS, SIDE_RATE, Favours, NearestOpening, Places, Pool
from twin.paths import Meeting, Paths, Share
from twin.plate import Plate, nearest_openings, neighbours
from twin.plate_sight import PlateLane
from twin.sequence import Points

#: Places kept of one path: the first of them always, and one of the later ones at random for all those.
KEPT = 4
_PER_BOUNCE, _BOUNCE_DIMENSION = 4, 2
#: Share of the joints to places anywhere.
_ANYWHERE = 0.1
_JOINT_DIMENSION, _LEFT_OUT_DIMENSION, _PER_LOOK = 4, 6, 4
#: Faces near the end are looked for at one in so many sight lines.
_LOOK_NEAR = 16
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
        self._grid = NearestOpening(mi, dr, plate, self._map)
        x, y = plate.centre.T
        nearest = _NEAREST * float(np.median(plate.radius))
        self._near, self._bound = dr.opaque(mi.Float, nearest), dr.opaque(mi.Float, 1 / nearest**2)
        self._favours = Favours(plate, index, number)
        self._bins = mi.UInt32(self._favours.bins().ravel())
        self._fade_level = dr.opaque(mi.Float, self._favours.fade_level)
        self._fade_side = dr.opaque(mi.Float, self._favours.fade_side)
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
        places, faces = dr.zeros(mi.Float, lanes * KEPT * NUMBERS), dr.zeros(mi.UInt32, lanes * KEPT)
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
                dr.scatter(places, value, slot * NUMBERS + k, keep)
            dr.scatter(faces, met.face, slot, keep)
            heading = mi.Frame3f(met.normal).to_world(cosine_hemisphere(mi, dr, u, v))
            factor = dr.pi * self._paths.lookup.between(met.table, met.normal, heading, met.towards, alive)
            survival = smaller(dr, factor, 1.0)
            alive &= w < survival
            flux *= factor / larger(dr, survival, 1e-20)
            return alive, dr.select(met.found & ~met.exposed, depth + 1, depth), met.place, heading, flux

        _, depth, *_ = dr.while_loop(state, lambda alive, *_: alive, step, label="light")
        dr.eval(places, faces, depth)  # at once, or the loop would run twice
        kept = np.array(places).reshape(lanes, KEPT, NUMBERS)
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
        flat, face = places.reshape(-1, NUMBERS), faces.ravel()
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
        return Pool(self._mi, self._dr, places, self._openings, blocks, block, randomisations, self._favours)

    def joined(self, sensor: PlateLane, seeds: Any, share: Share, pool: Pool, group: Any, randomisation: Any) -> Any:
        """Sum over a lane's sight lines of the light that is reflected at least twice.

        The end of every sight line is joined to a place. What the bound of the factor of form leaves out, little, is
        made up for at some of the sight lines (:meth:`_left_out`).

        Parameters
        ----------
        group, randomisation
            Illumination in the pool and randomisation of each lane.
        """
        mi, dr = self._mi, self._dr

        def step(begun: Any, total: Any) -> tuple[Any, Any]:
            active = begun < share.count
            index = share.index(mi, dr, begun, active)
            origin, heading, weight = sensor.sight_line(index, seeds, active)
            end = self._paths.meet(sensor, origin, heading, weight > 0)
            alive = end.found & ~end.exposed
            u, v = (self._points.coordinate(index, _JOINT_DIMENSION + k, seeds, alive) for k in range(2))
            cell = pool.cell(group, index, randomisation)
            return begun + 1, total + mi.Float64(weight * self._joint(sensor, end, pool, cell, u, v, alive))

        lanes = dr.width(share.start)
        state = (dr.zeros(mi.UInt32, lanes), dr.zeros(mi.Float64, lanes))
        total = dr.while_loop(state, lambda begun, _: begun < share.count, step, label="joined")[-1]
        return total + self._left_out(sensor, seeds, share, pool, group, randomisation)

    def _left_out(self, sensor: PlateLane, seeds: Any, share: Share, pool: Pool, group: Any, randomisation: Any) -> Any:
        """What the bound of the factor of form leaves out of :meth:`joined`, from one in some of its sight lines.

        Faces near the end of the sight line are looked for, and joined in their turn (Kollig and Keller, "Illumination
        in the presence of weak singularities", 2004). One turn of the loop is one ray.
        """
        mi, dr = self._mi, self._dr
        lanes = dr.width(share.start)
        number = dr.zeros(mi.UInt32, lanes)
        apart = dr.select(share.count > _LOOK_NEAR, mi.UInt32(_LOOK_NEAR), share.count)
        turns = share.count // apart
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
            return near | (begun < turns)

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
            fresh = ~near & (begun < turns)
            index = dr.select(fresh, share.index(mi, dr, begun * apart, fresh), index)
            begun, depth = dr.select(fresh, begun + 1, begun), dr.select(fresh, 0, depth)
            new_origin, new_heading, new_weight = sensor.sight_line(index, seeds, fresh)
            origin, heading = dr.select(fresh, new_origin, origin), dr.select(fresh, new_heading, heading)
            weight = dr.select(fresh, new_weight * mi.Float(apart), weight)

            reach = dr.select(fresh, mi.Float(dr.inf), self._near)
            end = self._paths.meet(sensor, origin, heading, (near | fresh) & (weight > 0), reach)
            alive = end.found & ~end.exposed
            # What the joint before left out: the excess of the factor of form over its bound.
            gap = dr.squared_norm(end.place - origin)
            other = dr.dot(end.normal, end.towards)
            left_out = larger(dr, 1.0 - self._bound * gap / larger(dr, cosine * other, 1e-12), 0.0)
            weight = dr.select(near, weight * left_out, weight)
            again = alive & near & (weight > 0)
            lit = self._paths.lit(sensor, end, index, depth, seeds, again)
            dimension = _LEFT_OUT_DIMENSION + depth * _PER_LOOK
            a, b, u, v = (self._points.coordinate(index, dimension + k, seeds, alive) for k in range(_PER_LOOK))
            joint = self._joint(sensor, end, pool, pool.cell(group, index, randomisation), u, v, again)
            total += mi.Float64(dr.select(again, weight * (lit + joint), 0.0))

            local = cosine_hemisphere(mi, dr, a, b)
            heading = mi.Frame3f(end.normal).to_world(local)
            near = alive & (weight > 0)
            weight *= dr.pi * self._paths.lookup.between(end.table, end.normal, end.towards, heading, near)
            return begun, near, index, depth + 1, end.place, heading, local.z, weight, total

        return dr.while_loop(state, going, step, label="left out")[-1]

    def _joint(self, sensor: PlateLane, end: Meeting, pool: Pool, cell: Any, u: Any, v: Any, active: Any) -> Any:
        """Radiance along a sight line by joining its end to one place of the pool."""
        mi, dr = self._mi, self._dr
        base = cell * pool.openings
        opening = self._grid.at(end.place, active)
        up, down = end.normal.z > _LEVEL, end.normal.z < -_LEVEL
        facing = dr.select(up, mi.UInt32(0), dr.select(down, mi.UInt32(2), 1))
        row = (base + opening) * 3 + facing
        found, whole = pool.favoured(row, u * (1.0 / (1.0 - _ANYWHERE)), active)
        share = dr.select(whole > 0.0, mi.Float(1.0 - _ANYWHERE), 0.0)
        near = u < share
        which = dr.gather(mi.UInt32, self._bins, opening * BINS + found, active)
        start = (base + which) * 3 + (found & 1) + dr.select(up, mi.UInt32(1), 0)
        first, last = pool.start(base * 3, active), pool.start((base + pool.openings) * 3, active)
        low = dr.select(near, pool.start(start, active), first)
        high = dr.select(near, pool.start(start + 1, active), last)
        active = active & (high > low)  # in place it would change the caller's
        place = low + dr.minimum(mi.UInt32(v * mi.Float(high - low)), dr.select(active, high - low - 1, 0))
        position, towards, flux, face, its = pool.place(place, active)
        normal, mark = self._paths.face(face, active)
        # The density of the choice, at the place chosen.
        density = (1.0 - share) / larger(dr, mi.Float(last - first), 1.0)
        density += share * self._rate(opening, its, end.normal.z, normal.z, active) / larger(dr, whole, 1e-20)
        surface = self._paths.surface(sensor.table, mark, active)
        value = self._seen(end, position, normal, towards, surface, active)
        return dr.select(active, value * flux / (density * pool.paths), 0.0)

    def _rate(self, opening: Any, its: Any, end: Any, place: Any, active: Any) -> Any:
        """How often a place under an opening is joined to an end, by the heights of their normals: :class:`Favours`."""
        mi, dr = self._mi, self._dr
        x, y, own_x, own_y = (
            dr.gather(mi.Float, array, at, active) for at in (its, opening) for array in (self._x, self._y)
        )
        squared = (x - own_x) * (x - own_x) + (y - own_y) * (y - own_y)
        reach = dr.gather(mi.Float, self._far, opening, active)
        close = (its == opening) | (squared <= reach * reach)
        level, side = 1.0 + squared * self._fade_level, 1.0 + squared * self._fade_side
        level, side = LEVEL_RATE / (level * level), SIDE_RATE / (side * side)
        end_level, level_place = dr.abs(end) > _LEVEL, dr.abs(place) > _LEVEL
        opposite = dr.select(end * place < 0.0, level, 0.0)
        own = dr.select(its == opening, mi.Float(1.0), 0.0)
        from_level = dr.select(level_place, opposite, side)
        from_side = dr.select(level_place, dr.select(place > 0.0, side, 0.0), own)
        return dr.select(close, dr.select(end_level, from_level, from_side), 0.0)

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
