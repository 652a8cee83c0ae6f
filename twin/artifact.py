"""The sample as a closed triangle mesh with labelled surfaces.

The mesh is made directly from the dimensions (plate with holes, spacer frame, block), in the artifact frame: plate
top at z = 0, holes open towards +z, array centred on the origin; lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, ArtifactForm, Holes
from instrument.errors import InputError
from twin import cells
from twin.cells import IntArray
from twin.plate import Plate, make_plate

#: Sides of the polygon that stands for a circular hole.
HOLE_SIDES = 64
_MERGE_DISTANCE = 1e-6


class Surface(IntEnum):
    """Which part of the sample a triangle belongs to."""

    PLATE_TOP = 0
    HOLE_WALL = 1
    UNDERSIDE = 2
    SPACER = 3
    FLOOR = 4
    OUTSIDE = 5


@dataclass(frozen=True)
class SurfaceMesh:
    """Closed triangle mesh, normals outwards.

    Attributes
    ----------
    vertices, shape (vertex, 3), mm
    faces, shape (face, 3)
        Indices of the corners, counter-clockwise seen from outside.
    labels, shape (face,)
        :class:`Surface` of every face.
    opening
        Width of the widest opening in mm; infinite where it is not known.
    plate
        The top as a pierced plate; None where it is not known to be one.
    """

    vertices: FloatArray
    faces: IntArray
    labels: NDArray[np.uint8]
    opening: float = np.inf
    plate: Plate | None = None

    def corners(self) -> FloatArray:
        """Corner points, shape (face, 3, 3)."""
        return self.vertices[self.faces]

    def normals(self) -> FloatArray:
        """Outward unit normals, shape (face, 3)."""
        a, b, c = np.moveaxis(self.corners(), 1, 0)
        normal = np.cross(b - a, c - a)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def areas(self) -> FloatArray:
        """Areas of the faces in mm2, shape (face,)."""
        a, b, c = np.moveaxis(self.corners(), 1, 0)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    def volume(self) -> float:
        """Enclosed volume in mm3; negative if the normals point inwards."""
        a, b, c = np.moveaxis(self.corners(), 1, 0)
        return float(np.sum(a * np.cross(b, c)) / 6)

    def open_edges(self) -> int:
        """Number of edges that do not join exactly two faces of opposite sense; 0 for a closed mesh."""
        start = self.faces.ravel()
        end = np.roll(self.faces, -1, axis=1).ravel()
        count = len(self.vertices)
        forward, times = np.unique(start * count + end, return_counts=True)
        backward = np.unique(end * count + start)
        return int(np.sum(times > 1) + len(np.setxor1d(forward, backward)) // 2)


def build_mesh(dimensions: ArtifactDimensions, sides: int = HOLE_SIDES) -> SurfaceMesh:
    """Make the mesh of a sample: from its dimensions, or from the file that they name.

    Raises
    ------
    InputError
        If the mesh file is open, intersects itself or is not in mm.
    """
    if dimensions.mesh is not None:
        from twin.mesh_files import read_mesh

        return read_mesh(dimensions.mesh)
    if not len(dimensions.holes):
        return flat_sample(dimensions.form)
    _check_form(dimensions)
    return _pierced_plate(dimensions.form, dimensions.holes, sides)


def flat_sample(form: ArtifactForm) -> SurfaceMesh:
    """A solid slab with its top at z = 0."""
    builder = _Builder()
    outline = cells.rectangle(form.outline[0] / 2, form.outline[1] / 2)
    builder.plane(outline, cells.fan(outline), 0.0, Surface.PLATE_TOP)
    builder.outer_box(form.outline, -form.block_thickness, 0.0)
    half = (form.outline[0] / 2, form.outline[1] / 2)
    return replace(builder.mesh(), plate=make_plate(half, np.zeros((0, 2)), np.zeros(0), 0.0, closed=True))


def square_pit(outline: float, opening: float, depth: float) -> SurfaceMesh:
    """A square pit in a thick square plate: the simplest cavity with a closed description."""
    builder = _Builder()
    outer, inner = cells.rectangle(outline / 2, outline / 2), cells.rectangle(opening / 2, opening / 2)
    builder.plane(np.concatenate([outer, inner]), cells.ring(outer, inner), 0.0, Surface.PLATE_TOP)
    builder.tube(inner, -depth, 0.0, Surface.HOLE_WALL)
    builder.plane(inner, cells.fan(inner), -depth, Surface.FLOOR)
    builder.outer_box((outline, outline), -depth - 5.0, 0.0)
    return builder.mesh(opening)


def to_polydata(mesh: SurfaceMesh) -> Any:
    """The mesh as PyVista's ``PolyData`` with cell data ``surface``, for pictures and export."""
    import pyvista

    sizes = np.full((len(mesh.faces), 1), 3)
    data = pyvista.PolyData(mesh.vertices, np.hstack([sizes, mesh.faces]).ravel())
    data.cell_data["surface"] = mesh.labels
    return data


