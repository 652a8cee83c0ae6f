"""What a plan measures: numbers, a polar map of its points, and the button that starts it."""

from __future__ import annotations

from typing import Any

from PySide6.QtWidgets import QComboBox, QFormLayout, QFrame, QLabel, QPushButton, QVBoxLayout

from gui import words
from gui.pages.base import card
from gui.panels.base import quiet, value
from gui.polar_map import PolarMap, Spot
from gui.theme import Theme
from instrument.plan import Plan

_LEGEND = "○ planned, in the order of the dotted line   × blocked   ✳ light. Point at one to read it."


class PlanPoints(QFrame):
    """A card beside the table of the plan."""

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        frame, body = card("What the plan measures")
        outer.addWidget(frame)
        self._plan: Plan | None = None
        self._shown: list[Any] = []
        self.facts: dict[str, QLabel] = {}
        form = QFormLayout()
        for name in ("Points", "Blocked", "Takes about", "Arms move"):
            self.facts[name] = value("–")
            self.facts[name].setWordWrap(True)
            form.addRow(quiet(name), self.facts[name])
        body.addLayout(form)
        self.choice = QComboBox()
        self.choice.setAccessibleName("Illumination that the map shows")
        self.choice.currentIndexChanged.connect(lambda _: self._show_points())
        body.addWidget(self.choice)
        self.map = PolarMap(theme)
        self.map.pointed.connect(self._pointed)
        body.addWidget(self.map, 1)
        self.readout = quiet()
        self.readout.setWordWrap(True)
        body.addWidget(self.readout)
        self._pointed(-1)
        self.start = QPushButton("Start this plan  F5")
        self.start.setProperty("role", "main")
        self.start.setMinimumHeight(40)
        body.addWidget(self.start)

    def show_plan(self, plan: Plan) -> None:
        """Show the points of a plan."""
        self._plan = plan
        points = [*plan.points, *(each.geometry for each in plan.blocked)]
        keys = dict.fromkeys((p.wavelength, p.illumination_zenith, p.illumination_azimuth) for p in points)
        before = self.choice.currentText()
        self.choice.blockSignals(True)
        self.choice.clear()
        for wavelength, zenith, azimuth in keys:
            side = f", azimuth {words.angle(azimuth)}" if azimuth else ""
            self.choice.addItem(
                f"{wavelength:g} nm, illumination zenith {words.angle(zenith)}{side}", (wavelength, zenith, azimuth)
            )
        self.choice.setCurrentIndex(max(self.choice.findText(before), 0))
        self.choice.blockSignals(False)
        self._show_points()

    def _show_points(self) -> None:
        key = self.choice.currentData()
        plan = self._plan
        if plan is None or key is None:
            return
        key = tuple(key)
        mine = [(p, "") for p in plan.points]
        mine += [(each.geometry, each.reason) for each in plan.blocked]
        self._shown = [
            (p, why) for p, why in mine if (p.wavelength, p.illumination_zenith, p.illumination_azimuth) == key
        ]
        spots = [Spot(p.sensor_zenith, p.sensor_azimuth, "blocked" if why else "planned") for p, why in self._shown]
        self.map.show_spots(spots, (key[1], key[2]), path=True)

    def _pointed(self, index: int) -> None:
        if not 0 <= index < len(self._shown):
            self.readout.setText(_LEGEND)
            return
        point, why = self._shown[index]
        text = f"sensor zenith {words.angle(point.sensor_zenith)}, azimuth {words.angle(point.sensor_azimuth)}"
        self.readout.setText(f"{text}: blocked, {why}" if why else f"{text}: number {index + 1} of this illumination")
