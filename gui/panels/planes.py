"""The azimuth planes of the plan: how far each is and how its points agree."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QAbstractTableModel, QItemSelectionModel, QModelIndex, QPersistentModelIndex, QPointF, Qt
from PySide6.QtGui import QFont, QIcon, QPainter, QPalette, QStaticText
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableView,
    QWidget,
)

from gui import marks, words
from gui.model import Changes, ScanModel
from gui.panels.base import Panel
from gui.points import PlaneKey
from gui.scores import CATEGORIES
from gui.theme import Theme

_Index = QModelIndex | QPersistentModelIndex
_ANGLES = ("Illum.\nzenith", "Sensor\nazimuth")
_MISSING = "Miss-\ning"
_MARGIN, _SIGN = 4, 16  # logical pixels beside a text; width of the sign
_READY = 1000  # texts that are kept ready to be drawn


class PlaneTable(QAbstractTableModel):
    """One row a plane, in the order in which they are measured."""

    def __init__(self, model: ScanModel, theme: Theme) -> None:
        super().__init__()
        self.model = model
        self._planes: list[PlaneKey] = []
        self._rows: dict[PlaneKey, int] = {}
        self._columns: list[str] = []
        self._texts: dict[tuple[int, int], str] = {}  # of cells, as long as they hold
        self._current = -1  # row of the plane the arms are in
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
        self._current = self._current_row()
        wavelengths = len({plane.wavelength for plane in self._planes}) > 1
        self._columns = [*(["Wave-\nlength"] if wavelengths else []), *_ANGLES, "Points", _MISSING, *CATEGORIES]
        self.endResetModel()

    def update(self, planes: set[PlaneKey]) -> None:
        """Some planes have new values."""
        self._current = self._current_row()
        for row in sorted(self._rows[plane] for plane in planes if plane in self._rows):
            for column in range(len(self._columns)):
                self._texts.pop((row, column), None)
            self.dataChanged.emit(self.index(row, 0), self.index(row, len(self._columns) - 1))

    def is_current(self, row: int) -> bool:
        """Whether the arms are in the plane of a row."""
        return row == self._current

    def text(self, row: int, column: int) -> str:
        """What a cell says."""
        text = self._texts.get((row, column))
        if text is None:
            text = self._texts[row, column] = self._text(self._planes[row], self._columns[column])
        return text

    @property
    def here(self) -> QIcon:
        """The sign of the plane the arms are in, in the first column."""
        return self._here

    def is_count(self, column: int) -> bool:
        """Whether a column counts the points of a category."""
        return column >= len(self._columns) - len(CATEGORIES)

    def plane(self, row: int) -> PlaneKey:
        """The plane of a row."""
        return self._planes[row]

    def _current_row(self) -> int:
        plane = self.model.current_plane
        return -1 if plane is None else self.row(plane)

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
        """Text of a cell and what it means; :class:`Cells` draws it."""
        row = index.row()
        if role == Qt.ItemDataRole.DisplayRole:
            return self.text(row, index.column())
        if role == Qt.ItemDataRole.ToolTipRole:
            missing = self.model.plane_missing[self._planes[row]]
            return words.plane_title(self._planes[row]) + (f"; {missing} points missing" if missing else "")
        if role == Qt.ItemDataRole.AccessibleDescriptionRole:
            return "the arms are here" if self.is_current(row) else None
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


class Cells(QStyledItemDelegate):
    """Draws the cells of a :class:`PlaneTable`.

    Qt would ask the table for seven properties of each cell and lay its text out anew: the cells took half of what the
    whole page takes to paint.
    """

    def __init__(self, table: PlaneTable) -> None:
        super().__init__(table)
        self._table = table
        self._plain, self._bold = QFont(), QFont()
        self._bold.setBold(True)
        self._ready: dict[tuple[str, bool], tuple[QStaticText, float, float]] = {}

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: _Index) -> None:
        """Draw a cell: text, bold where the arms are, with a sign in the first column."""
        table, row, column, box = self._table, index.row(), index.column(), option.rect
        here, text = table.is_current(row), table.text(row, column)
        selected = bool(option.state & QStyle.StateFlag.State_Selected)
        if selected:
            painter.fillRect(box, option.palette.brush(QPalette.ColorRole.Highlight))
        if here and column == 0:
            table.here.paint(painter, box.left() + _MARGIN, box.top(), _SIGN, box.height())
        if not text:
            return
        laid_out, wide, high = self._of(text, here)
        free = box.width() - wide
        left = box.left() + (free / 2 if table.is_count(column) else max(free - _MARGIN, 0.0))
        at = QPointF(left, box.top() + (box.height() - high) / 2)
        if not (here or selected):  # the painter comes with the font and the colour of the table
            painter.drawStaticText(at, laid_out)
            return
        ink = QPalette.ColorRole.HighlightedText if selected else QPalette.ColorRole.Text
        painter.save()
        painter.setFont(self._bold if here else option.font)
        painter.setPen(option.palette.color(ink))
        painter.drawStaticText(at, laid_out)
        painter.restore()

    def _of(self, text: str, bold: bool) -> tuple[QStaticText, float, float]:
        """A text ready to be drawn, its width and its height."""
        ready = self._ready.get((text, bold))
        if ready is None:
            if len(self._ready) >= _READY:
                self._ready.clear()
            laid_out = QStaticText(text)
            laid_out.setTextFormat(Qt.TextFormat.PlainText)
            laid_out.prepare(font=self._bold if bold else self._plain)
            ready = self._ready[text, bold] = (laid_out, laid_out.size().width(), laid_out.size().height())
        return ready


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
        self.view.setItemDelegate(Cells(self.table))
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
