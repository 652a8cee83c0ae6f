"""A table of runs that costs the same for ten runs and for ten thousand: only what is seen is drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QPersistentModelIndex, Qt, Signal
from PySide6.QtGui import QIcon
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableView

from gui import marks
from gui.past_runs import PastRun
from gui.theme import Theme

#: Sign and tone of a state.
STATES = {
    "finished": ("check", "good"),
    "running": ("play", "busy"),
    "aborted": ("square", "quiet"),
    "interrupted": ("pause", "hold"),
    "halted": ("cross", "bad"),
    "faulted": ("warning", "bad"),
}
_UNKNOWN = ("warning", "bad")
_HEADS = ("Started (UTC)", "Title", "Points", "State", "Operator", "Sample", "Difference", "Diagnosis", "Folder")
_TIPS = {6: "Run against prediction: root mean square of the relative difference", 7: "What the diagnosis said"}
_WIDEST = ("2026-11-22 00:00 ", "", "10000 of 10000", "interrupted__", "A. B. Operator", "artifact no. 12", "100.0 % ")
_STATE = 3
Index = QModelIndex | QPersistentModelIndex
_NOWHERE = QModelIndex()


def _points(run: PastRun) -> str:
    return "" if run.row.outcome == "damaged" else f"{run.row.measured} of {run.row.planned}"


def _state(run: PastRun) -> str:
    return "cannot be read" if run.row.outcome == "damaged" else run.row.outcome


def _difference(run: PastRun) -> str:
    return "" if run.row.relative_rmse is None else f"{100 * run.row.relative_rmse:.2g} %"


#: What the columns say of a run.
_CELLS: tuple[Callable[[PastRun], str], ...] = (
    lambda run: run.started,
    lambda run: run.name,
    _points,
    _state,
    lambda run: run.row.operator,
    lambda run: run.row.sample,
    _difference,
    lambda run: run.row.verdict,
    lambda run: run.row.name,
)
#: What a column is sorted by where that is not its text; unknown numbers come first.
_KEYS: dict[int, Callable[[PastRun], Any]] = {
    0: lambda run: run.row.created,
    2: lambda run: run.row.measured,
    6: lambda run: -1.0 if run.row.relative_rmse is None else run.row.relative_rmse,
}


class _Rows(QAbstractTableModel):
    def __init__(self, theme: Callable[[], Theme]) -> None:
        super().__init__()
        self.runs: list[PastRun] = []
        self._theme = theme
        self._order = (0, Qt.SortOrder.DescendingOrder)
        self._icons: dict[tuple[str, str], QIcon] = {}

    def put(self, runs: Sequence[PastRun]) -> None:
        self.beginResetModel()
        self.runs = list(runs)
        self._sort()
        self.endResetModel()

    def rowCount(self, parent: Index = _NOWHERE) -> int:
        return 0 if parent.isValid() else len(self.runs)

    def columnCount(self, parent: Index = _NOWHERE) -> int:
        return 0 if parent.isValid() else len(_HEADS)

    def headerData(
        self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole
    ) -> str | None:
        if orientation is not Qt.Orientation.Horizontal:
            return None
        if role == Qt.ItemDataRole.ToolTipRole:
            return _TIPS.get(section)
        return _HEADS[section] if role == Qt.ItemDataRole.DisplayRole else None

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        run, column = self.runs[index.row()], index.column()
        if role == Qt.ItemDataRole.DisplayRole:
            return _CELLS[column](run)
        if role == Qt.ItemDataRole.ToolTipRole:
            return run.row.problem or str(run.folder)
        if role == Qt.ItemDataRole.DecorationRole and column == _STATE:
            sign, tone = STATES.get(run.row.outcome, _UNKNOWN)
            colour = self._theme().tone(tone)
            if (sign, colour) not in self._icons:
                self._icons[sign, colour] = marks.icon(sign, colour)
            return self._icons[sign, colour]
        return None

    def sort(self, column: int, order: Qt.SortOrder = Qt.SortOrder.AscendingOrder) -> None:
        self._order = (column, order)
        self.layoutAboutToBeChanged.emit()
        self._sort()
        self.layoutChanged.emit()

    def _sort(self) -> None:
        column, order = self._order
        key = _KEYS.get(column) or (lambda run: _CELLS[column](run).lower())
        self.runs.sort(key=key, reverse=order is Qt.SortOrder.DescendingOrder)


class RunTable(QTableView):
    """Runs, newest first until a head is pressed.

    Signals
    -------
    chosen
        Other rows are selected.
    opened
        A row is to be opened.
    """

    chosen = Signal()
    opened = Signal()

    def __init__(self, theme: Callable[[], Theme]) -> None:
        super().__init__()
        self._rows = _Rows(theme)
        self.setModel(self._rows)
        self.setAccessibleName("Runs, newest first")
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setTabKeyNavigation(False)
        self.setShowGrid(False)
        self.setWordWrap(False)
        self.verticalHeader().hide()
        self.verticalHeader().setSectionResizeMode(
            QHeaderView.ResizeMode.Fixed
        )  # rows that nobody sees are not measured
        self.setSortingEnabled(True)
        head = self.horizontalHeader()
        head.setSortIndicator(0, Qt.SortOrder.DescendingOrder)
        head.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft)
        metrics = self.fontMetrics()
        for column, text in enumerate(_WIDEST):
            if text:
                self.setColumnWidth(column, 16 + max(map(metrics.horizontalAdvance, (text, f"{_HEADS[column]} ▾"))))
        head.setSectionResizeMode(1, QHeaderView.ResizeMode.Stretch)
        self.selectionModel().selectionChanged.connect(lambda *_: self.chosen.emit())
        self.activated.connect(lambda _: self.opened.emit())

    def put(self, runs: Sequence[PastRun]) -> None:
        """Show these; those that were selected stay so, or the first one is."""
        before = {run.row.name for run in self.selected()}
        self._rows.put(runs)
        rows = [row for row, run in enumerate(self._rows.runs) if run.row.name in before]
        for row in rows or range(min(len(runs), 1)):
            self.selectRow(row)
        self.chosen.emit()

    @property
    def runs(self) -> list[PastRun]:
        """As they stand in the table."""
        return self._rows.runs

    def rowCount(self) -> int:
        """How many there are."""
        return len(self._rows.runs)

    def selected(self) -> list[PastRun]:
        """The selected runs, from above."""
        return [self._rows.runs[index.row()] for index in sorted(self.selectionModel().selectedRows())]
