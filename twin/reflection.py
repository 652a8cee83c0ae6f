"""The table of reflection inside a Dr.Jit kernel: lookup and sampling."""

from __future__ import annotations

from typing import Any

import numpy as np

from instrument.angles import FloatArray
from twin.artifact import Surface
from twin.kernel_math import cosine_hemisphere, full_angle, larger, smaller
from twin.material import Material


class TableLookup:
    """Evaluates and samples a material in a kernel.

    All sizes and values are opaque to the compiler: another table runs the same kernel.

    Parameters
    ----------
    material
        The tables: one for all surfaces, or one for each :class:`~twin.artifact.Surface`.
    surface_factor
        Reflectance of each surface over its table's.
    """

    def __init__(self, mi: Any, dr: Any, material: Material, surface_factor: dict[Surface, float] | None) -> None:
        self._mi, self._dr = mi, dr
        factor = np.ones(len(Surface))
        for surface, value in (surface_factor or {}).items():
            factor[surface] = value
        self._factor = mi.Float(factor)
        self._o, self._phi, self._i = (
            _Axis(mi, dr, nodes) for nodes in (material.cos_o, material.phi_rad, material.cos_i)
        )
        tables, o, phi, i = material.brdf.shape
        number = np.array(material.surfaces or [0] * len(Surface))
        self._first = mi.UInt32((number * (tables // material.materials)).astype(np.uint32))
        self._values = mi.Float(material.brdf.ravel())
        self._row = dr.opaque(mi.UInt32, i)
        self._plane = dr.opaque(mi.UInt32, phi * i)
        self._table = dr.opaque(mi.UInt32, o * phi * i)

    def evaluate(self, place: Any, cos_o: Any, phi: Any, cos_i: Any, active: Any) -> Any:
        """BRDF in 1/sr; ``place`` from :meth:`at`, ``phi`` in [0, 2 pi)."""
        dr, mi = self._dr, self._mi
        table, factor = place
        o, fo = self._o.bracket(cos_o, active)
        p, fp = self._phi.bracket(phi, active)
        i, fi = self._i.bracket(cos_i, active)
        corner = table + o * self._plane + p * self._row + i

        def along_i(start: Any) -> Any:
            low = dr.gather(mi.Float, self._values, start, active)
            return dr.lerp(low, dr.gather(mi.Float, self._values, start + 1, active), fi)

        near = dr.lerp(along_i(corner), along_i(corner + self._row), fp)
        corner += self._plane
        far = dr.lerp(along_i(corner), along_i(corner + self._row), fp)
        return factor * dr.lerp(near, far, fo)

    def at(self, table_index: Any, label: Any, active: Any) -> tuple[Any, Any]:
        """Select the table of a wavelength and a surface, and the factor of the surface."""
        dr, mi = self._dr, self._mi
        table = table_index + dr.gather(mi.UInt32, self._first, label, active)
        return table * self._table, dr.gather(mi.Float, self._factor, label, active)

    def sample(self, place: Any, normal: Any, towards: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Draw the direction from which light comes.

        Parameters
        ----------
        towards
            Unit vector to the sensor's side.
        u, v
            Uniform numbers.

        Returns
        -------
        direction, weight, density
            Unit vector; BRDF times cosine over density; density in 1/sr. Cosine-distributed.
        """
        mi, dr = self._mi, self._dr
        local = cosine_hemisphere(mi, dr, u, v)
        incoming = mi.Frame3f(normal).to_world(local)
        density = local.z * dr.inv_pi
        value = self.between(place, normal, towards, incoming, active)
        return incoming, value * dr.pi, density

    def between(self, place: Any, normal: Any, towards: Any, incoming: Any, active: Any) -> Any:
        """BRDF for light from ``incoming`` seen from ``towards``; zero unless both are above the surface."""
        dr = self._dr
        cos_o, cos_i = dr.dot(normal, towards), dr.dot(normal, incoming)
        phi = self.azimuth_difference(normal, towards, incoming, cos_o, cos_i)
        value = self.evaluate(place, cos_o, phi, cos_i, active)
        return dr.select((cos_o > 0) & (cos_i > 0), value, 0.0)

    def azimuth_difference(self, normal: Any, towards: Any, incoming: Any, cos_o: Any, cos_i: Any) -> Any:
        """Azimuth of ``towards`` minus that of ``incoming`` about the normal, in [0, 2 pi)."""
        dr = self._dr
        cosine = dr.dot(towards, incoming) - cos_o * cos_i
        sine = dr.dot(normal, dr.cross(incoming, towards))
        return full_angle(dr, sine, cosine)


class _Axis:
    """Ascending nodes and a table of where to look for an argument among them."""

    def __init__(self, mi: Any, dr: Any, nodes: FloatArray) -> None:
        self._mi, self._dr = mi, dr
        single = np.asarray(nodes, dtype=np.float32)
        span = float(single[-1] - single[0])
        bins = int(min(65536, max(16, np.ceil(2 * span / np.min(np.diff(single))))))
        edges = single[0] + span * np.arange(bins) / bins
        first = np.clip(np.searchsorted(single, edges, side="right") - 1, 0, len(single) - 2)
        width = np.diff(single)
        self._nodes = mi.Float(single)
        # A node more than intervals: Dr.Jit compiles arrays of one entry differently.
        self._inverse = mi.Float(np.append(1 / width, 0.0))
        self._first = mi.UInt32(first.astype(np.uint32))
        self._start = dr.opaque(mi.Float, float(single[0]))
        self._scale = dr.opaque(mi.Float, bins / span)
        self._bins = dr.opaque(mi.UInt32, bins - 1)
        self._last = dr.opaque(mi.UInt32, len(single) - 2)

    def bracket(self, x: Any, active: Any) -> tuple[Any, Any]:
        """Index of the node below and the fraction of the way to the next; the end's value beyond the ends."""
        dr, mi = self._dr, self._mi
        place = dr.minimum(mi.UInt32(larger(dr, (x - self._start) * self._scale, 0.0)), self._bins)
        low = dr.gather(mi.UInt32, self._first, place, active)
        # A bin is at most half as wide as the narrowest interval: one step further is enough.
        following = dr.gather(mi.Float, self._nodes, low + 1, active)
        low = dr.select((x >= following) & (low < self._last), low + 1, low)
        node = dr.gather(mi.Float, self._nodes, low, active)
        fraction = (x - node) * dr.gather(mi.Float, self._inverse, low, active)
        return low, smaller(dr, larger(dr, fraction, 0.0), 1.0)
