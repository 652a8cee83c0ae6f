"""Where the axes stand, told while they move: for whoever watches, and at no cost to the scan."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import pytest
from fake_bench import Bench
from scan_stage import plan_of, stage

from drivers.clock import Clock
from drivers.errors import CommunicationError
from instrument.bus import EventBus
from instrument.control import Controls
from instrument.events import AxesRead, PointMeasured, PointStarted, from_json, to_json
from instrument.motion import Mover
from instrument.settings import MotionSettings
from instrument.sightings import Sightings


def mover_of(bench: Bench, sightings: Sightings) -> Mover:
    for axis in bench.axes.values():
        axis.homed = True
    settings = MotionSettings(wire_wall=0.02, poll_wall=0.0005)
    return Mover(bench.axes, bench.clock, Controls(bench.clock), [].append, settings, sightings)


def test_an_arm_is_seen_on_its_way_and_at_its_end() -> None:
    bench, seen = Bench(Clock(20.0)), []
    arrived = mover_of(bench, Sightings(seen.append, every_wall=0.0)).move("sensor_zenith", 60.0)
    places = [positions["sensor_zenith"] for positions in seen]
    assert any(1.0 < place < 59.0 for place in places)
    assert places[-1] == arrived == pytest.approx(60.0, abs=0.01)
    assert all(one <= other + 0.01 for one, other in pairwise(places))


def test_a_look_that_is_not_answered_is_no_trouble_of_the_move(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, seen = Bench(Clock(20.0)), []
    axis = bench.axes["sensor_zenith"]
    asked = axis.position

    def mute_while_moving() -> float:
        if axis.busy():
            raise CommunicationError(axis.name, "no reply", "check the cable")
        return asked()

    mover = mover_of(bench, Sightings(seen.append, every_wall=0.0))
    monkeypatch.setattr(axis, "position", mute_while_moving)
    assert mover.move("sensor_zenith", 60.0) == pytest.approx(60.0, abs=0.01)
    assert axis.commands == [60.0]
    assert [positions["sensor_zenith"] for positions in seen] == pytest.approx([60.0], abs=0.01)


def test_nobody_is_told_more_often_than_wanted_and_the_end_of_the_way_is_always_told() -> None:
    seen = []
    sightings = Sightings(seen.append, every_wall=3600.0)
    for place in (1.0, 2.0, 3.0):
        sightings.told({"sensor_zenith": place})
    sightings.arrived()
    sightings.arrived()  # nothing new
    assert seen == [{"sensor_zenith": 1.0}, {"sensor_zenith": 3.0}]


def test_without_a_listener_no_drive_is_asked() -> None:
    bench = Bench()
    bench.axes["sensor_zenith"].unplugged = True
    Sightings(None, every_wall=0.0).look(bench.axes["sensor_zenith"])


def test_before_a_point_is_read_its_arms_are_told_to_stand_there(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of(illumination=(0.0, 15.0), azimuth=(0.0, 90.0), zenith=(20.0, -10.0)))
    bus_events = []
    s.bus.subscribe(bus_events.append, "watcher")
    s.run()  # which ends with every listener having heard everything
    latest: dict[str, float] = {}
    checked = 0
    for event in bus_events:
        if isinstance(event, AxesRead):
            latest = event.positions
        elif isinstance(event, PointMeasured):
            wanted = event.geometry.model_dump(include=set(latest))
            assert latest == pytest.approx(wanted, abs=0.01)
            checked += 1
    assert checked == 8
    assert sum(isinstance(event, PointStarted) for event in bus_events) == 8
    assert "axes_read" not in (s.run_dir / "journal.jsonl").read_text()


def test_positions_pass_by_whoever_comes_later() -> None:
    bus, late = EventBus(), []
    event = AxesRead(time=datetime.now(UTC), positions={"sensor_zenith": 12.5})
    bus.publish(event)
    bus.subscribe(late.append)
    bus.publish(event)
    assert bus.drain()
    bus.close()
    assert late == [event]
    assert bus.history == ()
    assert from_json(to_json(event)) == event
