"""How maps, cells and the window as a whole are painted."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtCore import QCoreApplication, QEvent, QObject, QRect, QSize
from PySide6.QtGui import QColor, QImage, QPainter
from PySide6.QtWidgets import QHeaderView, QStyle, QStyleOptionViewItem, QTableWidget, QTableWidgetItem
from pytestqt.qtbot import QtBot
from window_stage import Stage, running

from gui.pages.base import RoomyRows, fill
from gui.panels.planes import Cells
from gui.polar_map import PolarMap, Spot
from gui.theme import LIGHT


class Paints(QObject):
    """Counts how often a widget is painted."""

    count = 0

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        self.count += event.type() is QEvent.Type.Paint
        return False


def test_what_asks_for_a_picture_several_times_gets_one_when_the_work_is_done(stage: Stage, qtbot: QtBot) -> None:
    window, paints = stage.window, Paints()
    centre = window.centralWidget()
    qtbot.waitUntil(lambda: not window._soon.isActive(), timeout=2000)
    centre.installEventFilter(paints)
    for _ in range(3):  # as the scenes of three plots do
        centre.update()
        QCoreApplication.sendPostedEvents(window, QEvent.Type.UpdateRequest)
    assert paints.count == 0
    window._soon.timeout.emit()
    assert paints.count == 1


def test_a_longer_text_does_not_push_the_table_of_planes_aside(stage: Stage) -> None:
    running(stage, 5)
    plots = stage.window.plots
    width = plots.minimumSizeHint().width()
    plots.heading.setText("sensor azimuth " * 30)
    plots.readout.setText("measured " * 60)
    plots.body.activate()
    assert plots.minimumSizeHint().width() == width


def cell(stage: Stage, row: int, column: int, *, selected: bool = False) -> QImage:
    """A cell of the table of planes as it is drawn, 60 by 22 pixels on white."""
    panel: Any = stage.window.panel("PlanesPanel")
    image = QImage(60, 22, QImage.Format.Format_RGB32)
    image.fill(QColor("white"))
    option = QStyleOptionViewItem()
    option.initFrom(panel.view)
    option.rect = QRect(0, 0, 60, 22)
    if selected:
        option.state |= QStyle.StateFlag.State_Selected
    painter = QPainter(image)
    Cells(panel.table).paint(painter, option, panel.table.index(row, column))
    painter.end()
    return image


def ink(image: QImage, columns: range = range(60)) -> int:
    """Pixels that are not white."""
    white = QColor("white").rgb()
    return sum(image.pixel(x, y) != white for x in columns for y in range(22))


def test_cells_say_what_the_table_says(stage: Stage) -> None:
    running(stage, 5)
    table: Any = stage.window.panel("PlanesPanel").table  # type: ignore[attr-defined]
    points, missing = 2, 3
    assert table.text(0, points).startswith("5/")
    assert ink(cell(stage, 0, points)) > ink(cell(stage, 1, points)) > 0  # bold where the arms are
    assert ink(cell(stage, 0, 0), range(20)) > 0  # with a sign in the first column
    assert ink(cell(stage, 1, 0), range(20)) == 0
    assert ink(cell(stage, 1, missing)) == 0
    assert ink(cell(stage, 1, missing, selected=True)) == 60 * 22


def test_a_table_is_measured_when_it_is_full_and_not_for_every_text(qtbot: QtBot) -> None:
    asked: list[int] = []

    class Counting(RoomyRows):
        def sizeHint(self, option: Any, index: Any) -> QSize:
            asked.append(index.row())
            return super().sizeHint(option, index)

    table = QTableWidget(0, 2)
    qtbot.addWidget(table)
    table.setItemDelegate(Counting(table))
    content = QHeaderView.ResizeMode.ResizeToContents
    table.verticalHeader().setSectionResizeMode(content)
    table.horizontalHeader().setSectionResizeMode(0, content)
    table.horizontalHeader().setSectionResizeMode(1, QHeaderView.ResizeMode.Stretch)
    table.show()

    def put() -> None:
        table.setRowCount(10)
        for row in range(10):
            for column in range(2):
                table.setItem(row, column, QTableWidgetItem("words " * row))

    fill(table, put)
    qtbot.waitUntil(lambda: bool(asked))
    asked.clear()
    fill(table, put)
    assert len(asked) <= 5 * 20  # cells; 500 where every text has its row and its column measured
    assert table.horizontalHeader().sectionResizeMode(0) == content
    assert table.horizontalHeader().sectionResizeMode(1) == QHeaderView.ResizeMode.Stretch
    assert table.columnWidth(0) > table.fontMetrics().horizontalAdvance("words " * 8)


def shown(spots: list[Spot], qtbot: QtBot) -> PolarMap:
    """A map on which spots are drawn."""
    polar = PolarMap(LIGHT)
    qtbot.addWidget(polar)
    polar.resize(360, 360)
    polar.show_spots(spots)
    polar.draw()
    return polar


def test_the_numbers_of_the_rings_are_legible_on_a_map_full_of_points(qtbot: QtBot) -> None:
    full = [Spot(float(zenith), float(azimuth), "good") for zenith in range(0, 90, 3) for azimuth in range(0, 360, 4)]
    polar = shown(full, qtbot)
    picture = polar.grab().toImage()
    at = polar.place(Spot(30.0, polar._label_azimuth, ""))
    ground = [picture.pixelColor(round(at.x()) + x, round(at.y()) + y) for x in range(-9, 10) for y in range(-4, 5)]
    light = sum(colour.lightness() > 200 for colour in ground)
    dark = sum(colour.lightness() < 100 for colour in ground)
    assert light > 0.5 * len(ground)
    assert 5 < dark < 0.5 * len(ground)


@pytest.mark.parametrize("taken", [67.5, 247.5])
def test_the_numbers_of_the_rings_stand_where_there_are_no_points(taken: float, qtbot: QtBot) -> None:
    polar = shown([Spot(float(zenith), taken, "good") for zenith in range(5, 90, 5)], qtbot)
    assert 15.0 < abs(polar._label_azimuth - taken) < 345.0


def test_signs_of_neighbours_hardly_touch(qtbot: QtBot) -> None:
    sparse = shown([Spot(float(zenith), 0.0, "good") for zenith in range(-80, 81, 20)], qtbot)
    dense = shown([Spot(float(zenith), 0.0, "good") for zenith in range(-80, 81, 4)], qtbot)
    apart = (dense.place(dense.spots[0]) - dense.place(dense.spots[1])).manhattanLength()
    assert 0.5 * apart < dense._size < 0.7 * apart
    assert sparse._size > 1.2 * dense._size
