"""Scans that are killed, cut and starved of disk at random moments, and resumed until they are complete."""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from reliability_bench import measured, problems_of, small_scan

from instrument.journal import JOURNAL_NAME


def kill_trial(folder: Path, trials: int, seed: int = 1) -> dict[str, Any]:
    """Kill a scan (SIGKILL) at random moments, up to three times, then let it finish.

    The moment is drawn as a length of the journal, and some milliseconds after it is reached: a busy machine then
    spreads the moments over the scan as an idle one does.
    """
    expected, length = _uninterrupted(folder)
    draw, wrong, kills, lost = random.Random(seed), [], 0, 0
    for number in range(trials):
        run = _fresh(folder, "killed")
        begun = False
        for _ in range(draw.randint(1, 3)):
            process = forked(lambda run=run: _scan(run))
            goal = draw.uniform(0, length)
            killed = _kill_at(process, run / JOURNAL_NAME, goal, draw.uniform(0.0, 0.004))
            kills += killed
            begun = (run / JOURNAL_NAME).exists() and b"\n" in (run / JOURNAL_NAME).read_bytes()
            if not begun:
                lost += 1
                run = _fresh(folder, "killed")
            if not killed:
                break
        wrong += _finish(run, expected, f"trial {number}")
    return {"trials": trials, "kills": kills, "before_the_header": lost, "wrong": wrong}


def cut_trial(folder: Path, every: int = 1) -> dict[str, Any]:
    """Cut the journal at every byte of its last two lines, of the last lines of a whole run and of one under way."""
    expected, _ = _uninterrupted(folder)
    whole = (folder / "uninterrupted" / JOURNAL_NAME).read_bytes()
    lines = whole.splitlines(keepends=True)
    last_point = max(number for number, line in enumerate(lines) if line.startswith(b'{"kind":"point"'))
    wrong, cuts = [], 0
    for upto in (len(lines), last_point + 1):
        data = b"".join(lines[:upto])
        start = len(data) - len(lines[upto - 1]) - len(lines[upto - 2])
        for cut in range(start, len(data) + 1, every):
            run = _fresh(folder, "cut")
            (run / JOURNAL_NAME).write_bytes(data[:cut])
            _scan(run)
            wrong += _complete(run, expected, f"cut at byte {cut}")
            cuts += 1
    return {"trials": cuts, "wrong": wrong}


def disk_trial(folder: Path, trials: int, seed: int = 2) -> dict[str, Any]:
    """Let the disk be full at random bytes of the journal (a limit of the file's size), then give it room again."""
    expected, length = _uninterrupted(folder)
    draw, wrong, refused = random.Random(seed), [], 0
    for number in range(trials):
        run = _fresh(folder, "full")
        room = draw.randint(length // 10, length)

        def starved(run: Path = run, room: int = room) -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
            scan = small_scan(run)
            end = scan.run(600.0)
            bench = scan.bench
            os._exit(0 if bench.safe and not bench.wrong and end.outcome in ("finished", "faulted") else 3)

        try:
            status = status_of(forked(starved))
        except TimeoutError:
            wrong.append(f"trial {number}: hangs with a full disk")
            continue
        if status != 0:
            wrong.append(f"trial {number}: not safe with a disk full at byte {room}")
        refused += (run / JOURNAL_NAME).stat().st_size <= room
        if b"\n" in (run / JOURNAL_NAME).read_bytes():
            wrong += _finish(run, expected, f"trial {number}")
    return {"trials": trials, "disk_was_full": refused, "wrong": wrong}


def _uninterrupted(folder: Path) -> tuple[dict[int, Any], int]:
    run = _fresh(folder, "uninterrupted")
    _scan(run)
    return measured(run), (run / JOURNAL_NAME).stat().st_size


def _scan(run: Path) -> None:
    scan = small_scan(run)
    end = scan.run(600.0)
    if end.outcome != "finished" or scan.bench.wrong or not scan.bench.safe:
        raise RuntimeError(f"{end.outcome}: {end.reason}; {scan.bench.wrong}")


def _finish(run: Path, expected: dict[int, Any], name: str) -> list[str]:
    if status_of(forked(lambda: _scan(run))) != 0:
        return [f"{name}: cannot be resumed"]
    return _complete(run, expected, name)


def _complete(run: Path, expected: dict[int, Any], name: str) -> list[str]:
    return [f"{name}: {problem}" for problem in problems_of(run, expected)]


def _fresh(folder: Path, name: str) -> Path:
    run = folder / name
    shutil.rmtree(run, ignore_errors=True)
    run.mkdir(parents=True)
    return run


def forked(work: Callable[[], None]) -> int:
    """A child with everything imported; it must not return."""
    sys.stdout.flush()
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        work()
        status = 0
    finally:
        os._exit(status)


def _kill_at(process: int, journal: Path, goal: float, later: float) -> bool:
    """Kill a child once its journal is so long; False where it ended before."""
    deadline = time.monotonic() + 600.0
    while time.monotonic() < deadline:
        if os.waitpid(process, os.WNOHANG)[0]:
            return False
        if journal.exists() and journal.stat().st_size >= goal:
            break
        time.sleep(0.0005)
    return killed(process, time.monotonic() + later)


def killed(process: int, moment: float) -> bool:
    """Kill a child at a moment of the monotonic clock; False where it ended before."""
    while (left := moment - time.monotonic()) > 0:
        if os.waitpid(process, os.WNOHANG)[0]:
            return False
        time.sleep(min(left, 0.002))
    os.kill(process, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(process, 0)[1])


def status_of(process: int) -> int:
    """Exit status of a child, which is killed after ten minutes."""
    deadline = time.monotonic() + 600.0
    while time.monotonic() < deadline:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    raise TimeoutError("the scan hangs")
