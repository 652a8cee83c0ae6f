"""The loops of the tracing kernel: light reflected once, and light reflected more often.

Most of the noise of a reading comes from light reflected once (edges of holes and shadows cut the sight
lines), at a quarter of the cost of a whole path. So the two are separate estimates, and the second uses only one in
:data:`SCATTERED_SHARE` of the sight lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from twin.artifact import Surface, SurfaceMesh
from twin.kernel_math import larger, smaller
from twin.mesh_scene import MeshScene
from twin.plate_sight import PlateLane
from twin.reflection import TableLookup
from twin.sequence import Points
from twin.sight import Lane

_OFFSET_MM = 1e-4
_BOUNCE_DIMENSION, _PER_BOUNCE = 4, 3
#: Paths are thinned from this number of reflections on.
_ROULETTE_DEPTH = 5
_PLATE_SALT = 101


@dataclass(frozen=True)
class Meeting:
    """Where rays meet the sample; kernel variables."""

    found: Any
    place: Any
    normal: Any
    towards: Any
    table: Any
    exposed: Any
    face: Any


@dataclass(frozen=True)
class Share:
    """Which points of a block of the sequence a lane works through: numbers ``start + k * stride``, k below ``count``.

    Numbers run over the block in the order of :func:`~twin.sequence.coherent_order`, in stretches of ``span`` (a power
    of two); ``first`` is its first index.
    """

    start: Any
    stride: Any
    count: Any
    first: Any
    order: Any
    span: Any

    def index(self, mi: Any, dr: Any, turn: Any, active: Any) -> Any:
        """Index in the sequence of a lane's sight line number ``turn``."""
        whole = self.start + turn * self.stride
        number = whole & (self.span - 1)
        index = dr.gather(mi.UInt32, self.order, number & 255, active)
        index ^= dr.gather(mi.UInt32, self.order, 256 + ((number >> 8) & 255), active)
        index ^= dr.gather(mi.UInt32, self.order, 512 + ((number >> 16) & 255), active)
        return self.first + (whole - number) + index


