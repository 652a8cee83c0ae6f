"""A main window that is painted once in a pass of the event loop, and after the work of that pass."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QTimer
from PySide6.QtWidgets import QMainWindow


class PacedWindow(QMainWindow):
    """Paints when the event loop has nothing else to do.

    Every scene of a plot has its window painted as soon as one of its items has changed, however much is about to
    change elsewhere: a page that is shown would be painted twice, and in the pass in which it was laid out.
    """

    def __init__(self) -> None:
        super().__init__()
        self._idle = QTimer(self)
        self._idle.setSingleShot(True)
        self._idle.setInterval(0)
        self._idle.timeout.connect(self._paint)
        self._due = False

    def event(self, event: QEvent) -> bool:
        """Put a request to paint off."""
        if event.type() is not QEvent.Type.UpdateRequest or self._due:
            return super().event(event)
        self._idle.start()
        return True

    def _paint(self) -> None:
        self._due = True
        self.event(QEvent(QEvent.Type.UpdateRequest))
        self._due = False
