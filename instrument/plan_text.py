"""The text of a plan as a run folder keeps it: its tables written out, so that it needs no file beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import tomli_w

from instrument.files import text_of
from instrument.forms import read_toml
from instrument.plan import read_plan_form
from instrument.plan_forms import Table
from instrument.plan_points import table_of
from instrument.plan_table import PointTable

#: Stands in for rows while the rest is written; no name of a file can hold it.
_ROWS = "\0rows {}\0"


def self_contained(path: Path) -> str:
    """The plan without references to other files; the text as it is where there are none.

    Raises
    ------
    InputError
        If the plan, or a table of it, is wrong.
    """
    form = read_plan_form(path)
    tables = {
        number: table_of(part, f"{path}: {name}", path.parent, guess=form.angle_unit is None)
        for number, (name, part) in enumerate(form.parts)
        if isinstance(part, Table) and part.table is not None
    }
    if not tables:
        return text_of(path)
    whole: dict[str, Any]
    if path.suffix.lower() == ".csv":
        whole = {"version": form.version, "title": form.title, "part": [{"table": path.name}]}
    else:
        whole = read_toml(path)
    for number, table in tables.items():
        part = {key: value for key, value in whole["part"][number].items() if key != "table"}
        whole["part"][number] = part | {"columns": list(table.columns), "rows": _ROWS.format(number)}
    # Numbers are in nm and degree now: a guess at their unit has been made.
    text = tomli_w.dumps({"angle_unit": "degree"} | whole)
    for number, table in tables.items():
        text = text.replace(_quoted(_ROWS.format(number)), _rows(table))
    return text


def _quoted(text: str) -> str:
    return str(tomli_w.dumps({"rows": text}).removeprefix("rows = ").strip())


def _rows(table: PointTable) -> str:
    """An array of arrays, one row a line; a JSON list of numbers and plain words is TOML as well."""
    return "[\n" + "".join(f"    {json.dumps(list(row))},\n" for row in table.rows) + "]"
