"""What keeps a run whole: one writer, nothing overwritten, nothing half written, time that never runs back."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from example_runs import PLAN, four_points
from pydantic import ValidationError
from scan_stage import FACILITY, plan_of, stage

from instrument import journal as journal_module
from instrument.errors import InputError
from instrument.events import PointMeasured
from instrument.facility import Reference
from instrument.journal import JOURNAL_NAME, Journal, JournalError, read_journal
from instrument.output import check_writable
from instrument.plan import MOST_POINTS, PlanForm, make_plan
from instrument.request import ScanInputs, ScanRequest, complete, inputs_of, material_of
from instrument.run_folder import copy_artifact, copy_file, copy_material, make_run_folder
from instrument.scan_options import check_options
from instrument.scan_run import Interrupts, Keyboard
from instrument.session import _clock

EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"


def test_two_programs_do_not_write_one_journal(tmp_path: Path) -> None:
    folder = four_points(tmp_path / "run")
    before = (folder / JOURNAL_NAME).read_bytes()
    with Journal.reopen(folder), pytest.raises(InputError, match=r"journal.jsonl: another program is writing this run"):
        Journal.reopen(folder)
    with Journal.reopen(folder) as again:  # let go with the file
        assert len(again.done) == 4
    assert (folder / JOURNAL_NAME).read_bytes() == before


def test_a_journal_that_is_being_made_is_held_too(tmp_path: Path) -> None:
    s = stage(tmp_path)
    with pytest.raises(InputError, match="another program is writing"):
        Journal.reopen(tmp_path)
    s.engine.abort("never mind")
    s.run()


@pytest.mark.parametrize("shrinks", [True, False])
def test_a_line_that_the_disk_refused_is_never_followed_by_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shrinks: bool
) -> None:
    """Half a line in the middle would make the whole journal unreadable; at the end it is only torn."""
    folder = four_points(tmp_path / "run")
    before = read_journal(folder)
    write, truncate = os.write, os.ftruncate

    def full(descriptor: int, data: Any) -> int:
        write(descriptor, bytes(data)[:20])
        raise OSError(errno.ENOSPC, "No space left on device")

    def stuck(descriptor: int, length: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with Journal.reopen(folder) as journal:
        monkeypatch.setattr(journal_module.os, "write", full)
        monkeypatch.setattr(journal_module.os, "ftruncate", truncate if shrinks else stuck)
        with pytest.raises(OSError, match=r"No space|Input/output"):
            journal.record("note", text="refused")
        monkeypatch.undo()
        if shrinks:
            journal.record("note", text="there is room again")
        else:
            with pytest.raises(JournalError, match="closed"):
                journal.record("note", text="too late")
    after = read_journal(folder)
    assert after.points == before.points
    assert (after.torn is None) == shrinks
    assert len(after.chains) == len(before.chains) + shrinks


def test_laboratory_time_goes_on_after_an_accelerated_run(tmp_path: Path) -> None:
    """At speed 2000 a run is hours ahead of the wall clock when it stops; the next one must not seem earlier."""
    s = stage(tmp_path)
    s.when(lambda e: isinstance(e, PointMeasured) and e.index == 1, lambda: s.engine.abort("enough"))
    s.run()
    content = read_journal(tmp_path)
    ahead = content.latest
    assert ahead > datetime.now(UTC)
    assert ahead == max(datetime.fromisoformat(record["time"]) for record in content.others if "time" in record)
    assert _clock(2000.0, content).now() >= ahead
    assert abs(_clock(1.0, None).now() - datetime.now(UTC)) < timedelta(seconds=5)


def test_a_folder_with_anything_in_it_is_left_alone(tmp_path: Path) -> None:
    mine = tmp_path / "facility.toml"
    mine.write_text("my own")
    with pytest.raises(InputError, match="is not empty"):
        make_run_folder(tmp_path, Path("plan.toml"))
    assert mine.read_text() == "my own"
    assert make_run_folder(tmp_path / "a" / "b", Path("plan.toml")).is_dir()


def test_a_copy_never_replaces_what_the_run_needs(tmp_path: Path) -> None:
    """An artifact may call its table of holes what it likes, but not plan.toml."""
    run = tmp_path / "run"
    run.mkdir()
    (run / "plan.toml").write_text("version = 1")
    holes = (EXAMPLES / "artifact_holes.csv").read_text()
    (tmp_path / "plan.toml").write_text(holes)
    artifact = tmp_path / "artifact.toml"
    artifact.write_text((EXAMPLES / "artifact.toml").read_text().replace("artifact_holes.csv", "plan.toml"))
    with pytest.raises(InputError, match=r"replace plan.toml"):
        copy_artifact(artifact, run)
    assert (run / "plan.toml").read_text() == "version = 1"


@pytest.mark.parametrize(
    ("given", "copied"),
    [("coating.csv", "material.csv"), ("coating.bsdf", "material.bsdf"), ("coupon run", "material.nc")],
)
def test_a_material_keeps_its_form_and_a_resumed_run_finds_it(tmp_path: Path, given: str, copied: str) -> None:
    run = make_run_folder(tmp_path / "run", Path("plan.toml"))
    source = tmp_path / given
    source.write_bytes(b"what it is made of")
    assert copy_material(source, run) == run / copied
    assert (run / copied).read_bytes() == b"what it is made of"
    assert material_of(run) == run / copied


def test_copies_are_on_the_disk_before_they_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A resumed run needs its plan: after a power cut an unsynchronised copy is empty."""
    synchronised: list[str] = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (synchronised.append(os.readlink(f"/proc/self/fd/{fd}")), fsync(fd))[1])
    folder = make_run_folder(tmp_path / "new" / "run", Path("plan.toml"))
    assert {str(tmp_path), str(tmp_path / "new")} <= set(synchronised)
    copy_file(EXAMPLES / "table_iv.toml", folder, "plan.toml")
    assert any(".plan.toml." in name for name in synchronised)
    assert str(folder) in synchronised


