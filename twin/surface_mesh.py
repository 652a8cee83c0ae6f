"""A closed triangle mesh with labelled surfaces.

Artifact frame: top at z = 0, openings towards +z, array centred on the origin; lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.cells import IntArray
from twin.plate import Plate


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

    @cached_property
    def double_areas(self) -> FloatArray:
        """Outward normals times twice the area, mm2, shape (face, 3)."""
        corner = [np.ascontiguousarray(column) for column in self.faces.T]
        sides = []
        for coordinate in self.vertices.T:
            a, b, c = (np.take(coordinate, column) for column in corner)
            sides.append((b - a, c - a))
        (ux, vx), (uy, vy), (uz, vz) = sides
        across = np.empty((3, len(self.faces)))  # columns in a row, as their users want them
        across[0], across[1], across[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        return across.T

    def normals(self) -> FloatArray:
        """Outward unit normals, shape (face, 3)."""
        return np.asarray((self.double_areas.T / (2 * self.areas())).T)

    def areas(self) -> FloatArray:
        """Areas of the faces in mm2, shape (face,)."""
        x, y, z = self.double_areas.T
        return np.asarray(np.sqrt(x * x + y * y + z * z) / 2)

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
