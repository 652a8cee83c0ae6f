"""Targets reached from one side: which moves that takes, and that those keep to limits, cone and boxes."""

from __future__ import annotations

from itertools import pairwise

import pytest
from fake_bench import Bench
from hypothesis import given, settings
from hypothesis import strategies as st
from scan_stage import plan_of, stage

from drivers.arm import ArmForm
from drivers.forms import check_form
from drivers.interfaces import AxisLimits
from instrument.approach import Leg, one_sided
from instrument.durations import AXES, move_time
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Arms
from instrument.safety import Box, Envelope, Pose, check_plan

RISING = AxisLimits(-91.0, 91.0, 10.0, 20.0, approach=1, backlash=2.0)
FALLING = AxisLimits(-91.0, 91.0, 10.0, 20.0, approach=-1, backlash=2.0)


def envelope(sides: tuple[int, int, int], boxes: tuple[Box, ...] = (), cone: float = 5.0) -> Envelope:
    travel = dict(zip(AXES, ((-90.0, 90.0), (-5.0, 185.0), (-90.0, 90.0)), strict=True))
    speeds = {
        axis: AxisLimits(*travel[axis], 10.0, 20.0, approach=side, backlash=2.0 if side else 0.0)
        for axis, side in zip(AXES, sides, strict=True)
    }
    return Envelope(travel, cone, speeds, boxes)


@pytest.mark.parametrize(
    ("start", "target", "loose", "stops"),
    [
        (0.0, 30.0, False, [30.0]),  # the right way, engaged
        (0.0, 30.0, True, [30.0]),  # the right way, far enough to take up the play
        (30.0, 10.0, False, [8.0, 10.0]),  # the wrong way: beyond, and back
        (9.0, 10.0, False, [10.0]),  # a short step the right way, engaged
        (9.0, 10.0, True, [8.0, 10.0]),  # a short step from anywhere in the play
        (10.0, 10.0, False, []),
        (10.0, 10.0, True, [8.0, 10.0]),  # stands there, but nobody knows from which side
    ],
)
def test_an_arm_that_rises_to_its_targets(start: float, target: float, loose: bool, stops: list[float]) -> None:
    legs = one_sided(Leg("sensor_zenith", start, target), RISING, loose=loose)
    assert [leg.target for leg in legs] == stops
    assert [leg.overshoot for leg in legs] == [stop != target for stop in stops]
    mirrored = one_sided(Leg("sensor_zenith", -start, -target), FALLING, loose=loose)
    assert [-leg.target for leg in mirrored] == stops


zeniths = st.floats(-85.0, 85.0).map(lambda value: round(value, 1))
azimuths = st.floats(0.0, 180.0).map(lambda value: round(value, 1))
poses = st.builds(Pose, zeniths, azimuths, zeniths)
sides = st.tuples(*(st.sampled_from((-1, 0, 1)) for _ in AXES))
BOX = Box("post", Pose(-90.0, 60.0, 20.0), Pose(90.0, 80.0, 90.0))


@settings(deadline=None, max_examples=30)
@given(start=poses, targets=st.lists(poses, min_size=1, max_size=3), sides=sides, boxed=st.booleans())
def test_every_way_ends_on_the_right_side_and_never_leaves_what_is_allowed(
    start: Pose, targets: list[Pose], sides: tuple[int, int, int], boxed: bool
) -> None:
    allowed = envelope(sides, (BOX,) if boxed else ())
    wanted = [
        Geometry(wavelength=500, illumination_zenith=p[0], sensor_azimuth=p[1], sensor_zenith=p[2])
        for p in (start, *targets)
        if p.separation() >= 5.0 and not (boxed and BOX.touched(p))
    ]
    if not wanted:
        return
    plan = check_plan([(str(i), point) for i, point in enumerate(wanted)], Pose.of(wanted[0]), allowed)
    pose, last = plan.start, dict.fromkeys(AXES, 0.0)
    for legs, point in zip(plan.routes, wanted, strict=True):
        for leg in legs:
            assert getattr(pose, leg.axis) == leg.start
            low, high = allowed.travel[leg.axis]
            assert low <= leg.target <= high
            for share in (k / 20 for k in range(21)):
                here = pose.moved(leg.axis, leg.start + share * (leg.target - leg.start))
                assert here.separation() >= min(5.0, pose.separation()) - 2e-6
                assert not (boxed and BOX.touched(here))
            pose, last[leg.axis] = pose.moved(leg.axis, leg.target), leg.target - leg.start
        assert pose == Pose.of(point)
        # Whichever arm has an approach came from its side last; after the first point all of them have moved.
        assert all(last[axis] * side > 0 for axis, side in zip(AXES, sides, strict=True) if side)


