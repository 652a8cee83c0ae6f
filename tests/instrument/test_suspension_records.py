"""What the journal says of a scan that rested by itself: why, how long, and that nothing was measured meanwhile."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from fake_bench import FULL_CURRENT
from scan_stage import QUICK, Stage, stage

from instrument import hindrances
from instrument.dataset import run_of_journal
from instrument.events import PointStarted, StateChanged
from instrument.settings import ScanSettings
from instrument.states import State

FREE = namedtuple("FREE", "total used free")


@dataclass
class Cause:
    """Something that keeps a scan from measuring, and how it comes and goes."""

    name: str
    come: Callable[[Stage], Any]
    go: Callable[[Stage], Any]
    said: str
    dark: bool  # the source is off meanwhile


def _trip(s: Stage) -> None:
    s.bench.source.trip("interlock open: door")


def _close(s: Stage) -> None:
    s.bench.source.trouble = ""


def _noise(volts: float) -> Callable[[Stage], None]:
    return lambda s: setattr(s.bench.detector, "noise", volts)


def _bright(brf: float) -> Callable[[Stage], None]:
    return lambda s: s.bench.reflectance.update(sample=brf)


def _room(free: float) -> Callable[[Stage], None]:
    return lambda s: setattr(s, "free", free)


CAUSES = [
    Cause("interlock", _trip, _close, "interlock open: door", True),
    Cause("unstable source", _noise(2.0), _noise(1e-4), "the samples of one reading scatter by", False),
    Cause("saturated detector", _bright(1e5), _bright(0.4), "at the lowest gain", False),
    Cause("full disk", _room(50e6), _room(1e12), "50 MB are free; expected at least 100 MB", False),
]
SETTINGS: ScanSettings = QUICK.model_copy(
    update={
        "relight": "self",
        "disk_reserve": 100.0,
        "suspend_limit_wall": 0.4,
        "recovery": 5.0,
        "failures_in_a_row": 2,
    }
)


@pytest.fixture
def scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stage:
    s = stage(tmp_path, settings=SETTINGS)
    s.free = 1e12  # type: ignore[attr-defined]
    monkeypatch.setattr(hindrances.shutil, "disk_usage", lambda _: FREE(1e12, 0, s.free))  # type: ignore[attr-defined]
    return s


def suspended(event: Any) -> bool:
    return isinstance(event, StateChanged) and event.new == "suspended"


def second_point(event: Any) -> bool:
    return isinstance(event, PointStarted) and event.index == 1


def states(s: Stage) -> list[dict[str, Any]]:
    return [record for record in s.journal().others if record["kind"] == "state"]


def chained(records: list[dict[str, Any]]) -> bool:
    """Every change begins where the one before it ended, from idle to a final state, and time never runs back."""
    olds, news = [r["old"] for r in records], [r["new"] for r in records]
    times = [r["time"] for r in records]
    return ["idle", *news[:-1]] == olds and news[-1] in ("finished", "faulted") and times == sorted(times)


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.name)
def test_a_rest_is_recorded_with_its_reason_and_ends_in_whole_data(scan: Stage, cause: Cause) -> None:
    seen: list[tuple[bool, bool, bool]] = []

    def look_and_mend() -> None:
        bench = scan.bench
        seen.append((bench.shutter.opened, any(a.busy() for a in bench.axes.values()), bench.source.on))
        cause.go(scan)

    scan.when(second_point, lambda: cause.come(scan))
    scan.when(suspended, look_and_mend)
    end = scan.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert seen == [(False, False, not cause.dark)]
    records = states(scan)
    assert chained(records)
    rest = next(number for number, record in enumerate(records) if record["new"] == "suspended")
    assert cause.said in records[rest]["reason"]
    assert (records[rest + 1]["old"], records[rest + 1]["reason"]) == ("suspended", "resumed")
    began, ended = records[rest]["time"], records[rest + 1]["time"]
    content = scan.journal()
    assert not [p for p in content.points.values() if began <= p["time"] < ended]
    assert sorted(content.points) == [0, 1, 2]
    run = run_of_journal(content)
    current = (run["signal"].mean("sample") - run["dark"]) / run["gain"]
    assert current.values == pytest.approx([0.4 * FULL_CURRENT] * 3, rel=1e-3)
    assert not (run["quality_flag"].values & 7).any()


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.name)
def test_a_cause_that_stays_ends_honestly(scan: Stage, cause: Cause) -> None:
    """Points that could not be measured are marked with the reason, or not reached; none is claimed."""
    scan.when(second_point, lambda: cause.come(scan))
    end = scan.run()
    assert end.outcome == "faulted"
    assert cause.said in end.reason
    assert chained(states(scan))
    content = scan.journal()
    last = [record for record in content.others if record["kind"] == "ended"][-1]
    assert (last["outcome"], last["measured"]) == ("faulted", len(content.points))
    assert sorted([*content.points, *last["skipped"], *last["not_reached"]]) == [0, 1, 2]
    assert set(last["skipped"]) == set(content.skipped)
    assert all(cause.said in record["reason"] for record in content.skipped.values())
    # Room on the disk is looked for between points: the one under way is still written, from the reserve.
    assert list(content.points) == ([0, 1] if cause.name == "full disk" else [0])
    assert scan.bench.safe
    assert scan.engine.state is State.FAULTED
