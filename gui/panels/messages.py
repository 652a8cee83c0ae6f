"""What a person should read: time, level, what happened, what to do."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QPersistentModelIndex, Qt
from PySide6.QtGui import QFont
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableView, QWidget

from gui import marks, words
from gui.model import Changes, Line, ScanModel
from gui.panels.base import Panel, quiet
from gui.theme import Theme

_COLUMNS = ("Time (UTC)", "Level", "Message", "What to do")
_WRAPPED = 12  # newest lines that are shown whole; older ones tell the rest when pointed at
_Index = QModelIndex | QPersistentModelIndex


class MessageTable(QAbstractTableModel):
    """The model's messages, newest first."""

    def __init__(self, model: ScanModel, theme: Theme) -> None:
        super().__init__()
        self.model = model
        self._lines: list[Line] = []
        self.set_theme(theme)

    def set_theme(self, theme: Theme) -> None:
        """Draw the signs of the levels in a theme's colours."""
        colours = {"info": theme.quiet_text, "warning": theme.acceptable, "error": theme.poor}
        self._icons = {level: marks.icon(marks.LEVEL_SIGN[level], colour) for level, colour in colours.items()}

    def reload(self) -> None:
        """Take over the model's messages."""
        self.beginResetModel()
        self._lines = list(reversed(self.model.messages))
        self.endResetModel()

    def line(self, row: int) -> Line:
        """The message in a row."""
        return self._lines[row]

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008 - Qt's signature
        """Number of messages."""
        return 0 if parent.isValid() else len(self._lines)

    def columnCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008 - Qt's signature
        """Number of columns."""
        return len(_COLUMNS)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Names of the columns."""
        if orientation is Qt.Orientation.Horizontal and role == Qt.ItemDataRole.DisplayRole:
            return _COLUMNS[section]
        return None

    def data(self, index: _Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Content of a cell."""
        line, column = self._lines[index.row()], index.column()
        if role in (Qt.ItemDataRole.DisplayRole, Qt.ItemDataRole.ToolTipRole):
            return (words.clock_time(line.time), line.level, line.text, line.advice)[column]
        if role == Qt.ItemDataRole.DecorationRole and column == 1:
            return self._icons[line.level]
        if role == Qt.ItemDataRole.FontRole and line.level == "error" and column == 2:
            font = QFont()
            font.setBold(True)
            return font
        return None


class MessagesPanel(Panel):
    """The list of messages."""

    area = "bottom"
    order = 0
    title = "Messages"

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.table = MessageTable(model, theme)
        self.view = QTableView()
        self.view.setModel(self.table)
        self.view.setAccessibleName("Messages, newest first")
        self.view.setShowGrid(False)
        self.view.setWordWrap(True)
        self.view.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.view.setTabKeyNavigation(False)
        self.view.verticalHeader().hide()
        header = self.view.horizontalHeader()
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        for column, width in enumerate((90, 92)):
            header.resizeSection(column, width)
        for column in (2, 3):
            header.setSectionResizeMode(column, QHeaderView.ResizeMode.Stretch)
        self.view.verticalHeader().setMinimumSectionSize(24)
        self.view.verticalHeader().setDefaultSectionSize(24)
        self.none = quiet("Nothing to report so far.")
        self.none.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.body.addWidget(self.none, 1)
        self.body.addWidget(self.view, 1)
        self.refresh(Changes(scan=True))

    def refresh(self, changes: Changes) -> None:
        """Show new messages."""
        if changes.messages or changes.scan:
            self.table.reload()
            empty = self.table.rowCount() == 0
            self.none.setVisible(empty)
            self.view.setVisible(not empty)
            for row in range(min(self.table.rowCount(), _WRAPPED)):
                self.view.resizeRowToContents(row)

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.table.set_theme(theme)
        super().set_theme(theme)


PANEL = MessagesPanel
