"""Every way in which an arm fails a scan: a safe hold, a true record, and words that name arm and remedy."""

from __future__ import annotations

from pathlib import Path

import pytest
from fake_bench import FakeAxis
from scan_stage import Stage, plan_of, stage

from drivers.interfaces import Reading
from instrument.events import Message, PointMeasured, PointStarted

AXES = ("illumination_zenith", "sensor_azimuth", "sensor_zenith")
PLAN = {"illumination": (0.0, 15.0), "azimuth": (60.0, 90.0), "zenith": (30.0, 20.0)}


def scan(tmp_path: Path, **options) -> Stage:
    return stage(tmp_path, plan_of(**PLAN), **options)


def strike_in_the_second_point(s: Stage, strike) -> None:
    s.when(lambda event: isinstance(event, PointStarted) and event.index == 1, strike)


def words(s: Stage, reason: str) -> str:
    return "\n".join([reason, *(f"{e.text} ({e.advice})" for e in s.events(Message) if e.level != "info"),
                      *(record["reason"] for record in s.journal().skipped.values())])  # fmt: skip


def assert_the_record_is_true(s: Stage, total: int) -> None:
    """What is measured was measured where it says; the rest is named as missing."""
    journal = s.journal()
    for record in journal.points.values():
        for name in AXES:
            assert abs(record["readback"][name] - record["geometry"][name]) <= FakeAxis.tolerance
    ended = next(record for record in reversed(journal.others) if record["kind"] == "ended")
    assert sorted([*journal.points, *journal.skipped, *ended["not_reached"]]) == list(range(total))
    assert s.bench.safe
    assert s.bench.wrong == []


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize(
    ("fate", "told"),
    [
        ("alarm", "overload (30h) (clear the fault at the drive, then resume the run)"),
        ("lost_zero", "the axis has lost its zero (resume the run: it is homed again)"),
    ],
)
def test_a_fault_of_a_drive_ends_in_a_safe_hold_and_the_run_goes_on_later(
    tmp_path: Path, name: str, fate: str, told: str
) -> None:
    s = scan(tmp_path)
    strike_in_the_second_point(s, lambda: s.bench.axes[name].script.append(fate))
    end = s.run()
    assert end.outcome == "faulted"
    assert f"{name}: {told}" in end.reason
    assert_the_record_is_true(s, 8)
    for arm in s.bench.axes.values():  # a person deals with it; the zero stays lost where it was
        arm.fault = ""
        arm.script.clear()
    measured = len(s.journal().points)
    s.bench.log.clear()
    s.bench.closed = False
    again = scan(tmp_path, bench=s.bench)
    end = again.run()
    assert (end.outcome, end.done) == ("finished", 8)
    assert len(again.events(PointMeasured)) == 8 - measured
    assert [entry for entry in s.bench.log if entry.startswith("home")] == (
        [f"home {name}"] if fate == "lost_zero" else []
    )
    assert_the_record_is_true(again, 8)


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize(
    ("fates", "told"),
    [
        (["half"], "stands still"),  # the drive claims arrival and stands somewhere else
        (["hangs"] * 2, "it has not arrived"),  # the drive claims to move and does not
        (["ignored"] * 2, "instead of moving"),  # twice: the new command has no effect either
    ],
)
def test_an_arm_that_stalls_or_lies_costs_points_and_never_a_wrong_one(
    tmp_path: Path, name: str, fates: list[str], told: str
) -> None:
    s = scan(tmp_path)
    strike_in_the_second_point(s, lambda: s.bench.axes[name].script.extend(fates))
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 7)
    said = words(s, end.reason)
    assert f"{name}: " in said
    assert told in said
    assert "look at the arm and its drive before going on" in said
    assert_the_record_is_true(s, 8)


def test_an_arm_that_is_pushed_away_during_the_reading_is_no_point(tmp_path: Path) -> None:
    s = scan(tmp_path)
    arm, read = s.bench.axes["sensor_zenith"], s.bench.detector.read

    def pushed(samples: int) -> Reading:
        found = read(samples)
        if len(s.journal().points) == 1 and not s.journal().skipped:
            arm._from = arm._to = arm.place() + 0.5  # with the light, and once more in the dark
        return found

    s.bench.detector.read = pushed  # type: ignore[method-assign]
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 7)
    assert "sensor_zenith: it moved during the reading: it stands at 21.0000 instead of 20 degrees" in words(s, "")
    assert_the_record_is_true(s, 8)
