"""Closed triangle meshes from files (PLY, STL, OBJ; mm, artifact frame), checked before they are traced."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.artifact import Surface, SurfaceMesh
from twin.cells import IntArray, cluster

SUFFIXES = (".ply", ".stl", ".obj")
#: Samples outside these sizes are taken for a slip of unit, mm.
_SMALLEST, _LARGEST = 1.0, 1000.0
_TOP_TOLERANCE = 1.0
_PAIRS_AT_ONCE = 2_000_000


def read_mesh(path: Path) -> SurfaceMesh:
    """Read and check a mesh.

    Faces that look up at the level of the top are ``PLATE_TOP``, those that look down ``UNDERSIDE``, other horizontal
    ones ``FLOOR``, and the rest ``HOLE_WALL``.

    Raises
    ------
    InputError
        Naming the file and what is wrong: not a mesh, open edges, neighbouring faces of opposite sense, faces that
        cross, parts that lie within each other or have their normals inwards, a size that is not in mm, a top that is
        not at z = 0. A mesh with all its normals inwards is turned.
    """
    vertices, faces = _load(path)
    _check_size(path, vertices)
    size = float(np.ptp(vertices, axis=0).max())
    groups = cluster(vertices, 1e-7 * size)
    vertices, faces = vertices[np.unique(groups, return_index=True)[1]], groups[faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    mesh = SurfaceMesh(vertices, faces[proper], np.zeros(int(proper.sum()), dtype=np.uint8))
    _check_closed(path, mesh)
    if mesh.volume() < 0:
        mesh = SurfaceMesh(mesh.vertices, mesh.faces[:, ::-1], mesh.labels)
    mesh = SurfaceMesh(mesh.vertices, mesh.faces[mesh.areas() > 0], mesh.labels[mesh.areas() > 0])
    crossing = crossing_faces(mesh)
    if crossing is not None:
        where = mesh.corners()[crossing[0]].mean(axis=0)
        raise InputError(
            f"{path}: the mesh intersects itself: faces {crossing[0]} and {crossing[1]} cross near"
            f" ({where[0]:.3g}, {where[1]:.3g}, {where[2]:.3g}) mm; expected the surface of a solid"
        )
    _check_parts(path, mesh)
    return SurfaceMesh(mesh.vertices, mesh.faces, _labels(mesh))


def _load(path: Path) -> tuple[FloatArray, IntArray]:
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: mesh: found the suffix {path.suffix!r}; expected one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path}: no such file (the mesh of the sample)")
    import pyvista

    try:
        data = pyvista.read(str(path))
        if not isinstance(data, pyvista.PolyData):
            raise InputError(f"{path}: holds a {type(data).__name__}; expected a surface")
        data = data.triangulate()
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: not a readable mesh ({error})") from None
    if data.n_points == 0 or data.n_cells == 0 or len(data.faces) == 0:
        raise InputError(f"{path}: holds no faces; expected a closed triangle mesh")
    vertices = np.asarray(data.points, dtype=float)
    if not np.all(np.isfinite(vertices)):
        raise InputError(f"{path}: holds coordinates that are not finite")
    return vertices, np.asarray(data.faces).reshape(-1, 4)[:, 1:].astype(np.int64)


def _check_size(path: Path, vertices: FloatArray) -> None:
    size = np.ptp(vertices, axis=0)
    if not _SMALLEST <= float(size.max()) <= _LARGEST:
        raise InputError(
            f"{path}: the mesh measures {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}; expected a sample of"
            f" {_SMALLEST:g} to {_LARGEST:g} mm (are the lengths in mm?)"
        )
    top = float(vertices[:, 2].max())
    if abs(top) > _TOP_TOLERANCE:
        raise InputError(
            f"{path}: the top of the mesh is at z = {top:.4g} mm; expected the artifact frame: top at z = 0, openings"
            " towards +z"
        )


def _check_closed(path: Path, mesh: SurfaceMesh) -> None:
    count = mesh.open_edges()
    if not count:
        return
    sides = np.sort(np.concatenate([mesh.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    edges, times = np.unique(sides, axis=0, return_counts=True)
    odd = times != 2
    if np.any(odd):
        where = mesh.vertices[edges[int(np.argmax(odd))]].mean(axis=0)
        raise InputError(
            f"{path}: the mesh is not closed: {int(odd.sum())} edges do not join two faces, one near"
            f" ({where[0]:.3g}, {where[1]:.3g}, {where[2]:.3g}) mm; expected a watertight solid"
        )
    raise InputError(
        f"{path}: normals of neighbouring faces point to opposite sides of the surface ({count} edges); expected all"
        " outwards"
    )


def _check_parts(path: Path, mesh: SurfaceMesh) -> None:
    """Whether each part of the surface has the solid on its inner side and nothing on its outer one.

    Without crossings a part has everywhere on one side the same winding number.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(len(mesh.vertices),) * 2)
    part = connected_components(graph, directed=False)[1][mesh.faces[:, 0]]
    step = 1e-6 * float(np.ptp(mesh.vertices, axis=0).max())
    areas, normals, middle = mesh.areas(), mesh.normals(), mesh.corners().mean(axis=1)
    for number in np.unique(part):
        own = np.flatnonzero(part == number)
        face = own[int(np.argmax(areas[own]))]
        inner, outer = (_winding(mesh, middle[face] + sign * step * normals[face]) for sign in (-1, 1))
        if (inner, outer) != (1, 0):
            where = middle[face]
            what = "has its normals inwards" if inner < 1 else "lies within another part, or is double"
            raise InputError(
                f"{path}: a part of the mesh ({len(own)} faces, one near ({where[0]:.3g}, {where[1]:.3g},"
                f" {where[2]:.3g}) mm) {what}; expected the surface of a solid, normals outwards"
            )


