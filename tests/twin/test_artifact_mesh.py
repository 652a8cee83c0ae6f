from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from traced_samples import artifact, flat, shared_file

from instrument.artifact import read_artifact
from instrument.errors import InputError
from twin import cells
from twin.artifact import Surface, SurfaceMesh, build_mesh, square_pit
from twin.mesh_export import write_mesh
from twin.mesh_files import read_mesh
from twin.plate_mesh import rims_of


def solid_volume(holes: list[tuple[float, float, float]], plate: float, depth: float, spacer: float) -> float:
    block = 5.0
    return (
        50 * 50 * (depth + block)
        - (50 - 2 * spacer) ** 2 * (depth - plate)
        - plate * sum(np.pi * d**2 / 4 for _, _, d in holes)
    )


def assert_closed(mesh: SurfaceMesh) -> None:
    assert mesh.open_edges() == 0
    assert mesh.volume() > 0
    assert np.all(mesh.areas() > 0)


def test_the_papers_artifact_is_closed_and_has_the_volume_of_its_dimensions() -> None:
    mesh = build_mesh(artifact())
    assert_closed(mesh)
    holes = [(0.0, 0.0, 2.55)] * 144
    assert mesh.volume() == pytest.approx(solid_volume(holes, 1.13, 3.26, 4.0), rel=1e-12)


def test_areas_of_the_surfaces_are_those_of_the_dimensions() -> None:
    mesh = build_mesh(artifact())
    area = {surface: mesh.areas()[mesh.labels == surface].sum() for surface in Surface}
    opening = 144 * np.pi * 2.55**2 / 4
    assert area[Surface.PLATE_TOP] == pytest.approx(2500 - opening)
    assert area[Surface.FLOOR] == pytest.approx(42**2)
    assert area[Surface.HOLE_WALL] == pytest.approx(144 * np.pi * 2.55 * 1.13, rel=1e-3)
    # The outermost holes reach 0.075 mm over the spacer, whose top shows through them.
    assert 0 < area[Surface.SPACER] - 4 * 42 * 2.13 < 48 * 0.075 * 2.55
    assert area[Surface.UNDERSIDE] - area[Surface.SPACER] == pytest.approx(42**2 - opening - 4 * 42 * 2.13, abs=1e-6)


def test_normals_point_out_of_the_solid_on_every_surface() -> None:
    mesh = build_mesh(artifact([(1.0, -2.0, 3.0)]))
    normals, centres = mesh.normals(), mesh.corners().mean(axis=1)
    expected = {Surface.PLATE_TOP: 1.0, Surface.UNDERSIDE: -1.0, Surface.FLOOR: 1.0}
    for surface, z in expected.items():
        np.testing.assert_allclose(normals[mesh.labels == surface, 2], z, atol=1e-12)
    wall = mesh.labels == Surface.HOLE_WALL
    to_axis = np.array([1.0, -2.0]) - centres[wall, :2]
    assert np.all(np.sum(normals[wall, :2] * to_axis, axis=1) > 0)
    spacer = mesh.labels == Surface.SPACER
    assert np.all(np.sum(normals[spacer, :2] * centres[spacer, :2], axis=1) < 0)


def test_the_polygon_of_a_hole_keeps_the_area_of_the_circle() -> None:
    corners = cells.circle(0.3, -0.2, 2.55, 12)
    x, y = corners.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    assert area == pytest.approx(np.pi * 2.55**2 / 4, rel=1e-12)


def test_the_volume_agrees_with_a_boolean_solid() -> None:
    """Independent construction: constructive solid geometry with manifold3d."""
    holes = [(0.0, 0.0, 3.0), (4.0, 1.0, 2.0), (20.3, 3.0, 1.9), (-20.6, 20.4, 1.6)]
    mesh = build_mesh(artifact(holes))
    solid = manifold3d.Manifold.cube([50.0, 50.0, 8.26]).translate([-25.0, -25.0, -8.26])
    solid -= manifold3d.Manifold.cube([42.0, 42.0, 2.13]).translate([-21.0, -21.0, -3.26])
    for x, y, d in holes:
        polygon = cells.circle(x, y, d, 64)
        tool = manifold3d.Manifold.extrude(manifold3d.CrossSection([polygon]), 1.13 + 1.0)
        solid -= tool.translate([0.0, 0.0, -1.13])
    assert mesh.volume() == pytest.approx(solid.volume(), rel=1e-6)


