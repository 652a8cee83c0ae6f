"""The root command: what it lists, what it does not load, how errors look."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import pytest

from drivers.errors import CommunicationError, ConfigurationError
from instrument import __main__ as root
from instrument.errors import InputError, SafetyError

#: What costs more than the rest together; typer itself brings pydantic.
HEAVY = ("numpy", "xarray", "rich.console", "scipy", "mitsuba", "PySide6", "pyvista", "pymodbus", "matplotlib")


USAGE: dict[str, int] = {
    "--help": 0,
    "--version": 0,
    "": 2,
    "nonsense": 2,
    "scan --help": 0,
    "scan --speed fast": 2,
    "scan --nonsense": 2,
    "scan a b": 2,
    "runs": 2,
    "runs nonsense": 2,
}


@pytest.fixture(scope="module")
def answers() -> dict[str, tuple[int, list[str]]]:
    """Exit status of every such command line, and what heavy it has imported, one after the other in one process."""
    code = (
        "import json, sys\n"
        "from instrument.__main__ import main\n"
        "seen, told = set(), {}\n"
        "for words in json.loads(sys.argv[1]):\n"
        "    try:\n        status = main(words.split())\n"
        "    except SystemExit as end:\n        status = end.code\n"
        f"    heavy = [name for name in {HEAVY!r} if name in sys.modules and name not in seen]\n"
        "    seen.update(heavy)\n"
        "    told[words] = [status, heavy]\n"
        "print('\\n@', json.dumps(told))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(list(USAGE))], capture_output=True, text=True, check=True, timeout=60.0
    )
    return {words: (status, heavy) for words, (status, heavy) in json.loads(done.stdout.rpartition("@")[2]).items()}


@pytest.mark.parametrize(("words", "status"), USAGE.items())
def test_help_and_usage_errors_answer_without_anything_heavy(
    answers: dict[str, tuple[int, list[str]]], words: str, status: int
) -> None:
    assert answers[words] == (status, [])


def test_help_lists_every_registered_command_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        root.main(["--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    commands = text.partition("Commands:")[2]
    for point in entry_points(group=root.GROUP):
        line = next(row for row in commands.splitlines() if row.split()[:1] == [point.name.split(".")[0]])
        assert len(line.split()) > 2
    assert "cannot be loaded" not in text


def command_that_raises(error: BaseException) -> Callable[[], None]:
    def command() -> None:
        """Fail."""
        raise error

    return command


class Point(EntryPoint):
    """An entry point that holds its function."""

    def __new__(cls, name: str, function: Callable[..., None]) -> Point:
        return super().__new__(cls)

    def __init__(self, name: str, function: Callable[..., None]) -> None:
        super().__init__(name, "here:function", root.GROUP)
        vars(self)["function"] = function

    def load(self) -> Callable[..., None]:
        return vars(self)["function"]


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (InputError("plan.toml: grid: missing"), 2, "goniotwin: plan.toml: grid: missing"),
        (ConfigurationError("devices.toml: lines: missing"), 2, "goniotwin: devices.toml: lines: missing"),
        (
            CommunicationError("shutter", "no reply", "check the cable"),
            3,
            "goniotwin: shutter: no reply (check the cable)",
        ),
        (SafetyError("no way"), 3, "goniotwin: no way"),
        (ZeroDivisionError("oops"), root.EXIT_INTERNAL, "goniotwin: ZeroDivisionError: oops"),
    ],
)
def test_an_error_is_one_line_and_a_status(
    error: Exception, status: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(root.TRACEBACK_VARIABLE, raising=False)
    monkeypatch.setattr(root, "entry_points", lambda group: [Point("fail", command_that_raises(error))])
    assert root.main(["fail"]) == status
    shown = capsys.readouterr()
    assert shown.err.startswith(said)
    assert shown.err.count("\n") == 1
    assert "Traceback" not in shown.err
    assert shown.out == ""


def test_an_interruption_ends_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(root, "entry_points", lambda group: [Point("fail", command_that_raises(KeyboardInterrupt()))])
    with pytest.raises(SystemExit) as end:
        root.main(["fail"])
    assert end.value.code == 130


def test_dotted_names_are_groups(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    called = []

    def inner(word: str) -> None:
        """Say a word."""
        called.append(word)

    monkeypatch.setattr(root, "entry_points", lambda group: [Point("one.two.three", inner)])
    with pytest.raises(SystemExit) as end:
        root.main(["one", "two", "three", "hello"])
    assert end.value.code == 0
    assert called == ["hello"]
    with pytest.raises(SystemExit):
        root.main(["one", "two", "--help"])
    assert "Say a word." in capsys.readouterr().out


def test_a_command_that_cannot_be_loaded_leaves_the_others_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = EntryPoint("broken", "instrument.no_such_module:f", root.GROUP)

    def works() -> None:
        """Work."""

    monkeypatch.setattr(root, "entry_points", lambda group: [broken, Point("works", works)])
    with pytest.raises(SystemExit):
        root.main(["--help"])
    text = capsys.readouterr().out
    assert "Work." in text
    assert "cannot be loaded" in text
    assert root.main(["broken"]) == 2
    assert "no_such_module" in capsys.readouterr().err


BAD_INPUT = [
    ([], "nothing to scan with"),
    (["--simulate", "--devices", "d.toml"], "exclude each other"),
    (["--devices", "d.toml"], "PLAN: missing"),
    (["missing.toml", "--simulate"], "missing.toml: no such file"),
    (["--simulate", "--artifact", "missing.toml"], "missing.toml"),
    (["--simulate", "--facility", "missing.toml"], "missing.toml"),
    (["--simulate", "--material", "missing.nc"], "missing.nc: no such file"),
    (["--resume", "nowhere"], "nowhere"),
    (["--resume", "nowhere", "--out", "elsewhere"], "leave it out"),
]


@pytest.mark.parametrize(("words", "said"), BAD_INPUT)
def test_bad_input_to_a_scan_is_one_message_and_starts_nothing(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def must_not_start(*_: object, **__: object) -> None:
        raise AssertionError("the laboratory was started")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("instrument.session.laboratory_factory", must_not_start)
    assert root.main(["scan", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []
