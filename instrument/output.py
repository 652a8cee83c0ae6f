"""What commands write for programs: ``--json FILE``."""

from __future__ import annotations

import json
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
