"""Graphics that pyqtgraph does not bring: a filled band between two curves."""

from __future__ import annotations

from collections.abc import Sequence

import pyqtgraph as pg
from PySide6.QtCore import QPointF, QRectF
from PySide6.QtGui import QColor, QPainter, QPicture, QPolygonF


class Band(pg.GraphicsObject):
    """The area between two curves over the same abscissae.

    A single point is drawn as a short bar, so that a band is visible from the first value on.
    """

    def __init__(self, colour: str, alpha: int) -> None:
        super().__init__()
        self._picture = QPicture()
        self._bounds = QRectF()
        self.set_colour(colour, alpha)

    def set_colour(self, colour: str, alpha: int) -> None:
        """Fill with another colour; takes effect with the next data."""
        self._brush = QColor(colour)
        self._brush.setAlpha(alpha)

    def set_data(self, x: Sequence[float], low: Sequence[float], high: Sequence[float]) -> None:
        """Draw between ``low`` and ``high`` over ascending ``x``; empty sequences draw nothing."""
        if len(x) == 1:
            x, low, high = [x[0] - 0.8, x[0] + 0.8], [low[0]] * 2, [high[0]] * 2
        edge = [QPointF(a, b) for a, b in zip(x, high, strict=True)]
        edge += [QPointF(a, b) for a, b in zip(reversed(x), reversed(low), strict=True)]
        polygon = QPolygonF(edge)
        self.prepareGeometryChange()
        self._bounds = polygon.boundingRect()
        self._picture = QPicture()
        painter = QPainter(self._picture)
        painter.setPen(pg.mkPen(None))
        painter.setBrush(self._brush)
        painter.drawPolygon(polygon)
        painter.end()
        self.update()

    def paint(self, painter: QPainter, *_: object) -> None:
        """Draw."""
        painter.drawPicture(0, 0, self._picture)

    def boundingRect(self) -> QRectF:
        """Extent of the band."""
        return self._bounds
