"""The pages of the documentation, and the commands that they show."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HOME = Path(__file__).parents[2]
DOCS = HOME / "docs"
_FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=indent)```\s*$", re.MULTILINE | re.DOTALL
)
_CODE_SPAN = re.compile(r"(?<!`)`(?!`)([^`]+)`(?!`)")
#: Alternatives, options that may be left out, dots for more.
_SYNOPSIS = re.compile(r"[|\[\]()]|\.\.\.")
#: What a line begins with that is a command.
_PROGRAMS = ("goniotwin ", ".venv/bin/", "make ", "python ")


@dataclass(frozen=True)
class Command:
    """A command of a page.

    Attributes
    ----------
    text
        One line, continued lines joined, without remarks.
    exact
        It stands in a block of language ``sh``: a person can paste it. Others may be synopses.
    whole
        It stands in a block, and nothing in it says that something is left out: exact but for names.
    """

    page: str
    line: int
    text: str
    exact: bool
    whole: bool = False

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


def pages() -> list[Path]:
    """Every page, the front page of the project first."""
    return [HOME / "README.md", *sorted(DOCS.glob("*.md"))]


def blocks(page: Path) -> Iterator[tuple[str, int, str]]:
    """Fenced blocks of a page: language, number of the first line, text."""
    source = page.read_text(encoding="utf-8")
    for match in _FENCE.finditer(source):
        first = source.count("\n", 0, match.start()) + 2
        yield match["language"].strip(), first, match["text"]


def commands(page: Path) -> list[Command]:
    """Commands of a page: of its fenced blocks, and of the spans of code in its text."""
    name = page.name
    found = []
    for language, first, text in blocks(page):
        if language in ("sh", "", "text"):
            exact = language == "sh"
            lines = [(n, line) for n, line in _lines(text, first) if line and (exact or _is_command(line))]
            found += [Command(name, n, line, exact, exact or not _SYNOPSIS.search(line)) for n, line in lines]
    source = page.read_text(encoding="utf-8")
    without = _FENCE.sub(lambda match: "\n" * match[0].count("\n"), source)
    for number, line in _indented(without):
        found.append(Command(name, number, line, False))
    for match in _CODE_SPAN.finditer(without):
        span = " ".join(match[1].split())
        if span.startswith("goniotwin "):
            found.append(Command(name, without.count("\n", 0, match.start()) + 1, span, False))
    return found


def _indented(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("    ") and _is_command(line.strip()):
            yield number, line.strip()


def _lines(text: str, first: int) -> Iterator[tuple[int, str]]:
    """Lines with what continues them, and without the remark after them."""
    pending, began = "", first
    for number, line in enumerate(text.splitlines(), start=first):
        if not pending:
            began = number
        line = line.strip()
        if line.endswith("\\"):
            pending += line[:-1] + " "
            continue
        whole, pending = pending + line, ""
        yield began, re.sub(r"(^|\s+)#\s.*$", "", whole)


def _is_command(line: str) -> bool:
    return line.startswith(_PROGRAMS)
