"""Where commands may write: nothing that exists is lost unless a person asked for it (docs/records.md)."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from instrument.errors import InputError
from instrument.files import is_stream, write_atomically


def write_json(path: Path, content: Any, *, force: bool = False) -> None:
    """Write what a command found for programs (``--json FILE``), atomically.

    What is there is replaced if it is JSON, or if ``force`` is set.

    Raises
    ------
    InputError
        If the file cannot be written, or holds anything but JSON.
    """
    if not force:
        check_json(path)
    write_result(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def write_result(path: Path, content: bytes) -> None:
    """Write a whole file, atomically.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    try:
        write_atomically(path, content)
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


def check_json(path: Path | None) -> None:
    """Find out beforehand whether ``--json FILE`` can be written: it replaces a JSON file, and no other.

    Raises
    ------
    InputError
        If it cannot be written, or a file of that name holds something else, a plan or a run perhaps.
    """
    if path is None:
        return
    check_writable(path)
    try:
        content = path.read_bytes() if path.is_file() and not is_stream(path) else b""
        if content.strip():
            json.loads(content)
    except ValueError:
        raise InputError(f"{path}: exists already and is no JSON file; choose another name") from None
    except OSError as error:
        raise InputError(f"{path}: exists already and cannot be read: {error.strerror}") from None


def check_new(path: Path, force: bool) -> None:
    """Refuse to write where something is already, unless a person asked for it.

    Raises
    ------
    InputError
        If the file exists and ``force`` is not set; or if it cannot be written (:func:`check_writable`).
    """
    check_writable(path)
    if path.is_file() and not is_stream(path) and not force:
        raise InputError(f"{path}: exists already; choose another name, or replace it with --force")


def check_new_folder(folder: Path, force: bool) -> None:
    """The same for a folder of several files; an empty one, or none, is new.

    Raises
    ------
    InputError
        If it is a file, or holds anything and ``force`` is not set.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; expected a folder")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise InputError(f"{folder}: is not empty; choose another folder, or write into it with --force")
