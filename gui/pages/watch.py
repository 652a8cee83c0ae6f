"""Watch: measurement beside prediction, by plane, as polar maps, over time."""

from __future__ import annotations

from PySide6.QtCore import QByteArray, QSettings, Qt
from PySide6.QtWidgets import QHBoxLayout, QPushButton, QSplitter, QTabWidget, QVBoxLayout, QWidget

from gui.pages.base import Desk, Page


class WatchPage(Page):
    """Tally and planes on the left; one tab for each way of looking on the right."""

    name = "watch"
    title = "Watch"
    sign = "eye"
    tip = "Measured and predicted values side by side, growing point by point"
    order = 50

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        left = QWidget()
        stack = QVBoxLayout(left)
        stack.setContentsMargins(0, 0, 0, 0)
        stack.setSpacing(8)
        for panel in desk.in_area("left"):
            stack.addWidget(panel, panel.stretch)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        for panel in desk.in_area("centre"):
            self.tabs.addTab(panel, panel.title)
        export = QPushButton("Export  Ctrl+E")
        export.setToolTip("Every point as a table and every plot as a picture, into the run folder")
        export.clicked.connect(lambda: self.asked.emit("export"))
        self.tabs.setCornerWidget(export)
        self.across = QSplitter(Qt.Orientation.Horizontal)
        self.across.setHandleWidth(8)
        self.across.setChildrenCollapsible(False)
        self.across.addWidget(left)
        self.across.addWidget(self.tabs)
        self.across.setStretchFactor(1, 1)
        self.across.setSizes([380, 880])
        row.addWidget(self.across)

    def restore(self, settings: QSettings) -> None:
        """Take up the layout of last time."""
        value = settings.value("across")
        if isinstance(value, QByteArray):
            self.across.restoreState(value)

    def remember(self, settings: QSettings) -> None:
        """Keep the layout for next time."""
        settings.setValue("across", self.across.saveState())


PAGE = WatchPage
