"""Who measured which sample against which standard: recorded, amended, never overwritten."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from example_runs import PLAN, facility, four_points, geometry, header, reading
from test_plan_command import run

from instrument.amending import amend
from instrument.errors import InputError
from instrument.forms import parse_form
from instrument.journal import Journal, read_journal
from instrument.plan import read_plan
from instrument.request import ScanRequest
from instrument.run_archive import verify
from instrument.run_build import rebuild_run
from instrument.run_read import read_run
from instrument.run_record import FIELDS, RunRecord, current_record, history
from instrument.run_write import write_run

SAID = {"operator": "A. Muster", "sample": "plate 7", "reference_standard": "PTB-0815"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = four_points(tmp_path_factory.mktemp("whole") / "run", record=SAID)
    write_run(rebuild_run(folder), folder / "run.nc")
    return folder


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "run"))


def test_a_run_file_says_who_measured_what(folder: Path) -> None:
    stored = read_run(folder / "run.nc")
    assert {name: stored.attrs[name] for name in SAID} == SAID
    assert not {"project", "remarks", "record_history"} & stored.attrs.keys()


def test_an_amendment_is_appended_and_nothing_before_it_changes(folder: Path) -> None:
    before, numbers = (folder / "journal.jsonl").read_bytes(), read_run(folder / "run.nc").load()
    amend(folder, {"sample": "plate 8", "project": "round robin"}, by="B. Beispiel", reason="wrong label")
    after = (folder / "journal.jsonl").read_bytes()
    assert after.startswith(before)
    assert after.count(b"\n") == before.count(b"\n") + 1
    content = read_journal(folder)
    assert content.header["record"] == SAID
    assert current_record(content).said() == SAID | {"sample": "plate 8", "project": "round robin"}
    stored = read_run(folder / "run.nc")
    assert (stored.attrs["sample"], stored.attrs["project"]) == ("plate 8", "round robin")
    first, change = json.loads(stored.attrs["record_history"])
    assert first == {"recorded": SAID}
    assert (change["by"], change["reason"]) == ("B. Beispiel", "wrong label")
    for name in numbers.variables:
        np.testing.assert_array_equal(stored[name].values, numbers[name].values)
    result = verify(folder)
    assert result.passed, result.as_dict()


def test_amendments_follow_each_other_and_their_history_is_shown(folder: Path, tmp_path: Path) -> None:
    amend(folder, {"sample": "plate 8"}, by="B", reason="wrong label")
    output = run("amend", folder, "--sample", "plate 9", "--by", "C", "--because", "found in [the] box").output
    assert "sample: plate 9" in output
    assert "was plate 7, is plate 8 (wrong label)" in output
    assert "was plate 8, is plate 9 (found in [the] box)" in output
    assert [(row["before"], row["after"]) for row in history(read_journal(folder))] == [
        ("plate 7", "plate 8"),
        ("plate 8", "plate 9"),
    ]
    shown = run("show", folder, "--json", tmp_path / "s.json").output
    assert "operator: A. Muster" in shown
    assert "amended" in shown
    assert json.loads((tmp_path / "s.json").read_text())["record"]["sample"] == "plate 9"
    assert verify(folder).passed
    times = [row["time"] for row in history(read_journal(folder))]
    assert times == sorted(times)


def test_what_is_said_already_is_not_said_again(folder: Path) -> None:
    before = (folder / "journal.jsonl").read_bytes()
    assert amend(folder, {"sample": "plate 7"}, by="B", reason="again") is None
    assert (folder / "journal.jsonl").read_bytes() == before


def test_a_word_can_be_withdrawn(folder: Path) -> None:
    amend(folder, {"sample": ""}, by="B", reason="not known after all")
    assert "sample" not in read_run(folder / "run.nc").attrs
    assert verify(folder).passed


def test_a_changed_amendment_is_found(folder: Path) -> None:
    amend(folder, {"sample": "plate 8"}, by="B", reason="wrong label")
    text = (folder / "journal.jsonl").read_text()
    (folder / "journal.jsonl").write_text(text.replace('"by":"B"', '"by":"X"'))
    assert not verify(folder).passed


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--by", "B", "--because", "why"), "nothing to amend"),
        (("--sample", "x", "--by", "", "--because", "why"), "by"),
        (("--sample", "x", "--by", "B", "--because", " "), "reason"),
        (("--sample", "two\nlines", "--by", "B", "--because", "why"), "one line"),
    ],
)
def test_an_amendment_without_substance_is_refused(folder: Path, options: tuple[str, ...], expected: str) -> None:
    before = (folder / "journal.jsonl").read_bytes()
    assert expected in run("amend", folder, *options, expected=2).output
    assert (folder / "journal.jsonl").read_bytes() == before


def test_readings_cannot_be_amended(folder: Path) -> None:
    with pytest.raises(InputError, match="changes"):
        amend(folder, {"brf": "0.5"}, by="B", reason="nicer")


def test_a_run_that_is_being_written_is_not_amended(folder: Path) -> None:
    with Journal.reopen(folder), pytest.raises(InputError, match="another program is writing this run"):
        amend(folder, {"sample": "x"}, by="B", reason="why")


def test_a_run_without_run_file_or_of_an_older_program_is_amended(tmp_path: Path) -> None:
    old = four_points(tmp_path / "old")
    amend(old, {"operator": "B"}, by="B", reason="was never said")
    assert current_record(read_journal(old)) == RunRecord(operator="B")
    assert "record" not in read_journal(old).header


def test_the_command_line_has_the_last_word_over_the_plan(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace("[[grid]]", '[record]\nsample = "p"\nproject = "q"\n[[grid]]', 1))
    plan = read_plan(tmp_path / "plan.toml", facility())
    assert RunRecord(sample="s", operator="o").over(plan.record).said() == {
        "operator": "o",
        "sample": "s",
        "project": "q",
    }


def test_a_plan_may_not_say_other_things(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace("[[grid]]", '[record]\nboss = "p"\n[[grid]]', 1))
    with pytest.raises(InputError, match="boss: unknown key"):
        read_plan(tmp_path / "plan.toml", facility())


def test_a_resumed_run_keeps_its_record(tmp_path: Path) -> None:
    from instrument.scan_options import check_options

    with pytest.raises(InputError, match="runs amend"):
        check_options({"resume": tmp_path, "sample": "x"})
    assert set(ScanRequest(record=parse_form({"sample": "x"}, RunRecord, "t")).record.said()) == {"sample"}
    assert set(header(record=SAID)["record"]) <= set(FIELDS)


def test_planes_are_told_apart_by_rotation_and_polarisation(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "plan.toml").write_text(PLAN)
    (folder / "facility.toml").write_text(header()["facility"])
    with Journal.create(folder, header(points=3)) as journal:
        for number, polarization in enumerate(("s", "p")):
            at = geometry(15.0, polarization=polarization)
            journal.record("reference", index=number, **reading(at, 0.99, float(number)))
        for number, changes in enumerate(({}, {"sample_rotation": 45.0}, {"polarization": "p"})):
            at = geometry(30.0, **({"polarization": "s"} | changes))
            journal.record("point", index=number, **reading(at, 0.5, 10.0 + number))
    write_run(rebuild_run(folder), folder / "run.nc")
    run("show", folder, "--json", tmp_path / "s.json")
    planes = json.loads((tmp_path / "s.json").read_text())["planes"]
    assert [(plane["polarization"], plane["sample_rotation"]) for plane in planes] == [("s", 0), ("s", 45), ("p", 0)]
    assert [plane["brf"][0] for plane in planes] == pytest.approx([0.5] * 3, rel=1e-3)
