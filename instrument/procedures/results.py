"""Results of procedures: one JSON file each, in a folder of their own, never changed afterwards."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from instrument.errors import InputError
from instrument.files import json_object, write_atomically
from instrument.forms import Form
from instrument.prompts import Answer

FORMAT = "goniotwin-calibration"
#: Where results lie that nobody put elsewhere.
RESULTS = Path("calibrations")
Verdict = Literal["passed", "failed", "recorded"]


class Quantity(Form):
    """A value, its standard uncertainty (k = 1; None where it has none), and its unit (``1`` for ratios)."""

    value: float
    u: float | None = None
    unit: str

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        if not self.u:
            return f"{self.value:.6g}{unit}"
        size = max(abs(self.value), self.u)
        power = math.floor(math.log10(size))
        scale, mark = (10.0**power, f"e{power}") if power < -3 or power > 5 else (1.0, "")
        digits = max(0, 1 - math.floor(math.log10(self.u / scale)))
        value = f"{self.value / scale:.{digits}f} ± {self.u / scale:.{digits}f}"
        return f"({value}){mark}{unit}" if mark else f"{value}{unit}"


class Finding(Form):
    """What a procedure can say of itself when it has ended."""

    verdict: Verdict
    summary: str
    values: dict[str, Quantity]
    advice: tuple[str, ...] = ()
    readings: tuple[dict[str, Any], ...] = ()
    subject: str = ""


class CalibrationResult(Form):
    """One result, as it is stored.

    Attributes
    ----------
    taken
        UTC (laboratory time), when the procedure ended.
    subject
        What it was done with: identity of a standard or of a control sample.
    instrument
        Name of the facility, identity of every device, and whether it was the simulated laboratory.
    settings
        What the procedure was asked to do.
    answers
        What people confirmed.
    notes
        What was decided on the way.
    """

    format: Literal["goniotwin-calibration"] = "goniotwin-calibration"
    version: Literal[1] = 1
    procedure: str
    taken: datetime
    who: str = ""
    subject: str = ""
    verdict: Verdict
    summary: str
    values: dict[str, Quantity] = Field(default_factory=dict)
    advice: tuple[str, ...] = ()
    settings: dict[str, Any] = Field(default_factory=dict)
    instrument: dict[str, Any] = Field(default_factory=dict)
    answers: tuple[Answer, ...] = ()
    notes: tuple[str, ...] = ()
    readings: tuple[dict[str, Any], ...] = ()
    software: str = Field(default_factory=lambda: f"goniotwin {version('goniotwin')}")

    def age(self, now: datetime | None = None) -> timedelta:
        """Time since it was taken."""
        return (now or datetime.now(UTC)) - self.taken


def store(result: CalibrationResult, folder: Path) -> Path:
    """Write a result under a name of its own; returns the file.

    Raises
    ------
    InputError
        If the folder cannot be made or written.
    """
    stem = f"{result.taken:%Y%m%dT%H%M%SZ}-{result.procedure}"
    text = json.dumps(result.model_dump(mode="json"), indent=1, allow_nan=False) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        number = 1
        while (path := folder / (f"{stem}.json" if number == 1 else f"{stem}-{number}.json")).exists():
            number += 1
        write_atomically(path, text.encode())
    except OSError as error:
        raise InputError(f"{folder}: the result cannot be written: {error.strerror}") from None
    return path


def read_result(path: Path) -> CalibrationResult:
    """Read one result.

    Raises
    ------
    InputError
        Naming file and key.
    """
    data = json_object(path, f"a JSON file of {FORMAT}")
    if data.get("format") != FORMAT:
        raise InputError(f"{path}: format: expected {FORMAT!r}")
    try:
        return CalibrationResult.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: {key}: {first['msg']} (found {first['input']!r})") from None


def read_results(folder: Path, procedure: str | None = None, subject: str | None = None) -> list[CalibrationResult]:
    """Every result in a folder, oldest first.

    Raises
    ------
    InputError
        If one of them is damaged.
    """
    found = [read_result(path) for path in sorted(folder.glob("*.json"))] if folder.is_dir() else []
    chosen = [r for r in found if procedure in (None, r.procedure) and subject in (None, r.subject)]
    return sorted(chosen, key=lambda result: result.taken)


def latest(folder: Path, procedure: str) -> CalibrationResult | None:
    """The youngest result of a procedure; None where there is none."""
    results = read_results(folder, procedure)
    return results[-1] if results else None
