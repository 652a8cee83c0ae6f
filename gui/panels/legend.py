"""What the lines, bands and symbols of the plots mean."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QHBoxLayout, QLabel, QWidget

from gui import marks
from gui.flow import FlowLayout
from gui.panels.base import quiet
from gui.scores import CATEGORIES
from gui.theme import Theme

_HEIGHT = 22


class _Sample(QWidget):
    """A short piece of a curve as it is drawn in the plot."""

    def __init__(self, theme: Theme, what: str) -> None:
        super().__init__()
        self._theme, self._what = theme, what
        self.setFixedSize(QSize(34, _HEIGHT))

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        theme = self._theme
        if self._what == "simulated":
            for alpha, half in ((45, 8), (85, 4)):
                colour = QColor(theme.simulated)
                colour.setAlpha(alpha)
                painter.fillRect(QRectF(2, 11 - half, 30, 2 * half), colour)
            painter.setPen(QPen(QColor(theme.simulated), 2))
            painter.drawLine(QPointF(2, 11), QPointF(32, 11))
        elif self._what == "measured":
            painter.setPen(QPen(QColor(theme.measured), 1))
            painter.drawLine(QPointF(17, 1), QPointF(17, 21))
            painter.drawLine(QPointF(13, 1), QPointF(21, 1))
            painter.drawLine(QPointF(13, 21), QPointF(21, 21))
            painter.setPen(QPen(QColor(theme.measured), 3.5))
            painter.drawLine(QPointF(17, 6), QPointF(17, 16))
            painter.setPen(QPen(QColor(theme.measured), 1.6))
            painter.setBrush(QColor(theme.surface))
            painter.drawEllipse(QPointF(17, 11), 3.2, 3.2)
        elif self._what == "missing":
            painter.setPen(QPen(QColor(theme.poor), 1.8))
            painter.drawRect(QRectF(12, 6, 10, 10))
        else:
            painter.setPen(QPen(QColor(theme.accent), 1.5, Qt.PenStyle.DashDotLine))
            painter.drawLine(QPointF(17, 0), QPointF(17, 22))


def legend(theme: Theme) -> QWidget:
    """What explains the plots, in as many rows as it takes."""
    widget = QWidget()
    flow = FlowLayout(widget)
    entries = {
        "measured": "measured, k = 1 and 2",
        "simulated": "simulated, k = 1 and 2",
        "here": "arms now",
        "missing": "not measured",
    }
    for what, text in entries.items():
        flow.addWidget(_entry(_Sample(theme, what), text))
    _add_categories(flow, theme)
    return widget


def category_legend(theme: Theme) -> QWidget:
    """What explains the polar maps."""
    widget = QWidget()
    flow = FlowLayout(widget)
    _add_categories(flow, theme)
    for sign, colour, text in (
        ("disc", theme.measured, "measured, no prediction yet"),
        ("ring", theme.quiet_text, "not measured yet"),
        ("frame", theme.poor, "could not be measured"),
    ):
        label = QLabel()
        label.setPixmap(marks.pixmap(sign, colour, 14))
        flow.addWidget(_entry(label, text))
    return widget


def _add_categories(flow: FlowLayout, theme: Theme) -> None:
    for category in CATEGORIES:
        sign = QLabel()
        sign.setPixmap(marks.pixmap(marks.CATEGORY_SIGN[category], getattr(theme, category), 14))
        flow.addWidget(_entry(sign, category))


def _entry(sign: QWidget, text: str) -> QWidget:
    entry = QWidget()
    row = QHBoxLayout(entry)
    row.setContentsMargins(0, 0, 0, 0)
    row.setSpacing(4)
    entry.setFixedHeight(_HEIGHT)
    row.addWidget(sign)
    row.addWidget(quiet(text))
    return entry
