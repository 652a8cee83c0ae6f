"""TOML forms: every wrong key is named, with what was found and what was expected."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from example_runs import FACILITY, SHARED
from hypothesis import given
from hypothesis import strategies as st

from instrument.angles import angle_between, direction, fold
from instrument.artifact import read_artifact
from instrument.errors import InputError
from instrument.facility import read_facility
from instrument.files import write_atomically
from instrument.forms import read_toml

EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"


def refused_facility(tmp_path: Path, old: str, new: str) -> str:
    assert old in FACILITY
    path = tmp_path / "facility.toml"
    path.write_text(FACILITY.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_facility(path)
    message = str(caught.value)
    assert all(line.startswith(str(path)) for line in message.splitlines())
    return message


def test_the_example_facility_is_the_papers(tmp_path: Path) -> None:
    facility = read_facility(EXAMPLES / "facility.toml")
    assert (facility.beam.diameter, facility.sensor.mirror_distance) == (10.8, 204.7)
    assert facility.arms.shadow_half_angle == 5.0
    assert facility.reference.sensor_azimuth == (0.0, 45.0, 90.0, 135.0)
    assert facility.budget.measurement_noise == (0.0051, 0.0070)


@pytest.mark.skipif(not (SHARED / "cases").exists(), reason="../shared/cases is not there")
def test_the_binding_facility_is_read() -> None:
    assert read_facility(SHARED / "cases" / "common" / "facility.toml").budget.sensor_azimuth == (0.0020, 0.0058)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("radius_1_e2 = 8.0", "radius = 8.0", "beam.radius: unknown key (found 8.0)"),
        ("radius_1_e2 = 8.0\n", "", "a gaussian beam needs radius_1_e2"),
        ("diameter = 10.8", "diameter = -1.0", "beam.diameter"),
        ("diameter = 10.8", 'diameter = "wide"', "beam.diameter"),
        ("[beam]", '[beam]\nprofile = "square"', "beam.profile: found 'square'"),
        ("target_diameter = 10.8\n", "", "sensor.target_diameter: missing"),
        ("sensor_azimuth = [0.0, 180.0]", "sensor_azimuth = [180.0, 0.0]", "must run from low to high"),
        ("reflectance_factor = 0.99", "reflectance_factor = 0.0", "reference.reflectance_factor: found 0.0"),
        ("instrument_stability = 0.0082", "instrument_stability = 82", "budget.instrument_stability"),
        ("instrument_stability", "instrument_stabilty", "budget.instrument_stabilty: unknown key"),
        ('name = "three arms"', "", "name: missing"),
        ("[sample]\n", "[sample]\nu_height = nan\n", "sample.u_height"),
    ],
)
def test_a_wrong_facility_is_named(old: str, new: str, expected: str, tmp_path: Path) -> None:
    assert expected in refused_facility(tmp_path, old, new)


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    for content, expected in ((b"\xff\xfe", "not a text file"), (b"a = ", "not valid TOML"), (b"# x\n", "empty")):
        (tmp_path / "a.toml").write_bytes(content)
        with pytest.raises(InputError, match=expected):
            read_toml(tmp_path / "a.toml")
    with pytest.raises(InputError, match="is a folder"):
        read_toml(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_toml(tmp_path / "b.toml")


HOLES = "hole,x_mm,y_mm,diameter_mm,u_x_mm,u_y_mm,u_diameter_mm\n0,0,0,2.5,0.01,0.01,0.02\n1,3.6,0,2.5,,,\n"


CHAMFERS = "hole,x_mm,y_mm,diameter_mm,chamfer_mm,u_chamfer_mm\nleft,0,0,2.5,0.2,0.01\nright,3.6,0,2.5,,\n"


def artifact(tmp_path: Path, holes: str = HOLES, text: str = 'holes = "holes.csv"\n') -> Path:
    (tmp_path / "holes.csv").write_text(holes)
    (tmp_path / "artifact.toml").write_text(text)
    return tmp_path / "artifact.toml"


def test_an_artifact_is_its_dimensions_and_holes(tmp_path: Path) -> None:
    found = read_artifact(artifact(tmp_path))
    assert len(found.holes) == 2
    assert found.holes.x.tolist() == [0.0, 3.6]
    assert found.holes.u_diameter.tolist() == [0.02, 0.0]
    assert len(read_artifact(EXAMPLES / "artifact.toml").holes) == 144


def test_a_flat_sample_has_no_holes(tmp_path: Path) -> None:
    assert len(read_artifact(artifact(tmp_path, text="block_thickness = 5.0\n")).holes) == 0


def test_a_hole_without_a_chamfer_of_its_own_has_the_artifacts(tmp_path: Path) -> None:
    text = 'holes = "holes.csv"\nedge_chamfer = 0.05\nu_edge_chamfer = 0.02\n'
    found = read_artifact(artifact(tmp_path, CHAMFERS, text))
    assert found.chamfers.tolist() == [0.2, 0.05]
    assert found.u_chamfers.tolist() == [0.01, 0.02]
    assert read_artifact(artifact(tmp_path, HOLES, text)).chamfers.tolist() == [0.05, 0.05]


def test_changed_dimensions_are_checked(tmp_path: Path) -> None:
    known = read_artifact(artifact(tmp_path))
    wider = known.changed(hole_diameter=0.1, plate_thickness=0.2, cavity_depth=-0.3, edge_chamfer=0.1)
    assert wider.holes.diameter.tolist() == pytest.approx([2.6, 2.6])
    assert (wider.form.plate_thickness, wider.form.cavity_depth) == pytest.approx((1.2, 2.7))
    assert wider.chamfers.tolist() == pytest.approx([0.1, 0.1])
    assert known.form.plate_thickness == 1.0
    with pytest.raises(InputError, match=r"edge_chamfer: found -0\.1"):
        known.changed(edge_chamfer=-0.1)
    with pytest.raises(InputError, match="holes 0 and 1 overlap"):
        known.changed(hole_diameter=1.2)


@pytest.mark.parametrize(
    ("holes", "text", "expected"),
    [
        (HOLES.replace("diameter_mm", "d_mm", 1), None, "header: found"),
        (HOLES.replace("2.5,0.01", "wide,0.01"), None, "line 2: diameter_mm: found 'wide'"),
        (HOLES.replace("3.6,0,2.5", "3.6,0,"), None, "line 3: diameter_mm"),
        (HOLES.replace("0,0,0,2.5", "0,0,0,-2.5"), None, "diameter_mm: found -2.5; expected > 0"),
        (HOLES.replace("3.6,0", "2.0,0"), None, "holes 0 and 1 overlap by 0.500 mm"),
        (HOLES.replace("3.6,0", "3600,0"), None, "leaves the plate"),
        (HOLES.replace("0.01,0.01,0.02", "-0.01,0.01,0.02"), None, "u_x_mm"),
        (HOLES, 'holes = "none.csv"\n', "no such file"),
        (HOLES, 'holes = "holes.csv"\nplate_thickness = 4.0\n', "cavity_depth"),
        (HOLES, 'mesh = "none.ply"\n', "mesh"),
        (HOLES, "plate_thicknes = 1.0\n", "plate_thicknes: unknown key"),
        (HOLES, 'holes = "holes.csv"\nplate_thickness = -1.0\n', "plate_thickness: found -1.0"),
        (HOLES, 'holes = "holes.csv"\nspacer_edge = -4.0\n', "spacer_edge: found -4.0"),
        (HOLES, 'holes = "holes.csv"\nspacer_edge = 25.0\n', "spacer_edge: found 25 mm; expected less than half"),
        (HOLES, 'holes = "holes.csv"\nedge_chamfer = 1.0\n', "edge_chamfer: found 1 mm; expected from 0 to less"),
        (HOLES, 'holes = "holes.csv"\nedge_chamfer = 0.6\n', "the chamfers of holes 0 and 1 overlap by 0.100 mm"),
        (HOLES, 'holes = "holes.csv"\nblock_tilt_x = 6.0\n', "block_tilt_x, block_tilt_y: found 6 and 0 degrees"),
        (HOLES, 'holes = "holes.csv"\nblock_tilt_y = 90.0\n', "block_tilt_y: found 90.0"),
        (HOLES.replace("1,3.6", "0,3.6"), None, "line 3: hole: found '0' again, as on line 2"),
        (CHAMFERS.replace("0.2,0.01", "-0.2,0.01"), None, "line 2: chamfer_mm: found '-0.2'"),
        (CHAMFERS.replace("0.2,0.01", "1.2,0.01"), None, "hole left: chamfer_mm: found 1.2 mm"),
        (CHAMFERS.replace("0,0,2.5", "24,0,1.8"), None, "the chamfer of hole left at (24, 0) mm leaves the plate"),
    ],
)
def test_a_wrong_artifact_is_named(holes: str, text: str | None, expected: str, tmp_path: Path) -> None:
    path = artifact(tmp_path, holes, text or 'holes = "holes.csv"\n')
    with pytest.raises(InputError) as caught:
        read_artifact(path)
    assert expected in str(caught.value)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("angles", "vector"),
    [((0, 0), (0, 0, 1)), ((90, 0), (1, 0, 0)), ((90, 90), (0, 1, 0)), ((-90, 0), (-1, 0, 0)), ((180, 33), (0, 0, -1))],
)
def test_directions_point_where_the_contract_says(
    angles: tuple[float, float], vector: tuple[float, float, float]
) -> None:
    np.testing.assert_allclose(direction(*angles), vector, atol=1e-15)


@given(st.floats(-90, 90), st.floats(-720, 720))
def test_folding_keeps_the_direction(zenith: float, azimuth: float) -> None:
    folded = fold(zenith, azimuth)
    assert folded[0] >= 0
    assert 0 <= folded[1] <= 360
    np.testing.assert_allclose(direction(*folded), direction(zenith, azimuth), atol=1e-12)


@given(st.floats(0, 180), st.floats(0, 360))
def test_the_angle_to_the_normal_is_the_zenith(zenith: float, azimuth: float) -> None:
    assert angle_between(direction(zenith, azimuth), direction(0, 0)) == pytest.approx(zenith, abs=1e-9)


def test_tiny_angles_are_not_lost() -> None:
    assert angle_between(direction(30.0, 0.0), direction(30.0 + 1e-7, 0.0)) == pytest.approx(1e-7, rel=1e-6)


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_atomically(path, b"one")
    write_atomically(path, b"two")
    assert path.read_bytes() == b"two"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert path.stat().st_mode & 0o077 == 0o644 & 0o077


def test_a_pipe_is_written_to_and_stays_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_atomically(path, b"content")
        assert os.read(reader, 100) == b"content"
    finally:
        os.close(reader)
    assert path.is_fifo()


def test_what_is_open_for_output_is_added_to(tmp_path: Path) -> None:
    """As ``/dev/stdout`` is where a shell sends the output to the end of a file."""
    with (tmp_path / "out.txt").open("ab", buffering=0) as handle:
        (tmp_path / "link").symlink_to(f"/proc/self/fd/{handle.fileno()}")
        for name in (tmp_path / "link", Path(f"/dev/fd/{handle.fileno()}")):
            handle.write(b"before ")
            write_atomically(name, b"content\n")
        assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "out.txt").read_text() == "before content\n" * 2


def test_like_facilities_have_the_same_hash(tmp_path: Path) -> None:
    """What is computed for a facility is kept under it."""
    path = tmp_path / "facility.toml"
    path.write_text(FACILITY)
    known, again = read_facility(path), read_facility(path)
    wanted = known.calibration.model_copy(update={"due_days": {"dark-level": 1.0}})
    assert hash(known) == hash(again)
    assert len({known, again, known.model_copy(update={"calibration": wanted})}) == 2
