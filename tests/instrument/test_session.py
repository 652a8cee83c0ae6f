"""Whole scans on the simulated laboratory: real drivers on real wires, with faults on the wire and at the devices."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from watched_session import Watched, state_is_safe

from drivers.lock import InstrumentBusy
from instrument.dataset import read_run
from instrument.errors import InputError
from instrument.events import Event, PointMeasured, PointSkipped, PointStarted, StateChanged
from instrument.journal import read_journal
from instrument.session import ScanRequest, ScanSession, derive_run
from instrument.settings import ScanSettings
from sim_fixtures.laboratory import start_simulated

SPEED = 200.0
IMPATIENT = ScanSettings(suspend_limit_wall=2.0, look_wall=0.5)
PLAN = """
version = 1
title = "a short plan"
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0]
sensor_azimuth = [0.0, 90.0]
sensor_zenith = [40.0, 20.0, 10.0]
"""


@pytest.fixture(autouse=True)
def _plain_sample(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A Lambertian sample needs no optical model; locks stay inside the test."""
    monkeypatch.setattr("instrument.session.laboratory_factory", lambda: partial(start_simulated, flux="lambertian"))
    monkeypatch.setenv("GONIOTWIN_LOCK_DIR", str(tmp_path / "locks"))


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture
def request_(plan: Path, tmp_path: Path) -> ScanRequest:
    return ScanRequest(plan=plan, simulate=True, speed=SPEED, out=tmp_path / "run", twin=False)


@pytest.fixture
def watched(request_: ScanRequest) -> Iterator[Watched]:
    watch = Watched(request_)
    with watch.session:
        yield watch


def test_a_scan_on_real_wires_leaves_a_whole_run_folder(watched: Watched, tmp_path: Path) -> None:
    end = watched.run()
    assert (end.outcome, end.done, watched.session.error) == ("finished", 6, None)
    assert state_is_safe(watched)
    folder = tmp_path / "run"
    assert {path.name for path in folder.iterdir()} == {
        "journal.jsonl",
        "plan.toml",
        "facility.toml",
        "artifact.toml",
        "artifact_holes.csv",
        "material.nc",
        "run.nc",
    }
    run = read_run(folder / "run.nc")
    assert run.sizes == {"point": 6, "sample": 9, "reference": 4, "dark_sample": 9, "reference_dark_sample": 9}
    assert run["sensor_zenith"].values.tolist() == [40.0, 20.0, 10.0] * 2
    assert abs(run["readback_sensor_zenith"] - run["sensor_zenith"]).max() < 0.02
    assert 0.3 < float(run["brf"].min()) <= float(run["brf"].max()) < 1.1
    assert run.attrs["journal_digest"] == read_journal(folder).digest


@pytest.mark.slow
@pytest.mark.parametrize("device", ["sensor_zenith", "illumination_zenith", "detector", "source", "shutter"])
def test_a_lost_reply_costs_no_point(watched: Watched, device: str) -> None:
    watched.when_point_starts(1, lambda: watched.control("drop_replies", device=device))
    watched.when_point_starts(3, lambda: watched.control("drop_replies", device=device))
    end = watched.run()
    assert (end.outcome, end.done) == ("finished", 6)
    assert state_is_safe(watched)


@pytest.mark.slow
def test_a_command_that_never_arrived_costs_no_point(watched: Watched) -> None:
    watched.when_point_starts(1, lambda: watched.control("lose_requests", device="sensor_zenith", count=2))
    end = watched.run()
    assert (end.outcome, end.done) == ("finished", 6)


@pytest.mark.slow
def test_a_stalled_axis_marks_its_point_and_the_scan_goes_on(watched: Watched) -> None:
    watched.when_point_starts(1, lambda: watched.control("stall", axis="sensor_zenith"))
    end = watched.run()
    assert (end.outcome, end.done) == ("finished", 5)
    (skipped,) = watched.of(PointSkipped)
    assert skipped.index == 1
    assert "sensor_zenith" in skipped.reason
    assert state_is_safe(watched)


@pytest.mark.slow
def test_an_alarm_ends_the_scan_safely_and_the_run_goes_on_later(watched: Watched, tmp_path: Path) -> None:
    watched.when_point_starts(2, lambda: watched.control("alarm", axis="sensor_zenith"))
    end = watched.run()
    assert end.outcome == "faulted"
    assert 0 < end.done < 6
    assert state_is_safe(watched)
    watched.session.close()
    again = Watched(ScanRequest(resume=tmp_path / "run", twin=False))
    with again.session:
        end = again.run()
        assert again.session.laboratory is not None
    assert (end.outcome, end.done) == ("finished", 6)
    assert read_run(tmp_path / "run" / "run.nc").sizes["point"] == 6


