"""Reading the TOML forms of the data contract, with errors that name file and key."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from instrument.errors import InputError
from instrument.files import text_of

_KIND = re.compile(r"(constrained-\w+|float|int|str|bool|none|(literal|list|tuple|dict|function-\w+|nullable)\[.*\])$")


class Form(BaseModel):
    """A part of a TOML form: unknown keys are errors, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


F = TypeVar("F", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    InputError
        If the file is missing, no text, not TOML, or holds no key: where every key has a default, a file that was cut
        to nothing would stand for something.
    """
    found = parse_toml(text_of(path, "a TOML file"), str(path))
    if not found:
        raise InputError(f"{path}: empty; expected a TOML file with at least one key")
    return found


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse TOML; an :class:`InputError` that names ``source`` tells what is wrong with it."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: not valid TOML: {error}") from None


def read_form(path: Path, form: type[F]) -> F:
    """Read a TOML file into a form.

    Raises
    ------
    InputError
        Naming the file, every wrong key, what was found and what was expected.
    """
    return parse_form(read_toml(path), form, str(path))


def parse_form(data: dict[str, Any], form: type[F], source: str) -> F:
    """Check a dictionary against a form; ``source`` names it in errors."""
    try:
        return form.model_validate(data)
    except ValidationError as error:
        raise InputError(_explain(source, error)) from None


def _explain(source: str, error: ValidationError) -> str:
    lines = []
    for problem in error.errors():
        # Where a key may be of several kinds, pydantic adds the kind in words that are not in the file.
        key = ".".join(str(part) for part in problem["loc"] if not _KIND.match(str(part))) or "(file)"
        if problem["type"] == "extra_forbidden":
            lines.append(f"{source}: {key}: unknown key (found {problem['input']!r})")
        elif problem["type"] == "missing":
            lines.append(f"{source}: {key}: missing")
        else:
            message = problem["msg"].removeprefix("Value error, ")
            lines.append(f"{source}: {key}: found {problem['input']!r}; {message}")
    return "\n".join(lines)
