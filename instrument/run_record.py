"""Who measured which sample against which standard: written when a run begins, amended later, never overwritten.

The first words stand in the header of the journal. An amendment is a record of its own, dated and signed; what was
written before stays where it is, and every digest with it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from instrument.forms import Form, parse_form
from instrument.journal import JournalContent

FieldName = Literal["operator", "sample", "reference_standard", "project", "remarks"]
FIELDS: tuple[FieldName, ...] = ("operator", "sample", "reference_standard", "project", "remarks")
AMENDMENT = "amendment"


def _one_line(text: str) -> str:
    if not all(character.isprintable() for character in text):
        raise ValueError("expected one line of text without control characters")
    return text.strip()


Line = Annotated[str, Field(max_length=1000), AfterValidator(_one_line)]


class RunRecord(Form):
    """What a person says of a run; empty where nobody said anything.

    Attributes
    ----------
    operator
        Who measured.
    sample, reference_standard
        Which piece of each, by the name that the laboratory gives it.
    """

    operator: Line = ""
    sample: Line = ""
    reference_standard: Line = ""
    project: Line = ""
    remarks: Line = ""

    def said(self) -> dict[str, str]:
        """What was said, without what was not."""
        return {name: text for name in FIELDS if (text := getattr(self, name))}

    def over(self, other: RunRecord) -> RunRecord:
        """This record, with another's words where it has none."""
        return RunRecord(**(other.said() | self.said()))


class Amendment(Form):
    """One amendment: when and by whom, what it says from now on, and why."""

    time: datetime
    by: Annotated[Line, Field(min_length=1)]
    reason: Annotated[Line, Field(min_length=1)]
    changes: Annotated[dict[FieldName, Line], Field(min_length=1)]


def first_record(header: Mapping[str, Any]) -> RunRecord:
    """What was said when the run began."""
    return RunRecord.model_validate(header.get("record", {}))


def amendments(content: JournalContent) -> list[Amendment]:
    """Every amendment of a run, oldest first."""
    return [
        parse_form(
            {key: value for key, value in record.items() if key in Amendment.model_fields},
            Amendment,
            f"{content.path}: amendment",
        )
        for record in content.others
        if record["kind"] == AMENDMENT
    ]


def amended(record: RunRecord, changes: Sequence[Amendment]) -> RunRecord:
    """What holds after amendments."""
    for amendment in changes:
        record = record.model_copy(update={str(key): word for key, word in amendment.changes.items()})
    return record


def current_record(content: JournalContent) -> RunRecord:
    """What holds now."""
    return amended(first_record(content.header), amendments(content))


def history(content: JournalContent) -> list[dict[str, str]]:
    """Every word that was ever amended, oldest first: when, by whom, why, which field, before and after."""
    record, rows = first_record(content.header), []
    for amendment in amendments(content):
        for name, text in amendment.changes.items():
            rows.append(
                {
                    "time": amendment.time.isoformat(),
                    "by": amendment.by,
                    "reason": amendment.reason,
                    "field": name,
                    "before": getattr(record, name),
                    "after": text,
                }
            )
        record = amended(record, [amendment])
    return rows


def record_attributes(content: JournalContent) -> dict[str, str]:
    """Global attributes of a run file: what holds now, and its history as JSON where there is one."""
    history = amendments(content)
    attributes = amended(first_record(content.header), history).said()
    if history:
        first = {"recorded": first_record(content.header).said()}
        attributes["record_history"] = json.dumps([first, *(item.model_dump(mode="json") for item in history)])
    return attributes