@pytest.mark.slow
def test_an_open_interlock_suspends_until_a_person_resumes(watched: Watched) -> None:
    watched.when_point_starts(1, lambda: watched.control("open_interlock"))

    def back() -> None:
        assert not watched.control("state")["emission"]
        watched.control("close_interlock")
        watched.session.resume()

    watched.when_state("suspended", back)
    end = watched.run()
    assert "suspended" in [event.new for event in watched.of(StateChanged)]
    assert (end.outcome, end.done) == ("finished", 6)


@pytest.mark.slow
@pytest.mark.parametrize("device", ["sensor_zenith", "illumination_zenith", "detector", "io", "source"])
def test_a_cable_that_is_out_for_seconds_costs_time_and_no_data(watched: Watched, device: str) -> None:
    watched.when_point_starts(2, lambda: watched.control("disconnect", device=device, seconds=3.0))
    end = watched.run()
    assert (end.outcome, end.done, watched.of(PointSkipped)) == ("finished", 6, [])
    assert state_is_safe(watched, watchdog_trips=device == "source")


@pytest.mark.slow
@pytest.mark.parametrize("device", ["detector", "sensor_zenith"])
def test_pulling_a_plug_for_good_ends_honestly(request_: ScanRequest, device: str) -> None:
    watch = Watched(request_, IMPATIENT)
    with watch.session:
        watch.when_point_starts(2, lambda: watch.control("disconnect", device=device, seconds=600.0))
        end = watch.run()
        journal = read_journal(watch.session.run_dir)
        ended = next(record for record in journal.others if record["kind"] == "ended")
        accounted = sorted([*journal.points, *journal.skipped, *ended["not_reached"]])
        assert accounted == list(range(6))
        assert end.outcome == "faulted"
        assert end.done == len(journal.points) < 6
        state = watch.control("state")
        assert not state["emission"]
        assert not state["shutter_open"]


@pytest.mark.slow
def test_a_laboratory_that_dies_ends_the_scan(request_: ScanRequest) -> None:
    import os

    watch = Watched(request_, IMPATIENT)
    with watch.session:
        pid = watch.session.laboratory.pid  # type: ignore[union-attr]
        watch.when_point_starts(2, lambda: os.kill(pid, signal.SIGKILL))
        end = watch.run()
        assert end.outcome == "faulted"
        assert end.run_file is not None


@pytest.mark.slow
def test_two_programs_do_not_drive_one_instrument(watched: Watched, plan: Path, tmp_path: Path) -> None:
    inputs = watched.session.laboratory.inputs  # type: ignore[union-attr]
    other = ScanRequest(plan=plan, devices=inputs.devices, facility=inputs.facility, out=tmp_path / "other")

    class Nobody:
        def mount(self, what: str) -> None: ...

    with pytest.raises(InstrumentBusy, match=r"in use by process \d+"):
        ScanSession(other, operator=Nobody()).open()
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
def test_a_changed_plan_is_not_resumed(watched: Watched, tmp_path: Path) -> None:
    watched.when_point_starts(1, watched.session.abort)
    assert watched.run().outcome == "aborted"
    watched.session.close()
    plan = tmp_path / "run" / "plan.toml"
    plan.write_text(plan.read_text().replace("40.0", "45.0"))
    with pytest.raises(InputError, match=r"plan.toml: changed since the run began"):
        ScanSession(ScanRequest(resume=tmp_path / "run")).open()


@pytest.mark.slow
def test_a_folder_that_holds_a_run_is_not_used_again(watched: Watched, request_: ScanRequest) -> None:
    with pytest.raises(InputError, match="holds a run already"):
        ScanSession(request_).open()


@pytest.mark.slow
def test_a_killed_scan_goes_on_where_it_was(plan: Path, tmp_path: Path) -> None:
    """The process dies without a chance to tidy up; another goes on with its journal."""
    words = [sys.executable, "-m", "instrument", "scan", str(plan), "--simulate", "--speed", "60", "--no-twin"]
    journal = tmp_path / "run" / "journal.jsonl"
    with (tmp_path / "out.txt").open("w") as out:
        program = subprocess.Popen([*words, "--out", str(tmp_path / "run")], stdout=out, stderr=out)
        deadline = time.monotonic() + 90.0
        while not (journal.exists() and journal.read_bytes().count(b'"kind":"point"') >= 2):
            assert program.poll() is None, (tmp_path / "out.txt").read_text()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        program.kill()
        program.wait()
    done = len(read_journal(tmp_path / "run").points)
    assert 2 <= done < 6
    again = Watched(ScanRequest(resume=tmp_path / "run", twin=False, speed=SPEED))
    with again.session:
        end = again.run()
    assert (end.outcome, end.done) == ("finished", 6)
    assert [event.index for event in again.of(PointMeasured)] == list(range(done, 6))


