"""Closed solids of planes, openings and walls, joined at their common corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin import cells
from twin.cells import IntArray
from twin.surface_mesh import Surface, SurfaceMesh

_MERGE_DISTANCE = 1e-6


@dataclass(frozen=True)
class Level:
    """A plane ``z = height + slope . (x, y)``, in mm."""

    height: float
    slope: tuple[float, float] = (0.0, 0.0)

    def at(self, points: FloatArray) -> FloatArray:
        """Height at points, shape (..., 2)."""
        return self.height + points[..., 0] * self.slope[0] + points[..., 1] * self.slope[1]

    def raised(self, points: FloatArray) -> FloatArray:
        """Points of the plane, shape (n, 3), over points of shape (n, 2)."""
        return np.column_stack([points, self.at(points)])


class SolidBuilder:
    """Collects patches of triangles and joins them at their common corners."""

    def __init__(self) -> None:
        self._vertices: list[FloatArray] = []
        self._faces: list[IntArray] = []
        self._labels: list[NDArray[np.uint8]] = []
        self._count = 0

    def add(self, vertices: FloatArray, faces: IntArray, label: Surface) -> None:
        """Add triangles, shape (face, 3), over vertices of their own, shape (vertex, 3)."""
        self._vertices.append(vertices)
        self._faces.append(faces + self._count)
        self._labels.append(np.full(len(faces), label, dtype=np.uint8))
        self._count += len(vertices)

    def plane(self, points: FloatArray, faces: IntArray, level: Level, label: Surface, *, down: bool = False) -> None:
        """A patch of a level facing up, or down."""
        self.add(level.raised(points), faces[:, ::-1] if down else faces, label)

    def tube(self, upper: FloatArray, lower: FloatArray, label: Surface) -> None:
        """The wall between two rings of as many corners, shape (n, 3) each, one below the other; normals inwards."""
        count = len(upper)
        here = np.arange(count)
        following = (here + 1) % count
        faces = np.concatenate(
            [np.stack([here, following, count + here], 1), np.stack([following, count + following, count + here], 1)]
        )
        self.add(np.concatenate([upper, lower]), faces, label)

    def walls(self, half: tuple[float, float], upper: Level, lower: Level, label: Surface, *, inwards: bool) -> None:
        """Four vertical walls of a rectangle between two levels.

        They join all corners collected so far on the rectangle's edges.
        """
        known = np.concatenate(self._vertices)
        for axis in (0, 1):
            for sign in (-1, 1):
                bound, end = sign * half[axis], half[1 - axis]
                rows = [_along(known, axis, bound, end, level) for level in (upper, lower)]
                vertices = []
                for row, level in zip(rows, (upper, lower), strict=True):
                    points = np.empty((len(row), 2))
                    points[:, axis], points[:, 1 - axis] = bound, row
                    vertices.append(level.raised(points))
                faces = cells.strip(*rows)
                # A strip is clockwise seen with positions to the right: from -y for x, from +x for y.
                flip = ((axis == 1) == (sign > 0)) == inwards
                self.add(np.concatenate(vertices), faces[:, ::-1] if flip else faces, label)

    def outside(self, outline: tuple[float, float], upper: Level, bottom: float) -> None:
        """The outer sides and the bottom of a block."""
        half = (outline[0] / 2, outline[1] / 2)
        corners = cells.rectangle(*half)
        self.plane(corners, cells.fan(corners), Level(bottom), Surface.OUTSIDE, down=True)
        self.walls(half, upper, Level(bottom), Surface.OUTSIDE, inwards=False)

    def mesh(self) -> SurfaceMesh:
        """What was collected, with common corners merged and empty triangles left out."""
        vertices, faces = np.concatenate(self._vertices), np.concatenate(self._faces)
        labels = np.concatenate(self._labels)
        groups = cells.cluster(vertices, _MERGE_DISTANCE)
        first = np.unique(groups, return_index=True)[1]
        faces = groups[faces]
        proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        mesh = SurfaceMesh(vertices[first], faces[proper], labels[proper])
        thick = mesh.areas() > 1e-10
        return SurfaceMesh(mesh.vertices, mesh.faces[thick], mesh.labels[thick])


def _along(known: FloatArray, axis: int, bound: float, end: float, level: Level) -> FloatArray:
    """Positions of the corners known on an edge of a rectangle at a level, and of the edge's ends; ascending."""
    on_edge = (np.abs(known[:, axis] - bound) < 1e-9) & (np.abs(known[:, 2] - level.at(known)) < 1e-9)
    along = known[on_edge, 1 - axis]
    values = np.sort(np.concatenate([along[np.abs(along) <= end + 1e-9], [-end, end]]))
    keep = np.concatenate([[True], np.diff(values) > _MERGE_DISTANCE])
    return np.asarray(values[keep])
