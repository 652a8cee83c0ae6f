"""The sample as a closed triangle mesh with labelled surfaces.

The mesh is made directly from the dimensions (plate with holes, spacer frame, block), in the artifact frame: plate
top at z = 0, holes open towards +z, array centred on the origin; lengths in mm.
"""

from __future__ import annotations

from instrument.artifact import ArtifactDimensions, check_dimensions
from instrument.errors import InputError
from twin.plate_mesh import flat_sample, pierced_plate, square_pit
from twin.surface_mesh import Surface, SurfaceMesh

__all__ = ["HOLE_SIDES", "Surface", "SurfaceMesh", "build_mesh", "flat_sample", "square_pit"]

#: Sides of the polygon that stands for a circular hole.
HOLE_SIDES = 64


def build_mesh(dimensions: ArtifactDimensions, sides: int = HOLE_SIDES) -> SurfaceMesh:
    """Make the mesh of a sample: from its dimensions, or from the file that they name.

    Raises
    ------
    InputError
        If the mesh file is open, intersects itself or is not in mm, or the dimensions are those of no solid.
    """
    if dimensions.mesh is not None:
        from twin.mesh_files import read_mesh

        return read_mesh(dimensions.mesh)
    if not len(dimensions.holes):
        return flat_sample(dimensions.form)
    check_dimensions(dimensions)
    mesh = pierced_plate(dimensions, sides)
    if gaps := mesh.open_edges():
        raise InputError(
            f"artifact: holes: found {gaps} open edges, where the rim of a hole passes through a corner of the cavity;"
            " expected rims that stay clear of the corners by some micrometres"
        )
    return mesh
