"""The sample's mesh in the ray tracer's memory, and its change for another mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from twin.surface_mesh import SurfaceMesh


class MeshScene:
    """A mesh as the kernel sees it.

    Parameters
    ----------
    mesh
        Closed, normals outwards, mm.
    quick
        Sort the triangles in a third of the time, for rays that take a third longer: pays below about a million rays
        a mesh.

    Attributes
    ----------
    scene
        For ray tracing.
    faces
        Normal (three columns) and mark of every face: its label counted from 1, negative on top of the sample.
    """

    def __init__(self, mi: Any, mesh: SurfaceMesh, *, quick: bool = False) -> None:
        self._mi, self._quick, self._mesh = mi, quick, mesh
        self._load(mesh)

    def move(self, mesh: SurfaceMesh) -> None:
        """Take another mesh; where only its corners have moved, the scene stays."""
        if mesh.faces is not self._mesh.faces or mesh.labels is not self._mesh.labels:
            self._load(mesh)
            return
        self._parameters[self._corners] = self._mi.Float(mesh.vertices.ravel())
        self._parameters.update()
        self._mesh = mesh
        self.faces = _face_records(self._mi, mesh)

    def _load(self, mesh: SurfaceMesh) -> None:
        mi = self._mi
        shape = mi.Mesh("sample", vertex_count=len(mesh.vertices), face_count=len(mesh.faces))
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = mi.Float(mesh.vertices.ravel())
        parameters["faces"] = mi.UInt32(mesh.faces.ravel().astype(np.uint32))
        parameters.update()
        sample: dict[str, Any] = {"sample": shape}
        if self._quick:  # Embree sorts the triangles of a group by a faster method
            group = {"type": "shapegroup", "sample": shape}
            sample = {"group": group, "sample": {"type": "instance", "group": {"type": "ref", "id": "group"}}}
        self.scene = mi.load_dict({"type": "scene", **sample})
        self._parameters = mi.traverse(self.scene)
        self._corners = next(key for key in self._parameters.keys() if key.endswith("vertex_positions"))  # noqa: SIM118
        self._mesh = mesh
        self.faces = _face_records(mi, mesh)


def _face_records(mi: Any, mesh: SurfaceMesh) -> Any:
    """Columns apart, because a gather of four at once compiles differently with the alignment of the memory."""
    normals = mesh.normals()
    mark = mesh.labels.astype(float) + 1
    up = np.flatnonzero(normals[:, 2] > 1 - 1e-9)
    lowest = mesh.vertices[:, 2][mesh.faces[up]].min(axis=1)
    mark[up[lowest > mesh.vertices[:, 2].max() - 1e-9]] *= -1
    return [mi.Float(np.ascontiguousarray(column)) for column in (*normals.T, mark)]
