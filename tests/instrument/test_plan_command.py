"""``goniotwin plan`` and ``goniotwin runs``: what they say, and with which exit status."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from importlib.metadata import entry_points
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import xarray as xr
from example_runs import PLAN, four_points, geometry, header, minimal_run, reading, references

from instrument.__main__ import main
from instrument.dataset import read_run, rebuild_run, write_run
from instrument.journal import Journal
from instrument.plan_command import plan
from instrument.run_archive import first_difference
from instrument.runs_commands import verify

EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"


def run(name: str, *arguments: object, expected: int = 0) -> SimpleNamespace:
    """What a command prints, through the root command."""
    words = [*({"plan": ["plan"]}.get(name) or ["runs", name]), *map(str, arguments)]
    text = io.StringIO()
    with redirect_stdout(text), redirect_stderr(text), patch.dict(os.environ, COLUMNS="200"):
        try:
            status = main(words)
        except SystemExit as end:
            status = end.code or 0
    assert status == expected, text.getvalue()
    return SimpleNamespace(output=text.getvalue())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run folder, not to be changed."""
    folder = four_points(tmp_path_factory.mktemp("whole") / "run")
    write_run(rebuild_run(folder), folder / "run.nc")
    return folder


@pytest.fixture
def finished(whole: Path, tmp_path: Path) -> Path:
    """A finished run folder of one's own."""
    return Path(shutil.copytree(whole, tmp_path / "run"))


def test_the_papers_plan_is_summarised(tmp_path: Path) -> None:
    result = run(
        "plan", EXAMPLES / "table_iv.toml", "--facility", EXAMPLES / "facility.toml", "--json", tmp_path / "p.json"
    )
    assert "390 points, 6 blocked" in result.output
    assert "retro-reflection" in result.output
    summary = json.loads((tmp_path / "p.json").read_text())
    assert len(summary["points"]) == 390
    assert len(summary["blocked"]) == 6
    # The paper's instrument took about 2.7 points a minute: 390 points in some 2.4 hours.
    assert 390 / (summary["duration_s"] / 60) == pytest.approx(2.7, abs=0.2)


def test_the_duration_follows_dwell_and_speed(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)

    def seconds(*options: object) -> float:
        run("plan", tmp_path / "plan.toml", "--json", tmp_path / "p.json", *options)
        return float(json.loads((tmp_path / "p.json").read_text())["duration_s"])

    assert seconds("--dwell", 30) - seconds("--dwell", 20) == pytest.approx(10 * 8)
    assert seconds("--velocity", 1) > seconds("--velocity", 20)


def test_every_point_is_listed_on_request(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    assert "sensor zenith -60" in run("plan", tmp_path / "plan.toml", "--points").output


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[60.0, 30.0, -30.0, -60.0]", "[95.0]", "beyond the arm"),
        ("[60.0, 30.0, -30.0, -60.0]", "[1.05, 0.52, -0.52]", "are these radians?"),
        ("title", "titel", "unknown key"),
        ("[0.0]\nsensor_azimuth", "[0.0]\nillumination_azimuth = 30.0\nsensor_azimuth", "turn the sample"),
    ],
)
def test_a_wrong_plan_is_one_message_and_status_2(old: str, new: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace(old, new, 1))
    result = run("plan", tmp_path / "plan.toml", expected=2)
    assert expected in result.output
    assert str(tmp_path / "plan.toml") in result.output
    assert "Traceback" not in result.output


def test_missing_files_are_status_2(tmp_path: Path) -> None:
    for arguments in (("plan", "a.toml"), ("show", "b.nc"), ("verify", tmp_path), ("list", tmp_path / "none")):
        assert run(*arguments, expected=2).output.startswith("goniotwin: ")
    (tmp_path / "plan.toml").write_text(PLAN)
    result = run("plan", tmp_path / "plan.toml", "--json", tmp_path / "no" / "p.json", expected=2)
    assert "there is no folder" in result.output


