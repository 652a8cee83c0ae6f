"""Faults of axes, meter, shutter and disk under the scan engine: what is tried again, marked or given up."""

from __future__ import annotations

from pathlib import Path

import pytest
from fake_bench import Bench
from scan_stage import plan_of, stage

from drivers.errors import CommunicationError, DeviceFault
from instrument.engine import InstrumentFaulty
from instrument.events import Message, PointMeasured, PointSkipped, PointStarted, ScanStarted


def measured(s) -> list[int]:
    return [event.index for event in s.events(PointMeasured)]


@pytest.mark.parametrize("fate", ["lost_taken", "lost_dropped"])
def test_a_lost_reply_to_a_move_costs_no_point(tmp_path: Path, fate: str) -> None:
    s = stage(tmp_path)
    s.bench.axes["sensor_zenith"].script.extend(["ok", fate])
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert s.bench.wrong == []
    notes = [r["text"] for r in s.journal().others if r["kind"] == "note"]
    assert any("the reply to the command was lost" in note for note in notes)


@pytest.mark.parametrize("fate", ["ignored", "hangs"])
def test_an_axis_that_does_not_start_gets_one_new_command(tmp_path: Path, fate: str) -> None:
    s = stage(tmp_path)
    axis = s.bench.axes["sensor_zenith"]
    axis.script.extend(["ok", "ok", fate])
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert axis.commands.count(20.0) == 2
    assert any("one new command is sent" in e.text for e in s.events(Message))


def test_an_axis_that_stalls_half_way_gets_no_new_command_and_its_point_is_marked(tmp_path: Path) -> None:
    s = stage(tmp_path)
    axis = s.bench.axes["sensor_zenith"]
    axis.script.extend(["ok", "ok", "half"])
    end = s.run()
    assert (end.outcome, end.done, end.total) == ("finished", 2, 3)
    assert axis.commands.count(20.0) == 1
    (skipped,) = s.events(PointSkipped)
    assert skipped.index == 1
    assert "stands still at 25" in skipped.reason
    assert set(s.journal().skipped) == {1}
    assert "1 of 3 points" in end.reason


def test_an_axis_that_never_moves_again_ends_the_scan_honestly(tmp_path: Path) -> None:
    plan = plan_of(zenith=tuple(float(z) for z in range(70, 9, -10)))
    s = stage(tmp_path, plan)
    axis = s.bench.axes["sensor_zenith"]
    s.when(lambda e: isinstance(e, PointMeasured) and e.index == 1, lambda: setattr(axis, "always", "ignored"))
    end = s.run()
    assert end.outcome == "faulted"
    assert isinstance(s.engine.error, InstrumentFaulty)
    journal = s.journal()
    ended = journal.others[-2]
    assert ended["kind"] == "ended"
    assert len(journal.skipped) == 3
    accounted = sorted([*journal.points, *journal.skipped, *ended["not_reached"]])
    assert accounted == list(range(7))
    assert s.bench.safe


def test_an_alarm_ends_the_scan_and_the_rest_is_resumed_later(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.bench.axes["sensor_zenith"].script.extend(["ok", "ok", "alarm"])
    end = s.run()
    assert end.outcome == "faulted"
    assert isinstance(s.engine.error, DeviceFault)
    assert "overload (30h)" in end.reason
    again = stage(tmp_path)
    end = again.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert measured(again) == [1, 2]
    assert again.events(ScanStarted)[0].done == (0,)
    assert again.bench.log.count("mount reference") == 0
    assert sorted(again.journal().points) == [0, 1, 2]
    assert len(again.journal().references) == 4


def test_a_point_marked_before_is_tried_again_on_resumption(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.bench.axes["sensor_zenith"].script.extend(["ok", "ok", "half"])
    s.run()
    again = stage(tmp_path)
    end = again.run()
    assert measured(again) == [1]
    assert (end.outcome, end.done) == ("finished", 3)
    assert again.journal().skipped == {}


def test_a_lost_reading_is_asked_for_again_and_flagged(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(lambda e: isinstance(e, PointStarted) and e.index == 1, lambda: setattr(s.bench.detector, "lost_replies", 1))
    end = s.run()
    assert end.done == 3
    assert [event.quality_flag for event in s.events(PointMeasured)].count(8) == 1


def test_a_mute_meter_costs_time_and_no_point(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(lambda e: isinstance(e, PointStarted) and e.index == 1, lambda: setattr(s.bench.detector, "lost_replies", 3))
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert s.events(PointSkipped) == []


def test_a_fault_at_the_start_moves_nothing(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.bench.source.trouble = "interlock open: key switch"
    end = s.run()
    assert end.outcome == "faulted"
    assert "key switch" in end.reason
    assert s.bench.log == []


def test_a_laboratory_that_cannot_be_reached_ends_the_scan(tmp_path: Path) -> None:
    bench = Bench()

    def unreachable():
        raise CommunicationError("detector", "line 'meter' cannot be opened", "check the cable")

    bench.laboratory = unreachable  # type: ignore[method-assign]
    s = stage(tmp_path, bench=bench)
    end = s.run()
    assert end.outcome == "faulted"
    assert "meter" in end.reason


def test_a_shutter_that_sticks_open_is_never_called_safe(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(lambda e: isinstance(e, PointStarted) and e.index == 1, lambda: setattr(s.bench.shutter, "stuck", True))
    end = s.run()
    assert end.outcome == "faulted"
    assert "shutter" in end.reason
    assert not s.bench.source.on
    assert any("not brought into its safe state" in e.text for e in s.events(Message))
    assert s.bench.wrong == []


def test_a_full_disk_ends_the_scan_safely(tmp_path: Path) -> None:
    s = stage(tmp_path)

    def full() -> None:
        def refuse(*_: object, **__: object) -> None:
            raise OSError(28, "No space left on device")

        s.engine._job.journal.record = refuse  # type: ignore[method-assign]

    s.when(lambda e: isinstance(e, PointStarted) and e.index == 1, full)
    end = s.run()
    assert end.outcome == "faulted"
    assert "No space left" in end.reason
    assert s.bench.safe
