"""The journal of a run: one JSON line a record, on the disk before anything goes on.

The journal is the source of truth; ``run.nc`` is derived from it. Every line ends in the field ``chain``, the
SHA-256 of the previous line's ``chain`` and of the line up to that field: a changed, lost or exchanged
line shows. The form is documented in ``docs/journal.md``.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from instrument.errors import InputError
from instrument.files import JOURNAL_NAME as JOURNAL_NAME
from instrument.files import reading, sync_folder
from instrument.records import RECORDS

FORMAT, VERSION = "goniotwin-journal", 1
_CHAIN_KEY = b',"chain":"'
_CHAIN_TAIL = len(_CHAIN_KEY) + 64 + len('"}')
_NO_CHAIN = "0" * 64


class JournalError(ValueError):
    """The program tried to record something that has no place in the journal."""


@dataclass(frozen=True)
class JournalContent:
    """What a journal says.

    Attributes
    ----------
    header
        First line.
    references
        Reference readings in the order in which they were taken.
    points
        Readings by index of the point in the plan.
    skipped
        Points that could not be measured and were not measured later, by index.
    others
        State changes, notes and everything else, in order.
    chains
        ``chain`` of every complete line; the last one is the digest of the whole journal.
    torn
        What was left of a line that was never finished; None when every line is complete.
    length
        Bytes of the complete lines.
    """

    path: Path
    header: dict[str, Any]
    references: tuple[dict[str, Any], ...]
    points: dict[int, dict[str, Any]]
    skipped: dict[int, dict[str, Any]]
    others: tuple[dict[str, Any], ...]
    chains: tuple[str, ...]
    torn: bytes | None
    length: int

    @property
    def digest(self) -> str:
        """Digest of the complete lines."""
        return self.chains[-1]

    @property
    def latest(self) -> datetime:
        """Laboratory time (UTC) of the last thing that was recorded with one."""
        records = (self.header, *self.references, *self.points.values(), *self.skipped.values(), *self.others)
        stamps = (record.get("time", record.get("created")) for record in records)
        return max(datetime.fromisoformat(stamp) for stamp in stamps if isinstance(stamp, str))


@dataclass
class _Contents:
    """Grows while lines are read."""

    references: list[dict[str, Any]] = field(default_factory=list)
    points: dict[int, dict[str, Any]] = field(default_factory=dict)
    skipped: dict[int, dict[str, Any]] = field(default_factory=dict)
    others: list[dict[str, Any]] = field(default_factory=list)

    def add(self, record: dict[str, Any]) -> None:
        if record["kind"] == "point":
            self.points[record["index"]] = record
            self.skipped.pop(record["index"], None)
        elif record["kind"] == "skipped":
            self.skipped[record["index"]] = record
        elif record["kind"] == "reference":
            self.references.append(record)
        else:
            self.others.append(record)


def _refusal(record: Mapping[str, Any], done: Container[int]) -> str:
    """Why a record cannot follow those before it, among them the points ``done``; empty when it can."""
    if record["kind"] == "header":
        return "a second header"
    if record["kind"] in ("point", "skipped") and record["index"] in done:
        return f"point {record['index']} is recorded already"
    return ""


class Journal:
    """Writes the journal of one run. Made by :meth:`create` or :meth:`reopen`; a context manager that closes it.

    One program writes at a time: the file is locked while it is open. Of what is written only the indices of the
    points stay in memory, however long a scan gets.
    """

    def __init__(self, path: Path, descriptor: int, length: int, chain: str, done: set[int]) -> None:
        self.path = path
        self._descriptor: int | None = descriptor
        self._length, self._chain, self._done = length, chain, done

    @classmethod
    def create(cls, run_dir: Path, header: Mapping[str, Any]) -> Journal:
        """Start the journal of a new run; the header is on the disk when this returns.

        Raises
        ------
        InputError
            If the folder already has a journal.
        JournalError
            If the header lacks something (:class:`instrument.records.Header`).
        """
        path = run_dir / JOURNAL_NAME
        line, chain = _line(
            _checked({"kind": "header", "format": FORMAT, "version": VERSION} | dict(header)), _NO_CHAIN
        )
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError:
            raise InputError(f"{path}: a run was recorded here already; resume it or choose another folder") from None
        except FileNotFoundError:
            raise InputError(f"{run_dir}: no such folder") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be made: {error.strerror}") from None
        _hold(descriptor, path)
        journal = cls(path, descriptor, 0, chain, set())
        journal._append(line)
        sync_folder(run_dir)
        return journal

    @classmethod
    def reopen(cls, run_dir: Path) -> Journal:
        """Go on with a journal; a torn last line, which was never acknowledged, is cut off and noted.

        Raises
        ------
        InputError
            As :func:`read_journal`; if another program is writing this journal.
        """
        path = run_dir / JOURNAL_NAME
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}; expected the journal of a run") from None
        _hold(descriptor, path)
        try:
            content = read_journal(path)
        except BaseException:
            os.close(descriptor)
            raise
        journal = cls(path, descriptor, content.length, content.digest, set(content.points))
        if content.torn is not None:
            os.ftruncate(descriptor, content.length)
            os.fsync(descriptor)
            journal.record("note", text=f"cut off a torn last line of {len(content.torn)} bytes")
        return journal

    def record(self, kind: str, **payload: Any) -> None:
        """Write one record; it is on the disk when this returns.

        Parameters
        ----------
        kind
            ``point``, ``reference``, ``skipped``, ``state``, ``note`` have a fixed form
            (:mod:`instrument.records`); other kinds take any payload.
        payload
            Numbers, texts, times (UTC), pydantic models, and lists or dictionaries of them; finite.

        Raises
        ------
        JournalError
            For a point that is recorded already, a field that is missing, a number that is not finite.
        OSError
            If the disk refuses; nothing of the record remains then.
        """
        record = _checked({"kind": kind} | payload)
        refusal = _refusal(record, self._done)
        if refusal:
            raise JournalError(f"{self.path}: {refusal}")
        line, chain = _line(record, self._chain)
        self._append(line)
        self._chain = chain
        if kind == "point":
            self._done.add(record["index"])

    @property
    def digest(self) -> str:
        """Digest of everything recorded so far."""
        return self._chain

    @property
    def done(self) -> frozenset[int]:
        """Indices of the points recorded so far."""
        return frozenset(self._done)

    def close(self) -> None:
        """Release the file. May be repeated."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _append(self, line: bytes) -> None:
        if self._descriptor is None:
            raise JournalError(f"{self.path}: the journal is closed")
        try:
            view = memoryview(line)
            while view:
                view = view[os.write(self._descriptor, view) :]
            os.fsync(self._descriptor)
        except BaseException:
            self._take_back()
            raise
        self._length += len(line)

    def _take_back(self) -> None:
        """Remove what was written of a line; where not even that works, nothing may ever follow it."""
        assert self._descriptor is not None
        try:
            os.ftruncate(self._descriptor, self._length)
        except OSError:
            self.close()  # a torn line at the end is tolerated, one in the middle is not
            raise