def _winding(mesh: SurfaceMesh, point: FloatArray) -> int:
    """How often the surface encloses a point: solid angles of the faces (Van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(mesh.corners() - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.sum(a * np.cross(b, c), axis=1)
    rest = la * lb * lc + np.sum(a * b, axis=1) * lc + np.sum(b * c, axis=1) * la + np.sum(c * a, axis=1) * lb
    return round(float(np.sum(2 * np.arctan2(triple, rest))) / (4 * np.pi))


def _labels(mesh: SurfaceMesh) -> NDArray[np.uint8]:
    up = mesh.normals()[:, 2]
    level = mesh.corners()[:, :, 2].min(axis=1)
    labels = np.full(len(mesh.faces), Surface.HOLE_WALL, dtype=np.uint8)
    labels[up > 0.9] = Surface.FLOOR
    labels[up < -0.9] = Surface.UNDERSIDE
    labels[(up > 0.9) & (level > mesh.vertices[:, 2].max() - 1e-6)] = Surface.PLATE_TOP
    return labels


def crossing_faces(mesh: SurfaceMesh) -> tuple[int, int] | None:
    """Two faces that cross each other, or None.

    An edge crosses a face where its ends lie on either side of the face's plane and its line passes within the
    face; faces that share a corner with the edge are left out.
    """
    corners = mesh.corners()
    sides = np.sort(np.concatenate([mesh.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    edges, first = np.unique(sides, axis=0, return_index=True)
    owner = first % len(mesh.faces)
    for near_edge, near_face in _close_pairs(mesh.vertices[edges], corners):
        share = np.any(mesh.faces[near_face][:, :, None] == edges[near_edge][:, None, :], axis=(1, 2))
        edge, face = near_edge[~share], near_face[~share]
        hit = _crosses(mesh.vertices[edges[edge, 0]], mesh.vertices[edges[edge, 1]], corners[face])
        if np.any(hit):
            worst = int(np.argmax(hit))
            return int(owner[edge[worst]]), int(face[worst])
    return None


def _close_pairs(segments: FloatArray, triangles: FloatArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Pairs (segment, triangle) whose boxes overlap, in chunks: sweep along the widest axis."""
    low_s, high_s = segments.min(axis=1), segments.max(axis=1)
    low_t, high_t = triangles.min(axis=1), triangles.max(axis=1)
    axis = int(np.argmax(high_t.max(axis=0) - low_t.min(axis=0)))
    order = np.argsort(low_t[:, axis])
    starts = low_t[order, axis]
    reach = np.maximum.accumulate(high_t[order, axis])
    begin = np.searchsorted(reach, low_s[:, axis], side="left")
    end = np.searchsorted(starts, high_s[:, axis], side="right")
    count = np.maximum(end - begin, 0)
    bounds = np.concatenate([[0], np.cumsum(count)])
    at: int = 0
    while at < len(segments):
        stop = max(at + 1, int(np.searchsorted(bounds, bounds[at] + _PAIRS_AT_ONCE, side="right")) - 1)
        segment = np.repeat(np.arange(at, stop), count[at:stop])
        offset = np.arange(len(segment)) - np.repeat(bounds[at:stop] - bounds[at], count[at:stop])
        triangle = order[begin[segment] + offset]
        overlap = np.all((low_s[segment] <= high_t[triangle]) & (high_s[segment] >= low_t[triangle]), axis=1)
        yield segment[overlap], triangle[overlap]
        at = int(stop)


def _crosses(a: FloatArray, b: FloatArray, triangle: FloatArray) -> NDArray[np.bool_]:
    """Whether segments a-b pass through the inside of triangles, row by row."""
    p, q, r = np.moveaxis(triangle, 1, 0)
    normal = np.cross(q - p, r - p)
    scale = np.linalg.norm(normal, axis=1)
    above, below = (np.sum((x - p) * normal, axis=1) / np.maximum(scale, 1e-300) for x in (a, b))
    tolerance = 1e-7 * (1 + np.abs(p).max(axis=1))
    straddles = ((above > tolerance) & (below < -tolerance)) | ((above < -tolerance) & (below > tolerance))
    crossing = np.zeros(len(a), dtype=bool)
    rows = np.flatnonzero(straddles)
    a, b, p, q, r, normal, scale = (x[rows] for x in (a, b, p, q, r, normal, scale))
    point = a + (b - a) * (above[rows] / (above[rows] - below[rows]))[:, None]
    inside = np.ones(len(rows), dtype=bool)
    for start, end in ((p, q), (q, r), (r, p)):
        side = np.sum(np.cross(end - start, point - start) * normal, axis=1)
        inside &= side > 1e-9 * scale * np.linalg.norm(end - start, axis=1)
    crossing[rows] = inside
    return crossing
