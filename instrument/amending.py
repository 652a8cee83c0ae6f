"""Amending what a run says of operator, sample and standard, long after it was measured."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from instrument.errors import InputError
from instrument.files import replacing
from instrument.forms import parse_form
from instrument.journal import Journal, read_journal
from instrument.run_folder import RUN_NAME
from instrument.run_record import AMENDMENT, FIELDS, Amendment, current_record, record_attributes


def amend(run_dir: Path, changes: Mapping[str, str], *, by: str, reason: str) -> Amendment | None:
    """Append an amendment to the journal of a run, and tell ``run.nc``; no reading is touched.

    Parameters
    ----------
    changes
        New words by name of the field.
    by, reason
        Who amends, and why.

    Returns
    -------
    Amendment or None
        None where the record says all of this already.

    Raises
    ------
    InputError
        If there is no run, another program is writing it, or the words are wrong.
    """
    content = read_journal(run_dir)
    moment = max(datetime.now(UTC), content.latest)
    given = {"time": moment, "by": by, "reason": reason, "changes": dict(changes)}
    amendment = parse_form(given, Amendment, f"{run_dir}: amendment")
    known = current_record(content)
    news = {name: text for name, text in amendment.changes.items() if getattr(known, name) != text}
    if not news:
        return None
    amendment = amendment.model_copy(update={"changes": news})
    with Journal.reopen(run_dir) as journal:
        journal.record(AMENDMENT, **amendment.model_dump())
    _tell_run_file(run_dir / RUN_NAME, record_attributes(read_journal(run_dir)))
    return amendment


def _tell_run_file(path: Path, attributes: Mapping[str, str]) -> None:
    """Change nothing of a run file but the words: its numbers are not computed anew."""
    if not path.exists():
        return
    import h5netcdf

    try:
        with replacing(path) as part:
            shutil.copyfile(path, part)
            with h5netcdf.File(part, "a") as file:
                for name in (*FIELDS, "record_history"):
                    if name in attributes:
                        file.attrs[name] = attributes[name]
                    elif name in file.attrs:
                        del file.attrs[name]
    except OSError as error:
        raise InputError(f"{path}: the journal is amended, but this file cannot be: {error}") from None
