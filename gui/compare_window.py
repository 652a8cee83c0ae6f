"""Two runs side by side: the first drawn as measured, the second in the place of the simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSplitter, QTabWidget, QVBoxLayout, QWidget

from gui.comparison import score
from gui.model import ScanModel
from gui.pages.base import Desk
from gui.panels.planes import PlanesPanel
from gui.panels.plots import PlotsPanel
from gui.panels.polar import PolarPanel
from gui.panels.tally import TallyPanel


class CompareWindow(QWidget):
    """A window of its own on two runs.

    Parameters
    ----------
    events
        Of :func:`gui.replay.compared_events`.
    one, other
        What the runs are called.
    """

    def __init__(self, desk: Desk, events: Sequence[Any], one: str, other: str, parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle(f"{one} – {other} – goniotwin")
        self.model = ScanModel(score)
        for event in events:
            self.model.apply(event)
        self.model.take_changes()
        column = QVBoxLayout(self)
        heading = QLabel(f"Drawn as measured: {one}.   Drawn as simulated: {other}.")
        heading.setWordWrap(True)
        column.addWidget(heading)
        self.tally, self.planes = TallyPanel(self.model, desk.theme), PlanesPanel(self.model, desk.theme)
        self.plots, self.polar = PlotsPanel(self.model, desk.theme), PolarPanel(self.model, desk.theme)
        left = QWidget()
        stack = QVBoxLayout(left)
        stack.setContentsMargins(0, 0, 0, 0)
        stack.addWidget(self.tally)
        stack.addWidget(self.planes, 1)
        tabs = QTabWidget()
        tabs.setDocumentMode(True)
        tabs.addTab(self.plots, self.plots.title)
        tabs.addTab(self.polar, self.polar.title)
        split = QSplitter(Qt.Orientation.Horizontal)
        split.addWidget(left)
        split.addWidget(tabs)
        split.setSizes([380, 800])
        row = QHBoxLayout()
        row.addWidget(split)
        column.addLayout(row, 1)
        self.planes.plane_chosen.connect(self.plots.show_plane)
        self.plots.follow.hide()
        if self.model.planes:
            first = next(iter(self.model.planes))
            self.plots.show_plane(first)
            self.planes.show_plane(first)
        QShortcut(QKeySequence("Esc"), self, lambda: self.close())  # noqa: PLW0108 - it returns something
        self.resize(1180, 780)
