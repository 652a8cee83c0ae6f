"""The journal: what is acknowledged survives, what was tampered with shows."""

from __future__ import annotations

import errno
import json
import os
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from example_runs import START, four_points, geometry, header, reading
from hypothesis import given, settings
from hypothesis import strategies as st

from instrument.errors import InputError
from instrument.journal import Journal, JournalError, read_journal


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of a journal with four references and four points."""
    return (four_points(tmp_path_factory.mktemp("whole")) / "journal.jsonl").read_bytes()


def test_what_was_recorded_is_read_back(tmp_path: Path) -> None:
    content = read_journal(four_points(tmp_path))
    assert content.header["title"] == "four points"
    assert list(content.points) == [0, 1, 2, 3]
    assert [record["index"] for record in content.references] == [0, 1, 2, 3]
    assert content.points[2]["geometry"]["sensor_zenith"] == -30.0
    assert content.points[0]["time"] == "2026-03-02T08:01:00.000000Z"
    assert content.torn is None


def test_a_record_is_on_the_disk_before_the_call_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        real(descriptor)
        synced.append(os.fstat(descriptor).st_size)

    monkeypatch.setattr(os, "fsync", fsync)
    with Journal.create(tmp_path, header()) as journal:
        journal.record("note", text="here")
        assert synced[-1] == (tmp_path / "journal.jsonl").stat().st_size
        assert (tmp_path / "journal.jsonl").read_text().count("\n") == 2


@settings(deadline=None, max_examples=150)
@given(data=st.data())
def test_cut_anywhere_every_complete_line_is_read_and_none_invented(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    first = whole.index(b"\n") + 1
    cut = data.draw(st.integers(0, len(whole)))
    (folder / "journal.jsonl").write_bytes(whole[:cut])
    if cut < first:
        with pytest.raises(InputError, match="journal of a run"):
            read_journal(folder)
        return
    content = read_journal(folder)
    complete = whole[:cut].count(b"\n")
    expected = [json.loads(line) for line in whole.splitlines()[1:complete]]
    assert len(content.references) + len(content.points) == complete - 1
    for record in [*content.references, *content.points.values()]:
        assert record | {"chain": ""} in [line | {"chain": ""} for line in expected]
    assert (content.torn is None) == whole[:cut].endswith(b"\n")


@settings(deadline=None, max_examples=100)
@given(data=st.data())
def test_a_changed_byte_is_never_believed(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    position = data.draw(st.integers(0, len(whole) - 1))
    value = data.draw(st.integers(0, 255).filter(lambda byte: byte != whole[position]))
    folder = tmp_path_factory.mktemp("changed")
    damaged = whole[:position] + bytes([value]) + whole[position + 1 :]
    (folder / "journal.jsonl").write_bytes(damaged)
    try:
        content = read_journal(folder)
    except InputError:
        return
    # Only the last line's end may go unnoticed: then that line counts as torn.
    assert content.torn is not None
    assert position == len(whole) - 1
    assert list(content.points) == [0, 1, 2]


def test_a_lost_and_an_exchanged_line_show(whole: bytes, tmp_path: Path) -> None:
    lines = whole.splitlines(keepends=True)
    for changed in (lines[:3] + lines[4:], [*lines[:3], lines[4], lines[3], *lines[5:]]):
        (tmp_path / "journal.jsonl").write_bytes(b"".join(changed))
        with pytest.raises(InputError, match=r"line 4: .*changed or damaged"):
            read_journal(tmp_path)


def test_reopening_cuts_off_the_torn_line_and_goes_on(tmp_path: Path) -> None:
    path = four_points(tmp_path) / "journal.jsonl"
    path.write_bytes(path.read_bytes()[:-40])
    with Journal.reopen(tmp_path) as journal:
        assert journal.done == {0, 1, 2}
        journal.record("point", index=3, **reading(geometry(-60.0), 0.6, 120.0))
        with pytest.raises(JournalError, match="point 3 is recorded already"):
            journal.record("point", index=3, **reading(geometry(-60.0), 0.6, 140.0))
    content = read_journal(tmp_path)
    assert list(content.points) == [0, 1, 2, 3]
    assert "torn last line" in content.others[-1]["text"]
    assert content.digest == journal.digest


def test_zeros_that_a_power_cut_leaves_are_a_torn_line(tmp_path: Path) -> None:
    path = four_points(tmp_path) / "journal.jsonl"
    path.write_bytes(path.read_bytes() + b"\0" * 4096)
    content = read_journal(tmp_path)
    assert list(content.points) == [0, 1, 2, 3]
    assert content.torn == b"\0" * 4096


def test_no_run_is_written_over(tmp_path: Path) -> None:
    four_points(tmp_path)
    before = (tmp_path / "journal.jsonl").read_bytes()
    with pytest.raises(InputError, match="recorded here already"):
        Journal.create(tmp_path, header())
    assert (tmp_path / "journal.jsonl").read_bytes() == before


def test_a_full_disk_leaves_whole_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write

    def full(descriptor: int, data: memoryview) -> int:
        if len(data) > 20:
            return real(descriptor, data[:20])
        raise OSError(errno.ENOSPC, "no space left on device")

    with Journal.create(tmp_path, header()) as journal:
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", lambda d, data: full(d, data) if len(data) < 200 else real(d, data[:150]))
            with pytest.raises(OSError, match="no space"):
                journal.record("note", text="a" * 100)
        journal.record("note", text="after")
    content = read_journal(tmp_path)
    assert [record["text"] for record in content.others] == ["after"]
    assert content.torn is None


def test_a_skipped_point_may_be_measured_later(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        journal.record("skipped", index=2, geometry=geometry(30.0), time=START, reason="axis stalled")
        assert list(read_journal(tmp_path).skipped) == [2]
        journal.record("point", index=2, **reading(geometry(30.0), 0.5, 10.0))
        with pytest.raises(JournalError, match="recorded already"):
            journal.record("skipped", index=2, geometry=geometry(30.0), time=START, reason="again")
    content = read_journal(tmp_path)
    assert list(content.points) == [2]
    assert not content.skipped


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"signal": [1.0, float("nan")]}, "finite"),
        ({"signal": []}, "signal"),
        ({"gain": 0.0}, "gain"),
        ({"dark": None}, "dark"),
        ({"time": datetime(2026, 3, 2)}, "no time zone"),
        ({"index": -1}, "index"),
        ({"quality_flag": 16}, "quality_flag"),
        ({"extra": object()}, "no place in a journal"),
    ],
)
def test_what_is_no_reading_is_refused_and_leaves_no_trace(
    tmp_path: Path, change: dict[str, object], expected: str
) -> None:
    with Journal.create(tmp_path, header()) as journal:
        size = (tmp_path / "journal.jsonl").stat().st_size
        with pytest.raises(JournalError, match=expected):
            journal.record("point", **({"index": 0} | reading(geometry(30.0), 0.5, 1.0) | change))
        assert (tmp_path / "journal.jsonl").stat().st_size == size


def test_times_are_kept_in_utc_and_arrays_as_numbers(tmp_path: Path) -> None:
    with Journal.create(tmp_path, header()) as journal:
        local = datetime(2026, 3, 2, 10, 0, tzinfo=timezone(timedelta(hours=2)))
        journal.record("note", text="x", when=local, volts=np.array([1.0, 2.0]), count=np.int64(3), where=tmp_path)
    note = read_journal(tmp_path).others[0]
    assert note["when"] == "2026-03-02T08:00:00.000000Z"
    assert note["volts"] == [1.0, 2.0]
    assert note["count"] == 3


def test_a_closed_journal_takes_nothing(tmp_path: Path) -> None:
    journal = Journal.create(tmp_path, header())
    journal.close()
    journal.close()
    with pytest.raises(JournalError, match="closed"):
        journal.record("note", text="late")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "no complete line"),
        (b"hello\n", "not the header of a journal"),
        (b'{"format":"another"}\n', "not the header of a journal"),
        (b"[1, 2]\n", "not the header of a journal"),
        (b"\x89HDF\r\n\x1a\n\x00\xff", "not the header of a journal"),
        (b'{"kind":"header","format":"goniotwin-journal","version":7}\n', "journal version 7; this program reads"),
    ],
)
def test_a_foreign_file_is_named(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(content)
    with pytest.raises(InputError, match=expected) as caught:
        read_journal(path)
    assert str(path) in str(caught.value)


def test_a_missing_journal_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_journal(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        Journal.create(tmp_path / "absent", header())


def test_an_incomplete_header_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="plan"):
        Journal.create(tmp_path, {key: value for key, value in header().items() if key != "plan"})
    assert not (tmp_path / "journal.jsonl").exists()