def test_a_whole_run_verifies(whole: Path, tmp_path: Path) -> None:
    run("verify", whole, "--json", tmp_path / "v.json")
    found = json.loads((tmp_path / "v.json").read_text())
    assert found["passed"]
    assert {check["name"] for check in found["checks"]} == {
        "journal",
        "points",
        "plan.toml",
        "facility.toml",
        "digest",
        "run.nc",
    }


def tampered(folder: Path, change: Any) -> None:
    stored = read_run(folder / "run.nc")
    change(stored)
    write_run(stored, folder / "run.nc")


def set_value(variable: str, value: float) -> Any:
    def change(stored: xr.Dataset) -> None:
        stored[variable].values[2] = value

    return change


@pytest.mark.parametrize(
    ("spoil", "check"),
    [
        (lambda folder: (folder / "plan.toml").write_text(PLAN + "\n"), "plan.toml"),
        (lambda folder: (folder / "facility.toml").unlink(), "facility.toml"),
        (lambda folder: (folder / "run.nc").unlink(), "run.nc"),
        (lambda folder: tampered(folder, set_value("brf", 0.51)), "run.nc"),
        (lambda folder: tampered(folder, set_value("dark", 0.0)), "run.nc"),
        (lambda folder: tampered(folder, lambda run: run.attrs.update(journal_digest="0" * 64)), "digest"),
        (lambda folder: tampered(folder, lambda run: run.attrs.update(scan_direction="serpentine")), "run.nc"),
        (
            lambda folder: (folder / "journal.jsonl").write_text(
                (folder / "journal.jsonl").read_text().replace('"gain":1000000.0', '"gain":1000001.0', 1)
            ),
            "journal",
        ),
    ],
)
def test_whatever_was_changed_is_found(spoil: Any, check: str, finished: Path, tmp_path: Path) -> None:
    spoil(finished)
    run("verify", finished, "--json", tmp_path / "v.json", expected=1)
    checks = json.loads((tmp_path / "v.json").read_text())["checks"]
    assert [c["name"] for c in checks if not c["passed"]] == [check]


def test_a_run_file_older_than_its_journal_is_found(tmp_path: Path) -> None:
    folder = tmp_path
    (folder / "plan.toml").write_text(PLAN)
    (folder / "facility.toml").write_text(header()["facility"])
    with Journal.create(folder, header(points=2)) as journal:
        references(journal)
        journal.record("point", index=0, **reading(geometry(60.0), 0.5, 10.0))
        write_run(rebuild_run(folder), folder / "run.nc")
        journal.record("point", index=1, **reading(geometry(30.0), 0.5, 30.0))
    assert "the journal gives (2,)" in run("verify", folder, expected=1).output


def test_an_unfinished_run_does_not_verify_and_says_why(tmp_path: Path) -> None:
    folder = four_points(tmp_path / "run", points=6)
    write_run(rebuild_run(folder), folder / "run.nc")
    assert "4 of 6 points measured" in run("verify", folder, expected=1).output


def test_rounding_of_another_machine_is_no_difference() -> None:
    one, other = minimal_run(), minimal_run()
    other["brf"].values[:] *= 1 + 1e-13
    assert first_difference(one, other) == ""
    other["brf"].values[1] *= 1 + 1e-6
    assert first_difference(one, other).startswith("brf[1]")


def test_runs_are_listed_with_their_outcome(tmp_path: Path) -> None:
    four_points(tmp_path / "a")
    with Journal.reopen(tmp_path / "a") as journal:
        journal.record("ended", outcome="finished")
    four_points(tmp_path / "b", points=6)
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "journal.jsonl").write_text("hello\n")
    run("list", tmp_path, "--json", tmp_path / "l.json")
    rows = {Path(row["folder"]).name: row for row in json.loads((tmp_path / "l.json").read_text())}
    assert rows["a"]["outcome"] == "finished"
    assert (rows["b"]["outcome"], rows["b"]["measured"], rows["b"]["planned"]) == ("interrupted", 4, 6)
    assert "not the header" in rows["c"]["problem"]
    assert "no runs" in run("list", tmp_path / "c").output


