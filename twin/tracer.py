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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.artifact import Surface, SurfaceMesh
from twin.kernel_math import larger, smaller
from twin.llvm import import_mitsuba
from twin.material import Material
from twin.optics import Footprint, Layout, lit_footprint
from twin.sequence import INDEX_BITS, Points, mix
from twin.sight import Lane, records

#: Independent randomisations of the sequence: their scatter is the standard error.
RANDOMISATIONS = 16
#: Lanes of a launch are at least this many where the samples suffice, to fill the machine.
_LANES = 4096
_OFFSET_MM = 1e-4
#: Geometries of one launch at most: bounds the memory.
_POINTS = 8192
_BOUNCE_DIMENSION, _PER_BOUNCE = 4, 3
#: Paths are thinned from this number of reflections on.
_ROULETTE_DEPTH = 3


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

        from twin.reflection import TableLookup

        self._dr = dr
        self._scene = _scene(self._mi, mesh)
        self._faces = _face_records(self._mi, mesh)
        self._points = Points(self._mi, dr)
        self._lookup = TableLookup(self._mi, dr, material, surface_factor)
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
            Sight lines of each geometry and randomisation; a power of two keeps the sequence balanced.
        seed
            Of the randomisations. The same seed gives the same points: differences between parameters converge faster
            than either value.
        keys, shape (point,)
            Told apart, geometries draw independent points; by default their order tells them apart.
        first
            Index of the first sample: means over [0, n) and [n, 2 n) average to that over [0, 2 n).
        mixture
            How sight lines are chosen.

        Returns
        -------
        array, shape (point, RANDOMISATIONS)
        """
        if samples < 1 or first + samples > 2**INDEX_BITS:
            raise ValueError(f"samples: found {first} + {samples}; expected 1 to {2**INDEX_BITS}")
        keys = np.arange(len(layout), dtype=np.uint32) if keys is None else keys
        footprint = lit_footprint(layout, self._visible_depth(layout))
        shares = (mixture or Mixture()).shares(footprint)
        packed = records(layout, table_index, footprint, shares, keys)
        diverging = bool(np.any(layout.divergence_rad > 0))
        sums = [
            self._launch(packed[start : start + _POINTS], samples, first, seed, layout.square, diverging)
            for start in range(0, len(packed), _POINTS)
        ]
        return np.concatenate(sums or [np.zeros((0, RANDOMISATIONS))]) * (np.pi / samples)

    def _visible_depth(self, layout: Layout) -> FloatArray:
        """How deep sight lines through a hole can go, mm."""
        sine = np.linalg.norm(layout.view[:, :2], axis=1)
        reach = self._opening * np.abs(layout.view[:, 2]) / np.maximum(sine, 1e-6)
        return np.minimum(self._depth, reach)

    def _launch(
        self, packed: FloatArray, samples: int, first: int, seed: int, square: bool, diverging: bool
    ) -> FloatArray:
        """Sums over the samples, shape (point, RANDOMISATIONS)."""
        mi, dr = self._mi, self._dr
        cells = len(packed) * RANDOMISATIONS
        streams = _streams(cells, samples)
        stride = dr.opaque(mi.UInt32, streams)
        lane = dr.arange(mi.UInt32, cells * streams)
        cell = lane // stride
        start = lane - cell * stride + dr.opaque(mi.UInt32, first)
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
        sums = dr.zeros(mi.Float64, cells)
        per_lane = dr.opaque(mi.UInt32, samples // streams)
        dr.scatter_add(sums, self._trace(sensor, seeds, start, stride, per_lane), cell)
        return np.array(sums).reshape(-1, RANDOMISATIONS)

    def _trace(self, sensor: Lane, seeds: Any, start: Any, stride: Any, per_lane: Any) -> Any:
        """Sum of the contributions of each lane's paths, one path after the other in one loop of reflections."""
        mi, dr = self._mi, self._dr
        lanes = dr.width(start)
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
            return alive | (begun < per_lane)

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
            fresh = ~alive & (begun < per_lane)
            index = dr.select(fresh, start + begun * stride, index)
            new_origin, new_heading, new_weight = sensor.sight_line(index, seeds, fresh)
            origin, heading = dr.select(fresh, new_origin, origin), dr.select(fresh, new_heading, heading)
            weight, flow = dr.select(fresh, new_weight, weight), dr.select(fresh, 1.0, flow)
            depth, begun = dr.select(fresh, 0, depth), dr.select(fresh, begun + 1, begun)
            alive = (alive | fresh) & (weight > 0)

            hit = self._scene.ray_intersect_preliminary(mi.Ray3f(origin, heading), active=alive)
            alive &= hit.is_valid()
            face = dr.gather(mi.Vector4f, self._faces, hit.prim_index, alive)
            normal, exposed = mi.Normal3f(face.x, face.y, face.z), face.w < 0
            alive &= dr.dot(normal, heading) < 0
            place = mi.Point3f(origin + heading * hit.t + normal * _OFFSET_MM)
            table = self._lookup.at(sensor.table, mi.UInt32(dr.abs(face.w)) - 1, alive)

            light, irradiance = sensor.illuminate(place, index, depth, seeds)
            irradiance *= dr.dot(normal, light)
            seen = alive & (irradiance > 0)
            seen &= exposed | ~self._scene.ray_test(mi.Ray3f(place, light), active=seen & ~exposed)
            reflected = self._lookup.between(table, normal, -heading, light, seen)
            total += dr.select(seen, mi.Float64(weight * flow * reflected * irradiance), 0.0)

            alive &= ~exposed  # nothing lies above the top of the sample: only the beam comes from there
            dimension = _BOUNCE_DIMENSION + depth * _PER_BOUNCE
            u, v, w = (self._points.coordinate(index, dimension + k, seeds, alive) for k in range(3))
            incoming, factor, _ = self._lookup.sample(table, normal, -heading, u, v, alive)
            flow *= factor
            depth += 1
            survival = dr.select(depth > _ROULETTE_DEPTH, smaller(dr, flow, 0.95), 1.0)
            alive &= w < survival
            flow /= larger(dr, survival, 1e-20)
            return begun, alive, index, depth, place, incoming, weight, flow, total

        return dr.while_loop(state, going, step, label="paths")[-1]


def _streams(cells: int, samples: int) -> int:
    """Lanes a cell: enough to fill the machine, and a divisor of the number of samples."""
    streams = 1
    while cells * streams < _LANES and samples % (2 * streams) == 0:
        streams *= 2
    return streams


def _scene(mi: Any, mesh: SurfaceMesh) -> Any:
    """The mesh as a scene, straight from the arrays."""
    shape = mi.Mesh("sample", vertex_count=len(mesh.vertices), face_count=len(mesh.faces))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(mesh.vertices.ravel())
    parameters["faces"] = mi.UInt32(mesh.faces.ravel().astype(np.uint32))
    parameters.update()
    return mi.load_dict({"type": "scene", "sample": shape})


def _face_records(mi: Any, mesh: SurfaceMesh) -> Any:
    """Normal and label of every face, flat (face, 4); the label counts from 1 and is negative on top of the sample."""
    normals = mesh.normals()
    height = mesh.corners()[:, :, 2].min(axis=1)
    top = (normals[:, 2] > 1 - 1e-9) & (height > mesh.vertices[:, 2].max() - 1e-9)
    label = np.where(top, -1.0, 1.0) * (mesh.labels.astype(float) + 1)
    return mi.Float(np.column_stack([normals, label]).ravel())
