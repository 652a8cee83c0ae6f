"""Axes and grids that cost little: one level of ticks, painted again only when the range changes."""

from __future__ import annotations

import math
from typing import Any

import pyqtgraph as pg
from PySide6.QtCore import QLineF, QRectF
from PySide6.QtGui import QColor, QPainter
from PySide6.QtWidgets import QGraphicsItem, QGraphicsScene

from gui.words import MINUS

_APART = {"left": 34.0, "bottom": 64.0}  # pixels between two numbers, at least
_GRID_ALPHA = 40
_TICK = 4


def step(extent: float, length: float, apart: float) -> float:
    """Least of 1, 2 and 5 times a power of ten that keeps ticks so far apart.

    Parameters
    ----------
    extent
        What is shown, in the units of the axis; positive.
    length, apart
        Length of the axis and least distance of two ticks, pixels.
    """
    least = extent * min(apart / length, 0.5)
    power = 10.0 ** math.floor(math.log10(least))
    return power * next(digit for digit in (1.0, 2.0, 5.0, 10.0) if digit * power >= least * (1 - 1e-9))


class SteadyAxis(pg.AxisItem):
    """An axis with few ticks; Qt keeps its picture until the range changes."""

    def __init__(self, orientation: str) -> None:
        super().__init__(orientation)
        self.enableAutoSIPrefix(False)
        self.setStyle(tickLength=-_TICK)
        self.setCacheMode(QGraphicsItem.CacheMode.DeviceCoordinateCache)

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """One level of ticks: their distance and where they are (pyqtgraph's name and arguments)."""
        low, high = sorted((minVal, maxVal))
        if not (high > low and size > 0):
            return []
        apart = step(high - low, size, _APART[self.orientation])
        return [(apart, [apart * number for number in range(math.ceil(low / apart), math.floor(high / apart) + 1)])]

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        """Numbers with a minus sign that is one (pyqtgraph's name and arguments)."""
        strings: list[str] = super().tickStrings(values, scale, spacing)
        return [text.replace("-", MINUS) for text in strings]

    def places(self, length: float) -> list[float]:
        """Where the ticks are, over a length in pixels."""
        low, high = self.range
        return [value for _, values in self.tickValues(low, high, length) for value in values]


class Grid(pg.GraphicsObject):
    """Thin lines at the ticks of a plot's two axes."""

    def __init__(self, plot: Any) -> None:
        super().__init__()
        self._plot = plot
        self._pen = pg.mkPen(None)
        self.setZValue(-50)
        plot.addItem(self, ignoreBounds=True)

    def set_colour(self, colour: str) -> None:
        """Draw in another colour."""
        ink = QColor(colour)
        ink.setAlpha(_GRID_ALPHA)
        self._pen = pg.mkPen(ink)
        self.update()

    def viewTransformChanged(self) -> None:
        """The plot shows another range (pyqtgraph's name)."""
        self.prepareGeometryChange()

    def boundingRect(self) -> QRectF:
        """All that the plot shows."""
        shown: QRectF = self._plot.getViewBox().viewRect()
        return shown

    def paint(self, painter: QPainter, *_: object) -> None:
        """Draw."""
        shown, box = self.boundingRect(), self._plot.getViewBox()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        painter.setPen(self._pen)
        across = self._plot.getAxis("bottom").places(box.width())
        along = self._plot.getAxis("left").places(box.height())
        painter.drawLines([QLineF(x, shown.top(), x, shown.bottom()) for x in across])
        painter.drawLines([QLineF(shown.left(), y, shown.right(), y) for y in along])


def add_plot(graphics: Any, row: int) -> Any:
    """A plot in a row of a ``GraphicsLayoutWidget``, with steady axes."""
    plot = graphics.addPlot(row=row, col=0, axisItems={side: SteadyAxis(side) for side in ("left", "bottom")})
    graphics.scene().setItemIndexMethod(QGraphicsScene.ItemIndexMethod.NoIndex)  # few items, all of which move
    plot.setMenuEnabled(False)
    plot.hideButtons()
    plot.getAxis("left").setWidth(72)
    return plot


def style_axes(plot: Any, line: str, text: str, font: Any) -> None:
    """Colours and font of a plot's axes."""
    for side in ("left", "bottom"):
        axis = plot.getAxis(side)
        axis.setPen(pg.mkPen(line))
        axis.setTextPen(text)
        axis.setStyle(tickFont=font, autoExpandTextSpace=False)
