"""The sample's solid as a file for other programs: PLY, STL and OBJ meshes, and parametric OpenSCAD source.

Lengths in mm, artifact frame, normals outwards.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from instrument.artifact import ArtifactDimensions
from instrument.errors import InputError
from instrument.output import write_result
from twin.artifact import HOLE_SIDES, SurfaceMesh, build_mesh
from twin.openscad import openscad_of_dimensions, openscad_of_mesh

#: Mesh formats by the suffix of the file's name, and the one for source.
MESH_SUFFIXES = (".ply", ".stl", ".obj")
SOURCE_SUFFIX = ".scad"

_PLY_HEADER = """ply
format binary_little_endian 1.0
comment {comment}
element vertex {vertices}
property double x
property double y
property double z
element face {faces}
property list uchar int vertex_indices
end_header
"""


def export_artifact(dimensions: ArtifactDimensions, path: Path, *, sides: int = HOLE_SIDES) -> SurfaceMesh:
    """Write the solid of a sample in the format that the file's suffix names.

    Parameters
    ----------
    sides
        Of the polygon that stands for a circle.

    Returns
    -------
    SurfaceMesh
        The mesh of the same solid.

    Raises
    ------
    InputError
        If the suffix names no format, the dimensions are of no solid, or the file cannot be written.
    """
    _check_suffix(path)
    mesh = build_mesh(dimensions, sides)
    if path.suffix.lower() == SOURCE_SUFFIX:
        from_mesh = dimensions.mesh is not None
        text = openscad_of_mesh(mesh) if from_mesh else openscad_of_dimensions(dimensions, sides)
        write_result(path, text.encode())
    else:
        write_mesh(mesh, path)
    return mesh


def write_mesh(mesh: SurfaceMesh, path: Path) -> None:
    """Write a mesh as binary PLY or STL, or as OBJ.

    Coordinates keep double precision but in STL, whose format has single precision.

    Raises
    ------
    InputError
        If the suffix names no mesh format, or the file cannot be written.
    """
    writers = {".ply": _ply, ".stl": _stl, ".obj": _obj}
    suffix = path.suffix.lower()
    if suffix not in writers:
        raise InputError(f"{path}: found the suffix {path.suffix!r}; expected one of {', '.join(MESH_SUFFIXES)}")
    write_result(path, writers[suffix](mesh))


def _check_suffix(path: Path) -> None:
    known = (*MESH_SUFFIXES, SOURCE_SUFFIX)
    if path.suffix.lower() not in known:
        raise InputError(f"{path}: found the suffix {path.suffix!r}; expected one of {', '.join(known)}")


def _ply(mesh: SurfaceMesh) -> bytes:
    header = _PLY_HEADER.format(
        comment="goniotwin sample, mm, top at z = 0", vertices=len(mesh.vertices), faces=len(mesh.faces)
    )
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    return header.encode("ascii") + mesh.vertices.astype("<f8").tobytes() + faces.tobytes()


def _stl(mesh: SurfaceMesh) -> bytes:
    records = np.zeros(len(mesh.faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["normal"], records["corners"] = mesh.normals(), mesh.corners()
    # Not "solid ...": that is how a file in text begins.
    header = b"goniotwin sample, mm, top at z = 0".ljust(80)
    return header + np.uint32(len(mesh.faces)).astype("<u4").tobytes() + records.tobytes()


def _obj(mesh: SurfaceMesh) -> bytes:
    lines = ["# goniotwin sample, mm, top at z = 0"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("ascii")
