"""Parts of ``devices.toml``: strict forms, and errors that name file and key.

The instrument room has forms of its own; imports run downwards, so this room keeps this small pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from drivers.errors import ConfigurationError


class Form(BaseModel):
    """A part of the file: unknown keys are errors, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def claims(self) -> list[tuple[str, str]]:
        """What a device with these options has for itself on its line: units, and parts of them (empty: the whole)."""
        return []


F = TypeVar("F", bound=BaseModel)


def check_form(data: Any, form: type[F], source: str, prefix: Sequence[str] = ()) -> F:
    """Check data against a form.

    Parameters
    ----------
    data
        What the file holds.
    form
        What it should be.
    source
        Name of the file, for errors.
    prefix
        Keys above ``data`` in the file, for errors.

    Raises
    ------
    ConfigurationError
        One line a problem: file, key, what was found, what was expected.
    """
    try:
        return form.model_validate(data)
    except ValidationError as error:
        raise ConfigurationError("\n".join(_explain(source, prefix, problem) for problem in error.errors())) from None


def _explain(source: str, prefix: Sequence[str], problem: Any) -> str:
    key = ".".join(str(part) for part in (*prefix, *problem["loc"])) or "(file)"
    if problem["type"] == "extra_forbidden":
        return f"{source}: {key}: unknown key (found {problem['input']!r})"
    if problem["type"] == "missing":
        return f"{source}: {key}: missing"
    if problem["type"] == "union_tag_invalid":
        context = problem["ctx"]
        return f"{source}: {key}.kind: found {context['tag']!r}; expected one of {context['expected_tags']}"
    if problem["type"] == "union_tag_not_found":
        return f"{source}: {key}.kind: missing"
    return f"{source}: {key}: found {problem['input']!r}; {problem['msg'].removeprefix('Value error, ')}"
