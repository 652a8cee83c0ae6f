"""Plans: order, blocked points, and what a wrong file is told."""

from __future__ import annotations

from pathlib import Path

import pytest
from example_runs import facility
from hypothesis import given, settings
from hypothesis import strategies as st

from instrument.angles import angle_between, direction
from instrument.errors import InputError
from instrument.plan import Plan, PlanForm, make_plan, read_plan

EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"
GRID = {"wavelength": [500.0], "illumination_zenith": [0.0], "sensor_azimuth": [0.0], "sensor_zenith": [30.0, 20.0]}


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    return path


def plan_of(*grids: dict, **keys: object) -> Plan:
    form = PlanForm.model_validate({"version": 1, "grid": [GRID | grid for grid in grids], **keys})
    return make_plan(form, facility(), "plan.toml")


def refusal(tmp_path: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        read_plan(write(tmp_path, text), facility())
    return str(caught.value)


def grid_text(**changes: str) -> str:
    values = {key: str(value) for key, value in GRID.items()} | changes
    return "version = 1\n[[grid]]\n" + "\n".join(f"{key} = {value}" for key, value in values.items())


@pytest.mark.parametrize(("name", "kept", "nominal"), [("table_iii.toml", 652, 660), ("table_iv.toml", 390, 396)])
def test_the_papers_plans_keep_their_points(name: str, kept: int, nominal: int) -> None:
    plan = read_plan(EXAMPLES / name, facility())
    assert len(plan.points) == kept
    assert len(plan.points) + len(plan.blocked) == nominal
    assert {(b.geometry.illumination_zenith, b.geometry.sensor_zenith) for b in plan.blocked} <= {
        (angle, angle) for angle in (0.0, 15.0, 30.0, 45.0, 60.0)
    }


def test_points_come_in_the_order_wavelength_illumination_azimuth_zenith() -> None:
    plan = plan_of(
        {
            "wavelength": [600.0, 500.0],
            "illumination_zenith": [0.0, 40.0],
            "sensor_azimuth": [90.0, 45.0],
            "sensor_zenith": [30.0, 20.0],
        }
    )
    found = [(p.wavelength, p.illumination_zenith, p.sensor_azimuth, p.sensor_zenith) for p in plan.points]
    assert found == [(w, i, a, z) for w in (600, 500) for i in (0, 40) for a in (90, 45) for z in (30, 20)]


def test_serpentine_turns_every_other_sweep_across_grids() -> None:
    plan = plan_of({"sensor_azimuth": [0.0, 45.0, 90.0]}, {"sensor_azimuth": [135.0]}, direction="serpentine")
    assert [p.sensor_zenith for p in plan.points] == [30, 20, 20, 30, 30, 20, 20, 30]
    assert [p.sensor_azimuth for p in plan.points] == [0, 0, 45, 45, 90, 90, 135, 135]


def test_steps_include_both_ends_without_rounding_noise() -> None:
    plan = plan_of({"sensor_zenith": {"start": 10.0, "stop": 11.0, "step": 0.1}})
    assert [p.sensor_zenith for p in plan.points] == [10.0, 10.1, 10.2, 10.3, 10.4, 10.5, 10.6, 10.7, 10.8, 10.9, 11.0]


@pytest.mark.parametrize(("angle", "blocked"), [(5.0, False), (5.0 - 2e-7, False), (5.0 - 1e-5, True), (0.0, True)])
def test_a_point_is_blocked_strictly_inside_the_cone(angle: float, blocked: bool) -> None:
    plan = plan_of({"sensor_zenith": [angle, 40.0]})
    assert len(plan.blocked) == (1 if blocked else 0)


@settings(deadline=None)
@given(
    illumination=st.lists(st.integers(-80, 80), min_size=1, max_size=3, unique=True),
    azimuth=st.lists(st.integers(0, 180), min_size=1, max_size=4, unique=True),
    zenith=st.lists(st.integers(-85, 85), min_size=1, max_size=8, unique=True),
    serpentine=st.booleans(),
)
def test_every_combination_stands_exactly_once_and_the_cone_is_symmetric(
    illumination: list[int], azimuth: list[int], zenith: list[int], serpentine: bool
) -> None:
    form = PlanForm.model_validate(
        {
            "version": 1,
            "angle_unit": "degree",
            "direction": "serpentine" if serpentine else "unidirectional",
            "grid": [
                {
                    "wavelength": [500.0],
                    "illumination_zenith": [*illumination, 89],
                    "sensor_azimuth": azimuth,
                    "sensor_zenith": zenith,
                }
            ],
        }
    )
    wanted = {(i, a, z) for i in (*illumination, 89) for a in azimuth for z in zenith}
    # Light and sensor exchanged, and the whole mirrored in the x-z plane: the same angle.
    in_cone = {p for p in wanted if angle_between(direction(p[2], -p[1]), direction(p[0], 0.0)) < 5.0 - 1e-6}
    if in_cone == wanted:
        with pytest.raises(InputError, match="blocked"):
            make_plan(form, facility(), "plan.toml")
        return
    plan = make_plan(form, facility(), "plan.toml")
    found = [(p.illumination_zenith, p.sensor_azimuth, p.sensor_zenith) for p in plan.points]
    aside = [
        (b.geometry.illumination_zenith, b.geometry.sensor_azimuth, b.geometry.sensor_zenith) for b in plan.blocked
    ]
    assert len(found) + len(aside) == len(wanted)
    assert set(aside) == in_cone
    assert set(found) == wanted - in_cone


def test_sweeps_keep_their_direction_within_themselves() -> None:
    plan = read_plan(EXAMPLES / "table_iv.toml", facility())
    for before, after in zip(plan.points, plan.points[1:], strict=False):
        if before.sensor_azimuth == after.sensor_azimuth and before.illumination_zenith == after.illumination_zenith:
            assert after.sensor_zenith < before.sensor_zenith


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"sensor_zenit": "[1.0]"}, "grid.0.sensor_zenit: unknown key"),
        ({"sensor_zenith": "[]"}, "sensor_zenith: no value"),
        ({"sensor_zenith": "{ start = 80.0, stop = -80.0, step = 5.0 }"}, "step 5 has the wrong sign"),
        ({"sensor_zenith": "{ start = 80.0, stop = -80.0, step = 0.0 }"}, "step is 0"),
        ({"sensor_zenith": "{ start = 80.0, stop = -80.0, step = -3.0 }"}, "do not meet stop"),
        ({"sensor_zenith": "[95.0]"}, "sensor_zenith: found 95 degrees, beyond the arm; expected -90 to 90"),
        ({"sensor_azimuth": "[-45.0]"}, "sensor_azimuth: found -45 degrees, beyond the arm; expected 0 to 180"),
        ({"illumination_zenith": "[91.0]"}, "illumination_zenith: found 91 degrees, beyond the arm"),
        ({"sensor_zenith": "[30.0, 30.0]"}, "stands twice"),
        ({"sensor_zenith": "[0.0]"}, "nothing is left to measure"),
        ({"sensor_zenith": "[1.396, 1.047, 0.524]"}, "are these radians?"),
        ({"sensor_zenith": "{ start = 1.4, stop = -1.4, step = -0.1 }"}, "are these radians?"),
        ({"sensor_azimuth": "[0.0, 0.785398, 1.570796]"}, "are these radians?"),
        ({"illumination_zenith": "[0.2618]"}, "are these radians?"),
        ({"wavelength": "[0.5]"}, "are these micrometres?"),
        ({"wavelength": "[5e-7]"}, "are these metres?"),
        ({"wavelength": "[5000.0]"}, "are these angstroms?"),
        ({"wavelength": "[150.0]"}, "expected 200 to 3000 nm"),
        ({"wavelength": "[500.0, nan]"}, "finite"),
        ({"sensor_zenith": '["thirty"]'}, "sensor_zenith"),
    ],
)
def test_a_wrong_value_is_named(tmp_path: Path, changes: dict[str, str], expected: str) -> None:
    message = refusal(tmp_path, grid_text(**changes))
    assert expected in message
    assert str(tmp_path / "plan.toml") in message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("version = 1\n", "grid: missing"),
        ("version = 1\ngrid = []\n", "at least one [[grid]]"),
        ("version = 2\n" + grid_text().removeprefix("version = 1\n"), "version"),
        (grid_text().removeprefix("version = 1\n"), "version: missing"),
        ("samples = 0\n" + grid_text(), "samples"),
        ('direction = "zigzag"\n' + grid_text(), "direction"),
        ("version = \n", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in refusal(tmp_path, text)


def test_small_angles_pass_when_their_unit_is_stated(tmp_path: Path) -> None:
    text = grid_text(illumination_zenith="[30.0]", sensor_zenith="[-1.5, 0.0, 1.5]")
    assert "are these radians?" in refusal(tmp_path, text)
    plan = read_plan(write(tmp_path, 'angle_unit = "degree"\n' + text), facility())
    assert [p.sensor_zenith for p in plan.points] == [-1.5, 0.0, 1.5]


@pytest.mark.parametrize("angles", ["[1.0]", "[0.5, 0.25]", "[0.0]", "[-80.0, 1.0]"])
def test_plausible_degrees_are_not_suspected(tmp_path: Path, angles: str) -> None:
    text = grid_text(illumination_zenith="[45.0]", sensor_zenith=angles)
    assert read_plan(write(tmp_path, text), facility()).points


def test_a_missing_file_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_plan(tmp_path / "absent.toml", facility())
