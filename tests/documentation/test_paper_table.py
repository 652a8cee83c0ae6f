"""Every module, command and test that docs/paper.md names is there."""

from __future__ import annotations

import ast
import re
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

import pytest
from pages import DOCS, HOME

PAGE = DOCS / "paper.md"
ROOMS = ("instrument", "twin", "drivers", "gui", "sim_fixtures")
#: Sections of the publication that the page has to go through; tables and figures by their numbers.
SECTIONS = [f"II-{letter}" for letter in "ABCDEFGHI"] + ["II-F1", "II-F2", "II-F3", "III-A", "III-B", "IV", "A", "B-A"]
SECTIONS += ["B-B", "C"]
COLUMNS = 5


def rows() -> list[list[str]]:
    """Cells of every row of the page's tables, headings left out."""
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    return [row for row in cells if row[0] != "section"]


def spans(text: str) -> list[str]:
    return re.findall(r"`([^`]+)`", text)


@cache
def existing_tests() -> frozenset[str]:
    """Names of all test functions of the project."""
    names: set[str] = set()
    for file in (HOME / "tests").rglob("test_*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        names |= {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    return frozenset(names)


def test_rows_are_whole_and_every_section_is_there() -> None:
    found = rows()
    assert all(len(row) == COLUMNS for row in found), [row[0] for row in found if len(row) != COLUMNS]
    named = {row[0].split()[0].rstrip(",") for row in found}
    assert not set(SECTIONS) - named
    text = " ".join(row[0] for row in found)
    for table in ("I", "II", "III", "IV", "V", "VI"):
        assert re.search(rf"Table {table}\b", text), table
    figures: set[int] = set()
    for first, joined, last in re.findall(r"Figs?\. (\d+)(?: (and|to) (\d+))?", text):
        figures |= set(range(int(first), int(last) + 1)) if joined else {int(first)}
    assert figures >= set(range(10, 21))


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_a_row_names_what_exists(row: list[str]) -> None:
    _, _, program, checked, beyond = row
    for name in spans(checked):
        assert name in existing_tests(), f"{name}: no such test"
    for name in [*spans(program), *spans(beyond)]:
        _look_up(name)
    # What is done is checked, and what is not done is said.
    assert bool(spans(program)) == bool(spans(checked))
    assert spans(program) or beyond


def _look_up(name: str) -> None:
    if name.startswith("goniotwin "):
        path = ".".join(name.split()[1:])
        assert path in {point.name for point in entry_points(group="goniotwin.commands")}, name
    elif name.startswith("--"):
        for option in name.split():
            assert any(f'"{option}"' in text or f" {option[2:]}:" in text for text in _commands()), option
    elif name.startswith("make "):
        assert re.search(rf"^{name.split()[1]}:", (HOME / "Makefile").read_text(encoding="utf-8"), re.MULTILINE), name
    elif name.endswith(".toml"):
        assert (HOME / "sim_fixtures" / "examples" / name).is_file(), name
    elif name.split(".")[0] in ROOMS:
        assert find_spec(name) is not None, f"{name}: no such module"
    else:
        assert any(re.search(rf"\b{name}\b", text) for text in _sources()), f"{name}: nowhere in the program"


@cache
def _sources() -> list[str]:
    return [file.read_text(encoding="utf-8") for room in ("instrument", "twin") for file in (HOME / room).rglob("*.py")]


@cache
def _commands() -> list[str]:
    files = [file for room in ("instrument", "twin") for file in (HOME / room).rglob("*command*.py")]
    return [file.read_text(encoding="utf-8") for file in files]


def test_the_page_is_one_of_the_site() -> None:
    assert re.search(r"^paper$", (DOCS / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert Path(PAGE).is_file()