@pytest.mark.parametrize(
    "hole",
    [(19.8, 19.8, 2.56), (19.9, 3.0, 2.36), (20.9, 20.9, 2.0), (21.0, 21.0, 2.0), (23.0, 0.0, 2.0), (-20.6, 20.6, 1.5)],
)
def test_a_hole_over_the_spacer_ends_there(hole: tuple[float, float, float]) -> None:
    mesh = build_mesh(artifact([hole]))
    assert_closed(mesh)
    assert mesh.volume() == pytest.approx(solid_volume([hole], 1.13, 3.26, 4.0), abs=1e-8)


def test_the_measured_artifact_reaches_past_the_spacer_and_is_closed() -> None:
    dimensions = read_artifact(shared_file("cases", "common", "artifact.toml"))
    assert np.max(np.abs(dimensions.holes.x) + dimensions.holes.diameter / 2) > 21.0
    mesh = build_mesh(dimensions)
    assert_closed(mesh)
    volume = solid_volume([(0, 0, d) for d in dimensions.holes.diameter], 1.13, 3.26, 4.0)
    assert mesh.volume() == pytest.approx(volume, rel=1e-12)


def test_without_a_spacer_the_cavity_is_open_at_the_sides() -> None:
    mesh = build_mesh(artifact([(0.0, 0.0, 3.0)], spacer=0.0))
    assert_closed(mesh)
    assert not np.any(mesh.labels == Surface.SPACER)
    assert mesh.volume() == pytest.approx(2500 * (1.13 + 5.0) - np.pi * 9 / 4 * 1.13)


def test_an_open_cavity_is_closed_where_cells_of_holes_meet_the_edge() -> None:
    holes = [(0.0, 0.0, 3.0), (5.0, 0.0, 2.0), (-7.0, 9.0, 4.0)]
    mesh = build_mesh(artifact(holes, spacer=0.0))
    assert_closed(mesh)
    removed = 1.13 * sum(np.pi * d**2 / 4 for _, _, d in holes)
    assert mesh.volume() == pytest.approx(2500 * (1.13 + 5.0) - removed)


def test_the_polygon_over_the_spacer_has_corners_on_its_edge_and_the_area_of_the_circle() -> None:
    rims = rims_of(artifact([(0.0, 1.0, 3.0), (20.3, 3.0, 1.9), (-20.6, 20.4, 1.6)]), 40)
    assert rims is not None
    polygons = rims.polygons()
    x, y = np.moveaxis(polygons, -1, 0)
    area = 0.5 * np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)
    np.testing.assert_allclose(area, np.pi * rims.radius**2, rtol=1e-12)
    on_edge = np.sum(np.abs(polygons) == 21.0, axis=(1, 2))
    assert on_edge.tolist() == [0, 2, 4]
    distance = np.linalg.norm(polygons - rims.centre[:, None], axis=2)
    np.testing.assert_allclose(distance, rims.corner_radius(rims.radius)[:, None] * np.ones(40), rtol=1e-6)


CHAMFERED = [(0.0, 0.0, 3.0), (6.0, 1.0, 2.0), (20.3, 3.0, 1.9)]


def test_a_chamfer_takes_a_ring_of_45_degrees_from_every_hole() -> None:
    width, sides = 0.2, 200
    mesh = build_mesh(artifact(CHAMFERED).changed(edge_chamfer=width), sides)
    assert_closed(mesh)
    radius = np.array([d for _, _, d in CHAMFERED]) / 2
    ring = np.pi * (width**2 * radius + width**3 / 3)  # Pappus: a triangle about the axis
    assert mesh.volume() == pytest.approx(solid_volume(CHAMFERED, 1.13, 3.26, 4.0) - ring.sum(), rel=1e-12)
    area, normals = mesh.areas(), mesh.normals()
    top = area[mesh.labels == Surface.PLATE_TOP].sum()
    assert top == pytest.approx(2500 - np.pi * np.sum((radius + width) ** 2))
    wall = mesh.labels == Surface.HOLE_WALL
    cone = wall & (normals[:, 2] > 0.1)
    assert area[cone].sum() == pytest.approx(np.sum(np.pi * (2 * radius + width) * width * np.sqrt(2)), rel=3e-4)
    assert area[wall & ~cone].sum() == pytest.approx(np.sum(2 * np.pi * radius * (1.13 - width)), rel=3e-4)
    np.testing.assert_allclose(normals[cone, 2], np.sqrt(0.5), rtol=1e-3)
    assert mesh.plate is not None
    assert np.all(mesh.plate.radius >= radius + width)


