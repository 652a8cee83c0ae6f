"""OpenSCAD source of a sample, to change, to draw or to machine it."""

from __future__ import annotations

from instrument.artifact import ArtifactDimensions
from twin.artifact import HOLE_SIDES, SurfaceMesh

#: The solid in terms of the dimensions that are written before it.
_SOLID = """
// Radius of the polygon whose area is that of a circle of radius 1.
around = sqrt(2 * PI / (sides * sin(360 / sides)));
// Rise of the floor along x and y, mm a mm.
tilt = norm(block_tilt);
slope = tilt == 0 ? [0, 0] : tan(tilt) / tilt * [-block_tilt[1], block_tilt[0]];
inner = [outline[0] - 2 * spacer_edge, outline[1] - 2 * spacer_edge];
rise = (abs(slope[0]) * inner[0] + abs(slope[1]) * inner[1]) / 2;
bottom = -cavity_depth - block_thickness;
beyond = 1;  // tools reach past what they cut

module prism(radius_below, radius_above, below, above)
    translate([0, 0, below])
        rotate([0, 0, 180 / sides])
            cylinder(h = above - below, r1 = radius_below * around, r2 = radius_above * around, $fn = sides);

module box(size, below, above)
    translate([-size[0] / 2, -size[1] / 2, below])
        cube([size[0], size[1], above - below]);

module hole(diameter, chamfer) {
    prism(diameter / 2, diameter / 2, -plate_thickness - beyond, beyond);
    if (chamfer > 0)
        prism(diameter / 2, diameter / 2 + chamfer + beyond, -chamfer, beyond);
}

module plate()
    difference() {
        box(outline, -plate_thickness, 0);
        for (h = holes)
            translate([h[0], h[1], 0])
                hole(h[2], h[3]);
    }

// What lies above the floor, between the spacers or everywhere.
module above_floor()
    multmatrix([[1, 0, 0, 0], [0, 1, 0, 0], [slope[0], slope[1], 1, -cavity_depth], [0, 0, 0, 1]])
        box(spacer_edge > 0 ? inner : inner + [beyond, beyond], 0, cavity_depth + rise + beyond);

module block_and_spacers()
    difference() {
        box(outline, bottom, spacer_edge > 0 ? -plate_thickness : -cavity_depth + rise);
        above_floor();
    }

plate();
block_and_spacers();
"""


def openscad_of_dimensions(dimensions: ArtifactDimensions, sides: int = HOLE_SIDES) -> str:
    """Parametric source: a plate with holes, by difference, on a block with spacers; or a slab."""
    form, holes = dimensions.form, dimensions.holes
    outline = f"[{form.outline[0]!r}, {form.outline[1]!r}]"
    head = "// Sample of a goniospectrophotometer; lengths in mm, angles in degrees, top at z = 0.\n"
    if not len(holes):
        return (
            f"{head}outline = {outline};\nblock_thickness = {form.block_thickness!r};\n\n"
            "translate([-outline[0] / 2, -outline[1] / 2, -block_thickness])\n"
            "    cube([outline[0], outline[1], block_thickness]);\n"
        )
    rows = zip(holes.x.tolist(), holes.y.tolist(), holes.diameter.tolist(), dimensions.chamfers.tolist(), strict=True)
    table = ",\n".join(f"    [{x!r}, {y!r}, {d!r}, {c!r}]" for x, y, d, c in rows)
    return (
        f"{head}outline = {outline};\n"
        f"plate_thickness = {form.plate_thickness!r};\n"
        f"cavity_depth = {form.cavity_depth!r};  // from the top of the plate\n"
        f"spacer_edge = {form.spacer_edge!r};  // 0: the cavity is open at its sides\n"
        f"block_thickness = {form.block_thickness!r};\n"
        f"block_tilt = [{form.block_tilt_x!r}, {form.block_tilt_y!r}];  // of the block against the plate\n"
        f"sides = {sides};  // of the polygon that stands for a circle\n"
        f"holes = [  // x, y, diameter, width of the 45 degree chamfer\n{table}\n];\n"
    ) + _SOLID


def openscad_of_mesh(mesh: SurfaceMesh) -> str:
    """Source that holds a mesh as a polyhedron; its faces are clockwise seen from outside."""
    points = ",\n".join(f"    [{x!r}, {y!r}, {z!r}]" for x, y, z in mesh.vertices.tolist())
    faces = ",\n".join(f"    [{a}, {c}, {b}]" for a, b, c in mesh.faces.tolist())
    head = "// Sample of a goniospectrophotometer; mm, top at z = 0.\n"
    return f"{head}polyhedron(\n  points = [\n{points}\n  ],\n  faces = [\n{faces}\n  ]\n);\n"
