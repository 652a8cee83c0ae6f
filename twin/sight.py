"""Sight lines and light inside the tracing kernel, and the records that carry a geometry into it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.beam_image import BeamImage
from twin.kernel_math import larger, smaller, standard_normal, uniform_disc
from twin.optics import Footprint, Layout
from twin.sequence import Points, mix

#: Columns of a geometry's record, by name.
_WIDTHS = {
    "target": 3,
    "along": 3,
    "across": 3,
    "view": 3,
    "mirror_along": 3,
    "mirror_across": 3,
    "inverse_distance": 1,
    "light": 3,
    "light_u": 3,
    "light_v": 3,
    "beam": 3,
    "iris": 2,
    "falloff": 2,
    "inverse_source": 1,
    "divergence_rad": 1,
    "stop": 4,
    "table": 1,
    "key_high": 1,
    "key_low": 1,
    "share_top": 1,
    "share_depth": 1,
    "centre": 2,
    "frame": 4,
    "inverse": 4,
    "sweep": 2,
    "length": 1,
}
_LARGE = 1e9
_DIVERGENCE_SALT = 0x632BE59B


def records(
    layout: Layout,
    table_index: NDArray[np.int64],
    footprint: Footprint,
    shares: FloatArray,
    keys: NDArray[np.uint32],
) -> FloatArray:
    """Pack geometries for the kernel, shape (point, RECORD).

    Parameters
    ----------
    shares, shape (point, 2)
        Shares of the sight lines through the lit plate top and through the lit depth.
    keys, shape (point,)
        Numbers that tell geometries apart.
    """
    values = {name: getattr(layout, name) for name in _WIDTHS if hasattr(layout, name)}
    values |= {name: getattr(footprint, name) for name in ("centre", "frame", "inverse", "sweep", "length")}
    values["iris"] = 1 / layout.iris**2
    values["stop"] = _stop(layout)
    values["table"] = table_index
    values["key_high"], values["key_low"] = keys >> 16, keys & 0xFFFF  # exact in single precision
    values["share_top"], values["share_depth"] = shares[:, 0], shares[:, 1]
    return pack(values, _WIDTHS)


def _stop(layout: Layout) -> FloatArray:
    """Where on the field stop a ray lies for points of target and mirror, its outer rim, and how fast that falls."""
    radius, edge, share = layout.stop.T
    target, mirror = (np.linalg.norm(side, axis=1) for side in (layout.along, layout.mirror_along))
    outer = np.minimum(radius + edge / 2, _LARGE)
    return np.stack([(1 - share) * target, share * mirror, outer, 1 / edge], axis=1)


def pack(values: dict[str, Any], widths: dict[str, int]) -> FloatArray:
    """Put the named columns side by side, shape (point, sum of the widths)."""
    return np.concatenate(
        [np.asarray(values[name], dtype=float).reshape(-1, width) for name, width in widths.items()], axis=1
    )


def columns(mi: Any, dr: Any, data: Any, row: Any, widths: dict[str, int]) -> dict[str, list[Any]]:
    """Load a row of what :func:`pack` made."""
    starts = np.cumsum([0, *widths.values()]).tolist()
    base = row * starts[-1]
    return {
        name: [dr.gather(mi.Float, data, base + start + k) for k in range(width)]
        for (name, width), start in zip(widths.items(), starts, strict=False)
    }


class Picture:
    """The picture of a beam for the kernel, where :meth:`~instrument.beam_image.BeamImage.at` says what it means."""

    def __init__(self, mi: Any, dr: Any, image: BeamImage) -> None:
        self._mi, self._dr = mi, dr
        rows, columns = image.values.shape
        self._values = mi.Float(image.values.astype(np.float32).ravel())
        self._columns, self._last = dr.opaque(mi.UInt32, columns), dr.opaque(mi.Float, columns - 1)
        self._last_row = dr.opaque(mi.Float, rows - 1)
        self._first = [dr.opaque(mi.Float, value) for value in image.first]
        self._density = [dr.opaque(mi.Float, 1 / value) for value in image.pitch]

    def at(self, u: Any, v: Any, active: Any) -> Any:
        """Irradiance at places, mm from the beam's axis."""
        mi, dr = self._mi, self._dr
        x, y = (u - self._first[0]) * self._density[0], (v - self._first[1]) * self._density[1]
        inside = active & (x >= 0.0) & (y >= 0.0) & (x <= self._last) & (y <= self._last_row)
        column = mi.UInt32(dr.select(inside, smaller(dr, x, self._last - 1.0), 0.0))
        row = mi.UInt32(dr.select(inside, smaller(dr, y, self._last_row - 1.0), 0.0))
        a, b = x - mi.Float(column), y - mi.Float(row)
        corner = row * self._columns + column
        (low, low_next), (high, high_next) = (
            [dr.gather(mi.Float, self._values, start + k, inside) for k in range(2)]
            for start in (corner, corner + self._columns)
        )
        low, high = low + (low_next - low) * a, high + (high_next - high) * a
        return dr.select(inside, low + (high - low) * b, 0.0)


