"""What a plan draft means: asked of the instrument room, off the Qt thread."""

from __future__ import annotations

import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError
from gui.plan_cells import PlanDraft
from instrument.durations import AXES
from instrument.errors import InputError
from instrument.facility import UNKNOWN_FACILITY, Facility, read_facility
from instrument.plan import Plan
from instrument.plan_summary import Speeds, summarise
from instrument.settings import ScanSettings

#: How fast arms are where no ``devices.toml`` says it: as ``goniotwin plan`` assumes.
_SPEEDS = Speeds(velocity=20.0, acceleration=10.0)
_PLACE = re.compile(r"(?:grid|part) (\d+): (\w+)")
_KEYS = re.compile(r"(?:grid|part)[.\[ ]*(\d+)[\].: ]+(\w+)")


@dataclass(frozen=True)
class Checked:
    """A plan that can be measured."""

    plan: Plan
    summary: dict[str, Any]


@dataclass(frozen=True)
class Wrong:
    """Why a plan cannot be measured.

    Attributes
    ----------
    row, key
        Where the fault is; -1 and empty where it is in no single cell.
    """

    text: str
    row: int = -1
    key: str = ""


def check_draft(draft: PlanDraft, facility: Path | None, devices: Path | None = None) -> Checked | Wrong:
    """Check every point and every way between points, and estimate the duration."""
    with tempfile.TemporaryDirectory(prefix="goniotwin-plan-") as name:
        folder = Path(name)
        file = folder / (f"{draft.path.stem}.toml" if draft.path else "plan.toml")
        try:
            _copy_tables(draft, folder)
            file.write_text(draft.text(), encoding="utf-8")
            plan, summary = summarise(file, facility, devices, _SPEEDS, ScanSettings())
        except (InputError, ConfigurationError) as error:
            return wrong_of(str(error).replace(f"{file}: ", "").replace(f"{folder}/", ""))
    return Checked(plan, summary)


def wrong_of(text: str) -> Wrong:
    """A message of the instrument room with the cell that it means."""
    found = _PLACE.search(text) or _KEYS.search(text)
    return Wrong(text, int(found.group(1)) - 1, found.group(2)) if found else Wrong(text)


def _copy_tables(draft: PlanDraft, folder: Path) -> None:
    for part in draft.parts:
        table = part.get("table")
        if isinstance(table, str) and draft.path is not None:
            source, target = draft.path.parent / table, folder / table
            if not target.resolve().is_relative_to(folder.resolve()) or not source.is_file():
                raise InputError(f"table: {table}: no such file beside the plan")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)


def limits_of(facility: Path | None) -> dict[str, tuple[float, float]]:
    """What each arm can do, degree; of any instrument where the facility is not known."""
    known: Facility = read_facility(facility) if facility is not None else UNKNOWN_FACILITY
    return {axis: getattr(known.arms, axis) for axis in AXES}
