"""Sight lines through the openings of a plate, inside the tracing kernel."""

from __future__ import annotations

from typing import Any

import numpy as np

from instrument.angles import FloatArray
from twin.kernel_math import larger, uniform_disc
from twin.optics import Layout
from twin.plate import Plate, Slots, Spot
from twin.sequence import Points
from twin.sight import Lane, columns, pack

#: Columns of what a geometry's record needs besides, by name.
_WIDTHS = {
    "normal": 3,
    "per_area": 1,
    "size": 2,
    "spot": 2,
    "spot_u": 2,
    "spot_v": 2,
    "spot_area": 1,
    "by_light": 1,
}
#: Rays start so far above the top, mm.
_START_MM = 1e-3
_LIGHT_SALT = 202


def plate_records(layout: Layout, spot: Spot) -> FloatArray:
    """Pack what sight lines through the top need besides a geometry's record, shape (point, ...)."""
    normal = np.cross(layout.along, layout.across)
    size = np.stack([np.linalg.norm(side, axis=1) for side in (layout.along, layout.across)], axis=-1)
    area = np.linalg.norm(normal, axis=1)
    normal = normal / area[:, None]
    target_area = area * (4.0 if layout.square else np.pi)
    on_top = target_area * np.abs(np.sum(normal * layout.view, axis=1)) / np.maximum(layout.view[:, 2], 1e-6)
    spot_area = spot.area()
    values = {
        "normal": normal,
        "per_area": 1 / target_area,
        "size": size**2,
        "spot": spot.centre,
        "spot_u": spot.step_u * spot.radius[:, None],
        "spot_v": spot.step_v * spot.radius[:, None],
        "spot_area": spot_area,
        "by_light": (spot.radius > 0) & (spot_area < on_top),
    }
    return pack(values, _WIDTHS)


class Openings:
    """Discs of a plate and the slots of every geometry, for the kernel."""

    def __init__(self, mi: Any, dr: Any, plate: Plate, slots: Slots) -> None:
        self.x, self.y = (mi.Float(np.append(column, 0.0)) for column in plate.centre.T)
        self.radius = mi.Float(np.append(plate.radius, 0.0))
        self.table = [
            mi.UInt32(np.append(array.ravel(), np.uint32(0))) for array in (slots.opening, slots.start, slots.count)
        ]
        self.slots = dr.opaque(mi.UInt32, slots.opening.shape[1])
        self.half = [dr.opaque(mi.Float, value) for value in plate.half]