class Paths:
    """Follows sight lines through a sample."""

    def __init__(
        self, mi: Any, dr: Any, mesh: SurfaceMesh, lookup: TableLookup, points: Points, *, quick: bool = False
    ) -> None:
        self._mi, self._dr, self.lookup, self._points = mi, dr, lookup, points
        self._sample = MeshScene(mi, mesh, quick=quick)
        self.scene, self._faces = self._sample.scene, self._sample.faces

    def move(self, mesh: SurfaceMesh) -> None:
        """Go on with another mesh."""
        self._sample.move(mesh)
        self.scene, self._faces = self._sample.scene, self._sample.faces

    def reflected_once(self, sensor: Lane, seeds: Any, share: Share) -> Any:
        """Sum over a lane's sight lines of the light that comes straight from the beam."""
        mi, dr = self._mi, self._dr

        def step(begun: Any, total: Any) -> tuple[Any, Any]:
            index = share.index(mi, dr, begun, begun < share.count)
            origin, heading, weight = sensor.sight_line(index, seeds, begun < share.count)
            met = self.meet(sensor, origin, heading, weight > 0)
            return begun + 1, total + mi.Float64(weight * self.lit(sensor, met, index, 0, seeds))

        lanes = dr.width(share.start)
        state = (dr.zeros(mi.UInt32, lanes), dr.zeros(mi.Float64, lanes))
        return dr.while_loop(state, lambda begun, _: begun < share.count, step, label="reflected once")[-1]

    def plate_top(self, sensor: PlateLane, seeds: Any, share: Share, few: Share) -> Any:
        """Sum over a lane's points of the light from the top of a plate, which needs no ray: whole less openings.

        Directions hardly differ within a geometry, so the table is read once for all points, and what that leaves out
        is found from few of them.

        Parameters
        ----------
        few
            A share of fewer points.
        """
        mi, dr = self._mi, self._dr
        lanes = dr.width(share.start)
        normal = mi.Normal3f(0.0, 0.0, 1.0)
        surface = self.lookup.at(sensor.table, dr.opaque(mi.UInt32, int(Surface.PLATE_TOP)), True)
        about = self.lookup.between(surface, normal, *sensor.axes(), True)

        def summed(share: Share, *, change: bool) -> Any:
            def step(begun: Any, total: Any) -> tuple[Any, Any]:
                active = begun < share.count
                index = share.index(mi, dr, begun, active)
                for sign, choose in ((1.0, sensor.plate_point), (-1.0, sensor.opening_point)):
                    place, towards, weight = choose(index, seeds, active)
                    light, irradiance = sensor.illuminate(place, index, _PLATE_SALT, seeds)
                    seen = active & (weight > 0) & (irradiance > 0)
                    flow = sign * weight * irradiance * light.z
                    if change:
                        flow *= self.lookup.between(surface, normal, towards, light, seen) - about
                    total += mi.Float64(dr.select(seen, flow, 0.0))
                return begun + 1, total

            state = (dr.zeros(mi.UInt32, lanes), dr.zeros(mi.Float64, lanes))
            return dr.while_loop(state, lambda begun, _: begun < share.count, step, label="plate top")[-1]

        times = mi.Float64(share.count) / mi.Float64(few.count)
        return summed(share, change=False) * about + summed(few, change=True) * times

    def scattered(self, sensor: Lane, seeds: Any, share: Share) -> Any:
        """Sum over a lane's sight lines of the light that is reflected at least twice.

        One turn of the loop is one reflection; a lane whose path has ended begins the next one at once.
        """
        mi, dr = self._mi, self._dr
        lanes = dr.width(share.start)
        state = (
            dr.zeros(mi.UInt32, lanes),  # paths begun
            dr.zeros(mi.Bool, lanes),  # a path is under way
            dr.zeros(mi.UInt32, lanes),  # its number in the sequence
            dr.zeros(mi.UInt32, lanes),  # its reflections so far
            dr.zeros(mi.Point3f, lanes),
            dr.zeros(mi.Vector3f, lanes),
            dr.zeros(mi.Float, lanes),  # weight of the sight line
            dr.zeros(mi.Float, lanes),  # throughput since
            dr.zeros(mi.Float64, lanes),
        )

        def going(begun: Any, alive: Any, *_: Any) -> Any:
            return alive | (begun < share.count)

        def step(
            begun: Any,
            alive: Any,
            index: Any,
            depth: Any,
            origin: Any,
            heading: Any,
            weight: Any,
            flow: Any,
            total: Any,
        ) -> tuple[Any, ...]:
            fresh = ~alive & (begun < share.count)
            index = dr.select(fresh, share.index(mi, dr, begun, fresh), index)
            begun, depth = dr.select(fresh, begun + 1, begun), dr.select(fresh, 0, depth)
            new_origin, new_heading, new_weight = sensor.sight_line(index, seeds, fresh)
            origin, heading = dr.select(fresh, new_origin, origin), dr.select(fresh, new_heading, heading)
            weight, flow = dr.select(fresh, new_weight, weight), dr.select(fresh, 1.0, flow)

            met = self.meet(sensor, origin, heading, (alive | fresh) & (weight > 0))
            again = met.found & (depth > 0)
            lit = self.lit(sensor, met, index, depth, seeds, again)
            total += mi.Float64(weight * flow * lit)

            alive = met.found & ~met.exposed  # from above the top of the sample comes the beam alone
            dimension = _BOUNCE_DIMENSION + depth * _PER_BOUNCE
            u, v, w = (self._points.coordinate(index, dimension + k, seeds, alive) for k in range(3))
            incoming, factor, _ = self.lookup.sample(met.table, met.normal, met.towards, u, v, alive)
            flow *= factor
            depth += 1
            survival = dr.select(depth > _ROULETTE_DEPTH, smaller(dr, flow, 0.995), 1.0)
            alive &= w < survival
            flow /= larger(dr, survival, 1e-20)
            return begun, alive, index, depth, met.place, incoming, weight, flow, total

        return dr.while_loop(state, going, step, label="scattered")[-1]

    def meet(self, sensor: Lane, origin: Any, heading: Any, active: Any, reach: Any = None) -> Meeting:
        """Follow rays to the sample, up to a reach; a face seen from inside the solid does not count."""
        mi, dr = self._mi, self._dr
        ray = mi.Ray3f(origin, heading)
        if reach is not None:
            ray.maxt = reach
        hit = self.scene.ray_intersect_preliminary(ray, active=active)
        found = active & hit.is_valid()
        normal, mark = self.face(hit.prim_index, found)
        found &= dr.dot(normal, heading) < 0
        place = mi.Point3f(origin + heading * hit.t + normal * _OFFSET_MM)
        table = self.surface(sensor.table, mark, found)
        return Meeting(found, place, normal, -heading, table, mark < 0, hit.prim_index)

    def face(self, index: Any, active: Any) -> tuple[Any, Any]:
        """Normal and mark of a face."""
        mi, dr = self._mi, self._dr
        *direction, mark = (dr.gather(mi.Float, column, index, active) for column in self._faces)
        return mi.Normal3f(*direction), mark

    def surface(self, table: Any, mark: Any, active: Any) -> tuple[Any, Any]:
        """How a face with a mark reflects."""
        return self.lookup.at(table, self._mi.UInt32(self._dr.abs(mark)) - 1, active)

    def lit(self, sensor: Lane, met: Meeting, index: Any, depth: Any, seeds: Any, active: Any = True) -> Any:
        """Radiance that the beam leaves at the meeting, towards where the ray came from."""
        mi, dr = self._mi, self._dr
        light, irradiance = sensor.illuminate(met.place, index, depth, seeds)
        irradiance *= dr.dot(met.normal, light)
        seen = met.found & (irradiance > 0) & active
        seen &= met.exposed | ~self.scene.ray_test(mi.Ray3f(met.place, light), active=seen & ~met.exposed)
        brdf = self.lookup.between(met.table, met.normal, met.towards, light, seen)
        return dr.select(seen, brdf * irradiance, 0.0)
