"""What is written for other programs, read back by readers of their own."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path

import manifold3d
import numpy as np
import pytest
from openscad_source import solid_of_source
from traced_samples import artifact, flat

from instrument.__main__ import main
from instrument.artifact import ArtifactDimensions, read_artifact
from instrument.errors import InputError
from twin.artifact import Surface, build_mesh, square_pit
from twin.llvm import import_mitsuba
from twin.mesh_export import export_artifact, write_mesh
from twin.mesh_files import read_mesh
from twin.openscad import openscad_of_dimensions, openscad_of_mesh

EXAMPLES = Path(__file__).resolve().parents[2] / "sim_fixtures" / "examples"
HOLES = [(0.0, 0.0, 3.0), (5.0, 5.0, 2.0), (19.8, 19.8, 2.5), (-20.8, 3.0, 1.5)]


def volume(holes: list[tuple[float, float, float]], chamfer: float = 0.0) -> float:
    """In closed form; the plate is 1.13 mm, the cavity 3.26 mm, the spacer 4 mm."""
    radius = np.array([d for _, _, d in holes]) / 2
    widened = np.pi * (chamfer * radius * chamfer + chamfer**3 / 3)
    return float(50 * 50 * 8.26 - 42**2 * 2.13 - np.sum(np.pi * radius**2 * 1.13 + widened))


def ply_of(path: Path) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """A reader of the one PLY layout that is written."""
    content = path.read_bytes()
    head, body = content.split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    vertices = np.frombuffer(body, "<f8", 3 * counts["vertex"]).reshape(-1, 3)
    faces = np.frombuffer(body[vertices.nbytes :], np.dtype([("n", "u1"), ("v", "<i4", 3)]), counts["face"])
    assert len(body) == vertices.nbytes + faces.nbytes
    assert np.all(faces["n"] == 3)
    return vertices, faces["v"], lines


def stl_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Normals and corners of a binary STL file."""
    content = path.read_bytes()
    (count,) = struct.unpack("<I", content[80:84])
    records = np.frombuffer(content[84:], np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]))
    assert len(records) == count
    return records["n"].astype(float), records["v"].astype(float)


