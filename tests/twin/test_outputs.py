"""No command loses what exists: outputs are refused where something is, ``--json`` replaces nothing but JSON."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
import typer.main

from instrument.__main__ import GROUP, build, main
from instrument.errors import InputError
from instrument.output import check_new, check_new_folder, write_json, write_result
from sim_fixtures.examples import example_files

FILES = example_files()
INPUTS = ("--artifact", FILES.artifact, "--material", FILES.material, "--facility", FILES.facility)
RUN = FILES.material
#: Command, words before the name of what is there already, its suffix; ``/`` for a folder.
OUTPUTS: list[tuple[str, tuple[object, ...], str]] = [
    ("predict", (FILES.plan, *INPUTS, "--out"), ".nc"),
    ("compare", (RUN, *INPUTS, "--figures"), "/"),
    ("diagnose", (RUN, *INPUTS, "--json"), ".toml"),
    ("diagnose", (RUN, *INPUTS, "--prediction"), ".nc"),
    ("diagnose", (RUN, *INPUTS, "--report"), ".html"),
    ("diagnose", (RUN, *INPUTS, "--save-twin"), ".toml"),
    ("diagnose", (RUN, *INPUTS, "--plans"), "/"),
    ("blind-check", ("--json",), ".toml"),
    ("report", (RUN, "--out"), ".html"),
    ("report", (RUN, "--out", "new.html", "--pdf"), ".pdf"),
    ("report", (RUN, "--out", "new.html", "--figures"), "/"),
    ("design", (FILES.artifact, "--out"), "/"),
    ("budget", (RUN, "--out"), ".nc"),
    ("runs merge", (RUN, RUN, "--out"), ".nc"),
    ("artifact show", (FILES.artifact, "--out"), ".png"),
    ("artifact export", (FILES.artifact, "--out"), ".ply"),
    ("material table", (RUN, "--out"), ".nc"),
    ("exchange bird", (RUN,), ".json"),
    ("exchange csv", (RUN,), ".csv"),
    ("exchange documents", (RUN,), ".jsonl"),
    ("exchange mitsuba", (RUN,), ".bsdf"),
    ("exchange import", (RUN,), ".nc"),
    ("exchange pull", (f"file://{FILES.facility.parent}",), "/"),
    ("devices simulate", ("--out",), "/"),
]
#: A run folder is never written into twice (test_run_safety.py); sets of cases go on where they stopped
#: (their ``--json`` does not); a chart and a store are tried with theirs (test_procedures_standing.py,
#: test_exchange_stores.py).
ELSEWHERE = {"scan", "gui", "cases make", "blind-check", "calibrate chart", "exchange push"}
WRITING = {"--out", "--figures", "--pdf", "--prediction", "--save-twin", "--report", "--plans", "out", "url", "folder"}


@cache
def commands() -> dict[str, Any]:
    found = {}
    for point in entry_points(group=GROUP):
        words = point.name.split(".")
        command: Any = typer.main.get_command(build(words))
        for word in words:
            command = command.commands[word]
        found[" ".join(words)] = command
    return found


def test_every_command_that_writes_is_tried() -> None:
    reading = {"runs list", "runs verify", "runs amend"}  # their FOLDER is read, or amended
    writing = {
        name
        for name, command in commands().items()
        if name not in reading and WRITING & {word for one in command.params for word in (*one.opts, one.name)}
    }
    assert writing == {name for name, *_ in OUTPUTS} | ELSEWHERE


@pytest.mark.parametrize(
    ("command", "words", "suffix"), OUTPUTS, ids=lambda value: value if isinstance(value, str) else ""
)
def test_what_exists_is_kept(
    command: str,
    words: tuple[object, ...],
    suffix: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    there = tmp_path / "kept" if suffix == "/" else tmp_path / f"kept{suffix}"
    file = there / "notes.txt" if suffix == "/" else there
    file.parent.mkdir(exist_ok=True)
    file.write_text("an hour's work")
    assert main([*command.split(), *map(str, words), there.name]) == 2
    said = capsys.readouterr().err
    assert there.name in said
    assert "exists already" in said or "not empty" in said
    assert file.read_text() == "an hour's work"
    assert [path.name for path in tmp_path.iterdir()] == [there.name]
    if command not in ("exchange pull", "blind-check"):
        assert "--force" in {word for one in commands()[command].params for word in one.opts}


def test_force_and_what_is_no_file_are_let_through(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("old")
    check_new(tmp_path / "old", force=True)
    check_new(tmp_path / "new", force=False)
    check_new(Path("/dev/stdout"), force=False)
    check_new_folder(tmp_path, force=True)
    (tmp_path / "empty").mkdir()
    check_new_folder(tmp_path / "empty", force=False)
    check_new_folder(tmp_path / "none", force=False)


def test_json_replaces_json_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    for content in ({"a": 1}, [2]):
        write_json(file, content)
    assert file.read_text().split() == ["[", "2", "]"]
    for kept in (b'title = "a plan"\n', b"\x89HDF\r\n\x1a\n", b'{"a": 1}\n{"b": 2}\n'):
        file.write_bytes(kept)
        with pytest.raises(InputError, match=r"found\.json: exists already and is no JSON file"):
            write_json(file, {})
        assert file.read_bytes() == kept
    write_json(file, {}, force=True)
    assert file.read_text() == "{}\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_one_message() -> None:
    with pytest.raises(InputError, match=r"^/dev/full: cannot be written: No space left on device$"):
        write_result(Path("/dev/full"), b"an hour's work")