class PlateLane(Lane):
    """One lane's geometry, whose sight lines go through the openings of a plate.

    Parameters
    ----------
    extra
        From :func:`plate_records`, flat.
    options
        As of :class:`~twin.sight.Lane`.
    """

    def __init__(self, mi: Any, dr: Any, data: Any, extra: Any, openings: Openings, geometry: Any, points: Points,
                 **options: Any) -> None:  # fmt: skip
        super().__init__(mi, dr, data, geometry, points, **options)
        self._value |= columns(mi, dr, extra, geometry, _WIDTHS)
        self._openings, self._row = openings, geometry * openings.slots

    def sight_line(self, number: Any, seed: Any, active: Any) -> tuple[Any, Any, Any]:
        """Start a path just above an opening; weight as in :meth:`Lane.sight_line`."""
        x, y, mirror, area = self._in_opening(number, seed, active)
        place, towards, weight = self._through(x, y, mirror)
        return place + towards * (_START_MM / towards.z), -towards, weight * area

    def light_ray(self, number: Any, seed: Any, active: Any) -> tuple[Any, Any, Any]:
        """Send the beam's light through an opening: origin, heading and flux.

        The flux is in mm2 times the irradiance on the beam's axis.
        """
        mi, dr = self._mi, self._dr
        u, v = (self._points.coordinate(number, k, seed, active) for k in range(2))
        opening, own, share = self._slot(u, active)
        radius, x, y = self._disc(opening, active)
        disc = uniform_disc(mi, dr, own, v)
        place = mi.Point3f(x + radius * disc.x, y + radius * disc.y, 0.0)
        light, irradiance = self.illuminate(place, number, _LIGHT_SALT, seed)
        flux = irradiance * light.z * dr.pi * radius * radius / share
        return mi.Point3f(place + light * (_START_MM / light.z)), -light, dr.select(active, flux, 0.0)

    def plate_point(self, number: Any, seed: Any, active: Any) -> tuple[Any, Any, Any]:
        """A point of the whole top, the direction to the sensor, and the weight."""
        mi, dr = self._mi, self._dr
        u, v, mirror = self._numbers(number, seed, active)
        disc = uniform_disc(mi, dr, u, v)
        by_light = self._scalar("by_light") > 0.5
        (x, y), (ux, uy), (vx, vy) = (self._value[name] for name in ("spot", "spot_u", "spot_v"))
        x, y = x + ux * disc.x + vx * disc.y, y + uy * disc.x + vy * disc.y
        lit_place, lit_towards, lit_weight = self._through(x, y, mirror)
        a = dr.select(self._square, 2.0 * u - 1.0, disc.x)
        b = dr.select(self._square, 2.0 * v - 1.0, disc.y)
        target, seen_towards = self._sensor_ray(a, b, mirror)
        seen_weight = self._stopped(a, b, mirror)
        seen_place = target - seen_towards * (target.z / seen_towards.z)
        place = dr.select(by_light, lit_place, seen_place)
        weight = dr.select(by_light, lit_weight * self._scalar("spot_area"), seen_weight)
        half = self._openings.half
        on_plate = (dr.abs(place.x) <= half[0]) & (dr.abs(place.y) <= half[1])
        return place, dr.select(by_light, lit_towards, seen_towards), dr.select(on_plate, weight, 0.0)

    def opening_point(self, number: Any, seed: Any, active: Any) -> tuple[Any, Any, Any]:
        """A point of an opening as if the plate were whole, the direction to the sensor, and the weight."""
        x, y, mirror, area = self._in_opening(number, seed, active)
        place, towards, weight = self._through(x, y, mirror)
        return place, towards, weight * area

    def _numbers(self, number: Any, seed: Any, active: Any) -> tuple[Any, Any, Any]:
        u, v, s, t = (self._points.coordinate(number, k, seed, active) for k in range(4))
        return u, v, uniform_disc(self._mi, self._dr, s, t)

    def _in_opening(self, number: Any, seed: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Point of an opening, point of the mirror, and the area in mm2 that the choice stands for."""
        mi, dr = self._mi, self._dr
        u, v, mirror = self._numbers(number, seed, active)
        opening, own, share = self._slot(u, active)
        disc = uniform_disc(mi, dr, own, v)
        radius, x, y = self._disc(opening, active)
        return x + radius * disc.x, y + radius * disc.y, mirror, dr.pi * radius * radius / share

    def _slot(self, u: Any, active: Any) -> tuple[Any, Any, Any]:
        """Choose an opening by a uniform number: the opening, what is left of the number, the opening's share."""
        mi, dr = self._mi, self._dr
        slots = mi.Float(self._openings.slots)
        place = u * slots
        slot = self._row + mi.UInt32(place)
        opening, start, count = (dr.gather(mi.UInt32, array, slot, active) for array in self._openings.table)
        length = larger(dr, mi.Float(count), 1.0)
        return opening, (place - mi.Float(start)) / length, length / slots

    def _disc(self, opening: Any, active: Any) -> Any:
        """Radius and centre of an opening."""
        arrays = (self._openings.radius, self._openings.x, self._openings.y)
        return (self._dr.gather(self._mi.Float, array, opening, active) for array in arrays)

    def _through(self, x: Any, y: Any, mirror: Any) -> tuple[Any, Any, Any]:
        """The sensor's ray through a point of the top, and the density of such rays per mm2 of the top.

        Seen from a point of the mirror, areas on target and top are related by central projection.
        """
        mi, dr = self._mi, self._dr
        place = mi.Point3f(x, y, 0.0)
        gap = mi.Vector3f(self._vector("target") - place)
        lever = self._vector("mirror_along") * mirror.x + self._vector("mirror_across") * mirror.y
        inverse = self._scalar("inverse_distance")
        towards = self._vector("view") + (gap + lever) * inverse
        normal = self._vector("normal")
        slant = dr.dot(towards, normal)
        step = dr.dot(gap, normal) / slant
        offset = towards * step - gap
        size_u, size_v = self._value["size"]
        u, v = dr.dot(offset, self._vector("along")) / size_u, dr.dot(offset, self._vector("across")) / size_v
        inside = dr.select(self._square, (dr.abs(u) <= 1.0) & (dr.abs(v) <= 1.0), u * u + v * v <= 1.0)
        nearer = 1.0 - step * inverse
        density = nearer * nearer * towards.z / dr.abs(slant) * self._scalar("per_area")
        density *= self._stopped(u, v, mirror)
        return place, dr.normalize(towards), dr.select(inside & (towards.z > 0.0), density, 0.0)
