"""Watch: measurement beside prediction, by plane, as polar maps, over time."""

from __future__ import annotations

from PySide6.QtWidgets import QPushButton, QTabWidget

from gui.pages.base import Desk, SplitPage, stacked

_LEAST = 340  # logical pixels that the table of planes needs


class WatchPage(SplitPage):
    """Tally and planes on the left; one tab for each way of looking on the right."""

    name = "watch"
    title = "Watch"
    sign = "eye"
    tip = "Measured and predicted values side by side, growing point by point"
    order = 50

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        for panel in desk.in_area("centre"):
            self.tabs.addTab(panel, panel.title)
        export = QPushButton("Export  Ctrl+E")
        export.setToolTip("Every point as a table and every plot as a picture, into the run folder")
        export.clicked.connect(lambda: self.asked.emit("export"))
        self.tabs.setCornerWidget(export)
        self.stand(stacked(desk.in_area("left"), _LEAST), self.tabs, sizes=(380, 880))


PAGE = WatchPage
