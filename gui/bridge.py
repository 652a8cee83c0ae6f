"""Brings events from the engine's threads into the Qt thread, in order and in batches.

Any thread may call :meth:`Bridge.on_event`: it appends to a queue and wakes the Qt thread at most once a batch, so
that neither a burst of events nor a slow window holds the other up.
"""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal

from gui.model import ScanModel
from gui.notices import Notice
from gui.points import LaidOut, lay_out
from instrument.events import Event, ScanStarted

INTERVAL_MS = 33  # about 30 updates a second
BUDGET_S = 0.008  # of the Qt thread in a frame; what is left over waits for the next one


class Bridge(QObject):
    """Feeds a model in the Qt thread with what arrives on other threads; satisfies the engine's ``Observer``.

    Signals
    -------
    changed
        In the Qt thread, after a batch: what changed (:class:`gui.model.Changes`).
    """

    changed = Signal(object)
    _woken = Signal()

    def __init__(self, model: ScanModel, parent: QObject | None = None, interval_ms: int = INTERVAL_MS) -> None:
        super().__init__(parent)
        self.model = model
        self._queue: deque[Event | Notice | LaidOut] = deque()
        self._asleep = True  # racing writers may both wake the Qt thread, which does no harm
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(interval_ms)
        self._timer.timeout.connect(self._deliver)
        self._woken.connect(self._wake, Qt.ConnectionType.QueuedConnection)

    def on_event(self, event: Event | Notice) -> None:
        """Take an event from any thread; returns at once. Points of a new scan are laid out in that thread."""
        self._queue.append(lay_out(event) if isinstance(event, ScanStarted) else event)
        if self._asleep:
            self._asleep = False
            self._woken.emit()

    def finish(self, run_dir: Path) -> list[Any]:
        """Nothing to write: the window shows what the run folder holds."""
        return []

    def close(self) -> None:
        """Nothing to release."""

    def flush(self) -> None:
        """Deliver everything that has arrived, now; call in the Qt thread."""
        while self._queue:
            self._deliver()

    def _wake(self) -> None:
        if not self._timer.isActive():
            self._timer.start()

    def _deliver(self) -> None:
        self._asleep = True  # before the queue is read: an event that comes meanwhile wakes us again
        end = time.thread_time() + BUDGET_S
        while self._queue and time.thread_time() < end:
            self.model.apply(self._queue.popleft())
        if self._queue:
            self._asleep = False
            self._timer.start()
        self.changed.emit(self.model.take_changes())
