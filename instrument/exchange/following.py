"""The lines of a journal as they are written, and the documents that they give."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from instrument.errors import InputError
from instrument.exchange.documents import Document, Documents
from instrument.files import reading
from instrument.journal import JOURNAL_NAME, read_journal, read_line
from instrument.run_build import run_of_journal

#: How often a journal that somebody writes is looked at.
_INTERVAL_S = 0.5


class JournalTail:
    """Reads a journal that may be growing: every line once, checked against the chain, when it is complete."""

    def __init__(self, run_dir: Path) -> None:
        self._path = run_dir / JOURNAL_NAME if run_dir.is_dir() else run_dir
        self._place, self._number, self._chain = 0, 0, "0" * 64

    def new(self) -> list[tuple[dict[str, Any], str]]:
        """Records with their digests that were completed since the last call.

        Raises
        ------
        InputError
            If there is no journal, a line was changed, or the journal has become shorter.
        """
        with reading(self._path, "the journal of a run"), self._path.open("rb") as handle:
            size = handle.seek(0, 2)
            if size < self._place:
                raise InputError(f"{self._path}: has become shorter; expected a journal that only grows")
            handle.seek(self._place)
            complete = handle.read().split(b"\n")[:-1]
        found = []
        for line in complete:
            self._number += 1
            record, self._chain = read_line(self._path, self._number, line, self._chain)
            self._place += len(line) + 1
            found.append((record, self._chain))
        return found


def documents(run_dir: Path) -> Iterator[Document]:
    """Documents of what a journal holds now; the last one is ``stop`` where the run has ended.

    Raises
    ------
    InputError
        As :func:`instrument.journal.read_journal`.
    """
    maker = Documents()
    last: dict[str, Any] | None = None
    lines = JournalTail(run_dir).new()
    if not lines:
        raise InputError(f"{run_dir / JOURNAL_NAME}: no complete line; expected the journal of a run")
    for record, chain in lines:
        if record["kind"] == "ended":
            last = record
        elif record["kind"] in ("point", "reference", "skipped", "state"):
            # A run that went on after it had ended: only the last end counts.
            last = None
        yield from maker.line(record, chain)
    if last is not None:
        yield from _end(maker, run_dir, last)


def followed(run_dir: Path, *, wait: Callable[[float], object] = time.sleep) -> Iterator[Document]:
    """Documents of a run while it is measured, each as soon as its line is on the disk, to the end of the run.

    Parameters
    ----------
    wait
        Called with the seconds until the journal is looked at again.

    Raises
    ------
    InputError
        As :func:`instrument.journal.read_journal`.
    """
    maker, tail = Documents(), JournalTail(run_dir)
    while True:
        new = tail.new()
        for record, chain in new:
            yield from maker.line(record, chain)
            if record["kind"] == "ended":
                yield from _end(maker, run_dir, record)
                return
        if not new:
            wait(_INTERVAL_S)


def _end(maker: Documents, run_dir: Path, ended: dict[str, Any]) -> Iterator[Document]:
    content = read_journal(run_dir)
    # Without a point, or without a reading of the reference, there are readings and no result.
    if content.points and content.references:
        yield from maker.result(run_of_journal(content))
    yield maker.stop(ended)
