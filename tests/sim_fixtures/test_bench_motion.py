"""Arms of the bench: trapezoidal profiles against times worked out by hand, homing, stalls, limits."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_fixtures.bench.axis import AxisDesign, AxisModel
from sim_fixtures.bench.clock import BenchClock, ManualClock
from sim_fixtures.bench.profile import plan_motion, plan_stop


@pytest.mark.parametrize(
    ("distance", "speed", "acceleration", "deceleration", "expected"),
    [
        (5.0, 20.0, 10.0, 10.0, math.sqrt(2.0)),  # triangle: 2 sqrt(d/a)
        (40.0, 20.0, 10.0, 10.0, 4.0),  # just reaches the top speed
        (160.0, 20.0, 10.0, 10.0, 10.0),  # 2 s up, 120 degrees at 20 degree/s, 2 s down
        (30.0, 10.0, 10.0, 5.0, 4.5),  # 1 s up (5), 15 degrees in 1.5 s, 2 s down (10)
        (-5.0, 20.0, 10.0, 10.0, math.sqrt(2.0)),
    ],
)
def test_duration_from_rest_is_what_the_trapezoid_says(distance, speed, acceleration, deceleration, expected):
    motion = plan_motion(3.0, 1.0, 0.0, 1.0 + distance, speed, acceleration, deceleration)
    assert motion.duration == pytest.approx(expected, rel=1e-12)
    assert motion.at(3.0 + expected + 1e-9) == (1.0 + distance, 0.0)


def test_half_way_through_a_triangle_the_speed_is_greatest():
    motion = plan_motion(0.0, 0.0, 0.0, 5.0, 20.0, 10.0)
    position, velocity = motion.at(math.sqrt(0.5))
    assert position == pytest.approx(2.5)
    assert velocity == pytest.approx(math.sqrt(50.0))


def test_stop_at_top_speed_takes_the_braking_distance():
    motion = plan_stop(1.0, 30.0, -20.0, 10.0)
    assert motion.duration == pytest.approx(2.0)
    assert motion.target == pytest.approx(10.0)
    assert motion.at(2.0) == pytest.approx((15.0, -10.0))


def test_a_target_behind_a_moving_arm_is_reached_after_braking():
    # 20 degree/s with 10 degree/s^2: brakes for 2 s over 20 degrees, then 40 degrees back in 4 s.
    motion = plan_motion(0.0, 0.0, 20.0, -20.0, 20.0, 10.0)
    assert motion.duration == pytest.approx(6.0)
    assert motion.at(2.0) == pytest.approx((20.0, 0.0))
    assert motion.at(6.0) == (-20.0, 0.0)


@given(
    position=st.floats(-90, 90),
    velocity=st.floats(-20, 20),
    target=st.floats(-90, 90),
    speed=st.floats(0.5, 40),
    acceleration=st.floats(1, 50),
    deceleration=st.floats(1, 50),
)
def test_every_motion_is_continuous_keeps_its_limits_and_arrives(
    position, velocity, target, speed, acceleration, deceleration
):
    motion = plan_motion(0.0, position, velocity, target, speed, acceleration, deceleration)
    at = 0.0
    for before, after in zip(motion.segments, motion.segments[1:], strict=False):
        at += before.duration
        assert before.advance(before.duration)[1] == pytest.approx(after.velocity, abs=1e-6)
        assert abs(after.velocity) <= max(speed, abs(velocity)) * (1 + 1e-9)
    travelled = sum(segment.advance(segment.duration)[0] for segment in motion.segments)
    assert position + travelled == pytest.approx(target, abs=1e-6)
    final = motion.segments[-1]
    assert final.advance(final.duration)[1] == pytest.approx(0.0, abs=1e-6)
    assert all(abs(segment.acceleration) <= max(acceleration, deceleration) * (1 + 1e-9) for segment in motion.segments)


@pytest.mark.parametrize("limits", [(0.0, 10.0, 10.0), (20.0, -1.0, 10.0), (20.0, 10.0, 0.0)])
def test_a_limit_that_is_not_positive_is_refused(limits):
    with pytest.raises(ValueError, match="must be positive"):
        plan_motion(0.0, 0.0, 0.0, 5.0, *limits)


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def arm(clock):
    return AxisModel("sensor_zenith", AxisDesign(-95.0, 95.0, 0.0005, parked=-12.0), clock)


def homed(arm: AxisModel, clock: ManualClock) -> AxisModel:
    arm.home()
    clock.advance(11.0)
    assert not arm.moving()
    return arm


def test_before_homing_the_counter_starts_at_zero_wherever_the_arm_stands(arm):
    assert (arm.true_position(), arm.position(), arm.homed) == (-12.0, 0.0, False)


def test_homing_takes_its_time_and_finds_the_zero(arm, clock):
    arm.home()
    clock.advance(9.9)
    assert arm.moving()
    assert not arm.homed
    clock.advance(0.2)
    assert not arm.moving()
    assert arm.homed
    assert (arm.true_position(), arm.position()) == (0.0, 0.0)


def test_homing_that_is_stopped_leaves_no_zero(arm, clock):
    arm.home()
    clock.advance(0.5)
    arm.stop()
    clock.advance(5.0)
    assert not arm.moving()
    assert not arm.homed


def test_a_position_at_rest_is_a_multiple_of_the_encoder_step(arm, clock):
    homed(arm, clock).move(10.00037, 20.0, 10.0)
    clock.advance(10.0)
    assert arm.position() == 10.0005


def test_a_stalled_arm_stands_half_way_while_the_drive_believes_it_moves(arm, clock):
    homed(arm, clock).stall()
    arm.move(40.0, 20.0, 10.0)
    clock.advance(100.0)
    assert arm.moving()
    assert arm.true_position() == pytest.approx(20.0)
    arm.stop()
    assert not arm.moving()
    arm.move(40.0, 20.0, 10.0)
    clock.advance(2.9)
    assert arm.true_position() == 40.0


def test_a_stall_in_mid_motion_freezes_the_arm_where_it_is(arm, clock):
    homed(arm, clock).move(160.0 / 2, 20.0, 10.0)
    clock.advance(2.0)
    arm.stall()
    clock.advance(50.0)
    assert arm.moving()
    assert arm.true_position() == pytest.approx(20.0)


def test_an_arm_that_runs_beyond_its_travel_closes_the_limit_switch(arm, clock):
    homed(arm, clock).move(120.0, 20.0, 10.0)
    clock.advance(60.0)
    assert not arm.moving()
    assert arm.at_limit == 1
    assert arm.true_position() == 95.0


def test_stopping_mid_way_rests_on_the_braking_distance(arm, clock):
    homed(arm, clock).move(80.0, 20.0, 10.0)
    clock.advance(3.0)  # 20 degrees of ramp and 20 of cruise
    arm.stop()
    assert arm.moving()
    clock.advance(2.001)
    assert not arm.moving()
    assert arm.position() == 60.0


def test_the_clock_runs_as_many_times_faster_as_it_is_told():
    import time

    clock = BenchClock(200.0)
    begin, wall = clock.now(), time.monotonic()
    clock.wait_until(begin + 10.0)
    assert 0.045 < time.monotonic() - wall < 10.0  # not at the pace of the wall clock
    assert clock.now() - begin >= 10.0
    with pytest.raises(ValueError, match="speed must be positive"):
        BenchClock(0.0)
