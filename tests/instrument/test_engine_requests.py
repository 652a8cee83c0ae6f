"""What people ask of a running scan: pause, resume, abort, halt, and an interlock that they open."""

from __future__ import annotations

from pathlib import Path

import pytest
from scan_stage import QUICK, plan_of, stage

from instrument.events import Message, PointMeasured, PointStarted, StateChanged
from instrument.light import LightLost


def measured(s) -> list[int]:
    return [event.index for event in s.events(PointMeasured)]


def test_an_opened_interlock_suspends_the_scan_until_a_person_resumes_it(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(lambda e: isinstance(e, PointStarted) and e.index == 1, lambda: s.bench.source.trip("interlock open: door"))
    dark = []

    def back() -> None:
        dark.append((s.bench.source.on, s.bench.shutter.opened))
        s.bench.source.trouble = ""
        s.engine.resume()

    s.when(lambda e: isinstance(e, StateChanged) and e.new == "suspended", back)
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert dark == [(False, False)]
    assert any("interlock open: door" in e.text for e in s.events(Message))


def test_a_suspension_that_nobody_ends_becomes_a_fault(tmp_path: Path) -> None:
    s = stage(tmp_path, settings=QUICK.model_copy(update={"suspend_limit_wall": 0.2}))
    s.when(lambda e: isinstance(e, PointStarted) and e.index == 1, lambda: s.bench.source.trip("interlock open"))
    end = s.run()
    assert end.outcome == "faulted"
    assert isinstance(s.engine.error, LightLost)
    assert s.bench.safe


def test_pause_after_the_point_and_resume(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(lambda e: isinstance(e, PointStarted) and e.index == 0, s.engine.pause)
    seen = []

    def paused() -> None:
        seen.append((measured(s), s.bench.shutter.opened, s.bench.source.on))
        s.engine.resume()

    s.when(lambda e: isinstance(e, StateChanged) and e.new == "paused", paused)
    end = s.run()
    assert seen == [([0], False, True)]
    assert (end.outcome, end.done) == ("finished", 3)
    assert [event.quality_flag for event in s.events(PointMeasured)] == [0, 0, 0]


def test_pause_now_stops_the_arm_and_the_point_is_measured_afterwards(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of(zenith=(80.0, -80.0), azimuth=(90.0,)))
    still = []
    s.when(lambda e: isinstance(e, PointStarted) and e.index == 1, lambda: s.engine.pause(now=True))

    def paused() -> None:
        still.append(not any(axis.busy() for axis in s.bench.axes.values()))
        s.engine.resume()

    s.when(lambda e: isinstance(e, StateChanged) and e.new == "paused", paused)
    end = s.run()
    assert still == [True]
    assert (end.outcome, end.done) == ("finished", 2)
    assert s.bench.wrong == []


@pytest.mark.parametrize(("ask", "outcome"), [("abort", "aborted"), ("halt", "halted")])
def test_ending_early_keeps_what_is_measured(tmp_path: Path, ask: str, outcome: str) -> None:
    s = stage(tmp_path, run_file=True)
    s.when(lambda e: isinstance(e, PointMeasured) and e.index == 0, lambda: getattr(s.engine, ask)("enough"))
    end = s.run()
    assert (end.outcome, end.reason) == (outcome, "enough")
    assert 1 <= end.done < 3
    assert end.run_file is not None
    assert s.bench.safe
    assert s.engine.error is None
    again = stage(tmp_path)
    assert again.run().done == 3


def test_abort_while_the_operator_takes_his_time(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.operator.ready.clear()
    s.when(lambda e: isinstance(e, StateChanged) and e.new == "mounting", lambda: s.engine.abort("changed my mind"))
    end = s.run()
    s.operator.ready.set()
    assert end.outcome == "aborted"
    assert end.run_file is None


def test_an_operator_who_gives_up_ends_the_scan_in_an_orderly_way(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.operator.gives_up = True
    end = s.run()
    assert end.outcome == "aborted"
    assert "reference" in end.reason
    assert s.bench.safe
