"""Small drawn signs: the shapes that say in form what a colour says in hue."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QIcon, QPainter, QPainterPath, QPen, QPixmap, QPolygonF

#: Symbols of the categories, in the words of pyqtgraph and as signs of this module.
CATEGORY_SYMBOL = {"good": "o", "acceptable": "t1", "poor": "x"}
CATEGORY_SIGN = {"good": "disc", "acceptable": "triangle", "poor": "cross"}
LEVEL_SIGN = {"info": "ring", "warning": "warning", "error": "cross"}


def pixmap(sign: str, colour: str, size: int = 16, ratio: float = 2.0) -> QPixmap:
    """A sign as a picture of ``size`` logical pixels, sharp on screens up to ``ratio``."""
    image = QPixmap(round(size * ratio), round(size * ratio))
    image.setDevicePixelRatio(ratio)
    image.fill(Qt.GlobalColor.transparent)
    painter = QPainter(image)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.scale(size / 16, size / 16)
    ink = QColor(colour)
    pen = QPen(ink, 2.2, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin)
    painter.setPen(pen)
    painter.setBrush(ink)
    _DRAW[sign](painter)
    painter.end()
    return image


def icon(sign: str, colour: str, size: int = 16) -> QIcon:
    """A sign as an icon."""
    return QIcon(pixmap(sign, colour, size))


def _hollow(painter: QPainter) -> None:
    painter.setBrush(Qt.BrushStyle.NoBrush)


def _ring(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawEllipse(QRectF(3, 3, 10, 10))


def _disc(painter: QPainter) -> None:
    painter.drawEllipse(QRectF(4, 4, 8, 8))


def _triangle(painter: QPainter) -> None:
    painter.drawPolygon(QPolygonF([QPointF(8, 4), QPointF(12.5, 12), QPointF(3.5, 12)]))


def _cross(painter: QPainter) -> None:
    painter.drawLine(QPointF(4, 4), QPointF(12, 12))
    painter.drawLine(QPointF(12, 4), QPointF(4, 12))


def _square(painter: QPainter) -> None:
    painter.drawRect(QRectF(4, 4, 8, 8))


def _frame(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawRect(QRectF(4, 4, 8, 8))


def _play(painter: QPainter) -> None:
    painter.drawPolygon(QPolygonF([QPointF(5, 3.5), QPointF(12.5, 8), QPointF(5, 12.5)]))


def _pause(painter: QPainter) -> None:
    painter.setPen(Qt.PenStyle.NoPen)
    painter.drawRect(QRectF(3.5, 3, 3.5, 10))
    painter.drawRect(QRectF(9, 3, 3.5, 10))


def _check(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawPolyline(QPolygonF([QPointF(3, 8.5), QPointF(6.5, 12), QPointF(13, 4)]))


def _warning(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawPolygon(QPolygonF([QPointF(8, 2), QPointF(14.5, 13.5), QPointF(1.5, 13.5)]))
    painter.drawLine(QPointF(8, 6.5), QPointF(8, 9))
    painter.drawPoint(QPointF(8, 11.5))


def _gear(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawArc(QRectF(3, 3, 10, 10), 60 * 16, 260 * 16)
    painter.drawLine(QPointF(10.5, 3.7), QPointF(11.2, 1.2))
    painter.drawLine(QPointF(10.5, 3.7), QPointF(13.0, 4.6))


def _hand(painter: QPainter) -> None:
    path = QPainterPath()
    path.addRoundedRect(QRectF(4.5, 7.5, 8, 6.5), 2.5, 2.5)
    painter.drawPath(path)
    for x, top in ((5.0, 5.0), (7.4, 2.5), (9.8, 2.8), (12.0, 4.5)):
        painter.drawLine(QPointF(x, 9), QPointF(x, top))
    painter.drawLine(QPointF(4.5, 11), QPointF(2.2, 8.4))


def _house(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawPolyline(QPolygonF([QPointF(2, 8), QPointF(8, 2.5), QPointF(14, 8)]))
    painter.drawPolyline(QPolygonF([QPointF(4, 8), QPointF(4, 13.5), QPointF(12, 13.5), QPointF(12, 8)]))


def _arms(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawArc(QRectF(2, 3.5, 12, 19), 0, 180 * 16)
    painter.drawLine(QPointF(8, 13), QPointF(4.5, 5))
    painter.drawLine(QPointF(8, 13), QPointF(12.5, 7.5))


def _table(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawRect(QRectF(2.5, 3, 11, 10.5))
    painter.drawLine(QPointF(2.5, 6.5), QPointF(13.5, 6.5))
    painter.drawLine(QPointF(6.5, 3), QPointF(6.5, 13.5))


def _balance(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawLine(QPointF(8, 2.5), QPointF(8, 13.5))
    painter.drawLine(QPointF(3, 5), QPointF(13, 5))
    painter.drawArc(QRectF(1, 5.5, 4.5, 5), 180 * 16, 180 * 16)
    painter.drawArc(QRectF(10.5, 5.5, 4.5, 5), 180 * 16, 180 * 16)


def _eye(painter: QPainter) -> None:
    _hollow(painter)
    path = QPainterPath(QPointF(1.5, 8))
    path.quadTo(QPointF(8, 1.5), QPointF(14.5, 8))
    path.quadTo(QPointF(8, 14.5), QPointF(1.5, 8))
    painter.drawPath(path)
    painter.drawEllipse(QPointF(8, 8), 1.8, 1.8)


def _lens(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawEllipse(QRectF(2.5, 2.5, 8, 8))
    painter.drawLine(QPointF(9.5, 9.5), QPointF(14, 14))


def _folder(painter: QPainter) -> None:
    _hollow(painter)
    painter.drawPolygon(QPolygonF([QPointF(*p) for p in ((2, 4), (6.5, 4), (8, 5.8), (14, 5.8), (14, 13), (2, 13))]))


_DRAW: dict[str, Callable[[QPainter], None]] = {
    "ring": _ring,
    "disc": _disc,
    "triangle": _triangle,
    "cross": _cross,
    "square": _square,
    "frame": _frame,
    "play": _play,
    "pause": _pause,
    "check": _check,
    "warning": _warning,
    "gear": _gear,
    "hand": _hand,
    "house": _house,
    "arms": _arms,
    "table": _table,
    "balance": _balance,
    "eye": _eye,
    "lens": _lens,
    "folder": _folder,
}
