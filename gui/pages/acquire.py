"""Acquisition: how far the scan is, where the arms are, and what the last reading said."""

from __future__ import annotations

from PySide6.QtCore import QByteArray, QSettings, Qt
from PySide6.QtWidgets import QHBoxLayout, QSplitter, QVBoxLayout, QWidget

from gui.pages.base import Desk, Page, scrolled


class AcquirePage(Page):
    """Progress, reading and geometry on the left, the instrument on the right."""

    name = "acquire"
    title = "Acquire"
    sign = "play"
    tip = "Start and steer the scan; the last reading and where the arms are"
    order = 40

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        left = QWidget()
        stack = QVBoxLayout(left)
        stack.setContentsMargins(0, 0, 0, 0)
        stack.setSpacing(8)
        for panel in desk.in_area("acquire"):
            stack.addWidget(panel, panel.stretch)
        if not any(panel.stretch for panel in desk.in_area("acquire")):
            stack.addStretch(1)
        self.split = QSplitter(Qt.Orientation.Horizontal)
        self.split.setHandleWidth(8)
        self.split.addWidget(scrolled(left))
        for panel in desk.in_area("acquire-right"):
            self.split.addWidget(panel)
        self.split.setStretchFactor(1, 1)
        self.split.setSizes([430, 900])
        row.addWidget(self.split)

    def restore(self, settings: QSettings) -> None:
        """Take up the layout of last time."""
        value = settings.value("acquire/split")
        if isinstance(value, QByteArray):
            self.split.restoreState(value)

    def remember(self, settings: QSettings) -> None:
        """Keep the layout for next time."""
        settings.setValue("acquire/split", self.split.saveState())


PAGE = AcquirePage