def export_mesh(mesh: SurfaceMesh, path: Path) -> None:
    """Write a PLY, STL or OBJ file (mm, artifact frame)."""
    if path.suffix.lower() not in (".ply", ".stl", ".obj"):
        raise InputError(f"{path}: found the suffix {path.suffix!r}; expected .ply, .stl or .obj")
    to_polydata(mesh).save(str(path))


def _check_form(dimensions: ArtifactDimensions) -> None:
    form, source = dimensions.form, dimensions.source
    if form.cavity_depth <= form.plate_thickness:
        raise InputError(
            f"{source}: cavity_depth: found {form.cavity_depth} mm; expected more than the plate_thickness"
            f" ({form.plate_thickness} mm), it is measured from the top of the plate"
        )
    if 2 * form.spacer_edge >= min(form.outline):
        raise InputError(
            f"{source}: spacer_edge: found {form.spacer_edge} mm; expected less than half the outline {form.outline} mm"
        )


class _Builder:
    """Collects patches of triangles and joins them at their common corners."""

    def __init__(self) -> None:
        self._vertices: list[FloatArray] = []
        self._faces: list[IntArray] = []
        self._labels: list[NDArray[np.uint8]] = []
        self._count = 0

    def add(self, vertices: FloatArray, faces: IntArray, label: Surface) -> None:
        self._vertices.append(vertices)
        self._faces.append(faces + self._count)
        self._labels.append(np.full(len(faces), label, dtype=np.uint8))
        self._count += len(vertices)

    def plane(self, points: FloatArray, faces: IntArray, z: float, label: Surface, *, down: bool = False) -> None:
        """A horizontal patch facing up, or down."""
        vertices = np.column_stack([points, np.full(len(points), z)])
        self.add(vertices, faces[:, ::-1] if down else faces, label)

    def tube(self, polygon: FloatArray, bottom: float, top: float, label: Surface) -> None:
        """The wall of a vertical opening; normals into the opening."""
        count = len(polygon)
        vertices = np.concatenate(
            [np.column_stack([polygon, np.full(count, z)]) for z in (top, bottom)]
        )  # first the upper corners, then the lower
        here = np.arange(count)
        following = (here + 1) % count
        faces = np.concatenate(
            [np.stack([here, following, count + here], 1), np.stack([following, count + following, count + here], 1)]
        )
        self.add(vertices, faces, label)

    def box_walls(
        self, half: tuple[float, float], rows: tuple[float, float], extra: float, label: Surface, *, inwards: bool
    ) -> None:
        """Four vertical walls between the heights ``rows`` (upper, lower).

        Their upper corners are all corners collected so far on those lines; the lower ones are spaced by about
        ``extra`` mm (infinite: only the ends).
        """
        known = np.concatenate(self._vertices)
        for axis in (0, 1):
            for sign in (-1, 1):
                bound, end = sign * half[axis], half[1 - axis]
                on_line = (np.abs(known[:, axis] - bound) < 1e-9) & (np.abs(known[:, 2] - rows[0]) < 1e-9)
                along = known[on_line, 1 - axis]
                upper = _distinct(np.concatenate([along[np.abs(along) <= end + 1e-9], [-end, end]]))
                lower = np.linspace(-end, end, _divisions(end, extra) + 1)
                vertices = np.empty((len(upper) + len(lower), 3))
                vertices[:, axis] = bound
                vertices[:, 1 - axis] = np.concatenate([upper, lower])
                vertices[:, 2] = np.repeat(rows, (len(upper), len(lower)))
                faces = cells.strip(upper, lower)
                # A strip is clockwise seen with positions to the right: from -y for x, from +x for y.
                faces_negative = (axis == 1) == (sign > 0)
                flip = faces_negative == inwards
                self.add(vertices, faces[:, ::-1] if flip else faces, label)

    def outer_box(self, outline: tuple[float, float], bottom: float, top: float) -> None:
        """The outer sides and the bottom of a block."""
        half = (outline[0] / 2, outline[1] / 2)
        self.box_walls(half, (top, bottom), np.inf, Surface.OUTSIDE, inwards=False)
        corners = cells.rectangle(*half)
        self.plane(corners, cells.fan(corners), bottom, Surface.OUTSIDE, down=True)

    def mesh(self, opening: float = 0.0) -> SurfaceMesh:
        vertices, faces = np.concatenate(self._vertices), np.concatenate(self._faces)
        labels = np.concatenate(self._labels)
        groups = cells.cluster(vertices, _MERGE_DISTANCE)
        first = np.unique(groups, return_index=True)[1]
        faces = groups[faces]
        proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        mesh = SurfaceMesh(vertices[first], faces[proper], labels[proper])
        thick = mesh.areas() > 1e-10
        return SurfaceMesh(mesh.vertices, mesh.faces[thick], mesh.labels[thick], opening)


def _distinct(values: FloatArray) -> FloatArray:
    """Sorted values without those closer than the merging distance to their neighbour."""
    values = np.sort(values)
    keep = np.concatenate([[True], np.diff(values) > _MERGE_DISTANCE])
    return values[keep]


