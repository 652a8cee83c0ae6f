"""Work that would hold the window up, on threads; the outcome comes back in the Qt thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal


class Work(QObject):
    """One kind of work of which only the newest order counts.

    Signals
    -------
    finished
        The result of the newest order.
    failed
        The exception of the newest order.
    """

    finished = Signal(object)
    failed = Signal(object)
    _arrived = Signal(int, object, object)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._order = 0
        self._arrived.connect(self._deliver, Qt.ConnectionType.QueuedConnection)

    @property
    def busy(self) -> bool:
        """Whether an order is open."""
        return self._order > 0 and self._delivered != self._order

    _delivered = 0

    def do(self, task: Callable[[], Any]) -> None:
        """Give an order; what an earlier one brings is not heard of any more."""
        self._order += 1
        threading.Thread(target=self._run, args=(self._order, task), name="work", daemon=True).start()

    def _run(self, order: int, task: Callable[[], Any]) -> None:
        try:
            result, error = task(), None
        except Exception as caught:  # noqa: BLE001 - whatever went wrong is shown where the work was asked for
            result, error = None, caught
        try:
            self._arrived.emit(order, result, error)
        except RuntimeError:
            return  # the window is closed meanwhile

    def _deliver(self, order: int, result: Any, error: Exception | None) -> None:
        if order != self._order:
            return
        self._delivered = order
        if error is not None:
            self.failed.emit(error)
        else:
            self.finished.emit(result)