class Lane:
    """One lane's geometry, loaded from its record.

    Parameters
    ----------
    data
        Records of all geometries, flat.
    geometry
        Index of each lane's geometry.
    square, box
        Shape of the target; corners of a box around the sample.
    diverging
        Whether any beam diverges; without, no random numbers are spent on it.
    picture
        Irradiance of the beam, where it is a picture.
    """

    def __init__(
        self,
        mi: Any,
        dr: Any,
        data: Any,
        geometry: Any,
        points: Points,
        *,
        square: Any,
        box: Any,
        diverging: bool,
        picture: Picture | None = None,
    ) -> None:
        self._mi, self._dr, self._points = mi, dr, points
        self._square, self._box, self._diverging, self._picture = square, box, diverging, picture
        self._value = columns(mi, dr, data, geometry, _WIDTHS)
        self.table = mi.UInt32(self._value["table"][0])
        self.key = (mi.UInt32(self._value["key_high"][0]) << 16) | mi.UInt32(self._value["key_low"][0])

    def _vector(self, name: str) -> Any:
        return self._mi.Vector3f(*self._value[name])

    def _scalar(self, name: str) -> Any:
        return self._value[name][0]

    def axes(self) -> tuple[Any, Any]:
        """Directions to the sensor and to the light at the middle of target and beam."""
        return self._vector("view"), self._vector("light")

    def sight_line(self, number: Any, seed: Any, active: Any) -> tuple[Any, Any, Any]:
        """Start a path: a ray from the sensor, entering the box around the sample.

        Returns
        -------
        origin, heading, weight
            The weight is the density of the sensor's rays over that of the choice; zero for a ray that misses.
        """
        mi, dr = self._mi, self._dr
        u, v, s, t = (self._points.coordinate(number, k, seed, active) for k in range(4))
        x, y, weight = self._target_point(u, v)
        mirror = uniform_disc(mi, dr, s, t)
        target, towards = self._sensor_ray(x, y, mirror)
        weight *= self._stopped(x, y, mirror)
        lower = (self._box[0] - target) / towards
        upper = (self._box[1] - target) / towards
        far = [larger(dr, a, b) for a, b in zip(lower, upper, strict=True)]
        near = [smaller(dr, a, b) for a, b in zip(lower, upper, strict=True)]
        enters = smaller(dr, smaller(dr, far[0], far[1]), far[2])  # coming from the sensor
        leaves = larger(dr, larger(dr, near[0], near[1]), near[2])
        weight = dr.select(leaves < enters, weight, 0.0)
        return target + towards * enters, -towards, weight

    def _sensor_ray(self, x: Any, y: Any, mirror: Any) -> tuple[Any, Any]:
        """Point of the target, and the direction from there to a point of the mirror."""
        mi, dr = self._mi, self._dr
        offset = self._vector("along") * x + self._vector("across") * y
        lever = self._vector("mirror_along") * mirror.x + self._vector("mirror_across") * mirror.y - offset
        towards = dr.normalize(self._vector("view") + lever * self._scalar("inverse_distance"))
        return mi.Point3f(self._vector("target") + offset), towards

    def _stopped(self, x: Any, y: Any, mirror: Any) -> Any:
        """What the field stop lets through of the ray from a point of the target to one of the mirror."""
        dr = self._dr
        of_target, of_mirror, outer, fall = self._value["stop"]
        across, aside = of_target * x + of_mirror * mirror.x, of_target * y + of_mirror * mirror.y
        inside = (outer - dr.sqrt(across * across + aside * aside)) * fall
        return smaller(dr, larger(dr, inside, 0.0), 1.0)

    def _target_point(self, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Choose a point of the target from the mixture; weight by the balance heuristic (Veach 1997, 9.2)."""
        mi, dr = self._mi, self._dr
        top, deep = self._scalar("share_top"), self._scalar("share_depth")
        rest = 1.0 - top - deep
        is_top, is_deep = u < top, (u >= top) & (u < top + deep)
        low = dr.select(is_top, 0.0, dr.select(is_deep, top, top + deep))
        share = dr.select(is_top, top, dr.select(is_deep, deep, rest))
        own = smaller(dr, (u - low) / larger(dr, share, 1e-6), 1.0 - 2.0**-24)
        disc = uniform_disc(mi, dr, own, v)
        centre_x, centre_y = self._value["centre"]
        a, b, c, d = self._value["frame"]
        sweep_x, sweep_y = self._value["sweep"]
        length = self._scalar("length")
        progress, aside = (2.0 + length) * own - 1.0, 2.0 * v - 1.0
        p = dr.select(is_deep, sweep_x * progress - sweep_y * aside, disc.x)
        q = dr.select(is_deep, sweep_y * progress + sweep_x * aside, disc.y)
        lit = is_top | is_deep
        x = dr.select(lit, centre_x + a * p + b * q, dr.select(self._square, 2.0 * own - 1.0, disc.x))
        y = dr.select(lit, centre_y + c * p + d * q, dr.select(self._square, aside, disc.y))
        # Densities of the three ways of choosing, at the point chosen.
        e, f, g, h = self._value["inverse"]
        p = e * (x - centre_x) + f * (y - centre_y)
        q = g * (x - centre_x) + h * (y - centre_y)
        progress, aside = p * sweep_x + q * sweep_y, q * sweep_x - p * sweep_y
        scale = dr.abs(e * h - f * g)
        in_top = p * p + q * q <= 1.0
        in_deep = (dr.abs(aside) <= 1.0) & (progress >= -1.0) & (progress <= 1.0 + length)
        inside = dr.select(self._square, (dr.abs(x) <= 1.0) & (dr.abs(y) <= 1.0), x * x + y * y <= 1.0)
        whole = dr.select(self._square, 0.25, dr.inv_pi)
        chosen = (
            dr.select(in_top, top * scale * dr.inv_pi, 0.0)
            + dr.select(in_deep, deep * scale / (2.0 * (2.0 + length)), 0.0)
            + rest * whole
        )
        return x, y, dr.select(inside, whole / chosen, 0.0)

    def illuminate(self, place: Any, index: Any, depth: Any, seed: Any) -> tuple[Any, Any]:
        """Direction to the light at a place, and the irradiance normal to it over that on the beam's axis."""
        mi, dr = self._mi, self._dr
        axis, beam = self._vector("light"), self._vector("beam")
        offset = mi.Vector3f(place) - beam
        to_source = axis - offset * self._scalar("inverse_source")
        squared = dr.squared_norm(to_source)
        towards = to_source * dr.rsqrt(squared)
        if self._diverging:
            salt = seed + _DIVERGENCE_SALT + depth
            u = mi.Float(mix(index ^ salt) >> 8) * 2.0**-24
            v = mi.Float(mix(index + mix(salt)) >> 8) * 2.0**-24
            deviation = standard_normal(mi, dr, u, v) * self._scalar("divergence_rad")
            towards = dr.normalize(
                towards + self._vector("light_u") * deviation.x + self._vector("light_v") * deviation.y
            )
        across = offset - towards * (dr.dot(offset, axis) / dr.dot(towards, axis))
        u, v = dr.dot(across, self._vector("light_u")), dr.dot(across, self._vector("light_v"))
        u2, v2 = u * u, v * v
        (iris_u, iris_v), (decay_u, decay_v) = self._value["iris"], self._value["falloff"]
        within = u2 * iris_u + v2 * iris_v <= 1.0
        profile = dr.select(within, dr.exp(-(decay_u * u2 + decay_v * v2)), 0.0)
        if self._picture is not None:
            profile *= self._picture.at(u, v, within)
        return towards, profile / squared