def _divisions(half: float, spacing: float) -> int:
    return 1 if not np.isfinite(spacing) else max(1, round(2 * half / spacing))


def _pierced_plate(form: ArtifactForm, holes: Holes, sides: int) -> SurfaceMesh:
    """Plate with holes over a block; the spacer frame closes the cavity, without one (edge 0) it is open."""
    half = (form.outline[0] / 2, form.outline[1] / 2)
    inner = (half[0] - form.spacer_edge, half[1] - form.spacer_edge)
    under, floor = -form.plate_thickness, -form.cavity_depth
    centres = np.stack([holes.x, holes.y], axis=1)
    outlines = cells.power_cells(centres, holes.diameter / 2, *half)
    builder = _Builder()
    for cell, (x, y), diameter in zip(outlines, centres, holes.diameter, strict=True):
        rim = cells.circle(x, y, diameter, sides)
        _add_hole(builder, cell, rim, inner, under)
    spacing = 2 * inner[0] / max(1, round(np.sqrt(len(holes))))
    if form.spacer_edge > 0:
        builder.box_walls(inner, (under, floor), spacing, Surface.SPACER, inwards=True)
        builder.outer_box(form.outline, floor - form.block_thickness, 0.0)
    else:
        builder.box_walls(half, (0.0, under), np.inf, Surface.OUTSIDE, inwards=False)
        builder.outer_box(form.outline, floor - form.block_thickness, floor)
    points, faces = _grid(inner, spacing)
    builder.plane(points, faces, floor, Surface.FLOOR)
    # The discs around the polygons; what little plate they hold is traced like the rest.
    radius = holes.diameter / 2 * cells.around_circle(sides)
    plate = make_plate(half, centres, radius, form.cavity_depth, closed=form.spacer_edge > 0)
    return replace(builder.mesh(float(holes.diameter.max())), plate=plate)


def _add_hole(builder: _Builder, cell: FloatArray, rim: FloatArray, inner: tuple[float, float], under: float) -> None:
    """One cell: plate top, wall of the hole, underside, and what of the spacer shows through the hole."""
    reach = np.abs(rim).max(axis=0)
    beyond = bool(np.any(reach > inner))
    if beyond:
        rim = cells.with_crossings(rim, *inner)
    builder.plane(np.concatenate([cell, rim]), cells.ring(cell, rim), 0.0, Surface.PLATE_TOP)
    builder.tube(rim, under, 0.0, Surface.HOLE_WALL)
    underside, opening = cell, rim
    if np.any(np.abs(cell) > inner):
        underside, opening = _inside(cell, inner), _inside(rim, inner)
    if len(underside) and len(opening):
        points = np.concatenate([underside, opening])
        builder.plane(points, cells.ring(underside, opening), under, Surface.UNDERSIDE, down=True)
    elif len(underside):
        builder.plane(underside, cells.fan(underside), under, Surface.UNDERSIDE, down=True)
    if beyond:
        for piece in _outside(rim, inner):
            builder.plane(piece, cells.fan(piece), under, Surface.SPACER)


def _inside(polygon: FloatArray, inner: tuple[float, float]) -> FloatArray:
    for axis in (0, 1):
        for sign in (1, -1):
            polygon = cells.clip(polygon, axis, sign * inner[axis], sign)
    return polygon


def _outside(rim: FloatArray, inner: tuple[float, float]) -> list[FloatArray]:
    """Convex pieces of a hole that lie over the spacer frame."""
    between = cells.clip(cells.clip(rim, 0, inner[0], 1), 0, -inner[0], -1)
    pieces = []
    for sign in (1, -1):
        side = cells.clip(rim, 0, sign * inner[0], -sign)
        pieces.append(_with_corners(side, sign * inner[0], inner[1]))
        pieces.append(cells.clip(between, 1, sign * inner[1], -sign))
    return [piece for piece in pieces if len(piece) >= 3]


def _with_corners(polygon: FloatArray, x: float, half_y: float) -> FloatArray:
    """Insert the corners (x, +-half_y) of the cavity where an edge of the polygon along x runs across them."""
    result: list[FloatArray] = []
    for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        result.append(here)
        if here[0] == there[0] == x:
            across = [y for y in (-half_y, half_y) if min(here[1], there[1]) < y < max(here[1], there[1])]
            result.extend(np.array([x, y]) for y in sorted(across, reverse=bool(here[1] > there[1])))
    return np.array(result).reshape(-1, 2)


def _grid(half: tuple[float, float], spacing: float) -> tuple[FloatArray, IntArray]:
    """A rectangle divided into squares of about the spacing, two triangles each."""
    nx, ny = (_divisions(h, spacing) for h in half)
    x, y = np.linspace(-half[0], half[0], nx + 1), np.linspace(-half[1], half[1], ny + 1)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    a = i * (ny + 1) + j
    b, c, d = a + ny + 1, a + ny + 2, a + 1
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
