"""Plans as laboratories write them: tables, sequences, repeats, rotation and polarisation."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from example_runs import facility
from hypothesis import given, settings
from hypothesis import strategies as st

from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Facility, KeepOut
from instrument.plan import Plan, PlanForm, make_plan, read_plan, reference_geometries
from instrument.plan_text import self_contained

GRID = {"wavelength": [500.0], "illumination_zenith": [0.0], "sensor_azimuth": [0.0], "sensor_zenith": [30.0, 20.0]}
HEAD = "wavelength,illumination_zenith,sensor_azimuth,sensor_zenith\n"


def equipped(**arms: object) -> Facility:
    """The paper's instrument with a rotation stage and a polariser, unless told otherwise."""
    has = {"sample_rotation": (-180.0, 180.0), "polarizer": (0.0, 90.0)} | arms
    return facility().model_copy(update={"arms": facility().arms.model_copy(update=has)})


def plan_of(*parts: dict, at: Facility | None = None, **keys: object) -> Plan:
    form = PlanForm.model_validate({"version": 1, "part": [GRID | part for part in parts], **keys})
    return make_plan(form, at or facility(), "plan.toml")


def csv_plan(tmp_path: Path, text: str, **encoding: str) -> Plan:
    (tmp_path / "points.csv").write_text(text, **encoding)
    return read_plan(tmp_path / "points.csv", facility())


def refusal(tmp_path: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        csv_plan(tmp_path, text)
    return str(caught.value)


def test_a_table_is_measured_in_the_order_of_its_rows(tmp_path: Path) -> None:
    plan = csv_plan(tmp_path, "# control points\n" + HEAD + "\n550,15,90,-20\n500,0,0,30.5\n")
    assert plan.points == (
        Geometry(wavelength=550, illumination_zenith=15, sensor_azimuth=90, sensor_zenith=-20),
        Geometry(wavelength=500, illumination_zenith=0, sensor_azimuth=0, sensor_zenith=30.5),
    )
    assert plan.title == "points"


def test_units_of_the_header_are_converted(tmp_path: Path) -> None:
    head = "wavelength (um);illumination_zenith [rad];sensor_azimuth / deg;sensor_zenith (degree)\n"
    plan = csv_plan(tmp_path, head + "0,5;0,7853981633974483;90;-20,5\n", encoding="utf-8-sig")
    assert plan.points == (Geometry(wavelength=500, illumination_zenith=45, sensor_azimuth=90, sensor_zenith=-20.5),)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "empty"),
        (HEAD, "holds no row"),
        (HEAD + "500,0,0,thirty\n", "row 2, column sensor_zenith: found 'thirty'; expected a number (degree)"),
        (HEAD + "500,0,0,30\n\n500,0,0,nan\n", "row 4, column sensor_zenith: found 'nan'; expected a finite number"),
        (HEAD + "500,0,0\n", "row 2: found 3 columns; expected 4"),
        (HEAD + "500,0,0,95\n", "row 2, column sensor_zenith: found 95 degrees, beyond the arm; expected -90 to 90"),
        (HEAD + "150,0,0,30\n", "row 2, column wavelength: found 150; expected 200 to 3000 nm"),
        (HEAD + "0.5,0,0,30\n", "are these micrometres?"),
        (HEAD + "500,0,0,1.396\n500,0,0,-0.524\n", "are these radians?"),
        (HEAD + "500,0,0,30\n500,0,0,30.0\n", "stands twice"),
        (HEAD.replace("sensor_zenith", "sensor_zenit"), "did you mean 'sensor_zenith'"),
        (HEAD.replace("sensor_zenith", "vza"), "column 'vza': unknown; did you mean 'sensor_zenith'"),
        (
            HEAD.replace("sensor_zenith", "sensor_zenith (gon)"),
            "column sensor_zenith: found unit 'gon'; expected degree",
        ),
        (HEAD.replace(",sensor_zenith", "") + "500,0,0\n", "column 'sensor_zenith': missing"),
        (HEAD.replace("\n", ",sensor_zenith\n"), "'sensor_zenith' stands twice"),
        (HEAD.replace("\n", ",polarization\n") + "500,0,0,30,s\n", "no polariser"),
        (HEAD.replace("\n", ",polarization\n") + "500,0,0,30,x\n", "found 'x'; expected mean or s or p"),
        (HEAD.replace("\n", ",sample_rotation\n") + "500,0,0,30,5\n", "no stage that turns the sample"),
    ],
)
def test_a_wrong_table_is_named_with_row_and_column(tmp_path: Path, text: str, expected: str) -> None:
    message = refusal(tmp_path, text)
    assert expected in message
    assert str(tmp_path / "points.csv") in message


