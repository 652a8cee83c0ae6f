"""The real command line, asked whether it understands what a page shows."""

from __future__ import annotations

import re
import shlex
from functools import cache
from importlib.metadata import entry_points
from typing import Any

import typer.main

from instrument.__main__ import GROUP, build


@cache
def command_paths() -> frozenset[str]:
    """Every command, its words with a space between."""
    return frozenset(point.name.replace(".", " ") for point in entry_points(group=GROUP))


def words_of(text: str) -> list[str]:
    """Words of a line as a shell has them, without the program and what follows a redirection."""
    words = shlex.split(text)
    ends = [words.index(mark) for mark in (">", "|", "&&", "&") if mark in words]
    return words[1 : min(ends, default=len(words))]


def parse(words: list[str]) -> str:
    """Parse as the program does, without doing anything; returns the words of the command.

    Raises
    ------
    Exception
        What the command line says of a wrong command, option or value.
    """
    command: Any = typer.main.get_command(build(words))
    context = command.make_context("goniotwin", list(words))
    path = []
    while hasattr(command, "resolve_command"):
        rest = [*context._protected_args, *context.args]
        name, command, rest = command.resolve_command(context, rest)
        context = command.make_context(name, rest, parent=context)
        path.append(name)
    return " ".join(path)


@cache
def options_of(path: str) -> frozenset[str]:
    """Options of a command, or of all commands of a group."""
    found = {"--help"}
    for name in command_paths():
        if name == path or name.startswith(path + " "):
            words = name.split()
            command: Any = typer.main.get_command(build(words))
            for word in words:
                command = command.commands[word]
            found |= {option for parameter in command.params for option in [*parameter.opts, *parameter.secondary_opts]}
    return frozenset(found)


def complaint_about_synopsis(text: str) -> str:
    """What is wrong with a command in prose: alternatives, placeholders and dots may stand in it. Empty: nothing."""
    text = re.split(r"\s{2,}|: | for ", text.strip())[0]
    words = re.sub(r"[\[\]()]", " ", text.partition(" ")[2]).split()
    taken: list[str] = []
    while words and any(f"{name} ".startswith(" ".join([*taken, words[0]]) + " ") for name in command_paths()):
        taken.append(words.pop(0))
    if not taken:
        return "" if not words or words[0].startswith("-") or words[0].isupper() else f"no command {words[0]!r}"
    paths = [" ".join(taken)]
    while len(words) >= 2 and words[0] == "|" and not words[1].startswith("-"):
        paths.append(" ".join([*taken[:-1], words[1]]))
        words = words[2:]
    for path in paths:
        if path not in command_paths() and not any(name.startswith(path + " ") for name in command_paths()):
            return f"no command {path!r}"
    known = frozenset().union(*map(options_of, paths))
    wrong = [word for word in words if word.startswith("--") and word.split("=")[0].rstrip(".,;") not in known]
    return f"{paths[0]} has no {wrong[0]}" if wrong else ""