def scan(plan: Path, tmp_path: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "instrument", "scan", str(plan), "--simulate", "--no-twin", *words]
    return subprocess.Popen(
        [*command, "--out", str(tmp_path / "run"), "--json", str(tmp_path / "end.json")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_the_command_prints_a_line_a_point_and_ends_with_0(plan: Path, tmp_path: Path) -> None:
    with scan(plan, tmp_path, "--speed", str(SPEED)) as program:
        out, err = program.communicate(timeout=90.0)
    assert (program.returncode, err) == (0, "")
    lines = out.splitlines()
    assert sum(" BRF " in line for line in lines) == 6
    assert "6 of 6 points measured: finished." in lines
    end = json.loads((tmp_path / "end.json").read_text())
    assert (end["outcome"], end["done"], end["exit_status"]) == ("finished", 6, 0)
    assert Path(end["run_file"]).exists()


@pytest.mark.slow
def test_ctrl_c_ends_in_an_orderly_way_with_130(plan: Path, tmp_path: Path) -> None:
    with scan(plan, tmp_path, "--speed", "60") as program:
        assert program.stdout is not None
        for line in program.stdout:
            if " BRF " in line:
                program.send_signal(signal.SIGINT)
                break
        out, err = program.communicate(timeout=60.0)
    assert program.returncode == 130
    assert "Traceback" not in err
    assert "scan --resume" in out
    journal = read_journal(tmp_path / "run")
    assert [r["outcome"] for r in journal.others if r["kind"] == "ended"] == ["aborted"]
    assert (tmp_path / "run" / "run.nc").exists()


@pytest.mark.slow
def test_an_observer_found_by_its_entry_point_annotates_and_prints(
    request_: ScanRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    from instrument import audience
    from instrument.events import PointAnnotated

    class Twin:
        closed = threading.Event()

        def __init__(self, publish: Any) -> None:
            self.publish = publish

        def on_event(self, event: Event) -> None:
            if isinstance(event, PointStarted):
                values = {"brf": 0.5, "u_brf": 0.01}
                self.publish(PointAnnotated(time=event.time, index=event.index, source="twin", values=values))

        def finish(self, run_dir: Path) -> list[str]:
            assert (run_dir / "run.nc").exists()
            return ["a table"]

        def close(self) -> None:
            self.closed.set()

    class Point:
        name = "twin"

        def load(self) -> type[Twin]:
            return Twin

    class Broken:
        name = "broken"

        def load(self) -> Any:
            raise ImportError("no such library")

    monkeypatch.setattr(audience, "entry_points", lambda group: [Point(), Broken()])
    watch = Watched(request_.model_copy(update={"twin": True}))
    with watch.session as session:
        assert session.observed
        assert watch.run().outcome == "finished"
        assert session.finish() == ["a table"]
    assert Twin.closed.is_set()
    assert len(watch.of(PointAnnotated)) == 6
    assert any("broken cannot watch" in getattr(event, "text", "") for event in watch.events)


def test_a_file_that_an_observer_could_not_use_stops_a_scan_before_anything_starts(
    request_: ScanRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from instrument import audience

    class Twin:
        @staticmethod
        def check(facility: Path | None, artifact: Path | None, material: Path | None) -> None:
            assert (facility, artifact) == (None, None)
            raise InputError(f"{material}: the table has 3 gaps")

    class Point:
        name = "twin"

        def load(self) -> type[Twin]:
            return Twin

    material = tmp_path / "coupon.nc"
    material.touch()
    monkeypatch.setattr(audience, "entry_points", lambda group: [Point()])
    monkeypatch.setattr("instrument.session.laboratory_factory", lambda: pytest.fail("the laboratory was started"))
    request_ = request_.model_copy(update={"twin": True, "material": material})
    with pytest.raises(InputError, match=r"coupon.nc: the table has 3 gaps"), ScanSession(request_):
        pass
    assert not (tmp_path / "run").exists()


def test_nothing_is_derived_from_a_run_without_points(tmp_path: Path) -> None:
    from scan_stage import stage

    s = stage(tmp_path)
    s.engine.abort("before it began")
    s.run()
    assert derive_run(tmp_path) is None
