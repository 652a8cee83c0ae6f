"""Frames and memory of the window over a run of 10 000 points at 100 events a second.

``python benchmarks/bench_window.py [--points 10000] [--rate 100] [--page watch]`` opens the real window without a
screen and plays the events of a scan into it from another thread. Every pass of the event loop is timed by the loop
itself (:class:`Loop`, a timer that is due in every pass): wall time, and time of the Qt thread, which other programs on
the machine do not lengthen. ``--page each`` goes from page to page meanwhile.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import sys
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from PySide6.QtCore import QObject, QSettings, QTimer

from gui.application import load_qt, start_application
from gui.notices import ControllerStarting
from gui.run import keep_collections_short
from gui.setup import Setup
from gui.window import MainWindow
from instrument.events import (
    Event,
    Geometry,
    PointAnnotated,
    PointMeasured,
    PointStarted,
    ReferenceMeasured,
    ScanStarted,
    StateChanged,
)

START = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)
_EVENTS_A_POINT = 5
_SLOW_MS = 50.0


class NoScan:
    """Stands where a session would."""

    detached = False

    def start(self) -> None:
        """Nothing runs."""

    pause = pause_now = resume = abort = halt = start

    def answer(self, done: bool, value: float | str | None = None) -> None:
        """Nobody asks."""


def points_of(count: int) -> tuple[Geometry, ...]:
    """A plan of planes with 125 points."""
    zeniths = [round(-80 + 160 * i / 124, 3) for i in range(125)]
    planes = [(float(light), float(azimuth)) for light in range(0, 61, 6) for azimuth in range(0, 180, 15)]
    every = [
        Geometry(wavelength=500.0, illumination_zenith=light, sensor_azimuth=azimuth, sensor_zenith=zenith)
        for light, azimuth in planes
        for zenith in zeniths
    ]
    return tuple(every[:count])


def scan(points: tuple[Geometry, ...]) -> Iterator[Event]:
    """Events of the points: two changes of state, the start, the prediction, the reading."""
    old = "mounting"
    for index, geometry in enumerate(points):
        now = START + timedelta(seconds=20 * index)
        truth = 0.3 + 0.2 * math.cos(math.radians(geometry.sensor_zenith)) ** 2
        wave = math.sin(index * 12.9898) * 0.013
        yield StateChanged(time=now, old=old, new="moving")
        yield PointStarted(time=now, index=index, geometry=geometry)
        yield StateChanged(time=now, old="moving", new="measuring")
        yield PointAnnotated(time=now, index=index, source="twin", values={"brf": truth, "u_brf": 0.002 * truth})
        yield PointMeasured(
            time=now,
            index=index,
            geometry=geometry,
            brf=truth * (1 + wave),
            u_brf=0.013 * truth,
            signal=tuple(1 + 0.001 * math.sin(index + k) for k in range(9)),
            dark=1e-3,
            gain=1e7,
            done=index + 1,
            total=len(points),
            time_left_s=20.0 * (len(points) - index - 1),
        )
        old = "measuring"


class Loop(QObject):
    """Times every pass of the event loop."""

    def __init__(self) -> None:
        super().__init__()
        self.wall: list[float] = []
        self.thread: list[float] = []
        self._beat = QTimer(self)
        self._beat.setInterval(0)  # runs once in every pass of the loop
        self._beat.timeout.connect(self._pass)
        self._last: tuple[float, float] | None = None

    def start(self) -> None:
        """Begin to time."""
        self._beat.start()

    def stop(self) -> None:
        """No more."""
        self._beat.stop()

    def _pass(self) -> None:
        now = (time.perf_counter(), time.thread_time())
        if self._last is not None:
            self.wall.append(1e3 * (now[0] - self._last[0]))
            self.thread.append(1e3 * (now[1] - self._last[1]))
        time.sleep(0.001)  # an idle loop would wait for events here
        self._last = (time.perf_counter(), time.thread_time())


def memory_mb() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def play(window: MainWindow, points: tuple[Geometry, ...], rate: float, done: threading.Event) -> None:
    """Send events at a rate, from a thread of its own."""
    begun = time.perf_counter()
    for number, event in enumerate(scan(points)):
        late = begun + number / rate - time.perf_counter()
        if late > 0:
            time.sleep(late)
        window.bridge.on_event(event)
    done.set()


def begin(window: MainWindow, points: tuple[Geometry, ...]) -> None:
    """Let a scan begin, with a reference."""
    window.do("start")
    window.bridge.on_event(ControllerStarting())
    window.bridge.on_event(
        ScanStarted(time=START, run_dir="runs/bench", title="bench", points=points, duration_s=20.0 * len(points))
    )
    for index, azimuth in enumerate((0.0, 45.0, 90.0, 135.0)):
        window.bridge.on_event(
            ReferenceMeasured(
                time=START, index=index, sensor_azimuth=azimuth, current=3e-8, relative_standard_error=4e-4
            )
        )
    window.bridge.flush()


def run(count: int, rate: float, page: str, warm: int) -> dict[str, Any]:
    """Play a run and report frames and memory."""
    application = start_application()
    settings = QSettings(os.devnull, QSettings.Format.IniFormat)
    window = MainWindow(lambda listener, plan: NoScan(), settings, setup=Setup(simulate=True))
    keep_collections_short(window)
    window.show()
    window.prepare()
    points = points_of(count)
    begin(window, points)
    tabs: Any = getattr(window.page("watch"), "tabs")  # noqa: B009 - of this page only
    window.show_page("watch" if page == "each" else page)
    turning = QTimer()
    turn = iter(range(10**9))

    def next_page() -> None:
        number = next(turn)
        window.show_page(("acquire", "watch", "watch", "watch")[number % 4])
        tabs.setCurrentIndex(number % 3)

    if page == "each":
        turning.timeout.connect(next_page)
        turning.start(3000)
    loop, done = Loop(), threading.Event()
    memory: list[tuple[int, float]] = []

    def look() -> None:
        memory.append((window.model.settled, round(memory_mb(), 1)))
        if done.is_set() and window.model.settled == len(points):
            application.exit(0)

    watch = QTimer()
    watch.timeout.connect(look)
    watch.start(5000)
    QTimer.singleShot(warm, loop.start)
    sender = threading.Thread(target=play, args=(window, points, rate, done), daemon=True)
    began, cpu = time.perf_counter(), time.process_time()
    sender.start()
    application.exec()
    took, cpu = time.perf_counter() - began, time.process_time() - cpu
    loop.stop()
    wall, thread = sorted(loop.wall), sorted(loop.thread)
    half = [each for settled, each in memory if settled >= len(points) / 2]
    return {
        "points": len(points),
        "events": _EVENTS_A_POINT * len(points),
        "events_a_second": round(_EVENTS_A_POINT * len(points) / took, 1),
        "page": page,
        "frames": len(wall),
        "longest_frame_wall_ms": round(wall[-1], 1),
        "longest_frame_of_the_qt_thread_ms": round(thread[-1], 1),
        "p999_frame_of_the_qt_thread_ms": round(thread[int(0.999 * (len(thread) - 1))], 1),
        "frames_over_50_ms_of_the_qt_thread": sum(each > _SLOW_MS for each in thread),
        "share_of_one_processor": round(cpu / took, 2),
        "memory_mb": memory,
        "memory_growth_second_half_mb": round(half[-1] - half[0], 1) if half else None,
    }


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--rate", type=float, default=100.0, help="events a second")
    parser.add_argument("--page", default="each", help="acquire, watch, ... or each in turn")
    parser.add_argument("--warm-ms", type=int, default=1500, help="not timed at first: the window opens")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    load_qt()
    found = run(given.points, given.rate, given.page, given.warm_ms)
    text = json.dumps(found, indent=1)
    print(text)
    if given.json:
        given.json.write_text(text + "\n")
    sys.stdout.flush()
    os._exit(0 if found["frames_over_50_ms_of_the_qt_thread"] == 0 else 1)


if __name__ == "__main__":
    main()
