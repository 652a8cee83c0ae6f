"""The reference repeated during a scan: when it is due, what it corrects, and how sure that is."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from fake_bench import Bench
from hypothesis import given
from hypothesis import strategies as st
from scan_stage import FACILITY, QUICK, plan_of, stage

from instrument.dataset import run_of_journal
from instrument.drift import diffusion, drift_of
from instrument.events import StateChanged

RATE = 5e-5  # of the source's power, 1/s


class FadingBench(Bench):
    """Its source loses power steadily."""

    def current(self) -> float:
        return super().current() * (1 - RATE * self.clock.monotonic())


def repeating(minutes: float):
    reference = FACILITY.reference.model_copy(update={"repeat_minutes": minutes})
    return FACILITY.model_copy(update={"reference": reference})


def test_a_level_between_two_references_lies_on_the_line_between_theirs():
    times, levels = np.array([0.0, 1000.0]), np.array([1.0, 0.9])
    found = drift_of(np.array([0.0, 250.0, 1000.0]), np.array([0, 0, 1]), times, levels, np.array([False, True]))
    np.testing.assert_allclose(found.ratio, [1.0, 0.975, 1.0])
    # One change of -0.1 (over a mean of 0.95) in 1000 s; at a quarter of the way 1/4 * 3/4 of its square is left.
    walk = (0.1 / 0.95) ** 2 / 1000
    np.testing.assert_allclose(found.u, [0.0, math.sqrt(walk * 1000 * 3 / 16), 0.0], atol=1e-12)


def test_levels_of_references_with_the_light_off_in_between_are_not_joined():
    times, levels = np.array([0.0, 1000.0, 2000.0]), np.array([1.0, 0.5, 0.6])
    joined = np.array([False, False, True])
    found = drift_of(np.array([500.0, 1500.0]), np.array([0, 1]), times, levels, joined)
    np.testing.assert_allclose(found.ratio, [1.0, 0.55 / 0.5])
    assert found.u[0] == 0.0


def test_after_the_last_reference_the_uncertainty_grows_with_the_root_of_time():
    times, levels = np.array([0.0, 100.0]), np.array([1.0, 1.01])
    found = drift_of(np.array([200.0, 500.0]), np.array([1, 1]), times, levels, np.array([False, True]))
    np.testing.assert_allclose(found.ratio, 1.0)
    assert found.u[1] / found.u[0] == pytest.approx(2.0)


@given(st.floats(-0.01, 0.01), st.integers(4, 10))
def test_a_steady_slope_is_no_random_walk(slope: float, count: int):
    times = np.arange(count) * 60.0
    assert diffusion(times, 1 + slope * times / times[-1]) == pytest.approx(0.0, abs=1e-12)


def test_the_size_of_a_random_walk_is_found():
    steps = np.random.default_rng(5).standard_normal(4000) * 1e-4 * math.sqrt(30.0)
    levels = 1 + np.concatenate([[0.0], np.cumsum(steps)])
    assert diffusion(np.arange(4001) * 30.0, levels) == pytest.approx(1e-8, rel=0.1)


def test_a_scan_repeats_the_reference_on_schedule_and_takes_the_drift_out(tmp_path: Path):
    plan = plan_of(zenith=tuple(float(z) for z in range(10, 70, 4)))
    facility = repeating(2.0)
    scan = stage(tmp_path, plan, FadingBench(), facility=facility)
    end = scan.run()
    assert (end.outcome, end.done) == ("finished", 15)
    content = scan.journal()
    calibrations = [record for record in content.references if record["index"] == 0]
    assert len(calibrations) >= 3
    assert [bool(record.get("repeated")) for record in calibrations] == [False] + [True] * (len(calibrations) - 1)
    assert scan.bench.wrong == []
    reasons = [event.reason for event in scan.events(StateChanged) if event.new == "referencing"]
    assert reasons[0] == ""
    assert set(reasons[1:]) == {"repeated on schedule"}
    # Without drift, and with the law of the bench, every point reads the same share of the ideal flux.
    run = run_of_journal(content)
    plain = run["brf"].values * run["drift_correction"].values
    (tmp_path / "quiet").mkdir()
    quiet = stage(tmp_path / "quiet", plan)
    quiet.run()
    truth = run_of_journal(quiet.journal()).sortby("sensor_zenith")["brf"].values
    order = np.argsort(run["sensor_zenith"].values)
    before, after = np.abs(plain[order] / truth - 1), np.abs(run["brf"].values[order] / truth - 1)
    # A busy machine loses some laboratory seconds between a reading and its time: means, not extremes.
    assert before.mean() > 1e-3
    assert after.mean() < before.mean() / 5
    assert "u_brf_drift" in run["brf"].attrs["unc_comps"]
    parts = [run[name].values ** 2 for name in run["brf"].attrs["unc_comps"]]
    np.testing.assert_allclose(run["u_brf"].values, np.sqrt(np.sum(parts, axis=0)))


def test_a_scan_without_a_schedule_reads_the_reference_once(tmp_path: Path):
    scan = stage(tmp_path, settings=QUICK)
    scan.run()
    assert len(scan.journal().references) == len(FACILITY.reference.sensor_azimuth)
    assert "u_brf_drift" not in run_of_journal(scan.journal())