def test_a_run_is_shown_with_what_it_cannot_support(finished: Path, tmp_path: Path) -> None:
    with Journal.reopen(finished) as journal:
        journal.record(
            "skipped", index=9, geometry=geometry(30.0), time=header()["created"], reason="axis [/sen] stalled"
        )
    output = run("show", finished, "--json", tmp_path / "s.json").output
    assert "axis [/sen] stalled" in output
    assert "no correlation stated for `u_brf_stability`" in output
    summary = json.loads((tmp_path / "s.json").read_text())
    assert summary["planes"][0]["points"] == 4
    assert summary["brf"] == pytest.approx([0.3, 0.6], rel=1e-6)
    minimal_run().to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    assert "no test for drift" in run("show", tmp_path / "other.nc").output


def test_flagged_points_are_counted(tmp_path: Path) -> None:
    flagged = minimal_run().assign(quality_flag=("point", np.array([0, 9, 8], dtype=np.int8)))
    write_run(flagged, tmp_path / "run.nc")
    output = run("show", tmp_path / "run.nc").output
    assert "flagged repeated: 2 of 3 points" in output
    assert "flagged saturated: 1 of 3 points" in output


def test_commands_are_registered() -> None:
    found = {
        point.name: point.load() for point in entry_points(group="goniotwin.commands") if "instrument" in point.value
    }
    assert found["plan"] is plan
    assert found["runs.verify"] is verify


def test_command_modules_import_nothing_heavy() -> None:
    code = (
        "import sys, instrument.plan_command, instrument.runs_commands;"
        "sys.exit(any(name in sys.modules for name in ('numpy', 'xarray', 'pydantic', 'rich.table', 'h5py')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


def test_the_plan_says_ways_and_when_each_point_is_measured(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    output = run("plan", tmp_path / "plan.toml", "--points", "--json", tmp_path / "p.json").output
    assert "[sensor zenith 60 > 30]" in output
    summary = json.loads((tmp_path / "p.json").read_text())
    steps = [step for step in summary["steps"] if step["kind"] == "point"]
    assert [step["index"] for step in steps] == [0, 1, 2, 3]
    assert steps[1]["moves"] == [["sensor_zenith", 60.0, 30.0]]
    assert all(a["end_s"] == b["begin_s"] for a, b in pairwise(steps))
    assert steps[-1]["end_s"] <= summary["duration_s"]


def test_the_devices_say_how_long_moves_and_readings_take(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    example = (EXAMPLES.parents[1] / "docs" / "devices.example.toml").read_text()
    (tmp_path / "slow.toml").write_text(example.replace("nplc = 1.0", "nplc = 100.0"))
    seconds = {}
    for name, file in (
        ("quick", EXAMPLES.parents[1] / "docs" / "devices.example.toml"),
        ("slow", tmp_path / "slow.toml"),
    ):
        run("plan", tmp_path / "plan.toml", "--devices", file, "--dwell", 0, "--json", tmp_path / "p.json")
        seconds[name] = json.loads((tmp_path / "p.json").read_text())["duration_s"]
    # 18 samples of 99 periods of 20 ms more, twice that with auto-zero, in 8 readings and one at another gain.
    assert seconds["slow"] - seconds["quick"] == pytest.approx(99 * 0.02 * 2 * (8 * 18 + 9), rel=1e-6)
    assert "leave them out" in run("plan", tmp_path / "plan.toml", "--devices", "x", "--velocity", 5, expected=2).output


def test_a_plan_that_no_stage_can_follow_is_refused(tmp_path: Path) -> None:
    facility = (EXAMPLES / "facility.toml").read_text().replace("[arms]", "[arms]\npolarizer = [0.0, 90.0]", 1)
    (tmp_path / "facility.toml").write_text(facility)
    (tmp_path / "plan.toml").write_text(PLAN)
    example = EXAMPLES.parents[1] / "docs" / "devices.example.toml"
    named = ("--facility", tmp_path / "facility.toml")
    assert "polarisation" in run("plan", tmp_path / "plan.toml", *named).output
    output = run("plan", tmp_path / "plan.toml", *named, "--devices", example, expected=2).output
    assert "devices.toml connects no such device" in output
