"""How long moves and plans take."""

from __future__ import annotations

import pytest
from example_runs import facility, geometry
from hypothesis import given
from hypothesis import strategies as st

from drivers.interfaces import AxisLimits
from instrument.durations import AXES, duration, estimate_duration, move_time
from instrument.plan import PlanForm, make_plan

LIMITS = AxisLimits(-90, 90, velocity=10.0, acceleration=5.0)
ALL = dict.fromkeys(AXES, LIMITS)


@pytest.mark.parametrize(
    ("distance", "seconds"),
    [(0.0, 0.0), (5.0, 2.0), (-5.0, 2.0), (20.0, 4.0), (40.0, 6.0)],
)
def test_moves_follow_the_trapezoid(distance: float, seconds: float) -> None:
    # By hand. 5: sqrt(5/5) s up, as long down. 20: just reaches 10 deg/s after 2 s. 40: 20 degrees more at 10 deg/s.
    assert move_time(distance, LIMITS) == pytest.approx(seconds)


@given(st.floats(0.01, 180), st.floats(0.1, 50), st.floats(0.1, 50))
def test_a_move_integrates_to_its_distance(distance: float, velocity: float, acceleration: float) -> None:
    limits = AxisLimits(-90, 90, velocity, acceleration)
    seconds = move_time(distance, limits)
    ramp = min(velocity / acceleration, seconds / 2)
    covered = acceleration * ramp**2 + (seconds - 2 * ramp) * min(velocity, acceleration * ramp)
    assert covered == pytest.approx(distance, rel=1e-9)


def test_arms_move_one_after_the_other_or_together() -> None:
    points = [geometry(30.0), geometry(-10.0, sensor_azimuth=20.0)]
    assert duration(points, ALL, 7.0) == pytest.approx(2 * 7 + 6 + 4)
    assert duration(points, ALL, 7.0, together=True) == pytest.approx(2 * 7 + 6)
    assert duration(points, ALL, 7.0, seconds_per_move=0.5) == pytest.approx(2 * 7 + 6 + 4 + 1)
    assert duration(points, ALL, 7.0, start=geometry(10.0)) == pytest.approx(2 * 7 + 6 + 4 + 4)


def test_a_plan_takes_the_time_of_its_points() -> None:
    form = PlanForm.model_validate(
        {
            "version": 1,
            "grid": [
                {
                    "wavelength": [500.0],
                    "illumination_zenith": [0.0],
                    "sensor_azimuth": [0.0],
                    "sensor_zenith": [50.0, 10.0],
                }
            ],
        }
    )
    plan = make_plan(form, facility(), "plan.toml")
    assert estimate_duration(plan, ALL, 20.0) == pytest.approx(46.0)
