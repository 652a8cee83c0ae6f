"""Digests of what a computation depends on, and the user's folder for results that may be kept."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from pydantic import BaseModel

from instrument.facility import Beam
from instrument.files import cache_folder

__all__ = ["cache_folder", "content_digest"]

#: Where something comes from and what it is called: no part of the content.
_LABELS = {"name", "source", "notes"}


def content_digest(*parts: Any) -> str:
    """Digest of numbers, text, arrays, forms, datasets, data classes and containers of them.

    Labels (``name``, ``source``, ``notes``) and functions do not count; of a path its file's content does.
    """
    digest = hashlib.sha256()
    for part in parts:
        _feed(digest, part)
    return digest.hexdigest()


def _feed(digest: Any, part: Any) -> None:
    """Every value goes in with its kind and its length, so that different contents are different strings."""
    if part is None or isinstance(part, bool | int | float | str | np.generic):
        _add(digest, type(part).__name__, repr(part).encode())
    elif isinstance(part, np.ndarray):
        plain = repr(part.tolist()).encode() if part.dtype.hasobject else np.ascontiguousarray(part).tobytes()
        _add(digest, f"array {part.dtype.str} {part.shape}", plain)
    elif isinstance(part, Path):
        _add(digest, "file", part.read_bytes())
    elif isinstance(part, BaseModel):
        _feed_named(digest, {key: getattr(part, key) for key in type(part).model_fields})
        if isinstance(part, Beam) and part.picture is not None:
            _add(digest, "picture", part.picture.digest.encode())
    elif is_dataclass(part) and not isinstance(part, type):
        _feed_named(digest, {f.name: getattr(part, f.name) for f in fields(part)})
    elif isinstance(part, xr.Dataset | xr.DataArray):
        named = part.variables if isinstance(part, xr.Dataset) else {"values": part.variable, **part.coords}
        _feed_named(digest, {str(k): (v.dims, v.values, v.attrs) for k, v in named.items()})
    elif isinstance(part, dict):
        _feed_named(digest, {str(key): value for key, value in part.items()})
    elif isinstance(part, tuple | list):
        _add(digest, "sequence", str(len(part)).encode())
        for member in part:
            _feed(digest, member)
    elif not callable(part):
        raise TypeError(f"found {type(part).__name__}; expected data that have a digest")


def _feed_named(digest: Any, members: dict[str, Any]) -> None:
    kept = {key: value for key, value in sorted(members.items()) if key not in _LABELS}
    _add(digest, "named", str(len(kept)).encode())
    for key, value in kept.items():
        _add(digest, "key", key.encode())
        _feed(digest, value)


def _add(digest: Any, kind: str, content: bytes) -> None:
    digest.update(f"{kind} {len(content)}:".encode() + content)