def test_a_binary_table_is_no_table(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        read_plan(tmp_path / "points.csv", facility())


def test_grids_and_tables_follow_each_other_as_written(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("illumination_zenith,sensor_azimuth,sensor_zenith\n15,0,-40\n")
    (tmp_path / "plan.toml").write_text(
        'version = 1\n[[part]]\ntable = "points.csv"\nwavelength = [600.0, 500.0]\n[[part]]\nwavelength = [500.0]\n'
        "illumination_zenith = [0.0]\nsensor_azimuth = [0.0]\nsensor_zenith = [30.0]\n"
        '[[part]]\ntable = "points.csv"\nwavelength = [700.0]\n'
    )
    plan = read_plan(tmp_path / "plan.toml", facility())
    found = [(p.wavelength, p.illumination_zenith, p.sensor_zenith) for p in plan.points]
    assert found == [(600, 15, -40), (500, 15, -40), (500, 0, 30), (700, 15, -40)]


def test_the_copy_of_a_plan_needs_no_table_beside_it(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(
        "illumination_zenith (rad),sensor_azimuth,sensor_zenith (deg)\n0.5,10,-1.5\n0.5,0,1.25\n"
    )
    (tmp_path / "plan.toml").write_text('version = 1\nsamples = 5\n[[part]]\ntable = "p.csv"\nwavelength = [500.0]\n')
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone" / "plan.toml").write_text(self_contained(tmp_path / "plan.toml"))
    first, again = (read_plan(folder / "plan.toml", facility()) for folder in (tmp_path, tmp_path / "alone"))
    assert again.points == first.points
    assert (again.samples, len(again)) == (5, 2)


def test_the_copy_of_a_plan_of_grids_is_its_own_text(tmp_path: Path) -> None:
    text = "# mine\nversion = 1\n[[grid]]\n" + "\n".join(f"{key} = {value}" for key, value in GRID.items())
    (tmp_path / "plan.toml").write_text(text)
    assert self_contained(tmp_path / "plan.toml") == text


@pytest.mark.parametrize(
    "name", ["../points.csv", "/etc/passwd", "a/../../points.csv", "link.csv", ".", "sub/link/x.csv"]
)
def test_no_table_is_read_from_outside_the_folder_of_the_plan(tmp_path: Path, name: str) -> None:
    home = tmp_path / "home"
    (home / "sub").mkdir(parents=True)
    (tmp_path / "points.csv").write_text(HEAD + "500,0,0,30\n")
    (tmp_path / "x.csv").write_text(HEAD + "500,0,0,30\n")
    os.symlink(tmp_path / "points.csv", home / "link.csv")
    os.symlink(tmp_path, home / "sub" / "link")
    (home / "plan.toml").write_text(f'version = 1\n[[part]]\ntable = "{name}"\n')
    with pytest.raises(InputError, match="expected a file in the folder of the plan"):
        read_plan(home / "plan.toml", facility())


def test_points_are_repeated_in_a_row_or_with_the_whole_plan() -> None:
    plan = plan_of({"repeats": 2}, {"sensor_zenith": [10.0]}, repeats=2)
    found = [(p.sensor_zenith, p.repetition) for p in plan.points]
    assert found == [(30, 0), (30, 1), (20, 0), (20, 1), (10, 0), (30, 2), (30, 3), (20, 2), (20, 3), (10, 1)]


def test_a_point_that_comes_again_is_a_slip_unless_it_is_meant() -> None:
    with pytest.raises(InputError, match=r"stands twice.*duplicates"):
        plan_of({}, {"sensor_zenith": [20.0]})
    plan = plan_of({}, {"sensor_zenith": [20.0]}, duplicates="repeat")
    assert [(p.sensor_zenith, p.repetition) for p in plan.points] == [(30, 0), (20, 0), (20, 1)]


@settings(deadline=None, max_examples=30)
@given(st.permutations(["wavelength", "illumination_zenith", "sensor_azimuth", "sensor_zenith"]), st.booleans())
def test_the_last_of_the_order_runs_fastest_and_serpentine_turns_it(order: list[str], serpentine: bool) -> None:
    values = {
        "wavelength": [500.0, 600.0],
        "illumination_zenith": [20.0, 40.0],
        "sensor_azimuth": [90.0, 45.0],
        "sensor_zenith": [30.0, 20.0],
    }
    plan = plan_of(values | {"order": order, "direction": "serpentine" if serpentine else "unidirectional"})
    inner = [getattr(p, order[-1]) for p in plan.points]
    one = values[order[-1]]
    assert inner == ([*one, *one[::-1]] if serpentine else [*one, *one]) * 4
    assert [getattr(p, order[0]) for p in plan.points] == [v for v in values[order[0]] for _ in range(8)]


def test_an_order_that_forgets_an_axis_is_refused() -> None:
    with pytest.raises(ValueError, match="sensor_azimuth is missing"):
        plan_of({"order": ["wavelength", "illumination_zenith", "sensor_zenith"]})


def test_rotation_and_polarisation_are_axes_where_the_instrument_has_them() -> None:
    plan = plan_of({"sample_rotation": [0.0, 90.0], "polarization": ["s", "p"], "sensor_zenith": [30.0]}, at=equipped())
    assert [(p.polarization, p.sample_rotation) for p in plan.points] == [("s", 0), ("s", 90), ("p", 0), ("p", 90)]


def test_with_a_polariser_a_plan_that_says_nothing_means_the_mean() -> None:
    assert {p.polarization for p in plan_of({}, at=equipped()).points} == {"mean"}
    assert {p.polarization for p in plan_of({}).points} == {None}


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ({"sample_rotation": [10.0]}, "part 1: sample_rotation: found 10, but the instrument has no stage"),
        ({"polarization": ["s"]}, "part 1: polarization: found 's', but the instrument has no polariser"),
    ],
)
def test_what_the_instrument_lacks_is_refused(part: dict, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        plan_of(part)


def test_the_reference_is_read_once_a_wavelength_and_polarisation() -> None:
    at = equipped()
    plan = plan_of({"polarization": ["s", "p"], "wavelength": [500.0, 600.0], "sample_rotation": [0.0, 45.0]}, at=at)
    found = [
        (g.wavelength, g.polarization, g.sensor_azimuth, g.sample_rotation) for g in reference_geometries(plan, at)
    ]
    assert found == [(w, p, a, 0.0) for w in (500, 600) for p in "sp" for a in (0, 45, 90, 135)]


def test_points_where_the_arms_are_kept_out_are_left_out_and_say_why() -> None:
    box = KeepOut(name="cable", sensor_zenith=(25.0, 35.0))
    plan = plan_of({}, at=equipped(keep_out=(box,), polarizer=None))
    assert [p.sensor_zenith for p in plan.points] == [20.0]
    assert [(b.geometry.sensor_zenith, b.reason) for b in plan.blocked] == [
        (30.0, "where the arms are kept out: cable")
    ]


def test_a_geometry_of_three_arms_is_written_as_it_always_was() -> None:
    plain = Geometry(wavelength=500, illumination_zenith=0, sensor_azimuth=0, sensor_zenith=30)
    assert set(plain.model_dump()) == {
        "wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth"
    }  # fmt: skip
    turned = plain.model_copy(update={"sample_rotation": 90.0, "polarization": "p", "repetition": 2})
    assert Geometry.model_validate(turned.model_dump(mode="json")) == turned
