"""Polar maps of the three metrics, coloured and shaped by category (the paper's Fig. 15)."""

from __future__ import annotations

from PySide6.QtWidgets import QCheckBox, QComboBox, QHBoxLayout, QLabel, QWidget

from gui import words
from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet
from gui.panels.legend import category_legend
from gui.points import PlaneKey
from gui.polar_map import PolarMap, Spot
from gui.theme import Theme

#: Titles of the maps, and the category that each shows (:meth:`gui.points.Points.standing`).
_METRICS = {
    "Relative difference": "difference_category",
    "t′": "category",
    "Level of agreement n′": "level_category",
}
_HINT = "Point at a value to read it. The star is where the light comes from."


class PolarPanel(Panel):
    """Three maps of the points that share wavelength and illumination."""

    area = "centre"
    order = 10
    title = "Polar maps"
    lazy = True

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        row = QHBoxLayout()
        self.choice = QComboBox()
        self.choice.setAccessibleName("Illumination that the maps show")
        self.choice.currentIndexChanged.connect(self._chosen)
        self.follow = QCheckBox("Follow the scan")
        self.follow.setChecked(True)
        row.addWidget(QLabel("Illumination"))
        row.addWidget(self.choice, 1)
        row.addWidget(self.follow)
        self.body.addLayout(row)
        self.legend = category_legend(theme)
        self.body.addWidget(self.legend)
        maps = QHBoxLayout()
        self.maps = {name: PolarMap(theme, name, patient=True) for name in _METRICS}
        for each in self.maps.values():
            each.pointed.connect(self._pointed)
            each.went_stale.connect(self.fell_behind)
            maps.addWidget(each, 1)
        self.body.addLayout(maps, 1)
        self.readout = quiet(_HINT)
        self.readout.setWordWrap(True)
        self.body.addWidget(self.readout)
        self._groups: dict[tuple[float, float, float], list[int]] = {}
        self._places: dict[int, int] = {}
        self._members: list[int] = []
        self._light: tuple[float, float] | None = None
        self._others: list[str] = []  # maps that still show other points
        self._filling = False
        self.refresh(Changes(scan=True))

    @property
    def owing(self) -> bool:
        """Whether there is something left to show."""
        return super().owing or bool(self._others) or any(each.stale for each in self.maps.values())

    def catch_up(self) -> None:
        """Take over what has changed; draw one map that needs it."""
        if super().owing:
            super().catch_up()
            return
        if self._others:
            self._fill(self._others.pop(0))
            return
        for each in [each for each in self.maps.values() if each.stale][:1]:
            each.draw()

    def refresh(self, changes: Changes) -> None:
        """Show new points."""
        if changes.scan:
            self._regroup()
            return
        if changes.current and self.follow.isChecked() and self.model.current is not None:
            index = self._here()
            if index != self.choice.currentIndex():
                self.choice.setCurrentIndex(index)
                return
        shown = [(place, index) for index in changes.points if (place := self._places.get(index)) is not None]
        if shown:
            for name, each in self.maps.items():
                if name not in self._others:
                    each.change({place: self._kind(index, name) for place, index in shown})

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = theme
        for each in self.maps.values():
            each.set_theme(theme)
        legend = category_legend(theme)
        self.body.replaceWidget(self.legend, legend)
        self.legend.setParent(None)
        self.legend = legend

    def _regroup(self) -> None:
        self._groups = {}
        for plane, indices in self.model.planes.items():
            self._groups.setdefault(plane[:3], []).extend(indices)
        self._filling = True
        self.choice.clear()
        for wavelength, zenith, azimuth in self._groups:
            side = f", azimuth {words.angle(azimuth)}" if azimuth else ""
            self.choice.addItem(f"{wavelength:g} nm, illumination zenith {words.angle(zenith)}{side}")
        if self.follow.isChecked() and self.model.current is not None:
            self.choice.setCurrentIndex(self._here())
        self._filling = False
        self._show()

    def _here(self) -> int:
        """The place in the list of the illumination that the arms are in."""
        plane = self.model.current_plane
        return -1 if plane is None else list(self._groups).index(plane[:3])

    def _chosen(self) -> None:
        if not self._filling:
            self._show()

    def show_plane(self, plane: PlaneKey | None) -> None:
        """Show the illumination of a plane."""
        if plane is None:
            return
        for index, key in enumerate(self._groups):
            if key == plane[:3] and self.choice.currentIndex() != index:
                self.choice.setCurrentIndex(index)

    def _show(self) -> None:
        """Other points are to be shown: one map takes them over in a pass of the event loop."""
        index = self.choice.currentIndex()
        keys = list(self._groups)
        self._members = self._groups[keys[index]] if 0 <= index < len(keys) else []
        self._places = {point: place for place, point in enumerate(self._members)}
        self._light = (keys[index][1], keys[index][2]) if self._members else None
        self._others = list(self.maps)
        self.fell_behind.emit()

    def _fill(self, name: str) -> None:
        geometries = self.model.points.geometries
        spots = [
            Spot(geometries[index].sensor_zenith, geometries[index].sensor_azimuth, self._kind(index, name))
            for index in self._members
        ]
        self.maps[name].show_spots(spots, self._light)
        self.maps[name].draw()

    def _kind(self, index: int, name: str) -> str:
        return self.model.points.standing(index, _METRICS[name])

    def _pointed(self, place: int) -> None:
        index = next((i for i, p in self._places.items() if p == place), None)
        if index is None:
            self.readout.setText(_HINT)
            return
        point = self.model.points[index]
        azimuth = f"sensor azimuth {words.angle(point.geometry.sensor_azimuth)}   "
        self.readout.setText(azimuth + words.point_values(point))


PANEL = PolarPanel
