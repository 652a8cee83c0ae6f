"""What a scan's own process says reaches every window, from the first word on, in order."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from scan_script import geometries, preparation, readings, started

from gui import sessions
from gui.host import Host, Spool
from gui.notices import (
    ControllerClosed,
    ControllerFailed,
    ControllerStarting,
    OperatorAnswered,
    OperatorAsked,
    ProcedureEnded,
    ProcedureStarted,
)
from gui.remote import RemoteController
from gui.setup import Setup
from gui.wire import COMMANDS, decode, encode
from instrument.events import Message
from instrument.prompts import Prompt
from instrument.request import ScanRequest

POINTS = geometries({0.0: (0.0,)}, step=20)


@pytest.mark.parametrize(
    "item",
    [
        *preparation(POINTS),
        *readings(POINTS, 1),
        ControllerStarting(),
        ControllerClosed(),
        ControllerFailed(datetime(2026, 3, 2, 9, 0, tzinfo=UTC), "the {plan} is “wrong”", 'say "no"'),
        OperatorAsked("sample"),
        OperatorAsked(Prompt(key="align:level", title="“Level” it", kind="number", unit="mm", lower=-0.5, upper=50.0)),
        OperatorAsked(Prompt(key="align:centre", title="On the cross?", kind="choice", choices=("yes", "no"))),
        ProcedureStarted("Dark level"),
        ProcedureEnded(),
        OperatorAnswered(),
    ],
    ids=lambda item: type(item).__name__,
)
def test_everything_that_is_said_survives_the_wire(item: object) -> None:
    line = encode(item)  # type: ignore[arg-type]
    assert "\n" not in line
    assert decode(line.encode()) == item


def test_a_long_line_is_read_in_pieces_and_says_the_same() -> None:
    plan = geometries({0.0: tuple(range(0, 180, 9)), 15.0: (0.0,)}, step=2)
    event = started(plan, done=(3, 5))
    line = encode(event)
    assert len(line) > 100_000
    assert decode(line) == decode(line.encode()) == event
    wrong = line.replace('"sensor_azimuth":', '"sensor":', 1)
    with pytest.raises(ValueError, match="sensor_azimuth"):
        decode(wrong)
    long = Message(time=event.time, level="error", text="x" * 120_000)
    assert decode(encode(long)) == long


@pytest.mark.parametrize("line", [b"", b"{}", b'{"notice": "Unknown"}', b'{"kind": "nothing"}', b"HALT"])
def test_what_is_no_event_is_refused(line: bytes) -> None:
    with pytest.raises((ValueError, KeyError)):
        decode(line)


def test_a_late_reader_gets_every_line_and_a_slow_one_holds_nobody_up(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "spool")
    slow, theirs = socket.socketpair()
    follower = threading.Thread(target=spool.follow, args=(theirs,), daemon=True)
    follower.start()
    text = "x" * 1000
    began = time.monotonic()
    for number in range(2000):  # 2 MB: far more than a socket holds, and nobody reads
        spool.append(f"{number} {text}")
    assert time.monotonic() - began < 30.0
    spool.close()
    late, its = socket.socketpair()
    threading.Thread(target=spool.follow, args=(its,), daemon=True).start()
    for line in (late, slow):
        with line.makefile("rb") as lines:
            numbers = [int(next(lines).split()[0]) for _ in range(2000)]
        assert numbers == list(range(2000))
    follower.join(10.0)
    assert not follower.is_alive()
    for line in (slow, theirs, late, its):
        line.close()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    home = tmp_path / "s"
    monkeypatch.setenv(sessions.VARIABLE, str(home))
    return sessions.sessions_folder()


def host_in(folder: Path, **setup: object) -> Host:
    home = folder / "one"
    home.mkdir()
    content = Setup(simulate=True, operator="Ada", sample="coupon 7", **setup).content()  # type: ignore[arg-type]
    (home / sessions.REQUEST).write_text(json.dumps(content))
    return Host(home)


class Scan:
    """Stands where the session controller of a host would."""

    def __init__(self, host: Host, run_dir: Path) -> None:
        self.host, self.run_dir = host, run_dir
        self.asked: list[str] = []
        self.over = threading.Event()

    def start(self) -> None:
        run_dir = str(self.run_dir)
        for event in preparation(POINTS):
            self.host.on_event(event.model_copy(update={"run_dir": run_dir}) if hasattr(event, "run_dir") else event)

    def join(self, timeout: float) -> bool:
        return self.over.wait(timeout)

    def pause(self, *, now: bool = False) -> None:
        self.asked.append("pause now" if now else "pause")

    def resume(self) -> None:
        self.asked.append("resume")

    def halt(self) -> None:
        self.asked.append("halt")

    def abort(self) -> None:
        self.asked.append("abort")

    def answer(self, done: bool, value: float | str | None = None) -> None:
        self.asked.append(f"answer {done} {value!r}")


class Listener:
    """Remembers what arrives."""

    def __init__(self) -> None:
        self.items: list[object] = []

    def on_event(self, event: object) -> None:
        self.items.append(event)

    def names(self) -> list[str]:
        return [type(item).__name__ for item in self.items]

    def wait_for(self, name: str) -> None:
        deadline = time.monotonic() + 30.0
        while name not in self.names():
            assert time.monotonic() < deadline, self.names()
            time.sleep(0.01)


@pytest.fixture
def running(folder: Path, tmp_path: Path) -> Iterator[tuple[Host, Scan]]:
    host = host_in(folder)
    (tmp_path / "run").mkdir()
    scan = Scan(host, tmp_path / "run")
    host.controller = scan  # type: ignore[assignment]
    thread = threading.Thread(target=host.run, daemon=True)
    thread.start()
    yield host, scan
    scan.over.set()
    thread.join(30.0)
    assert not thread.is_alive()
    assert not host.folder.exists()


def found_session() -> sessions.LiveSession:
    deadline = time.monotonic() + 30.0
    while not (found := sessions.live_sessions()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found[0]


def test_windows_come_and_go_and_steer_the_same_scan(running: tuple[Host, Scan], tmp_path: Path) -> None:
    host, scan = running
    session = found_session()
    first, second = Listener(), Listener()
    one = RemoteController(first, folder=session.folder)
    one.start()
    first.wait_for("ReferenceMeasured")
    one.pause()
    one.leave()  # as a window that is closed, or killed
    assert one.join(10.0)
    assert "ControllerFailed" not in first.names()
    two = RemoteController(second, folder=session.folder)
    two.start()
    for word in ("pause_now", "resume", "abort", "halt"):
        getattr(two, word)()
    two.answer(True)
    two.answer(True, -0.25)
    two.answer(True, "no")
    two.answer(False)
    second.wait_for("ReferenceMeasured")
    assert second.names().count("ScanStarted") == 1
    deadline = time.monotonic() + 30.0
    while len(scan.asked) < 9 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert scan.asked == [
        *("pause", "pause now", "resume", "abort", "halt"),
        *("answer True None", "answer True -0.25", "answer True 'no'", "answer False None"),
    ]
    host.on_event(ControllerClosed())
    scan.over.set()
    second.wait_for("ControllerClosed")
    assert two.join(10.0)


def test_who_measures_what_stands_in_the_record_of_the_request() -> None:
    content = json.loads(
        json.dumps(Setup(simulate=True, operator="Ada", sample="no 7", project="round robin").content())
    )
    request = ScanRequest.model_validate(content["request"])
    assert request.record.said() == {"operator": "Ada", "sample": "no 7", "project": "round robin"}


def test_words_that_are_no_commands_are_not_obeyed(running: tuple[Host, Scan]) -> None:
    host, scan = running
    for word in ("", "start", "__class__", "run", "halt; pause", "halt now", "done [1]", "done {", "done true"):
        host.obey(word)
    assert scan.asked == []
    assert "halt" in COMMANDS


def test_a_process_that_ends_without_a_word_is_a_failure_with_advice(running: tuple[Host, Scan]) -> None:
    _, scan = running
    listener = Listener()
    controller = RemoteController(listener, folder=found_session().folder)
    controller.start()
    listener.wait_for("ReferenceMeasured")
    scan.over.set()  # no ControllerClosed before the line ends
    listener.wait_for("ControllerClosed")
    failure = next(item for item in listener.items if isinstance(item, ControllerFailed))
    assert "without a word" in failure.text
    assert "go on with the run" in failure.advice


def test_the_folder_of_a_dead_process_is_removed(folder: Path) -> None:
    dead = folder / "dead"
    dead.mkdir()
    (dead / sessions.ABOUT).write_text(json.dumps({"pid": 2**22 + 1}))
    assert sessions.live_sessions() == []
    assert not dead.exists()


def test_a_sessions_folder_that_others_may_write_is_refused(folder: Path) -> None:
    folder.chmod(0o777)
    with pytest.raises(PermissionError, match="can be written"):
        sessions.sessions_folder()
    folder.chmod(0o700)


def test_a_session_that_does_not_start_says_why(folder: Path) -> None:
    listener = Listener()
    controller = RemoteController(listener, {"request": {"speed": -1}})
    controller.start()
    listener.wait_for("ControllerClosed")
    failure = next(item for item in listener.items if isinstance(item, ControllerFailed))
    assert "does not answer" in failure.text
