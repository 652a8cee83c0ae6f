"""The azimuth planes of the plan: how far each is and how its points agree."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QAbstractTableModel, QItemSelectionModel, QModelIndex, QPersistentModelIndex, Qt
from PySide6.QtGui import QFont
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableView, QWidget

from gui import marks, words
from gui.model import Changes, ScanModel
from gui.panels.base import Panel
from gui.points import PlaneKey
from gui.scores import CATEGORIES
from gui.theme import Theme

_Index = QModelIndex | QPersistentModelIndex
_ANGLES = ("Illum.\nzenith", "Sensor\nazimuth")
_MISSING = "Miss-\ning"
_CENTRE = Qt.AlignmentFlag.AlignCenter
_RIGHT = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter


class PlaneTable(QAbstractTableModel):
    """One row a plane, in the order in which they are measured."""

    def __init__(self, model: ScanModel, theme: Theme) -> None:
        super().__init__()
        self.model = model
        self._planes: list[PlaneKey] = []
        self._rows: dict[PlaneKey, int] = {}
        self._columns: list[str] = []
        self._texts: dict[tuple[int, int], str] = {}  # of cells, as long as they hold
        self._bold = QFont()
        self._bold.setBold(True)
        self._current: PlaneKey | None = None
        self.set_theme(theme)

    def set_theme(self, theme: Theme) -> None:
        """Draw signs in a theme's colours."""
        self._signs = {c: marks.icon(marks.CATEGORY_SIGN[c], getattr(theme, c)) for c in CATEGORIES}
        self._here = marks.icon("play", theme.accent)

    def reload(self) -> None:
        """Take over another plan."""
        self.beginResetModel()
        self._planes = list(self.model.planes)
        self._rows = {plane: row for row, plane in enumerate(self._planes)}
        self._texts.clear()
        self._current = self.model.current_plane
        wavelengths = len({plane.wavelength for plane in self._planes}) > 1
        self._columns = [*(["Wave-\nlength"] if wavelengths else []), *_ANGLES, "Points", _MISSING, *CATEGORIES]
        self.endResetModel()

    def update(self, planes: set[PlaneKey]) -> None:
        """Some planes have new values."""
        self._current = self.model.current_plane
        for row in sorted(self._rows[plane] for plane in planes if plane in self._rows):
            for column in range(len(self._columns)):
                self._texts.pop((row, column), None)
            self.dataChanged.emit(self.index(row, 0), self.index(row, len(self._columns) - 1))

    def plane(self, row: int) -> PlaneKey:
        """The plane of a row."""
        return self._planes[row]

    def row(self, plane: PlaneKey) -> int:
        """The row of a plane; -1 where the plan has none."""
        return self._rows.get(plane, -1)

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008 - Qt's signature
        """Number of planes."""
        return 0 if parent.isValid() else len(self._planes)

    def columnCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008 - Qt's signature
        """Number of columns."""
        return len(self._columns)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Names of the columns; the categories by their signs."""
        if orientation is not Qt.Orientation.Horizontal or section >= len(self._columns):
            return None
        name = self._columns[section]
        if name in CATEGORIES:
            if role == Qt.ItemDataRole.DecorationRole:
                return self._signs[name]
            return f"points in {name} agreement" if role == Qt.ItemDataRole.ToolTipRole else None
        return name if role == Qt.ItemDataRole.DisplayRole else None

    def data(self, index: _Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Content of a cell."""
        row, column = index.row(), index.column()
        if role == Qt.ItemDataRole.DisplayRole:
            if (row, column) not in self._texts:
                self._texts[row, column] = self._text(self._planes[row], self._columns[column])
            return self._texts[row, column]
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return _CENTRE if self._columns[column] in CATEGORIES else _RIGHT
        if role == Qt.ItemDataRole.DecorationRole:
            return self._here if column == 0 and self._planes[row] == self._current else None
        if role == Qt.ItemDataRole.FontRole:
            return self._bold if self._planes[row] == self._current else None
        if role == Qt.ItemDataRole.ToolTipRole:
            missing = self.model.plane_missing[self._planes[row]]
            return words.plane_title(self._planes[row]) + (f"; {missing} points missing" if missing else "")
        return None

    def _text(self, plane: PlaneKey, name: str) -> str:
        if name in CATEGORIES:
            return str(self.model.plane_tally[plane][name] or "")
        if name == "Points":
            measured = self.model.plane_settled[plane] - self.model.plane_missing[plane]
            return f"{measured}/{len(self.model.planes[plane])}"
        if name == _MISSING:
            return str(self.model.plane_missing[plane] or "")
        if name == _ANGLES[0]:
            return words.angle(plane.illumination_zenith)
        if name == _ANGLES[1]:
            return words.angle(plane.sensor_azimuth)
        return f"{plane.wavelength:g} nm"


class PlanesPanel(Panel):
    """Table of planes; choosing a row shows that plane."""

    area = "left"
    order = 3
    title = "Azimuth planes"
    stretch = 1

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.table = PlaneTable(model, theme)
        self.view = QTableView()
        self.view.setModel(self.table)
        self.view.setAccessibleName("Azimuth planes of the plan")
        self.view.setShowGrid(False)
        self.view.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.view.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.view.setTabKeyNavigation(False)
        self.view.verticalHeader().hide()
        self.view.verticalHeader().setDefaultSectionSize(22)
        header = self.view.horizontalHeader()
        header.setMinimumSectionSize(38)
        header.setHighlightSections(False)
        self.body.addWidget(self.view)
        self._showing = False
        self.view.selectionModel().currentRowChanged.connect(self._chosen)
        self._reload()

    def refresh(self, changes: Changes) -> None:
        """Show new counts."""
        if changes.scan:
            self._reload()
        elif changes.planes:
            self.table.update(changes.planes)

    def _reload(self) -> None:
        """Show another plan; the columns keep their widths while its numbers grow."""
        self._showing = True
        self.table.reload()
        header = self.view.horizontalHeader()
        header.resizeSections(QHeaderView.ResizeMode.ResizeToContents)
        most = max((len(indices) for indices in self.model.planes.values()), default=0)
        room = self.view.fontMetrics().horizontalAdvance(f"{most}/{most}") + 22  # bold where the arms are
        points = header.count() - len(CATEGORIES) - 2
        if points >= 0:
            header.resizeSection(points, max(room, header.sectionSize(points)))
        for column in range(header.count() - len(CATEGORIES), header.count()):
            header.resizeSection(column, header.minimumSectionSize())
        self._showing = False

    def show_plane(self, plane: PlaneKey | None) -> None:
        """Mark the plane that is shown."""
        row = self.table.row(plane) if plane is not None else -1
        if row == self.view.currentIndex().row():
            return
        self._showing = True
        flags = QItemSelectionModel.SelectionFlag.ClearAndSelect | QItemSelectionModel.SelectionFlag.Rows
        self.view.selectionModel().setCurrentIndex(self.table.index(row, 0), flags)
        self._showing = False

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.table.set_theme(theme)
        self.theme = theme
        self.table.update(set(self.model.planes))

    def _chosen(self, index: QModelIndex) -> None:
        if index.isValid() and not self._showing:
            self.plane_chosen.emit(self.table.plane(index.row()))


PANEL = PlanesPanel
