"""Shows the pictures of the process that renders, and asks for new ones: when something has moved, and is seen."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

from PySide6.QtCore import QPointF, QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QImage, QKeyEvent, QPainter, QPaintEvent, QResizeEvent, QShowEvent, QWheelEvent
from PySide6.QtWidgets import QWidget

from gui import words
from gui.solid.geometry import SEEN, SURFACES, Camera, Stance, between
from gui.solid.renderer import Renderer
from gui.solid.turning import TurnedByHand
from gui.theme import Theme

_EVERY_MS = 100  # between two pictures, at least
_SHARE, _LONGEST_WALL = 2.0, 1.0  # of the time a picture took, the next one waits; at most so long
_SMOOTH_WALL = 0.55  # seconds from one report of the axes to the next
_STILL_WALL, _QUICK_WALL = 0.4, 0.35  # a fine picture of what stands still so long, where a plain one is that quick
_SLOW_WALL, _SLOW = 3.0, 3  # so many pictures in a row that take so long are too slow to be of use
_MOST_PIXELS = 1.2e6
_ZOOMS = (0.5, 12.0)
_ZOOM_KEYS = {Qt.Key.Key_Plus: 1.25, Qt.Key.Key_Equal: 1.25, Qt.Key.Key_Minus: 0.8}


class SolidView(TurnedByHand):
    """A rendered picture of the instrument.

    Signals
    -------
    drawn
        The first picture is there.
    failed
        There will be none, and why.
    """

    drawn = Signal()
    failed = Signal(str)

    def __init__(self, theme: Theme, renderer: Renderer | None = None) -> None:
        super().__init__("Arms, beam, sample and detector; arrow keys turn, plus and minus zoom")
        self.theme = theme
        self.picture: QImage | None = None
        self.problem = ""
        self.target: Stance | None = None
        self.camera = Camera()
        self._renderer = renderer or Renderer(self)
        self._renderer.pictured.connect(self._take)
        self._renderer.failed.connect(self._give_up)
        self._begun = False
        self._from: Stance | None = None
        self._left, self._changed, self._next = 0.0, 0.0, 0.0
        self._light, self._folder = False, ""
        self._asked: dict[str, Any] = {}
        self._places: dict[str, tuple[float, float]] = {}
        self._shown: Stance | None = None
        self._seconds, self._slow = 0.0, 0
        self._clock = QTimer(self)
        self._clock.setInterval(_EVERY_MS)
        self._clock.timeout.connect(self._tick)

    def begin(self) -> None:
        """Ask for pictures from now on, although this widget is not shown before the first one is there."""
        self._begun = True
        self._stir()

    @property
    def settled(self) -> bool:
        """Whether the picture shows what there is to be seen, or none will come."""
        return self._renderer.over or not self._clock.isActive()

    def go_to(self, stance: Stance | None, *, at_once: bool = False) -> None:
        """Let the axes go to where they are said to be."""
        if stance == self.target:
            return
        now = time.monotonic()
        self._from = None if at_once else self._now(now)
        self.target, self._left = stance, now
        self._stir()

    def look(self, camera: Camera) -> None:
        """Look from elsewhere."""
        self.camera = camera
        self._stir()

    def set_light(self, on: bool) -> None:
        """Whether light falls on the sample."""
        if on != self._light:
            self._light = on
            self._stir()

    def set_folder(self, folder: Path) -> None:
        """Show the sample of a run."""
        self._folder = str(folder)
        self._stir()

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = theme
        self._stir()
        self.update()

    def _now(self, now: float) -> Stance | None:
        """Between the last two reports."""
        if self.target is None or self._from is None:
            return self.target
        share = (now - self._left) / _SMOOTH_WALL
        return self.target if share >= 1.0 else between(self._from, self.target, share)

    # Asking

    def _stir(self) -> None:
        self._changed = time.monotonic()
        if self._begun and not self._renderer.over and not self._clock.isActive():
            self._clock.start()

    def _seen(self) -> bool:
        """Whether the picture is looked at; before the first one, whether its place is."""
        return self._place().isVisible() and not self.window().isMinimized()

    def _place(self) -> QWidget:
        return self if self.picture is not None else self.parentWidget() or self

    def _tick(self) -> None:
        now = time.monotonic()
        if not self._seen():
            self._clock.stop()
            return
        if self._renderer.waiting or now < self._next:
            return
        stance = self._now(now)
        fine = stance == self.target and now - self._changed > _STILL_WALL and 0 < self._seconds < _QUICK_WALL
        request = self.request(stance, fine=fine)
        if request is None or self._asked in (request, request | {"fine": True}):
            if (stance == self.target and now - self._changed > 2 * _STILL_WALL) or request is None:
                self._clock.stop()
        elif self._renderer.ask(request):
            self._asked = request

    def request(self, stance: Stance | None, *, fine: bool = False) -> dict[str, Any] | None:
        """What is to be drawn now (:mod:`gui.solid.process`); None where nothing is known of the instrument."""
        if stance is None:
            return None
        size = self._place().size()
        width, height = (each * self.devicePixelRatioF() for each in (size.width(), size.height()))
        less = min(1.0, math.sqrt(_MOST_PIXELS / max(width * height, 1.0)))
        theme = self.theme
        return {
            "width": max(round(less * width), 16),
            "height": max(round(less * height), 16),
            "stance": [round(angle, 3) for angle in stance],
            "camera": list(self.camera),
            "light": self._light,
            "folder": self._folder or None,
            "fine": fine,
            "theme": {
                "surface": theme.surface,
                "raised": theme.line,
                "line": theme.quiet_text,
                "quiet_text": theme.quiet_text,
                "simulated": theme.simulated,
                "measured": theme.measured,
            },
        }

    def _take(self, picture: QImage, answer: dict[str, Any]) -> None:
        first = self.picture is None
        self.picture, self._places, self.problem = picture, answer["places"], answer["problem"]
        self._shown = Stance(*self._asked["stance"])
        seconds = answer["seconds"]
        self._next = time.monotonic() + min(_SHARE * seconds, _LONGEST_WALL)
        if not self._asked["fine"] and not first:
            self._seconds = seconds
            self._slow = self._slow + 1 if seconds > _SLOW_WALL else 0
            if self._slow >= _SLOW:
                self._renderer.close()
                self._give_up(f"a picture takes {seconds:.0f} s")
                return
        self.update()
        if first:
            self._asked = {}  # how long a picture takes, the next one says: this one made everything ready
            self.drawn.emit()

    def _give_up(self, reason: str) -> None:
        self._clock.stop()
        self.picture = None
        self.failed.emit(reason)

    # Drawing

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the last picture, and the names of things over it."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        if self.picture is not None:
            painter.drawImage(QRectF(self.rect()), self.picture)
            self._name(painter)
        painter.end()

    def _name(self, painter: QPainter) -> None:
        assert self.picture is not None
        wide, high = self.width() / self.picture.width(), self.height() / self.picture.height()
        stance, theme = self._shown, self.theme
        texts = {}
        if stance is not None:
            zenith, azimuth = words.angle(round(stance.sensor_zenith, 1)), words.angle(round(stance.sensor_azimuth, 1))
            texts["light"] = f"light {words.angle(round(stance.illumination_zenith, 1))}"
            texts["sensor"] = f"sensor {zenith}, azimuth {azimuth}"
        for name, (x, y) in self._places.items():
            at = QPointF(x * wide, y * high)
            if name not in texts:
                self._label(painter, at, f"{name}°", theme.quiet_text, beside=False)
            elif self.camera.view != {"light": "lamp", "sensor": "detector"}[name]:
                self._label(painter, at, texts[name], theme.text, beside=True)
        self._legend(painter)

    def _legend(self, painter: QPainter) -> None:
        """What the colours of the sample mean."""
        theme, left = self.theme, 10.0
        width = sum(30 + painter.fontMetrics().horizontalAdvance(SURFACES[key][1]) for key in SEEN)
        ground = QColor(theme.surface)
        ground.setAlpha(235)
        painter.fillRect(QRectF(4.0, self.height() - 26.0, width, 23.0), ground)
        for key in SEEN:
            colour, text = SURFACES[key]
            spot = QRectF(left, self.height() - 20.0, 11.0, 11.0)
            painter.fillRect(spot, QColor(colour))
            painter.setPen(QColor(theme.quiet_text))
            painter.drawRect(spot)
            painter.drawText(QPointF(left + 16, self.height() - 10.0), text)
            left += 30 + painter.fontMetrics().horizontalAdvance(text)

    def _label(self, painter: QPainter, at: QPointF, text: str, colour: str, *, beside: bool) -> None:
        metrics = painter.fontMetrics()
        wide, high = metrics.horizontalAdvance(text), metrics.height()
        left = at.x() - wide / 2
        if beside:  # a head in the way of its own name
            left = at.x() + 26 if at.x() < 0.62 * self.width() else at.x() - 26 - wide
        box = QRectF(left - 3, at.y() - high / 2, wide + 6, high)
        if not QRectF(self.rect()).contains(box):
            return
        ground = QColor(self.theme.surface)
        ground.setAlpha(190)
        painter.fillRect(box, ground)
        painter.setPen(QColor(colour))
        painter.drawText(QPointF(left, box.bottom() - metrics.descent()), text)

    # The hand

    def showEvent(self, event: QShowEvent) -> None:
        """Catch up."""
        super().showEvent(event)
        self._stir()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """A picture of this size."""
        super().resizeEvent(event)
        self._stir()

    def wheelEvent(self, event: QWheelEvent) -> None:
        """Look from nearer or from farther away."""
        self._zoom(1.0015 ** event.angleDelta().y())

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Zoom with plus and minus, turn with the arrow keys."""
        factor = _ZOOM_KEYS.get(Qt.Key(event.key()))
        if factor is None:
            super().keyPressEvent(event)
        else:
            self._zoom(factor)

    def turn(self, azimuth: float, height: float) -> None:
        """An arm's own view is left for a free one."""
        camera = self.camera if self.camera.view == "free" else Camera()
        up = min(max(camera.height + height, -5.0), 90.0)
        self.look(camera._replace(azimuth=(camera.azimuth + azimuth) % 360.0, height=up))

    def _zoom(self, factor: float) -> None:
        least, most = _ZOOMS
        self.look(self.camera._replace(zoom=min(max(self.camera.zoom * factor, least), most)))
