"""A procedure at the terminal: run it, say what it found, keep the result."""

from __future__ import annotations

import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from instrument.control import Interruption
from instrument.errors import EXIT_DONE, EXIT_INCOMPLETE, EXIT_INTERRUPTED
from instrument.output import check_json, write_json
from instrument.procedures.people import LineOperator, person_in_charge
from instrument.procedures.results import CalibrationResult, Finding, read_results, store
from instrument.procedures.room import Room, RoomRequest, open_room
from instrument.prompts import account
from instrument.settings import ScanSettings

Work = Callable[[Room], Finding]
_COLOURS = {"passed": "green", "failed": "red", "recorded": "blue"}


def carry_out(room: Room, name: str, work: Work, settings: dict[str, Any]) -> CalibrationResult:
    """Run a procedure in a room; the result is not stored yet."""
    identities = room.identities()
    finding = work(room)
    return CalibrationResult(
        procedure=name,
        taken=datetime.now(UTC),
        who=room.request.who or account(),
        subject=finding.subject,
        verdict=finding.verdict,
        summary=finding.summary,
        values=finding.values,
        advice=finding.advice,
        settings=settings,
        instrument=identities,
        answers=tuple(room.answers),
        notes=tuple(room.notes),
        readings=finding.readings,
    )


def run_procedure(
    request: RoomRequest,
    name: str,
    work: Work,
    settings: dict[str, Any],
    report: Path | None = None,
    scan_settings: ScanSettings | None = None,
) -> int:
    """Run a procedure at the terminal and return the exit status: 0 passed, 1 failed, 130 interrupted.

    Raises
    ------
    InputError, ConfigurationError, DeviceError
        When it could not be carried out; nothing is stored then.
    """
    check_json(report)
    console = Console(highlight=False)
    person = person_in_charge(console)
    operator = None if request.simulate else person
    rehearsing = person if request.simulate and isinstance(person, LineOperator) else None
    try:
        with open_room(request, operator, scan_settings, rehearsing=rehearsing) as room:
            room.say = lambda text: console.print(f"  {text}", markup=False)
            result = carry_out(room, name, work, settings)
    except Interruption as request_to_end:
        print(f"goniotwin: {request_to_end.reason}; nothing is stored", file=sys.stderr)
        return EXIT_INTERRUPTED
    finally:
        person.dismissed = True
    path = store(result, request.results)
    show(console, result)
    console.print(f"Result: {path}", soft_wrap=True, markup=False)
    if report is not None:
        write_json(report, result.model_dump(mode="json") | {"file": str(path)})
    return EXIT_INCOMPLETE if result.verdict == "failed" else EXIT_DONE


def show(console: Console, result: CalibrationResult) -> None:
    """Print a result for people."""
    table = Table("value", "", title=f"{result.procedure} {result.taken:%Y-%m-%d %H:%M} UTC", title_justify="left")
    for name, quantity in result.values.items():
        table.add_row(name, str(quantity))
    if result.values:
        console.print(table)
    colour = _COLOURS[result.verdict]
    console.print(f"[{colour} bold]{result.verdict}[/]: ", end="")
    console.print(result.summary, markup=False, soft_wrap=True)
    for note in result.notes:
        console.print(f"  note: {note}", markup=False, soft_wrap=True)
    for line in result.advice:
        console.print(f"  {line}", markup=False, soft_wrap=True)


def list_results(folder: Path, now: datetime, everything: bool, console: Console) -> list[CalibrationResult]:
    """Print what is known of each procedure (and subject), the youngest result first; returns what was printed."""
    results = read_results(folder)
    chosen = list(reversed(results))
    if not everything:
        youngest = {(result.procedure, result.subject): result for result in results}
        chosen = sorted(youngest.values(), key=lambda result: result.procedure)
    if not chosen:
        console.print(f"{folder}: no results; goniotwin calibrate --help lists the procedures", markup=False)
        return []
    table = Table("procedure", "of", "age", "verdict", "found")
    for result in chosen:
        colour = _COLOURS[result.verdict]
        verdict = f"[{colour}]{result.verdict}[/]"
        table.add_row(result.procedure, result.subject, age_text(result, now), verdict, result.summary)
    console.print(table)
    return chosen


def age_text(result: CalibrationResult, now: datetime) -> str:
    """Age in the unit that suits it."""
    seconds = max(result.age(now).total_seconds(), 0.0)
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"
