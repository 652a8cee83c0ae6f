"""Rests that a scan takes by itself: what is amiss costs time and no data, and never for ever."""

from __future__ import annotations

import threading
from collections import namedtuple
from pathlib import Path
from typing import Any

import pytest
from scan_stage import QUICK, Stage, plan_of, stage

from drivers.errors import CommunicationError
from drivers.interfaces import Reading
from instrument import hindrances
from instrument.events import Message, PointMeasured, PointSkipped, PointStarted, StateChanged
from instrument.hindrances import ContactLost, LightLost

DEVICES = ("illumination_zenith", "sensor_azimuth", "sensor_zenith", "source", "selector", "shutter", "detector")


def at_point(index: int) -> Any:
    return lambda event: isinstance(event, PointStarted) and event.index == index


def suspended(event: Any) -> bool:
    return isinstance(event, StateChanged) and event.new == "suspended"


def device_of(s: Stage, name: str) -> Any:
    return s.bench.axes.get(name) or getattr(s.bench, name)


def suspensions(s: Stage) -> int:
    return sum(suspended(event) for event in s.events(StateChanged))


def every_point_once(s: Stage) -> bool:
    return sorted(event.index for event in s.events(PointMeasured)) == sorted(s.journal().points) == [0, 1, 2]


@pytest.mark.parametrize("name", [*DEVICES, "amplifier"])
def test_a_cable_that_is_out_for_a_while_costs_time_and_no_data(tmp_path: Path, name: str) -> None:
    s = stage(tmp_path)
    device = device_of(s, name)
    homings: list[int] = []
    s.when(at_point(1), lambda: setattr(device, "unplugged", True))

    def back() -> None:
        homings.append(len([entry for entry in s.bench.log if entry.startswith("home")]))
        device.unplugged = False

    s.when(suspended, lambda: threading.Timer(0.2, back).start())
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert every_point_once(s)
    assert suspensions(s) >= 1
    assert s.bench.wrong == []
    assert s.bench.safe
    assert any(name in event.text and event.level == "error" for event in s.events(Message))
    assert [entry.startswith("home") for entry in s.bench.log].count(True) == homings[0] == 3


def test_an_arm_that_comes_back_without_its_zero_is_homed_before_it_moves(tmp_path: Path) -> None:
    s = stage(tmp_path)
    axis = s.bench.axes["sensor_zenith"]
    s.when(at_point(1), lambda: setattr(axis, "unplugged", True))

    def back() -> None:
        axis.homed = False
        axis.unplugged = False

    s.when(suspended, back)
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert s.bench.wrong == []  # the bench sees every arm that is moved without its zero
    assert s.bench.log.count("home sensor_zenith") == 2
    assert any("lost its zero" in event.text for event in s.events(Message))


def test_a_device_that_stays_away_ends_the_scan_after_the_limit(tmp_path: Path) -> None:
    s = stage(tmp_path, settings=QUICK.model_copy(update={"suspend_limit_wall": 0.2}))
    s.when(at_point(1), lambda: setattr(s.bench.detector, "unplugged", True))
    end = s.run()
    assert end.outcome == "faulted"
    assert isinstance(s.engine.error, ContactLost)
    assert "detector" in end.reason
    assert not s.bench.source.on
    assert not s.bench.shutter.opened
    assert suspensions(s) == 1


def test_a_device_that_answers_and_never_measures_does_not_hold_the_scan_for_ever(tmp_path: Path) -> None:
    s = stage(tmp_path)
    detector, honest = s.bench.detector, s.bench.detector.read

    def mute(samples: int) -> Reading:
        raise CommunicationError("detector", "no reply")

    s.when(at_point(1), lambda: setattr(detector, "read", mute))
    s.when(lambda e: isinstance(e, PointSkipped), lambda: setattr(detector, "read", honest))
    end = s.run()
    assert end.outcome == "finished"
    assert set(s.journal().skipped) >= {1}
    assert suspensions(s) == ContactLost.tries * len(s.journal().skipped)


