"""Every command that a page shows is understood by the command line; the cheap ones are run, the tutorial's first."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
import typer
from command_line import complaint_about_synopsis, parse, words_of
from pages import DOCS, HOME, Command, commands, pages
from typer.exceptions import TyperException

import sim_fixtures.examples
from instrument import read_facility, read_plan, write_prediction
from instrument.__main__ import main
from twin import Twin

EXAMPLES = Path(sim_fixtures.examples.__file__).parent
#: Run in the prepared folder, each at its place in its page. What is put in place of something only saves time.
EXECUTED = (
    r"goniotwin --help",
    r"goniotwin scan --help",
    r"goniotwin plan first\.toml",
    r"goniotwin scan first\.toml .*--out runs/first",
    r"goniotwin runs (list|show|verify)\b",
    r"goniotwin budget ",
    r"goniotwin compare runs/first ",
    r"cp runs/first/",
    r"goniotwin artifact show ",
    r"goniotwin predict first\.toml ",
    r"goniotwin diagnose run\.nc$",
    r"goniotwin report runs/first ",
    r"goniotwin exchange (bird|csv|import|documents|mitsuba|push) ",
)
SHELL = ("git", "cd", "cp", "source", "pip", "export")
INSTEAD = {
    "--speed 120": "--speed 400 --no-twin",
    "--out prediction.nc": "--out prediction.nc --standard-error 0.01",
    " --pdf first.pdf": "",
}
#: Only parsed, and why.
PARSED_ONLY = {
    r"git clone |cd goniotwin|source ": "of a shell and of a copy that is not there yet",
    r"make (setup|test|demo)": "continuous integration runs these three themselves, before and around this test",
    r"make (judges|reliability|bench|docs)": "minutes to hours; the site is built by test_site.py",
    r".*benchmarks/": "minutes to hours",
    r"python examples/": "run by test_library_examples.py",
    r".*goniotwin gui": "a window that stays; tests/gui opens it",
    r"goniotwin scan first\.toml .*--out runs/second": "the same as the scan before it, of another plate",
    r"goniotwin diagnose .*(--artifact|sound\.json)": "renders the whole library; test_library_examples.py has five",
    r"goniotwin devices check": "needs the devices; tests/drivers/test_devices_check.py runs it",
    r"goniotwin devices simulate": "serves until Ctrl-C; tests/sim_fixtures/test_laboratory.py runs it",
}


def shown() -> list[Command]:
    return [command for page in pages() for command in commands(page)]


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_every_command_of_a_page_is_understood(page: Path) -> None:
    wrong = [f"{command}: {said}" for command in commands(page) if (said := complaint(command))]
    assert not wrong, "\n".join(wrong)


def complaint(command: Command) -> str:
    """What is wrong with a command; empty where nothing is."""
    program, *words = command.text.split()
    if program in ("goniotwin", ".venv/bin/goniotwin"):
        return _complaint(command) if command.whole else complaint_about_synopsis(command.text)
    if program == "make":
        text = (HOME / "Makefile").read_text(encoding="utf-8")
        return "" if all(re.search(rf"^{word}:", text, re.MULTILINE) for word in words) else "no such target"
    if program in ("python", ".venv/bin/python") and words[0] != "-m":
        script = HOME / words[0]
        if not script.is_file():
            return f"no such file: {words[0]}"
        text = script.read_text(encoding="utf-8")
        return " ".join(f"no {word}" for word in words[1:] if word.startswith("--") and f'"{word}"' not in text)
    return "" if program in SHELL else f"unknown program {program}"


def _complaint(command: Command) -> str:
    try:
        # Words about a command stand behind it, well apart.
        parse(words_of(re.split(r"\s{2,}", command.text)[0]))
    except typer.Exit as end:
        return "" if end.exit_code == 0 else f"exit status {end.exit_code}"
    except TyperException as error:
        return error.format_message()
    return ""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("goniotwin scan --simulated", "simulated"),
        ("goniotwin scan first.toml --speed quick", "valid number"),
        ("goniotwin scans first.toml", "scans"),
        ("goniotwin runs shows", "shows"),
        ("goniotwin predict first.toml", "artifact"),
        ("goniotwins plan first.toml", "unknown program"),
        ("make tests", "no such target"),
        ("python examples/predicts.py", "no such file"),
    ],
)
def test_a_wrong_command_is_not_understood(text: str, said: str) -> None:
    assert said in complaint(Command("page.md", 1, text, exact=True, whole=True))


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("goniotwin runs list | show | verify", False),
        ("goniotwin runs list | shew", True),
        ("goniotwin calibrate PROCEDURE (--simulate [--speed N] | --devices FILE --facility FILE)", False),
        ("goniotwin diagnose RUN ... --save-twins FILE", True),
        ("goniotwin gui [--simulate]", False),
        ("goniotwin reports", True),
    ],
)
def test_a_synopsis_is_held_to_commands_and_options(text: str, wrong: bool) -> None:
    assert bool(complaint(Command("page.md", 1, text, exact=False))) is wrong


@pytest.mark.parametrize("pattern", [*EXECUTED, *PARSED_ONLY])
def test_what_is_listed_here_is_in_a_page(pattern: str) -> None:
    assert any(re.match(pattern, command.text) for command in shown() if command.exact)


def test_every_command_of_the_tutorial_is_run_or_has_its_reason() -> None:
    for command in commands(DOCS / "tutorial.md"):
        if command.exact:
            listed = [pattern for pattern in [*EXECUTED, *PARSED_ONLY] if re.match(pattern, command.text)]
            assert len(listed) == 1, f"{command}: {listed}"


def written_files(page: Path) -> dict[str, str]:
    """Files that a page asks to write: a TOML block after a sentence that ends with its name."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"`(\w+\.toml)`[^`]*?:\n\n```toml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return dict(found)


@pytest.mark.slow
@pytest.mark.timeout(900)  # of the wall clock, on a busy machine
def test_the_tutorial_and_other_cheap_commands_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    files = written_files(DOCS / "tutorial.md")
    assert set(files) == {"first.toml", "deeper.toml"}
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    done = 0
    for page in sorted(pages(), key=lambda page: page.name != "tutorial.md"):
        for command in commands(page):
            if command.exact and any(re.match(pattern, command.text) for pattern in EXECUTED):
                _run(command, tmp_path)
                done += 1
    assert done >= len(EXECUTED)
    said = capsys.readouterr().out
    for words in ("34 points", "finished; 34 of 34 points", "combined", "is what the journal gives", "cavity"):
        assert words in said
    assert len(list((tmp_path / "pictures").iterdir())) >= 3


def _run(command: Command, folder: Path) -> None:
    text = command.text
    for shown_words, instead in INSTEAD.items():
        text = text.replace(shown_words, instead)
    program, *words = shlex.split(text)
    if program == "cp":
        *sources, target = words
        for source in sources:
            shutil.copy(folder / source, folder / target)
        return
    status: object = 0
    try:
        status = main(words)
    except SystemExit as end:
        status = end.code or 0
    assert status == 0, f"{command}: exit status {status}"
    if words[:1] == ["scan"] and "--out" in words:
        _predicted(folder / words[words.index("--out") + 1])
        shutil.copy(folder / "runs" / "first" / "run.nc", folder / "run.nc")


def _predicted(run: Path) -> None:
    """Leave a coarse prediction where the live twin, left out here, would have left a fine one."""
    twin = Twin.from_files(run / "facility.toml", run / "artifact.toml", run / "material.nc")
    points = read_plan(run / "plan.toml", read_facility(run / "facility.toml")).points
    write_prediction(twin.predict(points, standard_error=0.01), run / "prediction.nc")
