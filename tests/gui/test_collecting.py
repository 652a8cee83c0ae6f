"""Garbage with widgets in it is collected in the Qt thread, and nowhere else."""

from __future__ import annotations

import gc
import threading
import weakref
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pytestqt.qtbot import QtBot


class _Ring:
    """Refers to itself, so that only the collector can free it."""

    def __init__(self, told: list[int]) -> None:
        self.ring = self
        weakref.finalize(self, lambda: told.append(threading.get_ident()))


def test_garbage_is_collected_in_the_qt_thread_alone(qtbot: QtBot) -> None:
    from gui.collecting import Collector

    told: list[int] = []
    gc.enable()
    collector = Collector()
    assert not gc.isenabled()
    _Ring(told)

    def churn() -> None:
        kept = [[] for _ in range(5000)]  # passes the threshold of the youngest generation
        kept.clear()

    other = threading.Thread(target=churn)
    other.start()
    other.join()
    assert told == []
    filler: list[list[int]] = []

    def collected() -> bool:
        # Again and again: what the tests before have left is freed meanwhile and counts against it.
        filler.extend([number] for number in range(1000))
        return told == [threading.get_ident()]

    qtbot.waitUntil(collected, timeout=5000)
    collector.deleteLater()
