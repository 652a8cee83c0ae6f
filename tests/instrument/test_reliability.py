"""A reduced number of the trials that ``make reliability`` runs in full (``docs/reliability.md``)."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from reliability_alike import farthest_allowed, together_wrong, uninterrupted  # noqa: E402
from reliability_bench import measured, problems_of, small_scan  # noqa: E402
from reliability_crash import cut_trial, disk_trial, kill_trial  # noqa: E402
from reliability_faults import fault_trial, faults  # noqa: E402
from reliability_report import write_report  # noqa: E402
from reliability_soak import soak_trial  # noqa: E402
from reliability_wires import wire_trial  # noqa: E402

#: The children only scan and leave by ``os._exit``; a thread of the test runner is no part of that.
pytestmark = pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")


def test_killed_scans_are_resumed_to_what_they_would_have_been(tmp_path: Path) -> None:
    found = kill_trial(tmp_path, 5)
    assert found["wrong"] == []
    assert found["kills"] >= 3


def test_a_journal_cut_in_its_last_two_lines_is_gone_on_with(tmp_path: Path) -> None:
    found = cut_trial(tmp_path, every=131)
    assert found["wrong"] == []
    assert found["trials"] > 5


def test_a_disk_that_is_full_anywhere_costs_no_point(tmp_path: Path) -> None:
    found = disk_trial(tmp_path, 4)
    assert found["wrong"] == []
    assert found["disk_was_full"] >= 1


def test_the_trials_would_notice_a_point_that_is_missing_or_differs(tmp_path: Path) -> None:
    small_scan(tmp_path).run(600.0)
    expected = measured(tmp_path)
    assert problems_of(tmp_path, expected) == []
    changed = expected | {0: {**expected[0], "dark": 1.0}, 99: expected[1]}
    assert problems_of(tmp_path, changed) == ["point 99 is missing", "point 0 differs"]


def test_the_engine_costs_little_a_point_and_keeps_no_readings(tmp_path: Path) -> None:
    found = soak_trial(tmp_path, 200, stops=4)
    assert (found["outcome"], found["done"], found["readable"], found["wrong"]) == ("finished", 200, 200, [])
    assert found["cpu_ms_per_point"] < 20.0  # 5 on a quiet machine; a shared one counts some of its own trouble
    assert found["journal_bytes_per_point"] < 2000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stall half-way", "one reply garbled", "interlock opened, then closed"])
def test_a_fault_of_a_device_ends_as_it_should(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GONIOTWIN_LOCK_DIR", str(tmp_path / "locks"))
    chosen = next(fault for fault in faults() if fault.name == name)
    (row,) = fault_trial(tmp_path, [chosen], lambda _: None)
    assert row["wrong"] == []
    assert row["on_the_wire"] <= row["intended"]


@pytest.mark.slow
def test_a_scan_killed_on_real_wires_leaves_a_dark_laboratory_and_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GONIOTWIN_LOCK_DIR", str(tmp_path / "locks"))
    found = wire_trial(tmp_path / "wires", 1, most_kills=1, whole=1)
    assert found["wrong"] == []
    assert found["kills"] == 1
    assert len(found["off"]) == 8


def _scan(random: np.random.Generator, scale: float = 1.0, noise: float = 0.005) -> dict[int, float]:
    return {index: scale * (1.0 + index) * float(1.0 + noise * random.standard_normal()) for index in range(8)}


def test_two_readings_may_differ_by_their_noise_and_by_no_more() -> None:
    random = np.random.default_rng(1)
    expected = uninterrupted([_scan(random) for _ in range(12)], dict.fromkeys(range(8), 0.005))
    off = [value for _ in range(40) for value in expected.off(_scan(random)).values()]
    assert expected.wrong() == together_wrong(off, 12, 8) == []
    assert np.std(off) == pytest.approx(1.0, abs=0.1)
    # Normal quantile of 1 - 0.01/640, after Abramowitz and Stegun, Table 26.5 (4.1 to 4.2 for 2e-5 to 1.3e-5).
    assert 4.1 < farthest_allowed(320) < 4.2
    assert max(map(abs, off)) < farthest_allowed(320)
    # 0.2 % on all points together, 3 % on one, and a scatter that is not the one stated, do not pass.
    shifted = [value for _ in range(40) for value in expected.off(_scan(random, 1.002)).values()]
    assert together_wrong(shifted, 12, 8) != []
    assert abs(expected.off(_scan(random) | {3: 4.0 * 1.03})[3]) > farthest_allowed(320)
    assert uninterrupted([_scan(random, noise=0.007) for _ in range(12)], dict.fromkeys(range(8), 0.005)).wrong()


@pytest.mark.parametrize("family", ["SMC100", "ESP301", "AZ", "SuperK", "SELECT", "34465A", "FEMTO", "Modbus I/O"])
def test_the_list_has_what_every_family_has_to_survive(family: str) -> None:
    names = {fault.name for fault in faults() if fault.family == family}
    assert {"one reply lost", "one request lost", "one reply late", "one reply garbled"} <= names
    assert {"one reply in two pieces", "two replies in one", "cable out for ten seconds"} <= names
    if family in ("SMC100", "AZ", "SuperK", "SELECT", "FEMTO", "Modbus I/O"):
        assert "another unit answers" in names
    if family in ("AZ", "FEMTO", "Modbus I/O"):
        assert {"answered by the exception busy", "answered by the exception device failure"} <= names
    if family in ("SMC100", "ESP301", "AZ"):
        assert {"cable out for ten seconds in mid-move", "stall half-way", "alarm of the drive in mid-move"} <= names


def test_the_page_says_what_the_results_say(tmp_path: Path) -> None:
    results = json.loads((ROOT / "benchmarks" / "reliability.json").read_text())
    write_report(results, tmp_path / "page.md")
    assert (tmp_path / "page.md").read_text() == (ROOT / "docs" / "reliability.md").read_text()
