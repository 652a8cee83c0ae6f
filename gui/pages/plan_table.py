"""The table of a plan's parts, checked while a person types."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, Qt, Signal
from PySide6.QtGui import QBrush, QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QLineEdit,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from gui import words
from gui.plan_cells import COLUMNS, HOW, PlanDraft, cell_text, cell_value
from gui.theme import Theme

_KEYS = tuple(COLUMNS)
_EDITABLE = Qt.ItemFlag.ItemIsEditable


class _Typing(QStyledItemDelegate):
    """Tells what is typed before the cell is left."""

    typed = Signal(int, int, str, object)

    def createEditor(
        self, parent: QWidget, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> QWidget:
        """A line that reports every key."""
        editor = QLineEdit(parent)
        row, column = index.row(), index.column()
        editor.textEdited.connect(lambda text: self.typed.emit(row, column, text, editor))
        return editor


class PlanTableView(QTableWidget):
    """One row a part of the plan.

    Signals
    -------
    edited
        The draft has changed.
    complained
        What is wrong with the cell that is being typed; empty when nothing is.
    """

    edited = Signal()
    complained = Signal(str)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.theme = theme
        self.draft = PlanDraft()
        self._limits: dict[str, tuple[float, float]] = {}
        self._filling = False
        self.wrong: set[tuple[int, int]] = set()
        self.setAccessibleName("Parts of the plan; one row a grid")
        self.setColumnCount(len(_KEYS) + 1)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectItems)
        self.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.setTabKeyNavigation(False)
        self.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.setMinimumHeight(150)
        delegate = _Typing(self)
        delegate.typed.connect(self._typed)
        self.setItemDelegate(delegate)
        self.cellChanged.connect(self._changed)

    def show_draft(self, draft: PlanDraft, limits: dict[str, tuple[float, float]]) -> None:
        """Show another plan."""
        self.draft, self._limits = draft, limits
        self.wrong.clear()
        heads = []
        for key, head in COLUMNS.items():
            if key in limits:
                low, high = limits[key]
                heads.append(f"{head}\n{low:g} to {high:g}".replace("-", words.MINUS))
            else:
                heads.append(f"{head}\n200 to 3000")
        self.setHorizontalHeaderLabels([*heads, "Further keys\n(as in the file)"])
        self.fill()

    def fill(self) -> None:
        """Write every cell anew."""
        self._filling = True
        self.setRowCount(len(self.draft.parts))
        for row, part in enumerate(self.draft.parts):
            for column, key in enumerate(_KEYS):
                item = QTableWidgetItem(cell_text(part[key]) if key in part else "")
                item.setToolTip(HOW)
                if key not in part:
                    item.setFlags(item.flags() & ~_EDITABLE)
                    item.setText("from the table")
                self.setItem(row, column, item)
            item = QTableWidgetItem(self.draft.further(row))
            item.setFlags(item.flags() & ~_EDITABLE)
            item.setToolTip(self.draft.further(row))
            self.setItem(row, len(_KEYS), item)
        self._filling = False
        self._mark()

    def mark(self, row: int, key: str) -> None:
        """Mark the cell that a message means; a row of -1 marks none."""
        self.wrong = {(row, _KEYS.index(key))} if row >= 0 and key in _KEYS else set()
        self._mark()

    def _mark(self) -> None:
        self._filling = True
        for row in range(self.rowCount()):
            for column in range(len(_KEYS)):
                item = self.item(row, column)
                if item is None:
                    continue
                bad = (row, column) in self.wrong
                ground = QColor(self.theme.tone_surface["bad"]) if bad else QColor(self.theme.surface)
                item.setBackground(QBrush(ground))
                font = item.font()
                font.setBold(bad)
                font.setUnderline(bad)
                item.setFont(font)
        self._filling = False

    def _typed(self, row: int, column: int, text: str, editor: QLineEdit) -> None:
        problem = self._problem(column, text)
        editor.setProperty("wrong", bool(problem))
        editor.style().unpolish(editor)
        editor.style().polish(editor)
        self.complained.emit(f"Row {row + 1}, {_KEYS[column].replace('_', ' ')}: {problem}" if problem else "")
        if not problem:
            self.draft.parts[row][_KEYS[column]] = cell_value(text)
            self.edited.emit()

    def _changed(self, row: int, column: int) -> None:
        item = self.item(row, column)
        if self._filling or item is None or column >= len(_KEYS):
            return
        problem = self._problem(column, item.text())
        self.complained.emit(f"Row {row + 1}, {_KEYS[column].replace('_', ' ')}: {problem}" if problem else "")
        if problem:
            self.wrong.add((row, column))
            item.setToolTip(problem)
            self._mark()
            return
        self.wrong.discard((row, column))
        item.setToolTip(HOW)
        self.draft.parts[row][_KEYS[column]] = cell_value(item.text())
        self._mark()
        self.edited.emit()

    def _problem(self, column: int, text: str) -> str:
        try:
            value = cell_value(text)
        except ValueError as error:
            return str(error)
        key = _KEYS[column]
        low, high = self._limits.get(key, (200.0, 3000.0))
        unit = "nm" if key == "wavelength" else "°"
        numbers: list[Any] = [value["start"], value["stop"]] if isinstance(value, dict) else value
        beyond = [each for each in numbers if not low <= each <= high]
        if beyond:
            return f"found {beyond[0]:g} {unit}; expected {low:g} to {high:g} {unit}"
        return ""
