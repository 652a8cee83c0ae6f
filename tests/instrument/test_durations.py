"""How long moves take, one by one and in a plan."""

from __future__ import annotations

import pytest
from example_runs import geometry
from hypothesis import given
from hypothesis import strategies as st

from drivers.interfaces import AxisLimits
from instrument.durations import AXES, move_time
from instrument.safety import Envelope, Pose, check_plan

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


def test_arms_move_one_after_the_other_and_a_plan_takes_the_time_of_its_moves() -> None:
    points = [geometry(30.0), geometry(-10.0, sensor_azimuth=20.0)]
    named = [(f"point {index}", point) for index, point in enumerate(points)]
    checked = check_plan(named, Pose.of(points[0]), Envelope(dict.fromkeys(AXES, (-90.0, 90.0)), 0.0, ALL))
    # 20 degrees of azimuth in 4 s, then 40 of zenith in 6 s.
    assert checked.moving_time == pytest.approx(4 + 6)
    assert [len(legs) for legs in checked.routes] == [0, 2]
