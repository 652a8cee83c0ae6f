"""What every page is, and what pages share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from PySide6.QtCore import QByteArray, QModelIndex, QPersistentModelIndex, QSettings, QSize, Qt, Signal
from PySide6.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QScrollArea,
    QSplitter,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QVBoxLayout,
    QWidget,
)

from gui.model import Changes, ScanModel
from gui.notices import Notice
from gui.panels.base import Panel
from gui.setup import Setup
from gui.theme import Theme
from instrument.events import Event

if TYPE_CHECKING:
    from gui.guided import Guided


@dataclass
class Desk:
    """What lies before the person: the scan, what is set up, what is remembered.

    Attributes
    ----------
    feed
        Takes an event to show, from any thread; returns at once.
    guided
        Where procedures run; at most one of them at a time.
    """

    model: ScanModel
    setup: Setup
    settings: QSettings
    theme: Theme
    panels: list[Panel] = field(default_factory=list)
    feed: Callable[[Event | Notice], None] = field(default=lambda event: None)
    guided: list[Guided] = field(default_factory=list)

    def in_area(self, area: str) -> list[Panel]:
        """Panels of an area, in order."""
        return [panel for panel in self.panels if panel.area == area]

    def folder(self, key: str) -> str:
        """The folder that a file dialog opens."""
        return str(self.settings.value(f"folder/{key}", ""))

    def remember_folder(self, key: str, path: Path) -> None:
        """Open the same folder next time."""
        self.settings.setValue(f"folder/{key}", str(path.parent))


class Page(QWidget):
    """One page of the window.

    Signals
    -------
    asked
        A command to the scan (:data:`gui.panels.base.Command`).
    go
        Show the page of this name.
    told
        Something changed that other pages may show: ``plan``, ``setup``, ``run:FOLDER``.
    said
        A short line for the status bar.
    """

    asked = Signal(str)
    go = Signal(str)
    told = Signal(str)
    said = Signal(str)

    name: ClassVar[str]
    title: ClassVar[str]
    sign: ClassVar[str]
    tip: ClassVar[str] = ""
    order: ClassVar[int] = 0

    def __init__(self, desk: Desk) -> None:
        super().__init__()
        self.desk = desk
        self.setObjectName(f"page-{self.name}")

    @property
    def model(self) -> ScanModel:
        """The scan."""
        return self.desk.model

    def refresh(self, changes: Changes) -> None:
        """The scan has changed; called in the Qt thread at most about 30 times a second."""

    def hear(self, what: str) -> None:
        """Another page has told something."""

    def enter(self) -> None:
        """The page is shown now."""

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""

    def restore(self, settings: QSettings) -> None:
        """Take up the layout of last time."""

    def remember(self, settings: QSettings) -> None:
        """Keep the layout for next time."""


class SplitPage(Page):
    """A page of two parts, whose widths are remembered."""

    def stand(self, left: QWidget, *right: QWidget, sizes: tuple[int, int]) -> None:
        """Put the parts beside each other, with these widths (logical pixels) at first."""
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        self.split = QSplitter(Qt.Orientation.Horizontal)
        self.split.setHandleWidth(8)
        self.split.setChildrenCollapsible(False)
        for widget in (left, *right):
            self.split.addWidget(widget)
        self.split.setStretchFactor(1, 1)
        self.split.setSizes(list(sizes))
        row.addWidget(self.split)

    def restore(self, settings: QSettings) -> None:
        """Take up the layout of last time."""
        value = settings.value(f"{self.name}/split")
        if isinstance(value, QByteArray):
            self.split.restoreState(value)

    def remember(self, settings: QSettings) -> None:
        """Keep the layout for next time."""
        settings.setValue(f"{self.name}/split", self.split.saveState())


def stacked(panels: Sequence[Panel], width: int = 0) -> QWidget:
    """Panels one above the other, at least so wide; what is left of the height goes to those that stretch."""
    widget = QWidget()
    widget.setMinimumWidth(width)
    stack = QVBoxLayout(widget)
    stack.setContentsMargins(0, 0, 0, 0)
    stack.setSpacing(8)
    for panel in panels:
        stack.addWidget(panel, panel.stretch)
    if not any(panel.stretch for panel in panels):
        stack.addStretch(1)
    return widget


class RoomyRows(QStyledItemDelegate):
    """Rows with air between them, where texts take several lines."""

    def sizeHint(self, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex) -> QSize:
        """Eight logical pixels more than the text takes."""
        return super().sizeHint(option, index) + QSize(0, 8)


def fill(table: QTableWidget, put: Callable[[], None]) -> None:
    """Put texts into a table whose rows and columns fit them, and measure these once, not anew for every text."""
    rows, columns = table.verticalHeader(), table.horizontalHeader()
    modes = [columns.sectionResizeMode(column) for column in range(columns.count())]
    for header in (rows, columns):
        header.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
    put()
    for column, mode in enumerate(modes):
        columns.setSectionResizeMode(column, mode)
    rows.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)


def card(title: str = "", margins: int = 12) -> tuple[QFrame, QVBoxLayout]:
    """A card and the layout of its body."""
    frame = QFrame()
    frame.setObjectName("card")
    body = QVBoxLayout(frame)
    body.setContentsMargins(margins, margins - 2, margins, margins - 2)
    body.setSpacing(6)
    if title:
        label = QLabel(title)
        label.setObjectName("cardTitle")
        body.addWidget(label)
    return frame, body


def scrolled(widget: QWidget) -> QScrollArea:
    """A widget that scrolls where there is no room for it."""
    area = QScrollArea()
    area.setWidget(widget)
    area.setWidgetResizable(True)
    area.setFrameShape(QFrame.Shape.NoFrame)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
    return area


def explained(error: Exception) -> str:
    """An exception as a line with what to do."""
    from gui.control import explain

    text, advice = explain(error)
    return f"{text}\n{advice}" if advice else text
