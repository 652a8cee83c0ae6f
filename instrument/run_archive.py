"""What lies in a run folder, and whether it still is what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.errors import InputError
from instrument.journal import JOURNAL_NAME, JournalContent, read_journal
from instrument.request import FACILITY_NAME, PLAN_NAME
from instrument.run_build import run_of_journal
from instrument.run_folder import RUN_NAME
from instrument.run_read import read_run
from instrument.run_record import current_record

#: Derived values may differ by rounding when another machine computes them again.
_ROUNDING = 1e-9
#: Attributes without which numbers mean something else.
_MEANING = ("units", "unc_comps", "err_corr_1_form", "err_corr_1_params", "degrees_of_freedom")


@dataclass(frozen=True)
class Check:
    """One check of a run folder; ``found`` says what is the matter, or what is right."""

    name: str
    passed: bool
    found: str


@dataclass(frozen=True)
class RunSummary:
    """What a journal says of its run, in one row; ``problem`` says why it cannot be read."""

    created: str = ""
    title: str = ""
    planned: int = 0
    measured: int = 0
    skipped: int = 0
    outcome: str = ""
    sample: str = ""
    operator: str = ""
    problem: str = ""


@dataclass(frozen=True)
class Verification:
    """All checks of a run folder; ``folder`` may be a URL."""

    folder: Path | str
    checks: tuple[Check, ...] = field(default_factory=tuple)

    @property
    def passed(self) -> bool:
        """Whether nothing is the matter."""
        return all(check.passed for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"folder": str(self.folder), "passed": self.passed, "checks": [vars(check) for check in self.checks]}


def summary_of(content: JournalContent) -> RunSummary:
    """A run in one row, from its journal."""
    record = current_record(content)
    ended = [line for line in content.others if line["kind"] == "ended"]
    return RunSummary(
        created=content.header["created"],
        title=content.header.get("title", ""),
        planned=content.header["points"],
        measured=len(content.points),
        skipped=len(content.skipped),
        outcome=str(ended[-1].get("outcome", "")) if ended else "interrupted",
        sample=record.sample,
        operator=record.operator,
    )


def verify(folder: Path) -> Verification:
    """Check a run folder against its journal: lines unchanged, copies unchanged, ``run.nc`` what the journal gives.

    Raises
    ------
    InputError
        If the folder holds no journal.
    """
    if not (folder / JOURNAL_NAME).exists():
        raise InputError(f"{folder}: holds no {JOURNAL_NAME}; expected a run folder")
    try:
        content = read_journal(folder)
    except InputError as error:
        return Verification(folder, (Check("journal", False, str(error)),))
    lines = f"{len(content.chains)} lines unchanged"
    torn = f"; a torn last line of {len(content.torn)} bytes is ignored" if content.torn else ""
    checks = [Check("journal", True, lines + torn), _complete(content)]
    for name, key in ((PLAN_NAME, "plan"), (FACILITY_NAME, "facility")):
        checks.append(_copy(folder / name, content.header[key]))
    checks += _run_file(folder / RUN_NAME, content)
    return Verification(folder, tuple(checks))


def _complete(content: JournalContent) -> Check:
    planned, measured = content.header["points"], len(content.points)
    strangers = [index for index in content.points if index >= planned]
    if strangers:
        return Check("points", False, f"point {strangers[0]} is none of the {planned} of the plan")
    found = f"{measured} of {planned} points measured"
    if content.skipped:
        found += f", {len(content.skipped)} skipped"
    return Check("points", measured == planned, found)


def _copy(path: Path, expected: str) -> Check:
    if not path.exists():
        return Check(path.name, False, "missing")
    same = path.read_text(encoding="utf-8", errors="replace") == expected
    return Check(path.name, same, "as it was at the start" if same else "changed since the run was started")


def _run_file(path: Path, content: JournalContent) -> list[Check]:
    if not path.exists():
        return [Check(path.name, False, "missing; it can be made of the journal")]
    try:
        stored = read_run(path)
        rebuilt = run_of_journal(content)
    except InputError as error:
        return [Check(path.name, False, str(error))]
    digest = str(stored.attrs.get("journal_digest", ""))
    known = digest in content.chains
    line = f"stands for line {content.chains.index(digest) + 1} of {len(content.chains)}" if known else ""
    difference = first_difference(stored, rebuilt)
    return [
        Check("digest", known, line or f"{path.name} was made of another journal, or of one that was changed since"),
        Check(path.name, not difference, difference or "is what the journal gives"),
    ]


def first_difference(stored: xr.Dataset, rebuilt: xr.Dataset) -> str:
    """Where two runs first differ, in words; empty when they agree (derived values to 1e-9, the rest exactly).

    Compared are names, values, units, what the budget says of correlation, and global attributes.
    """
    strangers = [str(name) for name in stored.variables if name not in rebuilt.variables]
    if strangers:
        return f"{strangers[0]}: found; the journal gives no such variable"
    for name in map(str, rebuilt.variables):
        if name not in stored.variables:
            return f"{name}: missing"
        a, b = stored[name].values, rebuilt[name].values
        if a.shape != b.shape:
            return f"{name}: {a.shape} values; the journal gives {b.shape}"
        if name == "brf" or name.startswith(("u_brf", "brf_")):
            differs = ~np.isclose(a, b, rtol=_ROUNDING, atol=0)
        else:
            differs = a != b
        if np.any(differs):
            where = tuple(int(i) for i in np.argwhere(differs)[0])
            return f"{name}{list(where)}: found {a[where]}; the journal gives {b[where]}"
        for key in _MEANING:
            found, expected = (np.ravel(run[name].attrs.get(key, "")).tolist() for run in (stored, rebuilt))
            if found != expected:
                return f"{name}: {key}: found {found}; the journal gives {expected}"
    return _first_attribute(stored.attrs, rebuilt.attrs)


def _first_attribute(stored: Mapping[Any, Any], rebuilt: Mapping[Any, Any]) -> str:
    for name, expected in rebuilt.items():
        if name != "journal_digest" and stored.get(name) != expected:
            return f"global attribute {name}: differs from what the journal gives"
    return ""
