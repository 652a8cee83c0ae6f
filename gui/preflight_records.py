"""The last preflight of a run, from its journal. Read on a thread."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from instrument.errors import InputError
from instrument.journal import read_journal


def last_preflight(run_dir: Path) -> tuple[str, list[dict[str, Any]]]:
    """Time (ISO, UTC) and checks (``name``, ``passed``, ``found``); empty where there was none."""
    try:
        content = read_journal(run_dir)
    except InputError:
        return "", []
    found = [record for record in content.others if record["kind"] == "preflight"]
    return (str(found[-1].get("time", "")), list(found[-1].get("checks", []))) if found else ("", [])
