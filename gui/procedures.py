"""What procedures there are, and when each was last carried out."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

_PREFIX = "calibrate."
_LISTS = ("list", "chart", "accept")


@dataclass(frozen=True)
class Procedure:
    """One procedure: its command, what it does, and its last result.

    Attributes
    ----------
    verdict
        ``passed``, ``failed``, ``recorded``; empty where it was never carried out.
    needed
        Options without which it cannot be carried out.
    """

    command: str
    text: str
    verdict: str = ""
    age: str = ""
    summary: str = ""
    needed: tuple[str, ...] = ()


def procedures(folder: Path) -> list[Procedure]:
    """Every installed procedure, with its last result in a folder."""
    found = []
    results = _results(folder)
    for point in sorted(entry_points(group="goniotwin.commands"), key=lambda point: point.name):
        name = point.name.removeprefix(_PREFIX)
        if not point.name.startswith(_PREFIX) or name in _LISTS:
            continue
        function = point.load()
        text = (inspect.getdoc(function) or "").splitlines()[0]
        needed = tuple(
            key
            for key, parameter in inspect.signature(function).parameters.items()
            if parameter.default is inspect.Parameter.empty
        )
        last = next((r for r in reversed(results) if r.procedure.startswith(name)), None)
        if last is None:
            found.append(Procedure(name, text, needed=needed))
        else:
            found.append(Procedure(name, text, last.verdict, _age(last), last.summary, needed))
    return found


def _results(folder: Path) -> list[Any]:
    from instrument.errors import InputError
    from instrument.procedures.results import read_results

    try:
        return read_results(folder)
    except InputError:
        return []


def _age(result: Any) -> str:
    hours = (datetime.now(UTC) - result.taken).total_seconds() / 3600
    if hours < 48:
        return f"{max(hours, 0):.0f} h ago"
    return f"{hours / 24:.0f} days ago"
