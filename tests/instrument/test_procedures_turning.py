"""Illumination azimuths set by hand: the arms stand where the turned sample sees them as planned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fake_bench import Bench
from hypothesis import given
from hypothesis import strategies as st
from scan_stage import FACILITY, plan_of, stage

from instrument.angles import angle_between, direction
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.prompts import Prompt
from instrument.safety import Pose
from instrument.turning import position_at_start, require_turnable


def geometry(illumination: float, azimuth: float, zenith: float, sensor_azimuth: float) -> Geometry:
    return Geometry(
        wavelength=500.0,
        illumination_zenith=illumination,
        illumination_azimuth=azimuth,
        sensor_zenith=zenith,
        sensor_azimuth=sensor_azimuth,
    )


@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-80, 80), st.floats(0, 180))
def test_the_turned_sample_sees_both_arms_as_planned(illumination, azimuth, zenith, sensor_azimuth):
    """Directions in the laboratory, turned by plus the azimuth into the sample's frame, are those of the plan."""
    planned = geometry(illumination, azimuth, zenith, sensor_azimuth)
    pose = Pose.of(planned)
    assert 0.0 <= pose.sensor_azimuth <= 180.0
    for seen, wanted in (
        ((pose.illumination_zenith, azimuth), (illumination, azimuth)),
        ((pose.sensor_zenith, pose.sensor_azimuth + azimuth), (zenith, sensor_azimuth)),
    ):
        np.testing.assert_allclose(direction(*seen), direction(*wanted), atol=1e-9)
    apart = angle_between(direction(illumination, azimuth), direction(zenith, sensor_azimuth))
    assert pose.separation() == pytest.approx(float(apart), abs=1e-4)


def test_an_instrument_without_a_stage_refuses_and_one_with_it_keeps_to_its_range():
    turned = geometry(15.0, 30.0, 40.0, 0.0)
    with pytest.raises(InputError, match="turn the sample"):
        require_turnable(turned, None, "point 1")
    with pytest.raises(InputError, match="expected -20 to 20"):
        require_turnable(turned, (-20.0, 20.0), "point 1")
    require_turnable(turned, (-45.0, 45.0), "point 1")
    require_turnable(geometry(15.0, 0.0, 40.0, 0.0), None)


def test_nobody_knows_where_the_stage_stands_when_a_plan_turns_it():
    assert position_at_start([geometry(15.0, 0.0, 40.0, 0.0)]) == 0.0
    assert position_at_start([geometry(15.0, 0.0, 40.0, 0.0), geometry(15.0, 30.0, 40.0, 0.0)]) is None


class Hands:
    """Changes and turns the sample; the light has to be off meanwhile."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.turns = bench, list[str]()

    def mount(self, what: str) -> None:
        self.bench.mount(what)

    def reply(self, prompt: Prompt) -> None:
        if prompt.key.startswith("turn:"):
            assert self.bench.safe
            self.turns.append(prompt.key)


def test_a_scan_has_the_sample_turned_once_for_each_azimuth_and_records_it(tmp_path: Path):
    arms = FACILITY.arms.model_copy(update={"illumination_azimuth": (-90.0, 90.0)})
    facility = FACILITY.model_copy(update={"arms": arms})
    plan = plan_of(illumination=(20.0,), zenith=(40.0, 60.0))
    turned = tuple(point.model_copy(update={"illumination_azimuth": 30.0}) for point in plan.points)
    plan = type(plan)(**{**plan.__dict__, "points": plan.points + turned})
    scan = stage(tmp_path, plan, facility=facility)
    hands = Hands(scan.bench)
    scan.engine._steps._operator = hands
    end = scan.run()
    assert (end.outcome, end.done) == ("finished", 4), end.reason
    assert hands.turns == ["turn:0", "turn:30"]
    assert scan.bench.wrong == []
    content = scan.journal()
    told = [record["key"] for record in content.others if record["kind"] == "confirmation"]
    assert told == ["start-source", "turn:0", "turn:30"]
    last = content.points[3]
    assert last["geometry"]["illumination_azimuth"] == 30.0
    # Azimuth 0 of the sample's frame lies at -30 degrees in the laboratory: 150, at the opposite zenith.
    assert last["readback"]["sensor_azimuth"] == pytest.approx(150.0, abs=0.01)
    assert last["readback"]["sensor_zenith"] == pytest.approx(-60.0, abs=0.01)


def test_where_nobody_can_turn_the_sample_nothing_is_measured_wrong(tmp_path: Path):
    arms = FACILITY.arms.model_copy(update={"illumination_azimuth": (-90.0, 90.0)})
    plan = plan_of(illumination=(20.0,), zenith=(40.0,))
    turned = tuple(point.model_copy(update={"illumination_azimuth": 30.0}) for point in plan.points)
    scan = stage(
        tmp_path, type(plan)(**{**plan.__dict__, "points": turned}), facility=FACILITY.model_copy(update={"arms": arms})
    )
    end = scan.run()
    assert (end.outcome, end.done) == ("faulted", 0)
    assert "nobody is there to answer" in end.reason
    assert scan.bench.safe
