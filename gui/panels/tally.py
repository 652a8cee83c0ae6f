"""Running tally of good, acceptable and poor points by t'."""

from __future__ import annotations

from PySide6.QtCore import QRectF, Qt
from PySide6.QtGui import QBrush, QColor, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QGridLayout, QLabel, QWidget

from gui import marks
from gui.comparison import T_BANDS
from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet, value
from gui.scores import CATEGORIES, Category
from gui.theme import Theme

_PATTERN = {
    "good": Qt.BrushStyle.SolidPattern,
    "acceptable": Qt.BrushStyle.BDiagPattern,
    "poor": Qt.BrushStyle.DiagCrossPattern,
}
_MEANING: dict[Category, str] = {
    "good": f"|t′| < {T_BANDS[0]:g}",
    "acceptable": f"{T_BANDS[0]:g} to {T_BANDS[1]:g}",
    "poor": f"> {T_BANDS[1]:g}",
}


class ShareBar(QWidget):
    """Shares of the categories in one bar, each with a pattern of its own."""

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.theme = theme
        self.counts: dict[Category, int] = dict.fromkeys(CATEGORIES, 0)
        self.setFixedHeight(14)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the bar."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        frame = QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5)
        total, left = sum(self.counts.values()), frame.left()
        for category in CATEGORIES:
            if not self.counts[category]:
                continue
            width = frame.width() * self.counts[category] / total
            part = QRectF(left, frame.top(), width, frame.height())
            painter.fillRect(part, QBrush(QColor(getattr(self.theme, category)), _PATTERN[category]))
            painter.setPen(QPen(QColor(self.theme.surface), 1))
            painter.drawLine(part.topRight(), part.bottomRight())
            left += width
        painter.setPen(QPen(QColor(self.theme.line), 1))
        painter.drawRect(frame)


class TallyPanel(Panel):
    """Counts and shares of the categories."""

    area = "left"
    order = 2
    title = "Agreement by t′ so far"

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.bar = ShareBar(theme)
        self.body.addWidget(self.bar)
        grid = QGridLayout()
        grid.setVerticalSpacing(3)
        self.signs: dict[Category, QLabel] = {}
        self.counts: dict[Category, QLabel] = {}
        self.shares: dict[Category, QLabel] = {}
        for row, category in enumerate(CATEGORIES):
            self.signs[category], self.counts[category], self.shares[category] = QLabel(), value("0"), value("–")
            for column, widget in enumerate((self.signs[category], quiet(category), quiet(_MEANING[category]))):
                grid.addWidget(widget, row, column)
            for column, label in ((3, self.counts[category]), (4, self.shares[category])):
                label.setAlignment(Qt.AlignmentFlag.AlignRight)
                grid.addWidget(label, row, column)
        grid.setColumnStretch(2, 1)
        self.body.addLayout(grid)
        self.refresh(Changes(scan=True))

    def refresh(self, changes: Changes) -> None:
        """Show the counts."""
        if not (changes.planes or changes.scan):
            return
        tally = self.model.tally
        total = sum(tally.values())
        for category in CATEGORIES:
            if changes.scan:
                self.signs[category].setPixmap(
                    marks.pixmap(marks.CATEGORY_SIGN[category], getattr(self.theme, category), 14)
                )
            self.counts[category].setText(str(tally[category]))
            self.shares[category].setText(f"{100 * tally[category] / total:.0f} %" if total else "–")
        self.bar.theme, self.bar.counts = self.theme, {category: tally[category] for category in CATEGORIES}
        self.bar.setAccessibleName(", ".join(f"{tally[category]} {category}" for category in CATEGORIES))
        self.bar.update()


PANEL = TallyPanel
