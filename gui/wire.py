"""Events and notices as lines of JSON, between the process that runs a scan and the windows that show it."""

from __future__ import annotations

import json
from datetime import datetime
from itertools import chain
from typing import Any, get_args

from pydantic import TypeAdapter

from gui.notices import Notice
from instrument.events import Event, Geometry, from_json, to_json
from instrument.prompts import Prompt

_LONG = 100_000  # bytes
_POINTS = TypeAdapter(list[Geometry])
_NOTICES: dict[str, type[Any]] = {kind.__name__: kind for kind in get_args(Notice)}
#: What a window may ask of the process.
COMMANDS = ("pause", "pause_now", "resume", "abort", "halt", "done", "give_up")


def encode(item: Event | Notice) -> str:
    """One line without a line break."""
    if type(item).__name__ not in _NOTICES:
        return to_json(item)  # type: ignore[arg-type]
    fields: dict[str, Any] = vars(item)
    fields = {key: _plain(value) for key, value in fields.items()}
    return json.dumps({"notice": type(item).__name__, **fields})


def decode(line: str | bytes) -> Event | Notice:
    """Read a line back.

    Raises
    ------
    ValueError
        If the line is neither an event nor a notice.
    """
    start = (line if isinstance(line, bytes) else line.encode())[:12]
    if b'"notice"' not in start:
        return from_json(line) if len(line) < _LONG else _in_pieces(line)
    fields = json.loads(line)
    kind = _NOTICES[fields.pop("notice")]
    if "time" in fields:
        fields["time"] = datetime.fromisoformat(fields["time"])
    if isinstance(fields.get("what"), dict):
        fields["what"] = Prompt.model_validate(fields["what"])
    notice: Notice = kind(**fields)
    return notice


def answer_of(text: str) -> float | str | None:
    """The answer to a prompt, as it follows the word ``done``; None for a confirmation.

    Raises
    ------
    ValueError
        If it is neither a number nor a text.
    """
    value = json.loads(text) if text else None
    if isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if value is not None and not isinstance(value, float | str):
        raise ValueError(f"found {text!r}; expected a number or a text")
    return value


def _in_pieces(line: str | bytes) -> Event:
    """A long line, its points a few at a time: read at once, it would keep every other thread waiting."""
    fields = json.loads(line)
    if not isinstance(fields, dict) or not isinstance(fields.get("points"), list):
        return from_json(line)
    points, few = fields["points"], 200
    read = [_POINTS.validate_python(points[start : start + few]) for start in range(0, len(points), few)]
    return from_json(json.dumps(fields | {"points": []})).model_copy(update={"points": tuple(chain(*read))})


def _plain(value: Any) -> Any:
    if isinstance(value, datetime):
        return value.isoformat()
    return value.model_dump(mode="json") if isinstance(value, Prompt) else value
