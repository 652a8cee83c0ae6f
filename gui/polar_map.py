"""Points of a hemisphere from above: the azimuth around, the zenith angle from the middle outwards.

Drawn once into a picture that only grows by the points that change, each stamped from a picture of its sign, so that a
map of many points costs little more than one of few.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QFont,
    QImage,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPixmap,
    QPolygonF,
    QResizeEvent,
)
from PySide6.QtWidgets import QSizePolicy, QWidget

from gui.theme import Theme

_RINGS = (30.0, 60.0, 90.0)
_SPOKES = (0, 45, 90, 135, 180, 225, 270, 315)
_MARGIN = 26
_MANY = 100  # changes beyond which all is drawn anew
_SIZES, _OF_DISTANCE = (2.4, 5.5), 0.6  # of signs: logical pixels, share of the distance of neighbours
_LABEL_AZIMUTHS = (67.5, *(7.5 + 15.0 * number for number in range(24) if number != 4))
_NEAR = 14.0  # logical pixels within which a point is pointed at


class Spot(NamedTuple):
    """One point: sensor zenith and azimuth (degree, zenith of either sign) and what is to be seen there.

    ``kind``: ``planned``, ``blocked``, ``waiting``, ``missing``, ``measured``, ``good``, ``acceptable`` or ``poor``.
    """

    zenith: float
    azimuth: float
    kind: str


class PolarMap(QWidget):
    """A map of spots.

    Parameters
    ----------
    patient
        True where somebody calls :meth:`draw` when the map is :attr:`stale`, so that of several maps one is drawn in a
        pass of the event loop; until then it shows what it has. Otherwise the map draws when it is painted.

    Signals
    -------
    pointed
        Index of the spot under the pointer; -1 for none.
    went_stale
        The map has to be drawn anew.
    """

    pointed = Signal(int)
    went_stale = Signal()

    def __init__(self, theme: Theme, title: str = "", *, patient: bool = False) -> None:
        super().__init__()
        self.theme, self.title, self.patient = theme, title, patient
        self.spots: list[Spot] = []
        self.illumination: tuple[float, float] | None = None
        self.path = False
        self.stale = True
        self._image: QImage | None = None
        self._stamps: dict[str, QPixmap] = {}
        self._places: list[tuple[float, float]] = []
        self._size, self._label_azimuth = 5.5, 67.5
        self._under = -1
        self.setMouseTracking(True)
        self.setMinimumSize(QSize(170, 170))
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(title or "Polar map of the points")

    def show_spots(
        self, spots: Sequence[Spot], illumination: tuple[float, float] | None = None, *, path: bool = False
    ) -> None:
        """Show other points.

        Parameters
        ----------
        illumination
            Zenith and azimuth of the incident light, degree.
        path
            Draw a line from point to point, in their order; blocked ones are passed over.
        """
        self.spots, self.illumination, self.path = list(spots), illumination, path
        self._under = -1
        self._expire()

    def change(self, kinds: Mapping[int, str]) -> None:
        """Show points differently, by their index; only these are drawn."""
        new = {index: kind for index, kind in kinds.items() if self.spots[index].kind != kind}
        for index, kind in new.items():
            spot = self.spots[index]
            self.spots[index] = Spot(spot.zenith, spot.azimuth, kind)
        if not new or self.stale:
            return
        if len(new) > _MANY:
            self._expire()
            return
        painter = self._painter(self._picture())
        self._stamp(painter, new, "nothing")
        for kind in dict.fromkeys(new.values()):
            self._stamp(painter, [index for index in new if new[index] == kind], kind)
        painter.end()
        self.update()

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = theme
        self._expire()

    def draw(self) -> None:
        """Draw everything anew."""
        self.stale = False
        self._stamps.clear()
        middle, radius = self._middle(), self._radius() / 90.0
        self._places = []
        for spot in self.spots:
            angle_rad, away = math.radians(spot.azimuth), radius * spot.zenith
            self._places.append((middle.x() + away * math.cos(angle_rad), middle.y() - away * math.sin(angle_rad)))
        self._size = self._size_of_spot()
        self._label_azimuth = self._free_azimuth()
        self._image = self._whole()
        self.update()

    def _expire(self) -> None:
        self.stale = True
        self.update()
        self.went_stale.emit()

    def _picture(self) -> QImage:
        """What is drawn so far."""
        if self._image is None or (self.stale and not self.patient):
            self.draw()
        assert self._image is not None
        return self._image

    def _middle(self) -> QPointF:
        return QPointF(self.width() / 2, self.height() / 2 + (8 if self.title else 0))

    def place(self, spot: Spot) -> QPointF:
        """Where a spot lies in the widget."""
        angle_rad = math.radians(spot.azimuth + (180.0 if spot.zenith < 0 else 0.0))
        radius = abs(spot.zenith) / 90.0 * self._radius()
        return self._middle() + QPointF(radius * math.cos(angle_rad), -radius * math.sin(angle_rad))

    def nearest(self, position: QPointF) -> int:
        """Index of the spot at a position; -1 where there is none."""
        best, index = _NEAR, -1
        for number, spot in enumerate(self.spots):
            offset = self.place(spot) - position
            distance = math.hypot(offset.x(), offset.y())
            if distance < best:
                best, index = distance, number
        return index

    def _radius(self) -> float:
        return max(min(self.width(), self.height() - (16 if self.title else 0)) / 2 - _MARGIN, 10.0)

    def _size_of_spot(self) -> float:
        """Half the width of a sign: neighbours in the order of the plan hardly touch."""
        apart = 1.2 * self._radius() / math.sqrt(len(self.spots) + 1) / _OF_DISTANCE
        if len(self._places) > 1:
            steps = np.hypot(*np.diff(np.array(self._places), axis=0).T)
            apart = min(apart, float(np.median(steps)))
        return max(_SIZES[0], min(_SIZES[1], _OF_DISTANCE * apart))

    def _free_azimuth(self) -> float:
        """The azimuth at which the numbers of the rings hide least."""
        places = np.array(self._places).reshape(-1, 2)
        if not len(places):
            return _LABEL_AZIMUTHS[0]
        room = []
        for azimuth in _LABEL_AZIMUTHS:
            labels = [self.place(Spot(ring, azimuth, "")) for ring in _RINGS[:2]]
            nearest = min(float(np.hypot(*(places - (at.x(), at.y())).T).min()) for at in labels)
            room.append(round(nearest))  # of two that are alike, every map takes the same
        return _LABEL_AZIMUTHS[int(np.argmax(room))]

    def _painter(self, image: QImage) -> QPainter:
        painter = QPainter(image)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        return painter

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Draw anew in another size."""
        self._expire()
        super().resizeEvent(event)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Show the picture, and which point is pointed at."""
        picture = self._picture()
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.drawImage(QPointF(0, 0), picture)
        if 0 <= self._under < len(self.spots):
            painter.setPen(QPen(QColor(self.theme.text), 1.6))
            painter.drawEllipse(self.place(self.spots[self._under]), 9, 9)
        self._name_rings(painter)
        painter.end()

    def _whole(self) -> QImage:
        ratio = self.devicePixelRatioF()
        image = QImage(
            round(self.width() * ratio), round(self.height() * ratio), QImage.Format.Format_ARGB32_Premultiplied
        )
        image.setDevicePixelRatio(ratio)
        image.fill(Qt.GlobalColor.transparent)
        painter = self._painter(image)
        self._draw_grid(painter)
        if self.path:
            painter.setPen(QPen(QColor(self.theme.quiet_text), 0.9, Qt.PenStyle.DotLine))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawPolyline(QPolygonF([self.place(spot) for spot in self.spots if spot.kind != "blocked"]))
        kinds: dict[str, list[int]] = {}
        for index, spot in enumerate(self.spots):
            kinds.setdefault(spot.kind, []).append(index)
        for kind, indices in kinds.items():
            self._stamp(painter, indices, kind)
        painter.end()
        return image

    def _stamp(self, painter: QPainter, indices: Iterable[int], kind: str) -> None:
        """Draw spots of a kind; it is drawn once into a small picture, which Qt then copies to every place."""
        half = math.ceil(2 * self._size + 2)
        if kind not in self._stamps:
            ratio = self.devicePixelRatioF()
            stamp = QPixmap(round(2 * half * ratio), round(2 * half * ratio))
            stamp.setDevicePixelRatio(ratio)
            stamp.fill(Qt.GlobalColor.transparent)
            on_stamp = QPainter(stamp)
            on_stamp.setRenderHint(QPainter.RenderHint.Antialiasing)
            self._draw(on_stamp, kind, QPointF(half, half))
            on_stamp.end()
            self._stamps[kind] = stamp
        stamp, places = self._stamps[kind], self._places
        for index in indices:
            x, y = places[index]
            painter.drawPixmap(QPointF(x - half, y - half), stamp)

    def _draw_grid(self, painter: QPainter) -> None:
        theme, middle, radius = self.theme, self.place(Spot(0.0, 0.0, "")), self._radius()
        painter.setPen(QPen(QColor(theme.line), 1))
        for ring in _RINGS:
            painter.drawEllipse(middle, radius * ring / 90, radius * ring / 90)
        painter.setFont(self._small())
        for azimuth in _SPOKES:
            end = self.place(Spot(90.0, azimuth, ""))
            painter.setPen(QPen(QColor(theme.line), 1))
            painter.drawLine(middle, end)
            outside = self.place(Spot(90.0 * (1 + 15 / radius), azimuth, ""))
            painter.setPen(QColor(theme.quiet_text))
            box = QRectF(outside.x() - 24, outside.y() - 9, 48, 18)
            painter.drawText(box, Qt.AlignmentFlag.AlignCenter, f"{azimuth}°")
        if self.title:
            painter.setPen(QColor(theme.text))
            top = max(middle.y() - radius - _MARGIN - 18, 0.0)
            painter.drawText(QRectF(0, top, self.width(), 18), Qt.AlignmentFlag.AlignCenter, self.title)
        if self.illumination is not None:
            here = self.place(Spot(*self.illumination, ""))
            painter.setPen(QPen(QColor(theme.simulated), 2))
            for turn in range(4):
                angle_rad = math.radians(45 * turn)
                arm = QPointF(9 * math.cos(angle_rad), 9 * math.sin(angle_rad))
                painter.drawLine(here - arm, here + arm)

    def _small(self) -> QFont:
        font = self.font()
        font.setPointSizeF(font.pointSizeF() * 0.82)
        return font

    def _name_rings(self, painter: QPainter) -> None:
        """The zenith angles of the rings, over the spots: on a ground of their own, where they hide least."""
        painter.setFont(self._small())
        metrics = painter.fontMetrics()
        ground = QColor(self.theme.surface)
        ground.setAlpha(225)
        for ring in _RINGS[:2]:
            text, at = f"{ring:g}°", self.place(Spot(ring, self._label_azimuth, ""))
            box = QRectF(0, 0, metrics.horizontalAdvance(text) + 4, metrics.ascent() + 2)
            box.moveCenter(at)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(ground)
            painter.drawRoundedRect(box, 3, 3)
            painter.setPen(QColor(self.theme.text))
            painter.drawText(box, Qt.AlignmentFlag.AlignCenter, text)

    def _draw(self, painter: QPainter, kind: str, at: QPointF) -> None:
        """The sign of a kind; ``nothing`` wipes what was there."""
        theme, size = self.theme, self._size
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if kind == "nothing":
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor(theme.surface))
            painter.drawEllipse(at, size + 1, size + 1)
        elif kind in ("good", "measured"):
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor(theme.good if kind == "good" else theme.measured))
            painter.drawEllipse(at, size, size)
        elif kind == "acceptable":
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor(theme.acceptable))
            corners = [QPointF(0, -1.15), QPointF(1.1, 0.85), QPointF(-1.1, 0.85)]
            painter.drawPolygon(QPolygonF([at + corner * size for corner in corners]))
        elif kind in ("poor", "blocked"):
            painter.setPen(QPen(QColor(theme.poor), max(size * 0.42, 1.4)))
            for sign in (1, -1):
                arm = QPointF(size * 0.85, sign * size * 0.85)
                painter.drawLine(at - arm, at + arm)
        elif kind == "missing":
            painter.setPen(QPen(QColor(theme.poor), 1.4))
            painter.drawRect(QRectF(at.x() - size, at.y() - size, 2 * size, 2 * size))
        else:
            planned = kind == "planned"
            painter.setPen(QPen(QColor(theme.measured if planned else theme.quiet_text), 1.4 if planned else 0.9))
            painter.drawEllipse(at, size * 0.75, size * 0.75)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Tell which point is pointed at."""
        self._point(self.nearest(event.position()))

    def _point(self, index: int) -> None:
        if index != self._under:
            self._under = index
            self.pointed.emit(index)
            self.update()
