"""A run folder as a row of the catalogue: read from its journal, and from what else lies in the folder."""

from __future__ import annotations

import fcntl
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from instrument.errors import InputError
from instrument.files import json_object
from instrument.journal import JOURNAL_NAME, JournalContent, read_journal
from instrument.run_archive import RunSummary, summary_of
from instrument.run_folder import RUN_NAME
from instrument.run_read import read_run
from instrument.run_record import current_record

COMPARISON_NAME, DIAGNOSIS_NAME = "comparison.json", "diagnosis.json"
#: What a row is made of; a row is read anew when one of them has changed.
SOURCES = (JOURNAL_NAME, RUN_NAME, COMPARISON_NAME, DIAGNOSIS_NAME)
#: Figures of merit by name, and where they come from.
FIGURES = {
    "relative_rmse": "run against prediction, root mean square of the relative difference",
    "mean_absolute_relative_difference": "run against prediction",
    "rms_t": "run against prediction, root mean square of t'",
    "level_of_agreement": "run against prediction, mean n'",
    "median_relative_u": "median relative standard uncertainty of brf",
    "largest_relative_u": "largest relative standard uncertainty of brf",
    "completeness": "points measured over points planned",
    "probability": "of the first effect that the diagnosis names",
}
#: States beside the outcomes that a journal states: nothing said how it ended; a program is writing it; it is damaged.
INTERRUPTED, RUNNING, DAMAGED = "interrupted", "running", "damaged"


@dataclass(frozen=True)
class Entry(RunSummary):
    """One run: what its journal says of it, and what can be searched besides.

    Attributes
    ----------
    name
        Of the folder, from the folder of the catalogue.
    outcome
        As the journal states it, or one of :data:`INTERRUPTED`, :data:`RUNNING`, :data:`DAMAGED`.
    wavelengths
        nm, those measured, ascending and with commas between.
    digest
        Of the journal.
    figures
        Figures of merit (:data:`FIGURES`) that the folder has the files for.
    verdict
        Of the diagnosis, with the effects that it names.
    """

    name: str = ""
    project: str = ""
    wavelengths: str = ""
    digest: str = ""
    verdict: str = ""
    relative_rmse: float | None = None
    mean_absolute_relative_difference: float | None = None
    rms_t: float | None = None
    level_of_agreement: float | None = None
    median_relative_u: float | None = None
    largest_relative_u: float | None = None
    completeness: float | None = None
    probability: float | None = None

    def as_dict(self, folder: str) -> dict[str, Any]:
        """For ``--json``; ``folder`` is what a person named: the folder of the catalogue, or its URL."""
        return {"folder": f"{folder.rstrip('/')}/{self.name}"} | {
            k: v for k, v in asdict(self).items() if v is not None
        }


COLUMNS = tuple(field.name for field in fields(Entry))


def signature(folder: Path) -> str:
    """Changes when a file does that a row is made of."""
    stats = [(folder / name).stat() if (folder / name).exists() else None for name in SOURCES]
    return json.dumps([None if s is None else [s.st_size, s.st_mtime_ns] for s in stats])


def read_entry(folder: Path, name: str) -> Entry:
    """The row of a run folder; what is damaged in it becomes its ``problem``."""
    try:
        content = read_journal(folder)
    except InputError as error:
        return Entry(name=name, outcome=DAMAGED, problem=str(error))
    seen = summary_of(content)
    wavelengths = sorted({float(point["geometry"]["wavelength"]) for point in content.points.values()})
    known: dict[str, Any] = {
        **vars(seen),
        "outcome": RUNNING if seen.outcome == INTERRUPTED and is_being_written(content.path) else seen.outcome,
        "project": current_record(content).project,
        "wavelengths": ", ".join(f"{value:g}" for value in wavelengths),
        "digest": content.digest,
        "completeness": seen.measured / seen.planned if seen.planned else None,
    }
    problems: list[str] = []
    for read in (_of_run, _of_comparison, _of_diagnosis):
        try:
            known |= read(folder, content)
        except InputError as error:
            problems.append(str(error))
    return Entry(name=name, **known | {"problem": "; ".join(problems)})


def is_being_written(journal: Path) -> bool:
    """Whether a program holds the journal (:class:`instrument.journal.Journal` locks it)."""
    try:
        with journal.open("rb") as handle:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a store without locks: nobody can tell
        return False
    return False


def _of_run(folder: Path, content: JournalContent) -> dict[str, Any]:
    if not (folder / RUN_NAME).exists():
        return {}
    run = read_run(folder / RUN_NAME)
    brf = np.abs(run["brf"].values)
    relative = run["u_brf"].values[brf > 0] / brf[brf > 0]
    if not relative.size:
        return {}
    return {"median_relative_u": float(np.median(relative)), "largest_relative_u": float(relative.max())}


def _of_comparison(folder: Path, content: JournalContent) -> dict[str, Any]:
    file = folder / COMPARISON_NAME
    overall = _json(file).get("global", {})
    if not isinstance(overall, Mapping):
        raise InputError(f"{file}: global: found {type(overall).__name__}; expected a JSON object")
    names = ("relative_rmse", "mean_absolute_relative_difference", "rms_t", "level_of_agreement")
    return {name: _number(overall.get(name)) for name in names}


def _of_diagnosis(folder: Path, content: JournalContent) -> dict[str, Any]:
    file = folder / DIAGNOSIS_NAME
    found = _json(file)
    effects = found.get("effects") or []
    if not isinstance(effects, list) or not all(isinstance(effect, Mapping) for effect in effects):
        raise InputError(f"{file}: effects: expected a list of JSON objects")
    named = ", ".join(str(effect.get("effect", "")) for effect in effects)
    verdict = str(found.get("verdict", ""))
    first = _number(effects[0].get("probability")) if effects else None
    return {"verdict": f"{verdict}: {named}" if named else verdict, "probability": first}


def _number(value: Any) -> float | None:
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if known else None


def _json(path: Path) -> Mapping[str, Any]:
    """An object of a file that another command wrote; empty where there is none."""
    return json_object(path, "what goniotwin writes with --json") if path.exists() else {}
