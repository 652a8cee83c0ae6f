"""Newport SMC100 command syntax (manual EDH0206En2051, section "Command syntax"): one command a line."""

from __future__ import annotations

import re
from dataclasses import dataclass

_COMMAND = re.compile(
    r"(?P<address>\d*)(?P<name>[A-Z]{2})(?P<value>\?|[+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+)?)?(?P<letter>[@A-Z](?![A-Z]))?",
    re.I,
)


@dataclass(frozen=True)
class Command:
    """A parsed line; ``address`` None where it names no controller, ``letter`` an error that ``TB`` puts into words."""

    address: int | None
    name: str
    query: bool
    value: float | None
    letter: str = ""


def parse(line: str) -> Command | None:
    """Parse a line; blanks do not count, and what follows the first command is ignored.

    Returns None where the line holds no command; a line that begins with one the manual does not know parses
    all the same (its controller remembers error A).
    """
    match = _COMMAND.match(re.sub(r"\s", "", line))
    if match is None:
        return None
    address, value = match["address"], match["value"]
    number = float(value) if value not in (None, "?") else None
    return Command(
        int(address) if address else None, match["name"].upper(), value == "?", number, (match["letter"] or "").upper()
    )
