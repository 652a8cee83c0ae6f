"""Limits, shadow cone and the ways between points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.interfaces import AxisLimits
from instrument.angles import angle_between, direction
from instrument.durations import AXES
from instrument.errors import InputError, SafetyError
from instrument.events import Geometry
from instrument.facility import Arms
from instrument.safety import Box, Envelope, Leg, Pose, check_plan, closest

WIDE = {
    "illumination_zenith": AxisLimits(-91.0, 91.0, 10.0, 20.0),
    "sensor_azimuth": AxisLimits(-1.0, 181.0, 10.0, 20.0),
    "sensor_zenith": AxisLimits(-91.0, 91.0, 10.0, 20.0),
}
ENVELOPE = Envelope.of(Arms(), WIDE)
zeniths = st.floats(-90.0, 90.0)
azimuths = st.floats(0.0, 180.0)
poses = st.builds(Pose, zeniths, azimuths, zeniths)


def point(illumination: float, azimuth: float, zenith: float, wavelength: float = 500.0) -> Geometry:
    return Geometry(
        wavelength=wavelength, illumination_zenith=illumination, sensor_azimuth=azimuth, sensor_zenith=zenith
    )


def separations(start: Pose, leg: Leg, steps: int = 400) -> np.ndarray:
    """Angle between the directions along a leg, by the definition of a direction in the data contract."""
    values = np.linspace(leg.start, leg.target, steps)
    at = {name: np.full(steps, value) for name, value in zip(AXES, start, strict=True)} | {leg.axis: values}
    return angle_between(
        direction(at["illumination_zenith"], 0.0), direction(at["sensor_zenith"], at["sensor_azimuth"])
    )


@given(pose=poses, axis=st.sampled_from(AXES), target=st.floats(-180.0, 180.0))
def test_the_closest_approach_is_that_of_a_finely_sampled_path(pose: Pose, axis: str, target: float) -> None:
    leg = Leg(axis, getattr(pose, axis), target)
    sampled = separations(pose, leg, 2000)
    spacing = abs(leg.target - leg.start) / 1999
    exact = closest(pose, leg)
    assert exact <= sampled.min() + 1e-6
    assert exact >= sampled.min() - spacing - 1e-6


def walk(start: Pose, legs: tuple[Leg, ...]) -> Pose:
    pose = start
    for leg in legs:
        assert getattr(pose, leg.axis) == leg.start
        pose = pose.moved(leg.axis, leg.target)
    return pose


@settings(max_examples=150, deadline=None)
@given(start=poses, target=poses)
def test_every_way_arrives_without_entering_the_cone_or_leaving_the_travel(start: Pose, target: Pose) -> None:
    assume(start.separation() >= 5.0)
    assume(target.separation() >= 5.0)
    legs = ENVELOPE.route(start, target)
    pose = start
    for leg in legs:
        low, high = ENVELOPE.travel[leg.axis]
        assert low <= leg.target <= high
        assert separations(pose, leg).min() >= 5.0 - 2e-6
        pose = pose.moved(leg.axis, leg.target)
    assert walk(start, legs) == target


grids = st.tuples(
    st.lists(st.sampled_from([0.0, 5.0, 15.0, 30.0, -45.0, 60.0]), min_size=1, max_size=2, unique=True),
    st.lists(st.sampled_from([0.0, 2.0, 45.0, 90.0, 180.0]), min_size=1, max_size=2, unique=True),
    st.lists(st.integers(-16, 16).map(lambda z: 5.0 * z), min_size=2, max_size=6, unique=True),
)


@settings(max_examples=40, deadline=None)
@given(grid=grids, start=poses)
def test_a_random_plan_is_checked_whole_and_its_path_is_clear(grid: tuple[list[float], ...], start: Pose) -> None:
    every = [point(i, a, z) for i in grid[0] for a in grid[1] for z in grid[2]]
    points = [p for p in every if Pose.of(p).separation() >= 5.0 - 1e-6]
    assume(start.separation() >= 5.0)
    checked = check_plan([(f"point {i}", p) for i, p in enumerate(points)], start, ENVELOPE)
    pose = start
    for geometry, legs in zip(points, checked.routes, strict=True):
        for leg in legs:
            assert separations(pose, leg).min() >= 5.0 - 2e-6
            pose = pose.moved(leg.axis, leg.target)
        assert pose == Pose.of(geometry)
    assert checked.moving_time >= 0


def test_the_sensor_swings_aside_where_the_straight_path_crosses_the_beam() -> None:
    legs = ENVELOPE.route(Pose(15.0, 0.0, 20.0), Pose(15.0, 0.0, 10.0))
    assert [leg.axis for leg in legs] == ["sensor_azimuth", "sensor_zenith", "sensor_azimuth"]


def test_at_normal_illumination_the_illumination_arm_has_to_swing_aside() -> None:
    legs = ENVELOPE.route(Pose(0.0, 90.0, 5.0), Pose(0.0, 90.0, -5.0))
    assert [leg.axis for leg in legs] == ["illumination_zenith", "sensor_zenith", "illumination_zenith"]


def test_a_clear_straight_path_is_taken_as_it_is() -> None:
    assert ENVELOPE.route(Pose(0.0, 0.0, 10.0), Pose(0.0, 0.0, 80.0)) == (Leg("sensor_zenith", 10.0, 80.0),)
    assert ENVELOPE.route(Pose(0.0, 0.0, 10.0), Pose(0.0, 0.0, 10.0)) == ()


def test_arms_that_stand_in_the_cone_may_only_move_out_of_it() -> None:
    assert ENVELOPE.clear(Pose(0.0, 0.0, 2.0), Leg("sensor_zenith", 2.0, 20.0))
    assert not ENVELOPE.clear(Pose(0.0, 0.0, 2.0), Leg("sensor_zenith", 2.0, -20.0))
    pose = Pose(0.0, 0.0, 0.0)
    for leg in ENVELOPE.route(pose, Pose(0.0, 135.0, 15.0)):
        assert np.all(np.diff(separations(pose, leg)) >= -1e-6) or separations(pose, leg).min() >= 5.0 - 2e-6
        pose = pose.moved(leg.axis, leg.target)


def test_a_point_beyond_an_arm_names_axis_value_and_travel() -> None:
    limits = WIDE | {"sensor_zenith": AxisLimits(-60.0, 60.0, 10.0, 20.0)}
    with pytest.raises(InputError, match=r"point 7: sensor_zenith: found 75 degrees.*expected -60 to 60"):
        Envelope.of(Arms(), limits).check_point(point(0.0, 0.0, 75.0), "point 7")


def test_the_narrower_of_facility_and_drive_counts() -> None:
    envelope = Envelope.of(Arms(sensor_zenith=(-70.0, 95.0)), WIDE)
    assert envelope.travel["sensor_zenith"] == (-70.0, 91.0)


def test_travels_without_anything_in_common_are_refused() -> None:
    limits = WIDE | {"sensor_azimuth": AxisLimits(200.0, 220.0, 10.0, 20.0)}
    with pytest.raises(SafetyError, match=r"sensor_azimuth.*nothing in common"):
        Envelope.of(Arms(), limits)


@pytest.mark.parametrize("distance", [0.0, 3.0, 4.99])
def test_a_point_in_the_cone_is_refused(distance: float) -> None:
    with pytest.raises(SafetyError, match="detector head would stand in the beam"):
        ENVELOPE.check_point(point(15.0, 0.0, 15.0 + distance), "point 1")


def test_a_point_on_the_rim_of_the_cone_is_allowed() -> None:
    assert ENVELOPE.check_point(point(15.0, 0.0, 20.0), "point 1") == Pose(15.0, 0.0, 20.0)


def test_a_turned_illumination_is_no_matter_of_the_arms() -> None:
    turned = point(15.0, 0.0, 40.0).model_copy(update={"illumination_azimuth": 30.0})
    with pytest.raises(InputError, match=r"illumination azimuth 30.*turn the sample"):
        ENVELOPE.check_point(turned, "point 1")


def test_no_way_at_all_is_said_with_both_ends() -> None:
    limits = WIDE | {
        "sensor_azimuth": AxisLimits(0.0, 0.0, 10.0, 20.0),
        "illumination_zenith": AxisLimits(0.0, 0.0, 10.0, 20.0),
    }
    envelope = Envelope.of(Arms(), limits)
    named = [("point 1", point(0.0, 0.0, 30.0)), ("point 2", point(0.0, 0.0, -30.0))]
    with pytest.raises(SafetyError, match=r"point 2: no way from .*sensor zenith 30 to .*sensor zenith -30"):
        check_plan(named, Pose(0.0, 0.0, 40.0), envelope)


def test_the_plan_of_the_artifact_needs_nine_ways_around_the_cone() -> None:
    grid = {0.0: (0, 45, 90, 135), 15.0: (0, 50, 75, 105, 130), 30.0: (0, 60, 120)}
    points = [point(i, float(a), 5.0 * z) for i, azimuths in grid.items() for a in azimuths for z in range(-16, 17)]
    points = [p for p in points if Pose.of(p).separation() >= 5.0 - 1e-6]
    assert len(points) == 390
    checked = check_plan([(f"point {i}", p) for i, p in enumerate(points)], Pose(0.0, 0.0, 0.0), ENVELOPE)
    assert checked.detours == 9
    assert 300.0 < checked.moving_time < 900.0


HEADS = Box("detector head against the source", Pose(40.0, 0.0, 50.0), Pose(90.0, 30.0, 90.0))


@settings(max_examples=40, deadline=None)
@given(start=poses, target=poses)
def test_no_way_leads_through_where_the_arms_would_touch(start: Pose, target: Pose) -> None:
    """Finely sampled, independently of how ways are searched for."""
    envelope = Envelope(ENVELOPE.travel, 5.0, keep_out=(HEADS,))
    assume(target.separation() >= 5.0 and not HEADS.touched(start) and not HEADS.touched(target))
    try:
        legs = envelope.route(start, target)
    except SafetyError:
        assume(False)
    pose = start
    for leg in legs:
        for step in np.linspace(leg.start, leg.target, 91):
            here = pose.moved(leg.axis, float(step))
            assert not all(low <= value <= high for low, value, high in zip(HEADS.low, here, HEADS.high, strict=True))
        pose = pose.moved(leg.axis, leg.target)
    assert pose == target


def test_a_way_is_found_around_what_stands_in_the_direct_one() -> None:
    low, high = Pose(-90.0, 60.0, 20.0), Pose(90.0, 80.0, 90.0)
    envelope = Envelope(ENVELOPE.travel, 5.0, keep_out=(Box("post", low, high),))
    legs = envelope.route(Pose(40.0, 30.0, 40.0), Pose(40.0, 120.0, 40.0))
    assert len(legs) == 3  # the sensor is lowered under the post, swung, and raised again
    assert [leg.axis for leg in legs] == ["sensor_zenith", "sensor_azimuth", "sensor_zenith"]
    assert legs[0].target < 20.0


def test_a_point_where_the_arms_would_touch_is_refused_by_name() -> None:
    envelope = Envelope(ENVELOPE.travel, 5.0, keep_out=(HEADS,))
    with pytest.raises(SafetyError, match=r"kept out \(detector head against the source\)"):
        envelope.check_point(point(50.0, 0.0, 80.0), "point 3")
    with pytest.raises(SafetyError, match="bring them out by hand"):
        envelope.route(Pose(50.0, 10.0, 60.0), Pose(0.0, 90.0, 30.0))


def test_the_facility_says_where_the_arms_would_touch() -> None:
    arms = Arms.model_validate({"keep_out": ({"name": "post", "sensor_azimuth": (0.0, 10.0)},)})
    limits = AxisLimits(-200.0, 200.0, 10.0, 10.0)
    envelope = Envelope.of(arms, dict.fromkeys(AXES, limits))
    assert envelope.keep_out[0].touched(Pose(0.0, 5.0, 30.0))
    assert not envelope.keep_out[0].touched(Pose(0.0, 11.0, 30.0))
    assert not envelope.clear(Pose(0.0, 20.0, 30.0), Leg("sensor_azimuth", 20.0, 10.0))
    with pytest.raises(ValidationError, match="at least one arm"):
        Arms.model_validate({"keep_out": ({"name": "everything"},)})
    with pytest.raises(ValidationError, match="from low to high"):
        Arms.model_validate({"keep_out": ({"sensor_azimuth": (10.0, 0.0)},)})