def _hold(descriptor: int, path: Path) -> None:
    """Keep other programs from writing the same journal; the kernel lets go when the file is closed."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise InputError(f"{path}: another program is writing this run; end that one first") from None


def read_journal(path: Path) -> JournalContent:
    """Read a journal, or the journal of a run folder.

    A last line without an end is what a power cut leaves: it is reported in ``torn`` and otherwise ignored.

    Raises
    ------
    InputError
        Naming file and line: no journal, another version, a line that was changed after it was written, a
        point recorded twice.
    """
    if path.is_dir():
        path = path / JOURNAL_NAME
    with reading(path, "the journal of a run"):
        data = path.read_bytes()
    *complete, tail = data.split(b"\n")
    if not complete:
        raise InputError(f"{path}: no complete line; expected the journal of a run, whose first line is its header")
    header, chain = read_line(path, 1, complete[0])
    chains, contents = [chain], _Contents()
    for number, line in enumerate(complete[1:], start=2):
        record, chain = read_line(path, number, line, chain)
        chains.append(chain)
        refusal = _refusal(record, contents.points)
        if refusal:
            raise InputError(f"{path}: line {number}: {refusal}")
        contents.add(record)
    return JournalContent(
        path,
        header,
        tuple(contents.references),
        contents.points,
        contents.skipped,
        tuple(contents.others),
        tuple(chains),
        tail or None,
        len(data) - len(tail),
    )


def read_line(path: Path, number: int, line: bytes, previous: str = _NO_CHAIN) -> tuple[dict[str, Any], str]:
    """The record of a line, counted from 1, and its ``chain``; ``previous`` is that of the line before."""
    header = _read_header(path, line) if number == 1 else None
    chain = _verified_chain(path, number, line, previous)
    return header or _read_record(path, number, line), chain


def _read_header(path: Path, line: bytes) -> dict[str, Any]:
    foreign = InputError(f"{path}: line 1: not the header of a journal; expected format {FORMAT!r}")
    try:
        header = json.loads(line)
    except ValueError:
        raise foreign from None
    if not isinstance(header, dict) or (header.get("kind"), header.get("format")) != ("header", FORMAT):
        raise foreign
    if header.get("version") != VERSION:
        raise InputError(f"{path}: journal version {header.get('version')!r}; this program reads version {VERSION}")
    try:
        return _checked(header)
    except JournalError as error:
        raise InputError(f"{path}: line 1: {error}") from None


def _read_record(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        record = json.loads(line)
        if not isinstance(record, dict) or not isinstance(record.get("kind"), str):
            raise InputError(f"{path}: line {number}: not a record; expected a JSON object with a kind")
        return _checked(record)
    except JournalError as error:
        raise InputError(f"{path}: line {number}: {error}") from None


def _verified_chain(path: Path, number: int, line: bytes, previous: str) -> str:
    body, tail = line[:-_CHAIN_TAIL], line[-_CHAIN_TAIL:]
    chain = tail[len(_CHAIN_KEY) : -2].decode("ascii", "replace")
    if not tail.startswith(_CHAIN_KEY) or not tail.endswith(b'"}') or chain != _chain(previous, body):
        raise InputError(
            f"{path}: line {number}: the line, or one before it, was changed or damaged after it was written"
            " (its chain digest does not match)"
        )
    return chain


def _chain(previous: str, body: bytes) -> str:
    return hashlib.sha256(previous.encode() + body).hexdigest()


def _line(record: Mapping[str, Any], previous: str) -> tuple[bytes, str]:
    body = json.dumps(record, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()[:-1]
    chain = _chain(previous, body)
    return body + _CHAIN_KEY + chain.encode() + b'"}\n', chain


def _checked(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record as plain JSON values, its form checked; its ``chain`` is left out."""
    plain: dict[str, Any] = {key: _plain(value) for key, value in record.items() if key != "chain"}
    form = RECORDS.get(plain["kind"])
    if form is not None:
        try:
            form.model_validate({key: value for key, value in plain.items() if key != "kind"})
        except ValidationError as error:
            problems = "; ".join(f"{'.'.join(map(str, p['loc']))}: {p['msg']}" for p in error.errors())
            raise JournalError(f"{plain['kind']}: {problems}") from None
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return _plain(value.model_dump())
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item) for item in value]
    if isinstance(value, datetime):
        if value.tzinfo is None:
            raise JournalError(f"time {value.isoformat()} has no time zone; expected UTC")
        return value.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not np.isfinite(value):
        raise JournalError(f"found {value}; expected finite numbers")
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise JournalError(f"{type(value).__name__} {value!r} has no place in a journal")
