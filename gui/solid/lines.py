"""The arms, the beam and the sample drawn with lines, where no picture can be rendered.

It needs no graphics card and no OpenGL, so it works wherever a window opens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PySide6.QtCore import QPointF, Qt, QTimer
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QPixmap, QPolygonF

from gui import words
from gui.solid.geometry import SAMPLE, Camera, Stance, between
from gui.solid.turning import TurnedByHand
from gui.theme import Theme
from instrument import angles

Vector = tuple[float, float, float]

_FRAME_MS = 40
_MOVE_WALL = 0.5  # seconds in which the picture follows a move, however long the arms take
_BEAM = 0.05  # half-width of the drawn beam, arm lengths


def direction(zenith: float, azimuth: float) -> Vector:
    """Unit vector of a direction in degree (:func:`instrument.angles.direction`), as numbers."""
    x, y, z = angles.direction(zenith, azimuth).tolist()
    return x, y, z


@dataclass(frozen=True)
class Sample:
    """What lies on the stage, mm: outline, and centre and diameter of every hole."""

    outline: tuple[float, float] = (50.0, 50.0)
    holes: tuple[tuple[float, float, float], ...] = ()


def sample_of(run_dir: Path) -> Sample:
    """The artifact of a run; a plain plate where the run has none. Reads files: not for the Qt thread."""
    from instrument.artifact import read_artifact
    from instrument.errors import InputError

    try:
        artifact = read_artifact(run_dir / "artifact.toml")
    except InputError:
        return Sample()
    holes = artifact.holes
    rows = zip(holes.x.tolist(), holes.y.tolist(), holes.diameter.tolist(), strict=True)
    return Sample(artifact.form.outline, tuple(rows))


class ArmsView(TurnedByHand):
    """A picture of the instrument in a pose; drag, or use the arrow keys, to look from elsewhere."""

    def __init__(self, theme: Theme) -> None:
        super().__init__("Arms, beam and sample; arrow keys turn the view")
        self.theme = theme
        self.pose: Stance | None = None
        self._from: Stance | None = None
        self._to: Stance | None = None
        self._share = 1.0
        self._seen_from = (Camera().azimuth, Camera().height)
        self._ground: tuple[Any, QPixmap] | None = None
        self.light = False
        self.sample = Sample()
        self._clock = QTimer(self)
        self._clock.setInterval(_FRAME_MS)
        self._clock.timeout.connect(self._step)

    def go_to(self, pose: Stance | None) -> None:
        """Move the drawn arms to a pose."""
        if pose == self._to:
            return
        if pose is None or self.pose is None:
            self.pose = self._to = pose
            self.update()
            return
        self._from, self._to, self._share = self.pose, pose, 0.0
        if self.isVisible():
            self._clock.start()
        else:
            self.pose = pose

    def _step(self) -> None:
        self._share = min(self._share + _FRAME_MS / 1000 / _MOVE_WALL, 1.0)
        assert self._from is not None
        assert self._to is not None
        smooth = self._share * self._share * (3 - 2 * self._share)
        self.pose = between(self._from, self._to, smooth)
        if self._share >= 1.0 or not self.isVisible():
            self.pose = self._to
            self._clock.stop()
        self.update()

    def _project(self, point: Vector) -> QPointF:
        azimuth, height = self._seen_from
        turn_rad, height_rad = math.radians(-90.0 - azimuth), math.radians(height)
        x, y, z = point
        across = x * math.cos(turn_rad) - y * math.sin(turn_rad)
        depth = x * math.sin(turn_rad) + y * math.cos(turn_rad)
        up = z * math.cos(height_rad) + depth * math.sin(height_rad)
        scale = min(self.width() / 2.75, self.height() / 1.95)
        return QPointF(self.width() / 2 + scale * across, self.height() * 0.72 - scale * up)

    def _line(self, painter: QPainter, points: Sequence[Vector]) -> None:
        painter.drawPolyline(QPolygonF([self._project(point) for point in points]))

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.drawPixmap(0, 0, self._still())
        if self.pose is not None:
            self._draw_arms(painter, self.pose)
        painter.end()

    def _still(self) -> QPixmap:
        """What does not move, drawn once for a view."""
        turn = self.pose.sample_turn if self.pose is not None else 0.0
        key = (self.size(), self._seen_from, self.theme, self.devicePixelRatioF(), self.sample, turn)
        if self._ground is None or self._ground[0] != key:
            picture = QPixmap(self.size() * key[3])
            picture.setDevicePixelRatio(key[3])
            picture.fill(Qt.GlobalColor.transparent)
            painter = QPainter(picture)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            self._draw_ground(painter, turn)
            painter.end()
            self._ground = (key, picture)
        return self._ground[1]

    def _draw_ground(self, painter: QPainter, turn: float) -> None:
        theme = self.theme
        painter.setPen(QPen(QColor(theme.line), 1.4))
        self._line(painter, [direction(90, azimuth) for azimuth in range(0, 361, 6)])
        painter.setPen(QPen(QColor(theme.line), 0.8))
        for azimuth in range(0, 180, 30):
            self._line(painter, [direction(zenith, azimuth) for zenith in range(-90, 91, 6)])
        for zenith in (30, 60):
            self._line(painter, [direction(zenith, azimuth) for azimuth in range(0, 361, 6)])
        painter.setPen(QColor(theme.quiet_text))
        for azimuth in (0, 90, 180, 270):
            x, y, _ = direction(90, azimuth)
            at = self._project((1.12 * x, 1.12 * y, 0.0))
            painter.drawText(at - QPointF(12, -5), f"{azimuth}°")
        self._draw_sample(painter, turn)

    def _draw_sample(self, painter: QPainter, turn: float) -> None:
        """The plate with its holes, turned as the sample is."""
        theme, sample = self.theme, self.sample
        cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        scale = 2 * SAMPLE / max(sample.outline)

        def outlined(points: Sequence[tuple[float, float]]) -> None:
            turned = ((cosine * x - sine * y, sine * x + cosine * y) for x, y in points)
            painter.drawPolygon(QPolygonF([self._project((scale * x, scale * y, 0.0)) for x, y in turned]))

        painter.setPen(QPen(QColor(theme.text), 1.4))
        painter.setBrush(QColor(theme.raised))
        across, along = sample.outline[0] / 2, sample.outline[1] / 2
        outlined([(-across, -along), (across, -along), (across, along), (-across, along)])
        painter.setBrush(QColor(theme.quiet_text))
        painter.setPen(Qt.PenStyle.NoPen)
        round_about = [(math.cos(angle / 6 * math.pi), math.sin(angle / 6 * math.pi)) for angle in range(12)]
        for x, y, diameter in sample.holes:
            outlined([(x + diameter / 2 * a, y + diameter / 2 * b) for a, b in round_about])

    def _draw_arms(self, painter: QPainter, pose: Stance) -> None:
        theme, (illumination, azimuth, zenith, _) = self.theme, pose
        light, sensor = direction(illumination, 0.0), direction(zenith, azimuth)
        beam = QColor(theme.simulated)
        beam.setAlpha(110 if self.light else 40)
        side = direction(illumination + 90.0, 0.0)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(beam)
        edges = [(1, 0.5), (1, -0.5), (0, -1.0), (0, 1.0)]
        painter.drawPolygon(
            QPolygonF(
                [
                    self._project(tuple(r * a + _BEAM * w * b for a, b in zip(light, side, strict=True)))  # type: ignore[arg-type]
                    for r, w in edges
                ]
            )
        )
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(QColor(theme.measured), 1.6, Qt.PenStyle.DashLine))
        self._line(painter, [(0.0, 0.0, 0.0), sensor])
        self._arm(painter, illumination, 0.0, theme.simulated, "light", f"{words.angle(round(illumination, 1))}")
        where = f"{words.angle(round(zenith, 1))}, azimuth {words.angle(round(azimuth, 1))}"
        self._arm(painter, zenith, azimuth, theme.measured, "sensor", where)

    def _arm(self, painter: QPainter, zenith: float, azimuth: float, colour: str, name: str, text: str) -> None:
        """An arc from the ground to the head, the head, and its angles."""
        foot = 90.0 if zenith >= 0 else -90.0
        steps = 24
        reach = [foot + (zenith - foot) * step / steps for step in range(steps + 1)]
        painter.setPen(QPen(QColor(colour), 5, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        self._line(painter, [tuple(1.04 * c for c in direction(angle, azimuth)) for angle in reach])  # type: ignore[misc]
        head = self._project(tuple(1.04 * c for c in direction(zenith, azimuth)))  # type: ignore[arg-type]
        painter.setBrush(QColor(self.theme.surface))
        painter.setPen(QPen(QColor(colour), 2.4))
        if name == "light":
            painter.drawEllipse(head, 9, 9)
        else:
            painter.drawRect(round(head.x()) - 8, round(head.y()) - 8, 16, 16)
        painter.setPen(QColor(self.theme.text))
        right = head.x() < self.width() * 0.62
        label = f"{name} {text}"
        width = painter.fontMetrics().horizontalAdvance(label)
        above = 26 if name == "light" else 0  # the two labels never stand on each other
        painter.drawText(head + QPointF(16 if right else -16 - width, 5 - above), label)

    def look_from(self, azimuth: float, height: float) -> None:
        """Look from a direction, degree."""
        self._seen_from = (azimuth % 360.0, min(max(height, 4.0), 88.0))
        self.update()

    def turn(self, azimuth: float, height: float) -> None:
        """Look from a little elsewhere."""
        self.look_from(self._seen_from[0] + azimuth, self._seen_from[1] + height)