def test_a_plan_read_differently_than_it_was_measured_is_not_gone_on_with(tmp_path: Path) -> None:
    stage(tmp_path).run()
    (tmp_path / "facility.toml").write_text((EXAMPLES / "facility.toml").read_text())
    content = read_journal(tmp_path)
    given = inputs_of(ScanRequest(simulate=True, plan=EXAMPLES / "table_iv.toml", facility=EXAMPLES / "facility.toml"))
    from dataclasses import replace

    with pytest.raises(InputError, match=r"point 0 was measured at .*; this program reads the plan as"):
        complete(replace(given, resumed=content, devices=Path("devices.toml")))
    assert isinstance(complete(replace(given, devices=Path("devices.toml"))), ScanInputs)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "nothing to scan with"),
        ({"simulate": True, "devices": "d"}, "exclude each other"),
        ({"devices": "d", "plan": "p"}, "--facility: missing"),
        ({"devices": "d", "facility": "f"}, "PLAN: missing"),
        ({"devices": "d", "facility": "f", "plan": "p", "speed": 3.0}, "--speed: belongs to the simulated"),
        ({"resume": "r", "plan": "p"}, "leave it out"),
        ({"resume": "r", "out": "o"}, "leave it out"),
    ],
)
def test_options_that_do_not_go_together_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_options(given)
    with pytest.raises(InputError, match=said):
        inputs_of(ScanRequest.model_validate(given))


def test_a_wrong_plan_is_refused_before_a_laboratory_is_started(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace("title", "titel"))
    with pytest.raises(InputError, match="titel: unknown key"):
        inputs_of(ScanRequest(simulate=True, plan=tmp_path / "plan.toml"))


def test_a_slip_of_the_step_is_no_plan_that_fills_the_memory() -> None:
    fine = {"start": -80.0, "stop": 80.0, "step": 0.01}
    grid = {
        "wavelength": (500.0,),
        "illumination_zenith": (0.0,),
        "sensor_azimuth": {"start": 0.0, "stop": 180.0, "step": 0.01},
        "sensor_zenith": fine,
    }
    form = PlanForm.model_validate({"version": 1, "grid": (grid,)})
    with pytest.raises(InputError, match=f"288034001 points up to here; expected at most {MOST_POINTS}"):
        make_plan(form, FACILITY, "plan.toml")
    assert len(plan_of()) == 3


def test_a_facility_without_reference_readings_is_refused() -> None:
    with pytest.raises(ValidationError, match="at least 1 item"):
        Reference(reflectance_factor=0.99, u_relative=0.005, sensor_azimuth=())


@pytest.mark.parametrize("name", ["no/such/end.json", "."])
def test_a_report_that_cannot_be_written_is_said_before_the_scan(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"there is no folder|is a folder"):
        check_writable(tmp_path / name)
    check_writable(tmp_path / "end.json")


def test_a_terminal_that_goes_away_is_an_orderly_end() -> None:
    interrupts = Interrupts()
    with interrupts.caught():
        os.kill(os.getpid(), signal.SIGHUP)
    assert interrupts.count == 1


def test_a_program_without_standard_input_has_no_keyboard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    keyboard = Keyboard()
    assert not keyboard.present
    with pytest.raises(EOFError):
        keyboard.line(0.0)


def test_a_resumption_of_what_is_no_run_folder_is_status_2(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("{}\n")
    (tmp_path / JOURNAL_NAME).write_text('{"format":"goniotwin-journal","version":1}\n')
    for wrong in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "none", tmp_path):
        with pytest.raises(InputError, match=r"journal"):
            inputs_of(ScanRequest(resume=wrong))


def test_the_lock_of_a_journal_dies_with_its_program(tmp_path: Path) -> None:
    folder = four_points(tmp_path / "run")
    code = (
        "import os, pathlib, signal, sys\nfrom instrument.journal import Journal\n"
        "held = Journal.reopen(pathlib.Path(sys.argv[1]))\nos.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(folder)], check=False, timeout=60.0)
    assert done.returncode == -signal.SIGKILL
    Journal.reopen(folder).close()
