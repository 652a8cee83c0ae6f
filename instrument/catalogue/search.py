"""What to look for in a catalogue."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from instrument.catalogue.entry import FIGURES
from instrument.errors import InputError

_CONDITION = re.compile(r"\s*([a-z_]+)\s*(<=|>=|<|>|=)\s*(\S+)\s*$")
_DAY = re.compile(r"\d{4}-\d{2}-\d{2}$")


@dataclass(frozen=True)
class Condition:
    """A figure of merit against a number."""

    figure: str
    comparison: str
    value: float


@dataclass(frozen=True)
class Query:
    """Every field that is set must hold.

    Attributes
    ----------
    plan, sample, operator, project, verdict
        Part of the text, in capitals or not.
    state
        The whole word: finished, aborted, halted, faulted, interrupted, running, damaged.
    since, until
        A run belongs where it was started at this time (UTC) or later, and before that one.
    wavelength
        nm.
    conditions
        On figures of merit; a run without the figure does not hold.
    """

    plan: str = ""
    sample: str = ""
    operator: str = ""
    project: str = ""
    verdict: str = ""
    state: str = ""
    since: datetime | None = None
    until: datetime | None = None
    wavelength: float | None = None
    conditions: Sequence[Condition] = field(default_factory=list)

    def sql(self) -> tuple[str, list[object]]:
        """As a condition of SQL, and its parameters."""
        parts, values = ["1"], list[object]()
        texts = {"title": self.plan, "sample": self.sample, "operator": self.operator, "project": self.project}
        for column, text in (texts | {"verdict": self.verdict}).items():
            if text:
                parts.append(f"instr(lower({column}), lower(?)) > 0")
                values.append(text)
        if self.state:
            parts.append("outcome = ?")
            values.append(self.state)
        for moment, comparison in ((self.since, ">="), (self.until, "<")):
            if moment is not None:
                parts.append(f"created {comparison} ?")
                values.append(moment.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z"))
        if self.wavelength is not None:
            parts.append("instr(', ' || wavelengths || ',', ?) > 0")
            values.append(f", {self.wavelength:g},")
        for condition in self.conditions:
            parts.append(f"{condition.figure} {condition.comparison} ?")
            values.append(condition.value)
        return " AND ".join(parts), values


def condition(text: str) -> Condition:
    """A condition as a person writes it: ``relative_rmse<0.03``.

    Raises
    ------
    InputError
        For a figure of merit that does not exist, or what is no condition.
    """
    found = _CONDITION.match(text)
    if found is None:
        raise InputError(f"--where: found {text!r}; expected a figure of merit, <, <=, >, >= or =, and a number")
    name, comparison, number = found.groups()
    if name not in FIGURES:
        raise InputError(f"--where: {name}: no figure of merit; expected one of {', '.join(FIGURES)}")
    try:
        return Condition(name, comparison, float(number))
    except ValueError:
        raise InputError(f"--where: {name}: found {number!r}; expected a number") from None


def moment(text: str, option: str, *, end: bool = False) -> datetime:
    """A date or a time of a person, UTC where it says nothing else; a date as an end takes in its whole day.

    Raises
    ------
    InputError
        If it is neither.
    """
    try:
        found = datetime.fromisoformat(text.replace("Z", "+00:00"))
    except ValueError:
        raise InputError(f"{option}: found {text!r}; expected a date like 2026-03-02, or 2026-03-02T08:00") from None
    found = found if found.tzinfo else found.replace(tzinfo=UTC)
    return found + timedelta(days=1) if end and _DAY.match(text) else found
