"""The ray tracer: radiance towards the sensor, for every geometry in one launch.

Paths start at the sensor (sight lines), look for the beam from every point they meet (next-event estimation) and go
on by sampling the reflection. A lane of the launch works through its share of the sample points one path after the
other, so memory does not grow with their number. What depends on geometry, instrument, material or sample is data to
the compiled kernel, never code: changing it costs no recompilation.

Accuracy: unbiased but for single-precision geometry (offsets of 0.1 micrometre) and hole polygons; sums in double
precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.artifact import Surface, SurfaceMesh
from twin.llvm import import_mitsuba
from twin.material import Material
from twin.optics import Footprint, Layout, lit_footprint
from twin.paths import SCATTERED_SHARE, Paths, Share
from twin.reflection import TableLookup
from twin.sequence import INDEX_BITS, Points, coherent_order, mix
from twin.sight import Lane, records

#: Independent randomisations of the sequence: their scatter is the standard error.
RANDOMISATIONS = 8
#: Lanes of a launch are at least this many where the samples suffice, to fill the machine.
_LANES = 4096
_PACKET = 16
#: Geometries of one launch at most: bounds the memory.
_POINTS = 8192


@dataclass(frozen=True)
class Mixture:
    """How sight lines are chosen: shares of those through the lit plate top, and through the lit depth.

    The rest goes over the whole target, because light scattered inside the cavity shows beyond the lit volume. A
    region that covers most of the target gets a smaller share: there is nothing to restrict.
    """

    lit_top: float = 0.4
    lit_depth: float = 0.35

    def shares(self, footprint: Footprint) -> FloatArray:
        """Shares of the two regions, shape (point, 2)."""
        area = np.abs(np.linalg.det(footprint.frame))
        top, deep = area, area * 2 * (2 + footprint.length) / np.pi
        gain = np.stack([np.clip(1 - top, 0, 1), np.clip(1 - deep, 0, 1)], axis=1)
        bounded = footprint.bounded[:, None]
        return np.where(bounded, np.array([self.lit_top, self.lit_depth]) * np.sqrt(gain), 0.0)


#: Every sight line of the target equally likely: slow, and the yardstick for the other.
UNRESTRICTED = Mixture(0.0, 0.0)


class Tracer:
    """Traces one sample with one material.

    Parameters
    ----------
    mesh
        Closed, normals outwards, mm.
    material
        Tables of reflection.
    surface_factor
        Reflectance of each surface over the table's.
    """

    def __init__(
        self, mesh: SurfaceMesh, material: Material, *, surface_factor: dict[Surface, float] | None = None
    ) -> None:
        self._mi = import_mitsuba()
        import drjit as dr

        self._dr = dr
        self._points = Points(self._mi, dr)
        lookup = TableLookup(self._mi, dr, material, surface_factor)
        self._paths = Paths(self._mi, dr, mesh, lookup, self._points)
        corners = (mesh.vertices.min(axis=0) - 0.01, mesh.vertices.max(axis=0) + 0.01)
        self._box = [self._mi.Point3f(*map(float, corner)) for corner in corners]
        dr.make_opaque(self._box)
        inner = mesh.labels != Surface.OUTSIDE
        self._depth = float(max(0.0, -mesh.corners()[inner][..., 2].min()))
        self._opening = mesh.opening

    def radiance(
        self,
        layout: Layout,
        table_index: NDArray[np.int64],
        samples: int,
        *,
        seed: int,
        keys: NDArray[np.uint32] | None = None,
        first: int = 0,
        mixture: Mixture | None = None,
    ) -> FloatArray:
        """Mean radiance over the sensor's rays, times pi over the beam's irradiance on its axis.

        Parameters
        ----------
        layout, table_index
            One entry a geometry.
        samples
            Sight lines of each geometry and randomisation; a power of two, so that the points are balanced.
        seed
            Of the randomisations. The same seed gives the same points: differences between parameters converge faster
            than either value.
        keys, shape (point,)
            Told apart, geometries draw independent points; by default their order tells them apart.
        first
            Index of the first sample, a multiple of ``samples``: means over [0, n) and [n, 2 n) average to that over
            [0, 2 n).
        mixture
            How sight lines are chosen.

        Returns
        -------
        array, shape (point, RANDOMISATIONS)
        """
        if samples < 1 or samples & (samples - 1) or first % samples or first + samples > 2**INDEX_BITS:
            raise ValueError(f"samples: found {samples} from {first}; expected a power of two, from a multiple of it")
        keys = np.arange(len(layout), dtype=np.uint32) if keys is None else keys
        footprint = lit_footprint(layout, self._visible_depth(layout))
        shares = (mixture or Mixture()).shares(footprint)
        packed = records(layout, table_index, footprint, shares, keys)
        diverging = bool(np.any(layout.divergence_rad > 0))
        sums = [
            self._launch(packed[start : start + _POINTS], samples, first, seed, layout.square, diverging)
            for start in range(0, len(packed), _POINTS)
        ]
        return np.concatenate(sums or [np.zeros((0, RANDOMISATIONS))]) * np.pi

    def _visible_depth(self, layout: Layout) -> FloatArray:
        """How deep sight lines through a hole can go, mm."""
        sine = np.linalg.norm(layout.view[:, :2], axis=1)
        reach = self._opening * np.abs(layout.view[:, 2]) / np.maximum(sine, 1e-6)
        return np.minimum(self._depth, reach)

    def _launch(
        self, packed: FloatArray, samples: int, first: int, seed: int, square: bool, diverging: bool
    ) -> FloatArray:
        """Means over the samples, shape (point, RANDOMISATIONS)."""
        mi, dr = self._mi, self._dr
        cells = len(packed) * RANDOMISATIONS
        streams = _streams(cells, samples)
        stride = dr.opaque(mi.UInt32, streams)
        lane = dr.arange(mi.UInt32, cells * streams)
        cell = lane // stride
        start, origin = lane - cell * stride, dr.opaque(mi.UInt32, first)
        geometry = cell // RANDOMISATIONS
        sensor = Lane(
            mi,
            dr,
            mi.Float(packed.ravel()),
            geometry,
            self._points,
            square=dr.opaque(mi.Bool, square),
            box=self._box,
            diverging=diverging,
        )
        randomisation = mix(cell - geometry * RANDOMISATIONS + mix(dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)))
        seeds = mix(sensor.key ^ randomisation)
        total = dr.zeros(mi.Float64, cells * streams)
        per_lane = samples // streams
        for follow, count in (
            (self._paths.reflected_once, per_lane),
            (self._paths.scattered, max(1, per_lane // SCATTERED_SHARE)),
        ):
            order = coherent_order((count * streams).bit_length() - 1)
            share = Share(start, stride, dr.opaque(mi.UInt32, count), origin, mi.UInt32(order.ravel()))
            total += follow(sensor, seeds, share) * dr.opaque(mi.Float64, 1 / (count * streams))
        return np.array(total).reshape(-1, RANDOMISATIONS, streams).sum(axis=2)


def mean_and_error(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean over the randomisations and its standard uncertainty, shape (point,) each.

    Parameters
    ----------
    values, shape (point, RANDOMISATIONS)

    Notes
    -----
    With so few randomisations their own scatter is uncertain: the mean follows Student's t, whose standard deviation
    is sqrt((n - 1)/(n - 3)) times the usual standard error (GUM Supplement 1, 6.4.9).
    """
    count = values.shape[1]
    spread = values.std(axis=1, ddof=1) / np.sqrt(count) * np.sqrt((count - 1) / (count - 3))
    return values.mean(axis=1), spread


def _streams(cells: int, samples: int) -> int:
    """Lanes a cell, a power of two: enough for packets of neighbours and to fill the machine."""
    streams = 1
    while (streams < _PACKET or cells * streams < _LANES) and streams * SCATTERED_SHARE < samples:
        streams *= 2
    return streams
