"""Renderings of variations, kept on disk by content: a repeat or a subset of a plan costs nothing."""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.variation import Variation
from twin.diagnosis.workbench import Progress, Workbench
from twin.optics import COORDINATES

_LOG = logging.getLogger(__name__)
_NOMINAL = Variation()


def default_cache() -> Path:
    """``goniotwin`` in the user's folder for caches."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "goniotwin"


@dataclass(frozen=True)
class Rendered:
    """Logarithm of what variations read over what the nominal twin reads, reference readings not considered.

    Attributes
    ----------
    log_ratio, u_log_ratio, shape (variation, point)
        Value and the ray tracer's standard error.
    """

    log_ratio: FloatArray
    u_log_ratio: FloatArray


class RenderStore:
    """Renders what is not known yet.

    Files are named by content and replaced whole, so that several processes may share a folder; one that
    cannot be read is rendered again.

    Parameters
    ----------
    workbench
        The nominal twin.
    folder
        Where renderings are kept; None keeps none.
    """

    def __init__(self, workbench: Workbench, folder: Path | None) -> None:
        self.workbench, self.folder = workbench, folder
        self._digest = workbench.digest()

    def missing(self, groups: Sequence[Sequence[Variation]], columns: dict[str, FloatArray]) -> int:
        """How many variations would have to be rendered for at least one geometry."""
        rows = _rows(columns)
        return sum(len(group) for group in groups if self._known(group, rows) is None)

    def get(
        self, groups: Sequence[Sequence[Variation]], columns: dict[str, FloatArray], progress: Progress | None = None
    ) -> list[Rendered]:
        """Renderings of groups of variations; a group is kept in one file.

        Parameters
        ----------
        progress
            Told the number of variations just rendered.
        """
        rows = _rows(columns)
        found = [self._known(group, rows) for group in groups]
        todo = [number for number, known in enumerate(found) if known is None]
        if todo:
            unique, place = np.unique(rows, axis=0, return_inverse=True)
            new = self._render([groups[number] for number in todo], unique, progress)
            for number, rendered in zip(todo, new, strict=True):
                self._keep(groups[number], unique, rendered)
                found[number] = _take(rendered, place.reshape(-1))
        return [known for known in found if known is not None]

    def _render(
        self, groups: Sequence[Sequence[Variation]], rows: FloatArray, progress: Progress | None
    ) -> list[Rendered]:
        """Render groups at geometries (row, coordinate); every variation once, the nominal twin once."""
        columns = {name: rows[:, k].copy() for k, name in enumerate(COORDINATES)}
        distinct = {variation.key(): variation for group in groups for variation in group}
        distinct.pop(_NOMINAL.key(), None)
        nominal = self.workbench.render([_NOMINAL], columns)[0]
        values = self.workbench.render(list(distinct.values()), columns, progress)
        place = {key: number for number, key in enumerate(distinct)}
        result = []
        for group in groups:
            log_ratio = np.zeros((len(group), len(rows)))
            error = np.zeros_like(log_ratio)
            for number, variation in enumerate(group):
                if variation.key() in place:
                    log_ratio[number], error[number] = _ratio(values[place[variation.key()]], nominal)
            result.append(Rendered(log_ratio, error))
        return result

    def _path(self, group: Sequence[Variation]) -> Path | None:
        if self.folder is None:
            return None
        content = "\n".join([self._digest, *(variation.key() for variation in group)])
        return self.folder / "responses" / f"{hashlib.sha256(content.encode()).hexdigest()[:40]}.npz"

    def _load(self, path: Path) -> tuple[FloatArray, Rendered] | None:
        """Geometries and renderings of a file; None, and a word in the log, if it is damaged."""
        try:
            with np.load(path, allow_pickle=False) as data:
                rows, log_ratio, error = data["geometry"], data["log_ratio"], data["u_log_ratio"]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as problem:
            _LOG.warning("%s: cannot be read (%s); its responses are rendered again", path, problem)
            return None
        if (
            log_ratio.shape != error.shape
            or log_ratio.shape[1:] != rows.shape[:1]
            or not np.all(np.isfinite(log_ratio))
        ):
            _LOG.warning("%s: does not hold what it should; its responses are rendered again", path)
            return None
        return rows, Rendered(log_ratio.astype(float), error.astype(float))

    def _known(self, group: Sequence[Variation], rows: FloatArray) -> Rendered | None:
        """Renderings of a group if all geometries are known."""
        path = self._path(group)
        loaded = None if path is None else self._load(path)
        if loaded is None:
            return None
        place = {row.tobytes(): number for number, row in enumerate(loaded[0])}
        wanted = [place.get(row.tobytes(), -1) for row in rows]
        return None if min(wanted, default=0) < 0 else _take(loaded[1], np.array(wanted, dtype=np.int64))

    def _keep(self, group: Sequence[Variation], rows: FloatArray, rendered: Rendered) -> None:
        """Add renderings to the file of a group; whoever replaces it last wins, and nobody reads half a file."""
        path = self._path(group)
        if path is None:
            return
        loaded = self._load(path)
        if loaded is not None:
            old = {row.tobytes() for row in rows}
            others = np.array([row.tobytes() not in old for row in loaded[0]], dtype=bool)
            rows = np.concatenate([rows, loaded[0][others]])
            rendered = Rendered(
                np.concatenate([rendered.log_ratio, loaded[1].log_ratio[:, others]], axis=1),
                np.concatenate([rendered.u_log_ratio, loaded[1].u_log_ratio[:, others]], axis=1),
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as handle:
            np.savez_compressed(
                handle,
                geometry=rows,
                log_ratio=rendered.log_ratio.astype(np.float32),
                u_log_ratio=rendered.u_log_ratio.astype(np.float32),
            )
            handle.flush()
        os.replace(handle.name, path)


def _ratio(varied: FloatArray, nominal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithm of the ratio of means and its standard error, from values of shape (point, randomisation)."""
    count = nominal.shape[-1]
    one, two = varied.mean(axis=-1), nominal.mean(axis=-1)
    lit = (one > 0) & (two > 0)
    safe_one, safe_two = np.where(lit, one, 1.0), np.where(lit, two, 1.0)
    spread = varied / safe_one[:, None] - nominal / safe_two[:, None]
    error = spread.std(axis=-1, ddof=1) / np.sqrt(count)
    return np.where(lit, np.log(safe_one / safe_two), _DARK), np.where(lit, error, 0.0)


#: Logarithm that stands for no light at all.
_DARK = -12.0


def _take(rendered: Rendered, place: np.ndarray) -> Rendered:
    return Rendered(rendered.log_ratio[:, place], rendered.u_log_ratio[:, place])


def _rows(columns: dict[str, FloatArray]) -> FloatArray:
    """Geometries as rows, rounded so that equal ones are equal, shape (point, coordinate)."""
    rows = np.stack([np.nan_to_num(columns[name], nan=0.0) for name in COORDINATES], axis=1)
    return np.asarray(np.round(rows, 6) + 0.0)
