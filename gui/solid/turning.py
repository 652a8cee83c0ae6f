"""A picture of the instrument that a hand turns, whoever draws it."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QSize, Qt
from PySide6.QtGui import QKeyEvent, QMouseEvent
from PySide6.QtWidgets import QSizePolicy, QWidget

_PER_PIXEL = (0.5, 0.4)  # degree of azimuth and of height
#: Where an arrow key leads the eye: degree of azimuth and of height.
_KEYS = {
    Qt.Key.Key_Left: (-8.0, 0.0),
    Qt.Key.Key_Right: (8.0, 0.0),
    Qt.Key.Key_Up: (0.0, 6.0),
    Qt.Key.Key_Down: (0.0, -6.0),
}


class TurnedByHand(QWidget):
    """What is drawn follows the mouse; the arrow keys lead the eye around it."""

    def __init__(self, accessible_name: str) -> None:
        super().__init__()
        self._drag: QPointF | None = None
        self.setMinimumSize(QSize(260, 220))
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(accessible_name)

    def turn(self, azimuth: float, height: float) -> None:
        """Look from so many degrees further round, against the clock as seen from above, and further up."""
        raise NotImplementedError

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Begin to turn the view."""
        self._drag = event.position()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Turn the view."""
        if self._drag is not None:
            moved = event.position() - self._drag
            self._drag = event.position()
            self.turn(-_PER_PIXEL[0] * moved.x(), _PER_PIXEL[1] * moved.y())

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """The view stays as it is."""
        self._drag = None

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Turn the view with the arrow keys."""
        by = _KEYS.get(Qt.Key(event.key()))
        if by is None:
            super().keyPressEvent(event)
        else:
            self.turn(*by)
