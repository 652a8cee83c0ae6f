"""The ray tracer: radiance towards the sensor, for every geometry in one launch.

A reading has three parts, estimated apart because their noise and their cost differ (:class:`Part`). Where the
sample's top is a pierced plate, light from the top itself needs no ray; light reflected once is looked for by sight
lines through the openings; scattered light is followed from the openings and joined to the ends of sight lines
(:mod:`twin.light_pool`). Any other sample is traced by paths from the sensor over the whole target
(:mod:`twin.paths`). A lane of a launch works through its share of the sample points one after the other, so memory does
not grow with their number. What depends on geometry, instrument, material or sample is data to the compiled
kernel, never code: changing it costs no recompilation.

Accuracy: unbiased but for single-precision geometry (offsets of 0.1 micrometre) and hole polygons; sums in double
precision.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.beam_image import BeamImage
from twin.artifact import Surface, SurfaceMesh
from twin.light_places import Places, Pool
from twin.light_pool import LightPaths
from twin.llvm import import_mitsuba
from twin.material import Material
from twin.optics import Layout
from twin.paths import Paths, Share
from twin.plate import Slots
from twin.plate_sight import Openings, PlateLane
from twin.prepared import UNRESTRICTED, Geometries, Mixture, Prepared, prepare
from twin.reflection import TableLookup
from twin.sequence import INDEX_BITS, Points, coherent_order, mix
from twin.sight import Lane, Picture

__all__ = ["RANDOMISATIONS", "SHARE", "UNRESTRICTED", "Mixture", "Part", "Tracer", "mean_and_error"]


class Part(IntEnum):
    """What a reading is made of: estimates apart, because their noise and their cost differ."""

    PLATE_TOP = 0
    REFLECTED_ONCE = 1
    SCATTERED = 2


#: Of so many sight lines of a reading a part uses one.
SHARE = {Part.PLATE_TOP: 1, Part.REFLECTED_ONCE: 1, Part.SCATTERED: 2}
#: Independent randomisations of the sequence: their scatter is the standard error.
RANDOMISATIONS = 16
#: Sight lines that share light paths, and light paths of an illumination for each of them.
LIGHT_BLOCK, LIGHT_RATIO = 512, 2
#: Blocks of light in one launch at most (about), and those kept for geometries to come.
_POOL_BLOCKS, _KEPT_LIGHTS = 64, 96
#: Sight lines of a geometry and randomisation that are joined in one launch at most: bounds the memory.
_POOL_LINES = 16384
_LIGHT_SALT, _PART_SALT = 0x51ED270B, 0x3C6EF372
#: Lanes of a launch are at least this many where the samples suffice, to fill the machine.
_LANES = 4096
_PACKET = 16
#: Of so many points on the plate's top one tells how the table changes between them.
_TOP_TABLE = 8
#: Geometries of one launch at most: bounds the memory.
_POINTS = 8192


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
    quick
        Be ready sooner and trace slower: for few rays (:class:`~twin.mesh_scene.MeshScene`).
    """

    def __init__(
        self,
        mesh: SurfaceMesh,
        material: Material,
        *,
        surface_factor: dict[Surface, float] | None = None,
        quick: bool = False,
    ) -> None:
        self._mi = import_mitsuba()
        import drjit as dr

        self._dr = dr
        self._points = Points(self._mi, dr)
        lookup = TableLookup(self._mi, dr, material, surface_factor)
        self._paths = Paths(self._mi, dr, mesh, lookup, self._points, quick=quick)
        self._picture: tuple[BeamImage | None, Picture | None] = None, None
        self._light: LightPaths | None = None
        self._followed: dict[tuple[bytes, int, int, int], Places] = {}
        self._measure(mesh)
        if mesh.plate is not None and len(mesh.plate.radius):
            self._light = LightPaths(self._mi, dr, self._paths, self._points, mesh.plate, mesh.normals()[:, 2])

    def move(self, mesh: SurfaceMesh) -> None:
        """Go on with another mesh of the same kind of sample.

        Cheap for a mesh of the same :class:`~twin.mould.Mould`.
        """
        if (mesh.plate is None or not len(mesh.plate.radius)) != (self._light is None):
            raise ValueError("found another kind of sample; expected a plate with holes as before, or none as before")
        self._paths.move(mesh)
        self._measure(mesh)
        self._followed.clear()
        if self._light is not None and mesh.plate is not None:
            self._light.move(mesh.plate, mesh.normals()[:, 2])

    def _measure(self, mesh: SurfaceMesh) -> None:
        corners = (mesh.vertices.min(axis=0) - 0.01, mesh.vertices.max(axis=0) + 0.01)
        self._box = [self._mi.Point3f(*map(float, corner)) for corner in corners]
        self._dr.make_opaque(self._box)
        inner = mesh.faces[mesh.labels != Surface.OUTSIDE]
        self._depth = float(max(0.0, -mesh.vertices[:, 2][inner].min()))
        self._opening = mesh.opening
        self._plate = mesh.plate

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
            Choose sight lines over the whole target in these shares, openings or not.

        Returns
        -------
        array, shape (point, RANDOMISATIONS)
        """
        if samples < 1 or samples & (samples - 1) or first % samples or first + samples > 2**INDEX_BITS:
            raise ValueError(f"samples: found {samples} from {first}; expected a power of two, from a multiple of it")
        prepared = self.prepare(layout, table_index, keys=keys, mixture=mixture)
        return np.asarray(
            sum(self.part(part, prepared, max(1, samples // SHARE[part]), seed=seed, first=first) for part in Part)
        )

    def prepare(
        self,
        layout: Layout,
        table_index: NDArray[np.int64],
        *,
        keys: NDArray[np.uint32] | None = None,
        mixture: Mixture | None = None,
    ) -> Prepared:
        """Make geometries ready for :meth:`part`; parameters as of :meth:`radiance`."""
        keys = np.arange(len(layout), dtype=np.uint32) if keys is None else keys
        depth = self._visible_depth(layout)
        return prepare(layout, table_index, keys, plate=self._plate, visible_depth=depth, mixture=mixture)

    def part(
        self,
        part: Part,
        prepared: Prepared,
        samples: int,
        *,
        seed: int,
        first: int = 0,
        chosen: NDArray[np.int64] | None = None,
    ) -> FloatArray:
        """What one part contributes to :meth:`radiance`, for the chosen geometries; parameters as there.

        The parts draw independent points.
        """
        seed = (seed ^ _PART_SALT * int(part)) & 0xFFFFFFFF
        chosen = np.arange(len(prepared)) if chosen is None else chosen
        sums = np.zeros((len(chosen), RANDOMISATIONS))
        for start in range(0, len(chosen), _POINTS):
            here = np.arange(start, min(start + _POINTS, len(chosen)))
            through = prepared.through[chosen[here]]
            whole, pierced = here[~through], here[through]
            if len(whole) and part != Part.PLATE_TOP:
                some = prepared.by_target.take(prepared.place[chosen[whole]])
                sums[whole] = self._launch(part, some, samples, first, seed)
            if len(pierced) and prepared.by_plate is not None and (part == Part.PLATE_TOP or self._light is not None):
                some = prepared.by_plate.take(prepared.place[chosen[pierced]])
                join = part == Part.SCATTERED and self._plate is not None and self._plate.closed
                trace = self._joined if join else self._launch
                sums[pierced] = trace(part, some, samples, first, seed)
        return sums * np.pi

    def _joined(self, part: Part, some: Geometries, samples: int, first: int, seed: int) -> FloatArray:
        """Scattered light by joining sight lines to light; each block of sight lines has its own light."""
        if samples > _POOL_LINES:
            starts = range(first, first + samples, _POOL_LINES)
            pieces = [self._joined(part, some, _POOL_LINES, start, seed) for start in starts]
            return np.asarray(np.mean(pieces, axis=0))
        total = np.zeros((len(some), RANDOMISATIONS))
        if some.light is None:
            raise ValueError("geometries without illuminations cannot be joined to light")
        blocks = range(first // LIGHT_BLOCK, -(-(first + samples) // LIGHT_BLOCK))
        paths = LIGHT_RATIO * min(LIGHT_BLOCK, first + samples)
        order = np.argsort(some.light.group, kind="stable")
        together = max(1, _POOL_BLOCKS // len(blocks))
        ends = np.flatnonzero(np.diff(some.light.group[order] // together)) + 1
        for rows in np.split(order, ends):
            few = some.take(rows)
            total[rows] = self._launch(part, few, samples, first, seed, self._lights(few, blocks, paths, seed))
        return total

    def _visible_depth(self, layout: Layout) -> FloatArray:
        """How deep sight lines through a hole can go, mm."""
        sine = np.linalg.norm(layout.view[:, :2], axis=1)
        reach = self._opening * np.abs(layout.view[:, 2]) / np.maximum(sine, 1e-6)
        return np.minimum(self._depth, reach)

    def _launch(
        self, part: Part, some: Geometries, samples: int, first: int, seed: int, light: Pool | None = None
    ) -> FloatArray:
        """Means over the samples, shape (point, RANDOMISATIONS)."""
        mi, dr = self._mi, self._dr
        cells = len(some) * RANDOMISATIONS
        streams = _streams(cells, samples)
        stride = dr.opaque(mi.UInt32, streams)
        lane = dr.arange(mi.UInt32, cells * streams)
        cell = lane // stride
        start = lane - cell * stride
        geometry = cell // RANDOMISATIONS
        slots = some.scattered if part == Part.SCATTERED else some.once
        sensor = self._sensor(some.records, some.extra, slots, some, geometry)
        randomisation = cell - geometry * RANDOMISATIONS
        seeds = _seeds(mi, dr, sensor.key, randomisation, seed)

        def share_of(samples: int, first: int, span: int) -> Share:
            order = mi.UInt32(coherent_order(span.bit_length() - 1).ravel())
            count, origin, stretch = (dr.opaque(mi.UInt32, number) for number in (samples // streams, first, span))
            return Share(start, stride, count, origin, order, stretch)

        share = share_of(samples, first, samples if light is None else min(samples, LIGHT_BLOCK))
        if light is not None and self._light is not None and some.light is not None:
            group = dr.gather(mi.UInt32, mi.UInt32(np.append(some.light.group, 0).astype(np.uint32)), geometry)
            total: Any = self._light.joined(sensor, seeds, share, light, group, randomisation)
        elif part == Part.PLATE_TOP:
            fewer = max(streams, samples // _TOP_TABLE)
            few = share_of(fewer, first * fewer // samples, fewer)
            total = self._paths.plate_top(sensor, seeds, share, few)
        else:
            follow: Any = {Part.REFLECTED_ONCE: self._paths.reflected_once, Part.SCATTERED: self._paths.scattered}[part]
            total = follow(sensor, seeds, share)
        return np.array(total).reshape(-1, RANDOMISATIONS, streams).sum(axis=2) / samples

    def _sensor(
        self, packed: FloatArray, extra: FloatArray | None, slots: Slots | None, some: Geometries, geometry: Any
    ) -> Any:
        mi, dr = self._mi, self._dr
        options: dict[str, Any] = {"square": dr.opaque(mi.Bool, some.square), "box": self._box}
        options |= {"diverging": some.diverging, "picture": self._picture_of(some.picture)}
        data = mi.Float(packed.ravel())
        if extra is None or slots is None or self._plate is None:
            return Lane(mi, dr, data, geometry, self._points, **options)
        openings = Openings(mi, dr, self._plate, slots)
        return PlateLane(mi, dr, data, mi.Float(extra.ravel()), openings, geometry, self._points, **options)

    def _picture_of(self, image: BeamImage | None) -> Picture | None:
        """The picture of a beam on the device; the last one is kept."""
        if image is not None and self._picture[0] is not image:
            self._picture = image, Picture(self._mi, self._dr, image)
        return None if image is None else self._picture[1]

    def _lights(self, some: Geometries, blocks: range, paths: int, seed: int) -> Pool:
        """Light of the geometries' illuminations for blocks of sight lines; what was followed lately is kept."""
        assert some.light is not None
        assert self._light is not None
        keys = some.light.keys
        for block in blocks:
            missing = np.array(
                [k for k, key in enumerate(keys) if (key, block, paths, seed) not in self._followed], int
            )
            if len(missing):
                for k, places in zip(missing, self._follow(some, missing, block, paths, seed), strict=True):
                    self._followed[keys[k], block, paths, seed] = places
        names = [(key, block, paths, seed) for key in keys for block in blocks]
        found = [self._followed.pop(name) for name in names]
        self._followed |= dict(zip(names, found, strict=True))  # the latest last
        while len(self._followed) > _KEPT_LIGHTS:
            del self._followed[next(iter(self._followed))]
        return self._light.pool(found, blocks, LIGHT_BLOCK, RANDOMISATIONS)

    def _follow(self, some: Geometries, chosen: NDArray[np.int64], block: int, paths: int, seed: int) -> list[Places]:
        """Follow the light of some illuminations."""
        mi, dr = self._mi, self._dr
        assert some.light is not None
        assert self._light is not None
        light = some.light
        length = dr.opaque(mi.UInt32, paths)
        lane = dr.arange(mi.UInt32, len(chosen) * RANDOMISATIONS * paths)
        cell = lane // length
        group = cell // RANDOMISATIONS
        sensor = self._sensor(light.records[chosen], light.extra[chosen], light.slots.take(chosen), some, group)
        # The same numbers for every illumination: differences between like ones converge faster.
        key = dr.opaque(mi.UInt32, _LIGHT_SALT)
        seeds = _seeds(mi, dr, key, cell - group * RANDOMISATIONS, seed)
        index = lane - cell * length + dr.opaque(mi.UInt32, block * LIGHT_BLOCK * LIGHT_RATIO)
        places, faces = self._light.follow(sensor, index, seeds)
        size = RANDOMISATIONS * paths
        return [
            self._light.sort(places[k * size : (k + 1) * size], faces[k * size : (k + 1) * size], RANDOMISATIONS)
            for k in range(len(chosen))
        ]


def _seeds(mi: Any, dr: Any, key: Any, randomisation: Any, seed: int) -> Any:
    return mix(key ^ mix(randomisation + mix(dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))))


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
    while (streams < _PACKET or cells * streams < _LANES) and streams < samples:
        streams *= 2
    return streams