def watertight_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Enclosed volume; manifold3d takes closed, oriented surfaces only."""
    solid = manifold3d.Manifold(manifold3d.Mesh64(np.array(vertices), np.array(faces, dtype=np.uint64)))
    assert solid.status() == manifold3d.Error.NoError
    return float(solid.volume())


def test_a_ply_file_holds_the_closed_solid(tmp_path: Path) -> None:
    path = tmp_path / "sample.ply"
    export_artifact(artifact(HOLES), path)
    vertices, faces, header = ply_of(path)
    assert watertight_volume(vertices, faces) == pytest.approx(volume(HOLES), rel=1e-12)
    assert not any("obj_info" in line for line in header)


def test_mitsuba_reads_the_ply_file(tmp_path: Path) -> None:
    path = tmp_path / "sample.ply"
    mesh = export_artifact(artifact(HOLES), path)
    shape = import_mitsuba().load_dict({"type": "ply", "filename": str(path)})
    assert shape.face_count() == len(mesh.faces)
    assert float(shape.surface_area()[0]) == pytest.approx(mesh.areas().sum(), rel=1e-5)


def test_a_stl_file_holds_the_closed_solid(tmp_path: Path) -> None:
    path = tmp_path / "sample.stl"
    export_artifact(artifact(HOLES), path)
    normals, corners = stl_of(path)
    vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    assert watertight_volume(vertices, faces.reshape(-1, 3)) == pytest.approx(volume(HOLES), rel=1e-6)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    large = np.linalg.norm(cross, axis=1) > 1e-4
    across = cross[large] / np.linalg.norm(cross[large], axis=1, keepdims=True)
    np.testing.assert_allclose(np.sum(normals[large] * across, axis=1), 1.0, atol=1e-3)


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj"])
def test_a_written_mesh_is_a_sample_again(tmp_path: Path, suffix: str) -> None:
    mesh = export_artifact(artifact(HOLES), tmp_path / f"sample{suffix}")
    again = read_mesh(tmp_path / f"sample{suffix}")
    assert again.open_edges() == 0
    assert again.volume() == pytest.approx(mesh.volume(), rel=1e-5)
    top = again.areas()[again.labels == Surface.PLATE_TOP].sum()
    assert top == pytest.approx(2500 - np.pi / 4 * sum(d**2 for _, _, d in HOLES), rel=1e-5)


def variants() -> list[tuple[ArtifactDimensions, float]]:
    """Samples and their volumes in closed form; a tilt of the floor about its centre keeps the volume."""
    plain = artifact(HOLES)
    opened = artifact([(0.0, 0.0, 3.0)], spacer=0.0)
    return [
        (plain, volume(HOLES)),
        (plain.changed(edge_chamfer=0.2), volume(HOLES, 0.2)),
        (plain.changed(edge_chamfer=0.2, block_tilt_x=1.0, block_tilt_y=-2.0), volume(HOLES, 0.2)),
        (opened, 2500 * (1.13 + 5.0) - np.pi * 9 / 4 * 1.13),
        (opened.changed(block_tilt_y=1.5), 2500 * (1.13 + 5.0) - np.pi * 9 / 4 * 1.13),
        (flat(), 2500 * 5.0),
    ]


@pytest.mark.parametrize("number", range(6))
def test_the_openscad_source_describes_the_solid(number: int) -> None:
    dimensions, expected = variants()[number]
    solid = solid_of_source(openscad_of_dimensions(dimensions, sides=16))
    assert solid.volume() == pytest.approx(expected, rel=1e-9)
    low, high = np.reshape(solid.bounding_box(), (2, 3))
    np.testing.assert_allclose(low[:2], -25.0)
    np.testing.assert_allclose(high, [25.0, 25.0, 0.0], atol=1e-12)


def test_a_tilted_floor_of_the_source_is_the_plane_of_the_tilt() -> None:
    dimensions = artifact([(0.0, 0.0, 3.0)]).changed(block_tilt_x=1.0, block_tilt_y=-2.0)
    mesh = solid_of_source(openscad_of_dimensions(dimensions)).to_mesh64()
    corners = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts, dtype=int)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    x, y = np.deg2rad(1.0), np.deg2rad(-2.0)
    angle = np.hypot(x, y)  # Rodrigues: the normal turned about the axis (x, y, 0)
    expected = np.array([y * np.sin(angle) / angle, -x * np.sin(angle) / angle, np.cos(angle)])
    floor = (corners[:, :, 2].max(axis=1) < -1.5) & (normals[:, 2] > 0) & (np.linalg.norm(normals, axis=1) > 1e-6)
    unit = normals[floor] / np.linalg.norm(normals[floor], axis=1, keepdims=True)
    np.testing.assert_allclose(unit, np.broadcast_to(expected, unit.shape), atol=1e-9)


def test_openscad_source_of_a_mesh_is_the_same_solid() -> None:
    mesh = square_pit(50.0, 10.0, 10.0)
    assert solid_of_source(openscad_of_mesh(mesh)).volume() == pytest.approx(mesh.volume())


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openscad") is None, reason="OpenSCAD is not installed")
def test_openscad_itself_makes_the_same_solid(tmp_path: Path) -> None:
    dimensions, expected = variants()[2]
    source = tmp_path / "sample.scad"
    source.write_text(openscad_of_dimensions(dimensions, sides=16))
    subprocess.run(["openscad", "-o", str(tmp_path / "sample.stl"), str(source)], check=True, capture_output=True)
    assert read_mesh(tmp_path / "sample.stl").volume() == pytest.approx(expected, rel=1e-5)


def write_artifact(folder: Path, holes: str, text: str = "") -> Path:
    (folder / "holes.csv").write_text("hole,x_mm,y_mm,diameter_mm\n" + holes)
    (folder / "artifact.toml").write_text('holes = "holes.csv"\n' + text)
    return folder / "artifact.toml"


def run(*arguments: object) -> int:
    try:
        return int(main(["artifact", *map(str, arguments)]) or 0)
    except SystemExit as end:
        return int(end.code or 0)


def test_the_command_writes_what_the_suffix_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_artifact(tmp_path, "a,0,0,3\nb,5,0,2\n")
    for suffix in ("ply", "stl", "obj", "scad"):
        assert run("export", source, "--out", tmp_path / f"sample.{suffix}") == 0
        assert (tmp_path / f"sample.{suffix}").stat().st_size > 500
    assert "closed" in capsys.readouterr().out
    assert run("export", source, "--out", tmp_path / "sample.step") == 2
    assert "expected one of .ply, .stl, .obj, .scad" in capsys.readouterr().err
    assert run("export", source, "--out", tmp_path / "nowhere" / "sample.ply") == 2


def test_a_mesh_is_converted(tmp_path: Path) -> None:
    pit = square_pit(50.0, 10.0, 10.0)
    write_mesh(pit, tmp_path / "pit.stl")
    (tmp_path / "artifact.toml").write_text('mesh = "pit.stl"\n')
    export_artifact(read_artifact(tmp_path / "artifact.toml"), tmp_path / "pit.ply")
    vertices, faces, _ = ply_of(tmp_path / "pit.ply")
    assert watertight_volume(vertices, faces) == pytest.approx(50 * 50 * 15 - 1000, rel=1e-6)


def test_show_reports_the_sample(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_artifact(tmp_path, "a,0,0,3\nb,5,0,2\n", "spacer_edge = 2.0\n")
    assert run("show", source, "--json", tmp_path / "sample.json") == 0
    assert "3 mm below the top, closed" in capsys.readouterr().out
    report = json.loads((tmp_path / "sample.json").read_text())
    assert report["narrowest_web"] == pytest.approx(2.5)
    assert report["area"]["plate_top"] == pytest.approx(2500 - np.pi * (1.5**2 + 1))
    assert report["volume"] == pytest.approx(build_mesh(read_artifact(source)).volume())
    assert report["open_edges"] == 0


def test_bad_dimensions_end_the_command_with_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_artifact(tmp_path, "a,0,0,3\nb,5,0,2\n", "edge_chamfer = -0.1\n")
    assert run("export", source, "--out", tmp_path / "sample.ply") == 2
    message = capsys.readouterr().err
    assert "edge_chamfer: found -0.1" in message
    assert len(message.strip().splitlines()) == 1


def test_other_suffixes_are_no_mesh(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected one of \.ply, \.stl, \.obj"):
        write_mesh(build_mesh(flat()), tmp_path / "sample.off")
