"""Meshes made from dimensions: the plate with holes over a block, the flat sample, a square pit.

A hole is a polygon of as many sides at every height, whose area is that of the circle. Where a hole reaches past the
inside of the spacer, two of its corners lie on the spacer's edge, so that the same triangles serve holes a little
elsewhere (:mod:`twin.mould`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, ArtifactForm
from twin import cells
from twin.cells import IntArray
from twin.plate import Plate, make_plate
from twin.rims import RimLayout, Rims, make_rims
from twin.solid_builder import Level, SolidBuilder
from twin.surface_mesh import Surface, SurfaceMesh


def flat_sample(form: ArtifactForm) -> SurfaceMesh:
    """A solid slab with its top at z = 0."""
    builder = SolidBuilder()
    half = (form.outline[0] / 2, form.outline[1] / 2)
    outline = cells.rectangle(*half)
    builder.plane(outline, cells.fan(outline), Level(0.0), Surface.PLATE_TOP)
    builder.outside(form.outline, Level(0.0), -form.block_thickness)
    plate = make_plate(half, np.zeros((0, 2)), np.zeros(0), 0.0, closed=True)
    return replace(builder.mesh(), opening=0.0, plate=plate)


def square_pit(outline: float, opening: float, depth: float) -> SurfaceMesh:
    """A square pit in a thick square plate: the simplest cavity with a closed description."""
    builder = SolidBuilder()
    outer, inner = cells.rectangle(outline / 2, outline / 2), cells.rectangle(opening / 2, opening / 2)
    builder.plane(np.concatenate([outer, inner]), cells.ring(outer, inner), Level(0.0), Surface.PLATE_TOP)
    builder.tube(Level(0.0).raised(inner), Level(-depth).raised(inner), Surface.HOLE_WALL)
    builder.plane(inner, cells.fan(inner), Level(-depth), Surface.FLOOR)
    builder.outside((outline, outline), Level(0.0), -depth - 5.0)
    return replace(builder.mesh(), opening=opening)


def inside_spacer(form: ArtifactForm) -> tuple[float, float]:
    """Half sides of the cavity."""
    return form.outline[0] / 2 - form.spacer_edge, form.outline[1] / 2 - form.spacer_edge


def rims_of(dimensions: ArtifactDimensions, sides: int, layout: RimLayout | None = None) -> Rims | None:
    """Polygons of the holes; None if they cannot have a given layout."""
    holes = dimensions.holes
    centres = np.stack([holes.x, holes.y], axis=1)
    spacer = inside_spacer(dimensions.form) if dimensions.form.spacer_edge > 0 else None
    return make_rims(centres, holes.diameter / 2, dimensions.chamfers, sides, spacer, layout)


def pierced_plate(dimensions: ArtifactDimensions, sides: int) -> SurfaceMesh:
    """Plate with holes over a block; the spacer frame closes the cavity, without one (edge 0) it is open."""
    form = dimensions.form
    half, inner = (form.outline[0] / 2, form.outline[1] / 2), inside_spacer(form)
    under, floor = Level(-form.plate_thickness), floor_of(form)
    rims = rims_of(dimensions, sides)
    assert rims is not None
    uppers, openings = rims.polygons(rims.chamfer), rims.polygons()
    outlines = cells.power_cells(rims.centre, rims.radius + rims.chamfer, *half)
    builder = SolidBuilder()
    for cell, upper, rim, chamfer in zip(outlines, uppers, openings, rims.chamfer, strict=True):
        _add_hole(builder, cell, upper if chamfer > 0 else rim, rim, float(chamfer), inner, under)
    spacing = 2 * inner[0] / max(1, round(np.sqrt(len(rims.radius))))
    builder.plane(*_grid(inner, spacing), floor, Surface.FLOOR)
    if form.spacer_edge > 0:
        builder.walls(inner, under, floor, Surface.SPACER, inwards=True)
    else:
        builder.walls(half, Level(0.0), under, Surface.OUTSIDE, inwards=False)
    bottom = -form.cavity_depth - form.block_thickness
    builder.outside(form.outline, Level(0.0) if form.spacer_edge > 0 else floor, bottom)
    return with_plate(builder.mesh(), dimensions, rims)


def floor_of(form: ArtifactForm) -> Level:
    """The floor of the cavity."""
    return Level(-form.cavity_depth, form.floor_slope)


def with_plate(mesh: SurfaceMesh, dimensions: ArtifactDimensions, rims: Rims) -> SurfaceMesh:
    """The mesh with what is known of its top."""
    form = dimensions.form
    half = (form.outline[0] / 2, form.outline[1] / 2)
    # The discs around the polygons; what little plate they hold is traced like the rest.
    radius = rims.corner_radius(rims.radius + rims.chamfer)
    inner = inside_spacer(form)
    deepest = form.cavity_depth + sum(abs(s) * side for s, side in zip(form.floor_slope, inner, strict=True))
    plate: Plate | None = make_plate(half, rims.centre, radius, deepest, closed=form.spacer_edge > 0)
    return replace(mesh, opening=float(2 * np.max(rims.radius + rims.chamfer)), plate=plate)


def _add_hole(
    builder: SolidBuilder,
    cell: FloatArray,
    upper: FloatArray,
    rim: FloatArray,
    chamfer: float,
    inner: tuple[float, float],
    under: Level,
) -> None:
    """One cell: plate top, wall of the hole, underside, and what of the spacer shows through the hole."""
    builder.plane(np.concatenate([cell, upper]), cells.ring(cell, upper), Level(0.0), Surface.PLATE_TOP)
    corners = Level(0.0).raised(upper)
    if chamfer > 0:
        edge = Level(-chamfer).raised(rim)
        builder.tube(corners, edge, Surface.HOLE_WALL)
        corners = edge
    builder.tube(corners, under.raised(rim), Surface.HOLE_WALL)
    underside, opening = cell, rim
    beyond = bool(np.any(np.abs(rim) > inner))
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
    nx, ny = (max(1, round(2 * h / spacing)) for h in half)
    x, y = np.linspace(-half[0], half[0], nx + 1), np.linspace(-half[1], half[1], ny + 1)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    a = i * (ny + 1) + j
    b, c, d = a + ny + 1, a + ny + 2, a + 1
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