def test_a_hole_may_have_a_chamfer_of_its_own() -> None:
    plain = artifact(CHAMFERED)
    own = np.array([0.3, 0.0, np.nan])
    dimensions = replace(plain, holes=replace(plain.holes, chamfer=own)).changed(edge_chamfer=0.1)
    np.testing.assert_allclose(dimensions.chamfers, [0.4, 0.1, 0.1])
    mixed = replace(plain, holes=replace(plain.holes, chamfer=np.array([0.3, 0.0, 0.1])))
    mesh = build_mesh(mixed)
    assert_closed(mesh)
    removed = sum(np.pi * (c**2 * d / 2 + c**3 / 3) for (_, _, d), c in zip(CHAMFERED, (0.3, 0.0, 0.1), strict=True))
    assert mesh.volume() == pytest.approx(solid_volume(CHAMFERED, 1.13, 3.26, 4.0) - removed, rel=1e-12)


@pytest.mark.parametrize("spacer", [4.0, 0.0])
def test_a_tilted_block_has_a_tilted_floor(spacer: float) -> None:
    level = artifact(CHAMFERED[:2], spacer=spacer)
    mesh = build_mesh(level.changed(block_tilt_x=1.0, block_tilt_y=-2.0))
    assert_closed(mesh)
    assert mesh.volume() == pytest.approx(build_mesh(level).volume(), rel=1e-12)
    floor = mesh.labels == Surface.FLOOR
    # The normal turned right-handed about x by 1 degree leans towards -y; about y by -2 degrees towards -x.
    expected = Rotation.from_rotvec(np.deg2rad([1.0, -2.0, 0.0])).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(mesh.normals()[floor], np.broadcast_to(expected, (int(floor.sum()), 3)), atol=1e-12)
    inside = (50.0 - 2 * spacer) ** 2
    assert mesh.areas()[floor].sum() == pytest.approx(inside / expected[2], rel=1e-12)
    centre = mesh.corners()[floor].mean(axis=1)
    assert np.average(centre[:, 2], weights=mesh.areas()[floor]) == pytest.approx(-3.26)


def test_a_sample_without_holes_is_a_slab() -> None:
    mesh = build_mesh(flat())
    assert_closed(mesh)
    assert mesh.volume() == pytest.approx(2500 * 5.0)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    rows=st.integers(1, 5),
    jitter=st.floats(0.0, 0.5),
    plate=st.floats(0.2, 2.5),
    spacer=st.floats(0.5, 10.0),
)
def test_any_layout_of_holes_gives_a_closed_solid(
    seed: int, rows: int, jitter: float, plate: float, spacer: float
) -> None:
    random = np.random.default_rng(seed)
    pitch = 50.0 / rows
    grid = (np.arange(rows) - (rows - 1) / 2) * pitch
    size = random.uniform(0.1, 0.45, rows * rows) * pitch
    free = (pitch - size) / 2 * 0.99
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    moves = random.uniform(-1, 1, (2, rows * rows)) * free * min(1.0, 2 * jitter)
    holes = list(zip(x + moves[0], y + moves[1], size, strict=True))
    mesh = build_mesh(artifact(holes, plate=plate, spacer=spacer))
    assert_closed(mesh)
    assert mesh.volume() == pytest.approx(solid_volume(holes, plate, 3.26, spacer), rel=1e-9)


def test_power_cells_tile_the_plate() -> None:
    random = np.random.default_rng(3)
    centres = random.uniform(-20, 20, (40, 2))
    outlines = cells.power_cells(centres, np.full(40, 1e-3), 25.0, 25.0)
    areas = [0.5 * np.sum(p[:, 0] * np.roll(p[:, 1], -1) - np.roll(p[:, 0], -1) * p[:, 1]) for p in outlines]
    assert sum(areas) == pytest.approx(2500.0, rel=1e-9)
    assert min(areas) > 0


def test_the_square_pit_has_its_volume() -> None:
    mesh = square_pit(50.0, 10.0, 10.0)
    assert_closed(mesh)
    assert mesh.volume() == pytest.approx(50 * 50 * 15 - 1000)


def written(path: Path, mesh: SurfaceMesh) -> Path:
    write_mesh(mesh, path)
    return path