def test_a_target_close_to_the_beam_is_approached_around_it() -> None:
    # From above, the arm would first have to go into the cone: azimuth aside, then down, then back.
    allowed = envelope((0, 0, 1))
    legs = allowed.route(Pose(0.0, 0.0, 40.0), Pose(0.0, 0.0, 6.0))
    assert max(abs(leg.target) for leg in legs if leg.axis == "sensor_zenith" and leg.overshoot) <= 90
    assert legs[-1] != Leg("sensor_zenith", 4.0, 6.0)
    pose = Pose(0.0, 0.0, 40.0)
    for leg in legs:
        assert allowed.clear(pose, leg)
        pose = pose.moved(leg.axis, leg.target)
    assert pose == Pose(0.0, 0.0, 6.0)


def test_an_approach_for_which_there_is_no_room_is_refused_by_name() -> None:
    allowed = Envelope.of(Arms(), dict.fromkeys(AXES, FALLING))
    point = Geometry(wavelength=500, illumination_zenith=0, sensor_azimuth=0, sensor_zenith=89)
    with pytest.raises(InputError, match=r"point 7: sensor_zenith: 89 degrees cannot be reached on falling angles.*91"):
        allowed.check_point(point, "point 7")


def test_the_way_beyond_counts_in_the_duration() -> None:
    point = [
        ("1", Geometry(wavelength=500, illumination_zenith=0, sensor_azimuth=0, sensor_zenith=z)) for z in (30, 60)
    ]
    one = check_plan(point, Pose(0.0, 0.0, 20.0), envelope((0, 0, -1)))
    # 20 -> 32 -> 30 -> 62 -> 60; the other arms have no approach.
    expected = sum(move_time(way, RISING) for way in (12.0, 2.0, 32.0, 2.0))
    assert one.moving_time == pytest.approx(expected)
    assert one.detours == 0


def test_a_scan_reaches_every_point_from_one_side_and_keeps_to_it_in_small_steps(tmp_path) -> None:
    bench = Bench()
    axis = bench.axes["sensor_zenith"]
    axis.limits = AxisLimits(-91.0, 91.0, 20.0, 40.0, approach=-1, backlash=1.0)
    s = stage(tmp_path, plan_of(azimuth=(0.0, 45.0), zenith=(30.0, 29.5, 10.0)), bench)
    assert s.run().outcome == "finished"
    assert not bench.wrong
    # Up to the reference, and beyond 30 once a sweep; falling steps need nothing more.
    assert axis.commands == [16.0, 15.0, 31.0, 30.0, 29.5, 10.0, 31.0, 30.0, 29.5, 10.0]
    moves = list(pairwise([0.0, *axis.commands]))
    assert all(b < a for a, b in moves if b in (15.0, 30.0, 29.5, 10.0))


def test_after_a_move_that_failed_the_play_is_taken_up_anew(tmp_path) -> None:
    bench = Bench()
    axis = bench.axes["sensor_zenith"]
    axis.limits = AxisLimits(-91.0, 91.0, 20.0, 40.0, approach=-1, backlash=1.0)
    axis.script.extend(["ok"] * 4 + ["half"])  # on the way from 30 to 29 it stands still: the point is given up
    s = stage(tmp_path, plan_of(zenith=(30.0, 29.0, 28.9)), bench)
    assert s.run().outcome == "finished"
    assert axis.commands == [16.0, 15.0, 31.0, 30.0, 29.0, 29.9, 28.9]
    assert not bench.wrong


def test_approach_and_backlash_are_configured_together() -> None:
    usual = {"lower": -90.0, "upper": 90.0, "velocity": 10.0, "acceleration": 10.0}
    form = check_form(usual | {"approach": "falling", "backlash": 0.5}, ArmForm, "devices.toml")
    assert (form.limits.approach, form.limits.backlash) == (-1, 0.5)
    assert check_form(usual, ArmForm, "devices.toml").limits.approach == 0
    for wrong, expected in (
        ({"approach": "rising"}, "belong together"),
        ({"backlash": 0.5}, "belong together"),
        ({"approach": "rising", "backlash": 0.01}, "more than twice the tolerance"),
        ({"approach": "above", "backlash": 0.5}, "approach"),
        ({"approach": "rising", "backlash": -0.5}, "backlash"),
    ):
        with pytest.raises(Exception, match=expected):
            check_form(usual | wrong, ArmForm, "devices.toml")
