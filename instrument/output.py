"""What commands write for programs: ``--json FILE``."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from instrument.errors import InputError
from instrument.files import write_atomically


def write_json(path: Path, content: Any) -> None:
    """Write a result as JSON, atomically.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    try:
        write_atomically(path, text.encode())
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def check_writable(path: Path) -> None:
    """Find out before hours of work whether their result can be written.

    Raises
    ------
    InputError
        If it cannot.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: cannot be written: the folder is read-only")


def check_new(path: Path, force: bool) -> None:
    """Refuse to write where something is already, unless a person asked for it.

    Raises
    ------
    InputError
        If the file exists and ``force`` is not set; or if it cannot be written (:func:`check_writable`).
    """
    check_writable(path)
    if path.exists() and not force:
        raise InputError(f"{path}: exists already; choose another name, or replace it with --force")