def test_an_open_mesh_is_refused(tmp_path: Path) -> None:
    mesh = square_pit(50.0, 10.0, 10.0)
    path = written(tmp_path / "open.ply", SurfaceMesh(mesh.vertices, mesh.faces[1:], mesh.labels[1:]))
    with pytest.raises(InputError, match=r"open\.ply: the mesh is not closed: 3 edges"):
        read_mesh(path)


def test_a_mesh_in_metres_is_refused(tmp_path: Path) -> None:
    mesh = square_pit(50.0, 10.0, 10.0)
    path = written(tmp_path / "metres.ply", SurfaceMesh(mesh.vertices / 1000, mesh.faces, mesh.labels))
    with pytest.raises(InputError, match=r"measures 0\.05 x 0\.05 x 0\.015.*in mm\?"):
        read_mesh(path)


def test_a_mesh_whose_top_is_not_at_zero_is_refused(tmp_path: Path) -> None:
    mesh = square_pit(50.0, 10.0, 10.0)
    path = written(tmp_path / "high.ply", SurfaceMesh(mesh.vertices + np.array([0, 0, 15.0]), mesh.faces, mesh.labels))
    with pytest.raises(InputError, match=r"top of the mesh is at z = 15 mm"):
        read_mesh(path)


def test_a_mesh_that_intersects_itself_is_refused(tmp_path: Path) -> None:
    one = build_mesh(flat())
    turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    both = SurfaceMesh(
        np.concatenate([one.vertices, one.vertices @ turn.T * 0.9 + [0.5, 0.3, -1.0]]),
        np.concatenate([one.faces, one.faces + len(one.vertices)]),
        np.concatenate([one.labels, one.labels]),
    )
    with pytest.raises(InputError, match="intersects itself: faces"):
        read_mesh(written(tmp_path / "crossed.ply", both))


def joined(*parts: SurfaceMesh) -> SurfaceMesh:
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    return SurfaceMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.labels for part in parts]),
    )


def within(mesh: SurfaceMesh) -> SurfaceMesh:
    """The same, smaller, inside of it."""
    return SurfaceMesh(mesh.vertices * 0.5 + [0.0, 0.0, -1.0], mesh.faces, mesh.labels)


def test_a_solid_within_a_solid_is_refused_and_a_bubble_is_not(tmp_path: Path) -> None:
    slab = build_mesh(flat())
    inner = within(slab)
    with pytest.raises(InputError, match=r"nested\.ply: a part of the mesh \(12 faces.*lies within another part"):
        read_mesh(written(tmp_path / "nested.ply", joined(slab, inner)))
    bubble = SurfaceMesh(inner.vertices, inner.faces[:, ::-1], inner.labels)
    assert read_mesh(written(tmp_path / "bubble.ply", joined(slab, bubble))).volume() == pytest.approx(
        2500 * 5.0 * 7 / 8, rel=1e-6
    )


def test_a_part_with_normals_inwards_is_refused(tmp_path: Path) -> None:
    slab = build_mesh(flat())
    small = SurfaceMesh(slab.vertices * 0.2 + [40.0, 0.0, 0.0], slab.faces[:, ::-1], slab.labels)
    with pytest.raises(InputError, match="has its normals inwards"):
        read_mesh(written(tmp_path / "turned.ply", joined(slab, small)))


def test_a_face_of_the_opposite_sense_is_refused(tmp_path: Path) -> None:
    mesh = square_pit(50.0, 10.0, 10.0)
    faces = mesh.faces.copy()
    faces[0] = faces[0, ::-1]
    with pytest.raises(InputError, match="normals of neighbouring faces point to opposite sides"):
        read_mesh(written(tmp_path / "mixed.ply", SurfaceMesh(mesh.vertices, faces, mesh.labels)))


def test_a_mesh_with_normals_inwards_is_turned(tmp_path: Path) -> None:
    mesh = square_pit(50.0, 10.0, 10.0)
    path = written(tmp_path / "inside_out.ply", SurfaceMesh(mesh.vertices, mesh.faces[:, ::-1], mesh.labels))
    assert read_mesh(path).volume() == pytest.approx(mesh.volume(), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("sample.txt", "", "found the suffix '.txt'"),
        ("empty.obj", "# nothing\n", "no faces|not a readable mesh"),
    ],
)
def test_a_file_that_is_no_mesh_is_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        read_mesh(path)
