"""Many events, many threads, many pictures: the window stays quick and small."""

from __future__ import annotations

import gc
import sys
import threading
import time
from typing import Any

import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot
from scan_script import START, geometries, preparation, readings
from window_stage import Stage, running

from gui.axes import step
from gui.bridge import Bridge
from gui.comparison import score
from gui.model import Changes, ScanModel
from instrument.events import Message


def test_events_of_many_threads_arrive_in_the_qt_thread_in_batches(qtbot: QtBot) -> None:
    model = ScanModel(score)
    bridge = Bridge(model)
    batches: list[tuple[Changes, threading.Thread]] = []
    bridge.changed.connect(lambda changes: batches.append((changes, threading.current_thread())))
    each, threads = 200, 4

    def write() -> None:
        for number in range(each):
            bridge.on_event(Message(time=START, level="info", text=str(number)))

    writers = [threading.Thread(target=write) for _ in range(threads)]
    for writer in writers:
        writer.start()
    qtbot.waitUntil(lambda: len(model.messages) == each * threads, timeout=5000)
    qtbot.wait(100)  # the Qt thread sleeps again
    bridge.on_event(Message(time=START, level="info", text="one more"))
    qtbot.waitUntil(lambda: len(model.messages) == each * threads + 1, timeout=5000)
    for writer in writers:
        writer.join()
    assert len(batches) < each * threads / 4
    assert sum(changes.messages for changes, _ in batches) == each * threads + 1
    assert {thread for _, thread in batches} == {threading.main_thread()}


def test_a_burst_of_events_does_not_hold_the_window_up(stage: Stage, qtbot: QtBot) -> None:
    points = geometries({float(i): (0.0, 45.0, 90.0) for i in range(0, 45, 5)}, step=5)
    events = [*preparation(points), *readings(points, len(points))]
    longest, last = 0.0, time.thread_time()
    for event in events:
        stage.window.bridge.on_event(event)
    while stage.window.model.settled < len(points):
        QApplication.processEvents()
        now = time.thread_time()
        longest, last = max(longest, now - last), now
    assert longest < 0.25  # generous, and of this thread: other programs may keep the machine busy


def test_memory_of_the_plot_does_not_grow_with_the_number_of_updates(stage: Stage) -> None:
    running(stage, 20)
    stage.window.plots._draw()
    gc.collect()
    before = len(stage.window.plots.graphics.scene().items())
    for _ in range(50):
        stage.window.plots._draw()
    assert len(stage.window.plots.graphics.scene().items()) == before


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="they are immortal since Python 3.12")
def test_qt_does_not_use_up_the_references_to_none_and_true(stage: Stage) -> None:
    running(stage, 20)
    before = {constant: sys.getrefcount(constant) for constant in (None, True, False)}
    for _ in range(5000):  # each emits two signals
        stage.window.plots.brf_plot.setYRange(0.0, 1.0, padding=0)
    for constant, count in before.items():
        assert sys.getrefcount(constant) > count - 1000  # PySide6 6.12.0 loses one a call and more


def test_of_three_maps_one_is_drawn_in_a_pass_and_none_when_the_tab_is_shown(stage: Stage) -> None:
    running(stage, 20)
    tabs: Any = stage.window.page("watch").tabs  # type: ignore[attr-defined]
    panel: Any = stage.window.panel("PolarPanel")
    tabs.setCurrentWidget(panel)
    assert panel.behind
    left = []
    while panel.behind:
        panel.catch_up()
        left.append(sum(each.stale for each in panel.maps.values()))
    assert left == [3, 2, 1, 0]


@pytest.mark.parametrize(
    ("extent", "length", "apart", "expected"),
    [(100.0, 500.0, 50.0, 10.0), (160.0, 700.0, 64.0, 20.0), (0.003, 200.0, 34.0, 0.001), (1.0, 50.0, 64.0, 0.5)],
)
def test_ticks_stand_as_close_as_they_may(extent: float, length: float, apart: float, expected: float) -> None:
    assert step(extent, length, apart) == pytest.approx(expected)
