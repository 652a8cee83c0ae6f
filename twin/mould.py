"""Plates with the same layout of holes, poured into one topology.

Which triangles make a plate with holes depends on where the holes are, but hardly: for holes that lie, and are as
wide, about as in the plate that the mould was made of, the same triangles serve with their corners moved. That costs
a few milliseconds instead of hundreds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, check_dimensions
from twin.artifact import HOLE_SIDES, build_mesh
from twin.cells import IntArray
from twin.plate_mesh import floor_of, rims_of, with_plate
from twin.rims import RimLayout, Rims
from twin.solid_builder import Level
from twin.surface_mesh import Surface, SurfaceMesh

#: Corners are recognised within this distance, mm; triangles smaller than the area (mm2) are no use.
_SAME_MM, _SMALLEST = 1e-7, 1e-9


@dataclass(frozen=True)
class _Recipe:
    """Where the corners of the mesh come from.

    Attributes
    ----------
    rim, shape (n,), place, shape (n,)
        Vertices on rims, and which corner of which level's polygons each is.
    under, floor, bottom
        Vertices of the underside, of the floor, and of the bottom that are on no rim.
    up, shape (n,)
        Of the horizontal faces, +1 for those that look up and -1 for those that look down; 0 for others.
    """

    rim: IntArray
    place: IntArray
    under: IntArray
    floor: IntArray
    bottom: IntArray
    up: FloatArray


class Mould:
    """Makes meshes of plates like one plate.

    Parameters
    ----------
    dimensions
        The plate whose topology the others share. A mould is made anew by itself where another one is asked for that
        differs too much.
    sides
        Of the polygons of the holes.

    Notes
    -----
    A sample without holes, or a mesh from a file, is built as ever.
    """

    def __init__(self, dimensions: ArtifactDimensions, sides: int = HOLE_SIDES) -> None:
        self._sides = sides
        self._recipe: _Recipe | None = None
        self.made = 0
        self._make(dimensions)

    def mesh(self, dimensions: ArtifactDimensions) -> SurfaceMesh:
        """The mesh of a plate; the same as of :func:`~twin.artifact.build_mesh` but for the choice of triangles.

        Raises
        ------
        InputError
            If the dimensions are those of no solid.
        """
        check_dimensions(dimensions)
        poured = self._pour(dimensions)
        return self._make(dimensions) if poured is None else poured

    def _make(self, dimensions: ArtifactDimensions) -> SurfaceMesh:
        """Build a mesh, and take its topology."""
        self._dimensions, self._mesh = dimensions, build_mesh(dimensions, self._sides)
        self._recipe = None
        self.made += 1
        if dimensions.mesh is None and len(dimensions.holes):
            rims = rims_of(dimensions, self._sides)
            assert rims is not None
            self._layout: RimLayout = rims.layout
            self._recipe = _recipe(self._mesh, dimensions, rims)
        return self._mesh

    def _pour(self, dimensions: ArtifactDimensions) -> SurfaceMesh | None:
        """The mesh in the topology at hand; None if that does not serve."""
        recipe = self._recipe
        if recipe is None or not _alike(dimensions, self._dimensions):
            return None
        rims = rims_of(dimensions, self._sides, self._layout)
        if rims is None:
            return None
        form = dimensions.form
        vertices = self._mesh.vertices.copy()
        for index, level in _flat_levels(recipe, dimensions):
            vertices[index, 2] = level.at(vertices[index])
        vertices[recipe.rim] = _corners(rims, form.plate_thickness)[recipe.place]
        mesh = SurfaceMesh(vertices, self._mesh.faces, self._mesh.labels)
        upright = mesh.double_areas[:, 2] * recipe.up
        if np.any(upright[recipe.up != 0] <= _SMALLEST):
            return None
        return with_plate(mesh, dimensions, rims)


def _alike(dimensions: ArtifactDimensions, other: ArtifactDimensions) -> bool:
    """Whether the parts of two plates that a mould does not move are the same."""
    form, given = dimensions.form, other.form
    return (
        dimensions.mesh is None
        and len(dimensions.holes) == len(other.holes)
        and form.outline == given.outline
        and form.spacer_edge == given.spacer_edge
        and bool(np.array_equal(dimensions.chamfers > 0, other.chamfers > 0))
    )


def _flat_levels(recipe: _Recipe, dimensions: ArtifactDimensions) -> list[tuple[IntArray, Level]]:
    form = dimensions.form
    return [
        (recipe.under, Level(-form.plate_thickness)),
        (recipe.floor, floor_of(form)),
        (recipe.bottom, Level(-form.cavity_depth - form.block_thickness)),
    ]


def _corners(rims: Rims, thickness: float) -> FloatArray:
    """Corners of all polygons at the top, at the lower edge of the chamfers and at the underside, one after the other.

    Shape (3 * hole * side, 3).
    """
    rim, upper = rims.polygons(), rims.polygons(rims.chamfer)
    plain = rims.chamfer == 0
    upper[plain] = rim[plain]
    heights = (np.zeros(len(plain)), -rims.chamfer, np.full(len(plain), -thickness))
    levels = [
        np.concatenate([points, np.broadcast_to(height[:, None, None], (*points.shape[:2], 1))], axis=2)
        for points, height in zip((upper, rim, rim), heights, strict=True)
    ]
    return np.concatenate(levels).reshape(-1, 3)


def _recipe(mesh: SurfaceMesh, dimensions: ArtifactDimensions, rims: Rims) -> _Recipe:
    """Recognise the corners of a built mesh."""
    from scipy.spatial import cKDTree

    form = dimensions.form
    found = cKDTree(_corners(rims, form.plate_thickness)).query(mesh.vertices)
    distance, place = (np.asarray(column) for column in found)
    on_rim = distance < _SAME_MM
    floor, z = floor_of(form), mesh.vertices[:, 2]

    def others(level: Level) -> IntArray:
        return np.flatnonzero(~on_rim & (np.abs(z - level.at(mesh.vertices)) < _SAME_MM))

    under, below = others(Level(-form.plate_thickness)), others(floor)
    bottom, top = others(Level(-form.cavity_depth - form.block_thickness)), others(Level(0.0))
    if sum(map(len, (under, below, bottom, top))) + int(np.sum(on_rim)) != len(z):
        raise AssertionError("corners of the mesh belong to no level")
    level_faces = np.isin(mesh.labels, [Surface.PLATE_TOP, Surface.UNDERSIDE, Surface.SPACER])
    up = np.where(level_faces & (np.abs(mesh.normals()[:, 2]) > 0.5), np.sign(mesh.normals()[:, 2]), 0.0)
    return _Recipe(np.flatnonzero(on_rim), place[on_rim], under, below, bottom, up)
