"""A main window that is painted once in a pass of the event loop, and after the work of that pass."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QTimer
from PySide6.QtWidgets import QMainWindow

_SOON_MS = 1  # a timer of 0 waits until nothing else happens: for ever, where a hand keeps moving the mouse


class PacedWindow(QMainWindow):
    """Paints when what is going on is done.

    Every scene of a plot has its window painted as soon as one of its items has changed, however much is about to
    change elsewhere: a page that is shown would be painted twice, and in the pass in which it was laid out.
    """

    def __init__(self) -> None:
        super().__init__()
        self._soon = QTimer(self)
        self._soon.setSingleShot(True)
        self._soon.setInterval(_SOON_MS)
        self._soon.timeout.connect(self._paint)
        self._due = False

    def event(self, event: QEvent) -> bool:
        """Put a request to paint off."""
        if event.type() is not QEvent.Type.UpdateRequest or self._due:
            return super().event(event)
        if not self._soon.isActive():
            self._soon.start()
        return True

    def _paint(self) -> None:
        self._due = True
        self.event(QEvent(QEvent.Type.UpdateRequest))
        self._due = False
