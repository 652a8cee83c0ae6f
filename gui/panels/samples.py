"""The samples of the last reading, one by one: drift, spikes and saturation show at once."""

from __future__ import annotations

from statistics import fmean

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QWidget

from gui import words
from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet
from gui.theme import Theme


class SampleDots(QWidget):
    """Samples as dots around their mean, in per cent of it."""

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.theme = theme
        self.samples: tuple[float, ...] = ()
        self.setMinimumHeight(96)
        self.setAccessibleName("Samples of the last reading")

    def show_samples(self, samples: tuple[float, ...]) -> None:
        """Show another reading."""
        self.samples = samples
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        theme = self.theme
        area = QRectF(self.rect()).adjusted(58, 6, -8, -20)
        mean = fmean(self.samples) if self.samples else 0.0
        deviations = [100 * (value / mean - 1) for value in self.samples] if mean else []
        span = max([0.01, *(abs(value) * 1.2 for value in deviations)])
        painter.setPen(QPen(QColor(theme.line), 1))
        for share in (0.0, 0.5, 1.0):
            y = area.top() + share * area.height()
            painter.drawLine(QPointF(area.left(), y), QPointF(area.right(), y))
        painter.setPen(QColor(theme.quiet_text))
        for share, text in ((0.0, f"+{span:.2g} %"), (0.5, "mean"), (1.0, f"{words.MINUS}{span:.2g} %")):
            box = QRectF(0, area.top() + share * area.height() - 8, 54, 16)
            painter.drawText(box, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, text)
        step = area.width() / max(len(deviations), 9)
        for number, value in enumerate(deviations):
            at = QPointF(area.left() + (number + 0.5) * step, area.center().y() - value / span * area.height() / 2)
            painter.setPen(QPen(QColor(theme.measured), 1))
            painter.drawLine(QPointF(at.x(), area.center().y()), at)
            painter.setBrush(QColor(theme.measured))
            painter.drawEllipse(at, 3.4, 3.4)
            painter.setPen(QColor(theme.quiet_text))
            painter.drawText(
                QRectF(at.x() - 12, area.bottom() + 3, 24, 16), Qt.AlignmentFlag.AlignCenter, f"{number + 1}"
            )
        painter.end()


class SamplesPanel(Panel):
    """The last reading's samples."""

    area = "acquire"
    order = 2
    title = "Samples of the last reading"

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.dots = SampleDots(theme)
        self.text = quiet()
        self.body.addWidget(self.dots)
        self.body.addWidget(self.text)
        self.refresh(Changes(scan=True))

    def refresh(self, changes: Changes) -> None:
        """Show the last reading."""
        if not (changes.current or changes.scan):
            return
        last = self.model.last
        self.dots.theme = self.theme
        self.dots.show_samples(last.signal if last else ())
        mean = fmean(last.signal) if last and last.signal else 0.0
        self.text.setText(f"mean {mean:.4f} V at {words.gain(last.gain)}" if last else "No reading yet")


PANEL = SamplesPanel
