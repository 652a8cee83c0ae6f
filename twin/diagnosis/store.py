"""Arrays over geometries, kept on disk by content: what is known of a geometry is not worked out again."""

from __future__ import annotations

import hashlib
import logging
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from instrument.angles import FloatArray
from instrument.files import replacing
from twin.optics import COORDINATES

_LOG = logging.getLogger(__name__)
_GEOMETRY = "geometry"
#: Decimals of angles and wavelengths by which geometries are told apart.
_DECIMALS = 6
Columns = dict[str, FloatArray]
Arrays = dict[str, FloatArray]


class PointStore:
    """Arrays of shape (..., point) that depend on a content and, point by point, on the geometry.

    Files are named by content and replaced whole, so that several processes may share a folder; one that cannot be
    read is worked out again, and one that cannot be written costs the next computation, not this one.

    Parameters
    ----------
    folder
        Where arrays are kept; None keeps none.
    names
        Of the arrays.
    """

    def __init__(self, folder: Path | None, names: Sequence[str]) -> None:
        self._folder, self._names = folder, tuple(names)

    def get(self, content: str, columns: Columns, make: Callable[[Columns], Arrays]) -> Arrays:
        """Arrays at geometries; those of unknown geometries are made, of each once.

        Parameters
        ----------
        content
            Tells apart all that the arrays depend on but the geometry.
        make
            From geometries to arrays, their last axis that of the points.
        """
        rows = _rows(columns)
        known = self._load(content)
        lacking = _lacking(known, rows)
        if len(lacking):
            made = make({name: column[lacking] for name, column in columns.items()})
            # Another process may have added some meanwhile.
            known = _joined(self._names, rows[lacking], made, self._load(content, quiet=True))
            self._keep(content, known)
        assert known is not None
        place = {row.tobytes(): number for number, row in enumerate(known[_GEOMETRY])}
        wanted = np.array([place[row.tobytes()] for row in rows], dtype=np.int64)
        return {name: known[name][..., wanted] for name in self._names}

    def lacking(self, content: str, columns: Columns) -> int:
        """How many different geometries would have to be worked out."""
        return len(_lacking(self._load(content), _rows(columns)))

    def _path(self, content: str) -> Path | None:
        name = f"{hashlib.sha256(content.encode()).hexdigest()[:40]}.npz"
        return None if self._folder is None else self._folder / name

    def _load(self, content: str, *, quiet: bool = False) -> Arrays | None:
        """Geometries and arrays of a file; None, and a word in the log, if it is damaged."""
        path = self._path(content)
        if path is None:
            return None
        try:
            with path.open("rb") as handle, np.load(handle, allow_pickle=False) as data:
                found = {name: np.asarray(data[name], dtype=float) for name in (_GEOMETRY, *self._names)}
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as problem:
            if not quiet:
                _LOG.warning("%s: cannot be read (%s); it is worked out again", path, problem)
            return None
        points = found[_GEOMETRY].shape[:1]
        if any(found[n].shape[-1:] != points or not np.all(np.isfinite(found[n])) for n in self._names):
            if not quiet:
                _LOG.warning("%s: does not hold what it should; it is worked out again", path)
            return None
        return found

    def _keep(self, content: str, arrays: Mapping[str, FloatArray]) -> None:
        path = self._path(content)
        if path is None:
            return
        plain: dict[str, Any] = dict(arrays)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as part, part.open("wb") as handle:
                np.savez_compressed(handle, **plain)
        except OSError as error:
            _LOG.warning("%s: cannot be kept: %s", path, error.strerror)


def _rows(columns: Columns) -> FloatArray:
    """Geometries as rows, rounded so that equal ones are equal, shape (point, coordinate)."""
    rows = np.stack([np.nan_to_num(columns[name], nan=0.0) for name in COORDINATES], axis=1)
    return np.ascontiguousarray(np.round(rows, _DECIMALS) + 0.0)


def _lacking(known: Arrays | None, rows: FloatArray) -> np.ndarray:
    """Places of unknown geometries, of equal ones the first, shape (new,)."""
    there = set() if known is None else {row.tobytes() for row in known[_GEOMETRY]}
    first: dict[bytes, int] = {}
    for number, row in enumerate(rows):
        first.setdefault(row.tobytes(), number)
    return np.array([number for key, number in first.items() if key not in there], dtype=np.int64)


def _joined(names: Sequence[str], rows: FloatArray, made: Arrays, known: Arrays | None) -> Arrays:
    """What was made, and what is known of other geometries."""
    if known is None:
        return {_GEOMETRY: rows} | {name: made[name] for name in names}
    new = {row.tobytes() for row in rows}
    others = np.flatnonzero([row.tobytes() not in new for row in known[_GEOMETRY]])
    joined = {name: np.concatenate([made[name], known[name][..., others]], axis=-1) for name in names}
    return {_GEOMETRY: np.concatenate([rows, known[_GEOMETRY][others]])} | joined
