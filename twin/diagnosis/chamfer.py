"""A chamfer at the upper edges of holes, cut into a finished mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.artifact import Surface, SurfaceMesh


def chamfered(mesh: SurfaceMesh, width_mm: float) -> SurfaceMesh:
    """Cut a chamfer of 45 degrees into the upper edge of every hole.

    The rim moves outwards by the width, the wall begins that much lower, and a cone joins the two; the cone counts as
    wall of the hole. The plate top's triangles stay where they are but for their corners on the rim.

    Parameters
    ----------
    mesh
        A plate with holes whose centres are known.
    width_mm
        0 or more; less than half of what separates neighbouring holes, and less than the plate's thickness.

    Raises
    ------
    ValueError
        If the mesh has no such plate or the chamfer does not fit.
    """
    if width_mm == 0:
        return mesh
    plate = mesh.plate
    if plate is None or not len(plate.radius):
        raise ValueError("only a plate with holes can get a chamfer")
    edges = _rim_edges(mesh)
    rim = np.unique(edges)
    offset = mesh.vertices[rim, None, :2] - plate.centre[None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    hole = np.argmin(np.abs(distance - plate.radius), axis=1)
    direction = offset[np.arange(len(rim)), hole] / distance[np.arange(len(rim)), hole][:, None]
    wall = mesh.labels == Surface.HOLE_WALL
    deepest = float(mesh.vertices[mesh.faces[wall], 2].min())
    if width_mm < 0 or -width_mm <= deepest:
        raise ValueError(f"chamfer: found a width of {width_mm:g} mm; expected 0 to less than {-deepest:g} mm")
    vertices = mesh.vertices.copy()
    vertices[rim, :2] += width_mm * direction
    below = mesh.vertices[rim] - np.array([0.0, 0.0, width_mm])
    lower = np.arange(len(vertices))
    lower[rim] = len(vertices) + np.arange(len(rim))
    faces = mesh.faces.copy()
    faces[wall] = lower[faces[wall]]
    start, end = edges.T
    cone = np.concatenate(
        [np.stack([start, end, lower[end]], axis=1), np.stack([start, lower[end], lower[start]], axis=1)]
    )
    return replace(
        mesh,
        vertices=np.concatenate([vertices, below]),
        faces=np.concatenate([faces, cone]),
        labels=np.concatenate([mesh.labels, np.full(len(cone), Surface.HOLE_WALL, dtype=np.uint8)]),
        opening=mesh.opening + 2 * width_mm,
        plate=replace(plate, radius=plate.radius + width_mm),
    )


def _rim_edges(mesh: SurfaceMesh) -> np.ndarray:
    """Edges between plate top and walls, as the walls' triangles run along them, shape (edge, 2)."""

    def directed(label: Surface) -> np.ndarray:
        faces = mesh.faces[mesh.labels == label]
        return np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)

    count = len(mesh.vertices)
    top = directed(Surface.PLATE_TOP)
    wall = directed(Surface.HOLE_WALL)
    shared = np.isin(wall[:, 0] * count + wall[:, 1], top[:, 1] * count + top[:, 0])
    return np.asarray(wall[shared])