def test_abort_ends_a_scan_that_waits_for_a_cable(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(at_point(1), lambda: setattr(s.bench.axes["sensor_zenith"], "unplugged", True))
    s.when(suspended, lambda: s.engine.abort("enough"))
    end = s.run()
    assert end.outcome == "aborted"
    assert not s.bench.source.on
    assert not s.bench.shutter.opened


@pytest.mark.parametrize("who", ["person", "self"])
def test_a_closed_interlock_lets_the_scan_go_on_by_whom_the_settings_name(tmp_path: Path, who: str) -> None:
    s = stage(tmp_path, settings=QUICK.model_copy(update={"relight": who}))
    s.when(at_point(1), lambda: s.bench.source.trip("interlock open: door"))
    s.when(suspended, lambda: setattr(s.bench.source, "trouble", ""))
    dark: list[bool] = []

    def may_come_back() -> None:
        dark.append(not s.bench.source.on)
        s.engine.resume()

    if who == "person":
        s.when(lambda e: isinstance(e, Message) and "no fault any more" in e.text, may_come_back)
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert dark == ([True] if who == "person" else [])


def test_a_class_4_source_does_not_come_back_without_a_person(tmp_path: Path) -> None:
    s = stage(tmp_path, settings=QUICK.model_copy(update={"suspend_limit_wall": 0.3}))
    s.when(at_point(1), lambda: s.bench.source.trip("interlock open: door"))
    s.when(suspended, lambda: setattr(s.bench.source, "trouble", ""))
    end = s.run()
    assert end.outcome == "faulted"
    assert isinstance(s.engine.error, LightLost)
    assert s.bench.safe


def test_a_pause_that_a_person_wants_outlasts_the_cause(tmp_path: Path) -> None:
    s = stage(tmp_path)
    cable = s.bench.detector
    s.when(at_point(1), lambda: setattr(cable, "unplugged", True))
    seen: list[str] = []

    def pause_and_plug() -> None:
        s.engine.pause()
        cable.unplugged = False
        threading.Timer(0.3, look).start()

    def look() -> None:
        seen.append(str(s.engine.state))
        s.engine.resume()

    s.when(suspended, pause_and_plug)
    end = s.run()
    assert seen == ["suspended"]
    assert (end.outcome, end.done) == ("finished", 3)


def test_a_disk_that_fills_up_suspends_until_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    free = [1e12]
    monkeypatch.setattr(hindrances.shutil, "disk_usage", lambda _: usage(1e12, 0, free[0]))
    s = stage(tmp_path, settings=QUICK.model_copy(update={"disk_reserve": 100.0}))
    s.when(lambda e: isinstance(e, PointMeasured) and e.index == 0, lambda: free.__setitem__(0, 99e6))
    s.when(suspended, lambda: free.__setitem__(0, 101e6))
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert suspensions(s) == 1
    assert any("99 MB are free" in event.text and "by itself" in event.advice for event in s.events(Message))


def test_unstable_light_is_waited_for_and_no_reading_of_it_is_kept(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(at_point(1), lambda: setattr(s.bench.detector, "noise", 2.0))
    s.when(suspended, lambda: setattr(s.bench.detector, "noise", 1e-4))
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert suspensions(s) == 1
    assert all(event.brf == pytest.approx(0.4, rel=0.2) for event in s.events(PointMeasured))


def test_light_that_stays_unstable_marks_the_point(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of())
    s.when(at_point(1), lambda: setattr(s.bench.detector, "noise", 2.0))
    s.when(lambda e: isinstance(e, PointSkipped), lambda: setattr(s.bench.detector, "noise", 1e-4))
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 2)
    assert "scatter by" in s.events(PointSkipped)[0].reason


def test_light_that_saturates_the_detector_for_a_while_costs_no_point(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(at_point(1), lambda: s.bench.reflectance.update(sample=1e5))
    s.when(suspended, lambda: s.bench.reflectance.update(sample=0.4))
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert suspensions(s) == 1
