"""Measured and simulated BRF over sensor zenith in one azimuth plane, and t' below it (the paper's Figs. 13 and 14)."""

from __future__ import annotations

from math import hypot
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QFont
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from gui import marks, words
from gui.axes import Grid, add_plot, style_axes
from gui.comparison import T_BANDS
from gui.curves import Band
from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet
from gui.panels.legend import legend
from gui.points import PlaneKey, Point
from gui.scores import CATEGORIES
from gui.theme import Theme
from gui.traces import roomy

_DIFFERENCE, _SCORE = "Relative difference", "t′"
_T_SPAN = T_BANDS[1] * 1.75  # of the t' axis, where no point needs more
_SIZE = {"good": 9, "acceptable": 10, "poor": 12}  # of the symbols; a cross looks smaller than a disc
_HINT = "Point at a value to read it. Drag to shift, turn the wheel to zoom."
_NOTHING = "No point of this plane is measured yet."


class PlotsPanel(Panel):
    """The live plot of one plane.

    Signals
    -------
    follow_changed
        Whether the plot follows the arms from plane to plane.
    """

    area = "centre"
    order = 0
    stretch = 1
    title = "Planes"
    lazy = True
    follow_changed = Signal(bool)

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.plane: PlaneKey | None = None
        self._build_head()
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setAccessibleName("Plot of measured and simulated reflectance factor, and of t prime")
        self.body.addWidget(self.graphics, 1)
        self.readout = quiet(_HINT)
        self.readout.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.readout.setWordWrap(True)
        room = self.readout.sizePolicy()
        room.setHorizontalPolicy(QSizePolicy.Policy.Ignored)
        self.readout.setSizePolicy(room)
        self.readout.setMinimumHeight(2 * self.readout.fontMetrics().lineSpacing())
        below = QHBoxLayout()
        below.addWidget(self.readout, 1)
        below.addWidget(self.below)
        below.addWidget(self.beside)
        self.body.addLayout(below)
        self._build_plots()
        self._style()
        self._draw()

    def _build_head(self) -> None:
        row = QHBoxLayout()
        self.heading = QLabel()
        font = self.heading.font()
        font.setPointSizeF(font.pointSizeF() * 1.2)
        font.setBold(True)
        self.heading.setFont(font)
        self.heading.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)  # names differ
        self.follow = QCheckBox("&Follow the scan")
        self.follow.setChecked(True)
        self.follow.setToolTip("Show the plane the arms are in (Ctrl+F)")
        self.follow.setShortcut("Ctrl+F")
        self.follow.toggled.connect(self.follow_changed)
        fit = QPushButton("Fit view  Home")
        fit.setShortcut("Home")
        fit.setToolTip("Undo zoom and shift (Home)")
        fit.clicked.connect(self.fit)
        self.below = QComboBox()
        self.below.addItems([_DIFFERENCE, _SCORE])
        self.below.setAccessibleName("What the lower plot shows")
        self.below.setToolTip("Relative difference with bands of |t′| = 1 and 2 (shaded), or t′ itself")
        self.below.currentIndexChanged.connect(lambda _: self._below_changed())
        self.beside = QComboBox()
        self.beside.setAccessibleName("Another plane, drawn beside this one")
        self.beside.setToolTip("Draw the measured values of another plane as a dashed line")
        self.beside.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.beside.setMinimumContentsLength(16)
        self.beside.currentIndexChanged.connect(lambda _: self._draw())
        row.addWidget(self.heading, 1)
        row.addWidget(self.follow)
        row.addWidget(fit)
        self.body.addLayout(row)
        self.legend_row = QVBoxLayout()
        self.body.addLayout(self.legend_row)

    def _build_plots(self) -> None:
        self.brf_plot: Any = add_plot(self.graphics, 0)
        self.t_plot: Any = add_plot(self.graphics, 1)
        self.brf_plot.getAxis("bottom").setStyle(showValues=False)  # those of the lower plot
        self.grids = [Grid(self.brf_plot), Grid(self.t_plot)]
        layout = self.graphics.ci.layout
        layout.setRowStretchFactor(0, 3)
        layout.setRowStretchFactor(1, 2)
        layout.setVerticalSpacing(6)
        layout.setContentsMargins(0, 0, 8, 0)
        self.t_plot.setXLink(self.brf_plot)
        self.zero = pg.InfiniteLine(0, angle=0)
        self.t_plot.addItem(self.zero)
        self.t_bands = [
            pg.LinearRegionItem((-limit, limit), orientation="horizontal", movable=False) for limit in reversed(T_BANDS)
        ]
        for depth, band in enumerate(self.t_bands):
            band.setZValue(-20 + depth)
            self.t_plot.addItem(band)
        self.sim_bands = [Band("#000000", 60), Band("#000000", 60)]  # k = 2, k = 1
        self.sim_line = pg.PlotDataItem()
        self.u2, self.u1 = pg.ErrorBarItem(), pg.ErrorBarItem()
        self.measured = pg.ScatterPlotItem()
        self.other = pg.PlotDataItem()
        for item in (self.other, *self.sim_bands, self.sim_line, self.u2, self.u1, self.measured):
            self.brf_plot.addItem(item)
        self.d_bands = [Band("#000000", 255), Band("#000000", 255)]  # |t'| = 2, 1
        for depth, each in enumerate(self.d_bands):
            each.setZValue(-10 + depth)
            self.t_plot.addItem(each, ignoreBounds=True)
        self.t_line = pg.PlotDataItem()
        self.t_points = pg.ScatterPlotItem()
        self.t_plot.addItem(self.t_line)
        self.t_plot.addItem(self.t_points)
        self.here = [pg.InfiniteLine(angle=90), pg.InfiniteLine(angle=90)]
        self.missing = pg.ScatterPlotItem()
        for plot, line in zip((self.brf_plot, self.t_plot), self.here, strict=True):
            line.setVisible(False)
            plot.addItem(line, ignoreBounds=True)
            plot.getViewBox().sigRangeChangedManually.connect(self._moved_by_hand)
        self.t_plot.addItem(self.missing, ignoreBounds=True)
        self._by_hand = False
        self._ranges: tuple[Any, ...] = ()
        self._offered: list[PlaneKey] | None = None
        self.graphics.scene().sigMouseMoved.connect(self._point_at)

    def _style(self) -> None:
        theme = self.theme
        self.graphics.setBackground(theme.surface)
        font = QFont(QApplication.font())
        for plot, grid in zip((self.brf_plot, self.t_plot), self.grids, strict=True):
            style_axes(plot, theme.line, theme.quiet_text, font)
            grid.set_colour(theme.quiet_text)
        label = {"color": theme.text, "font-size": f"{font.pointSizeF():g}pt"}
        self.brf_plot.setLabel("left", "BRF", **label)
        self._label = label
        self._brushes = {c: pg.mkBrush(getattr(theme, c)) for c in CATEGORIES}
        self._edge = self._pen(theme.surface, width=0.8)
        self._pens = [self._pen(theme.measured, width=width) for width in (1, 3.5, 1.6)]
        self._surface = pg.mkBrush(theme.surface)
        self._below_changed(draw=False)
        self.t_plot.setLabel("bottom", "sensor zenith (°)", **label)
        for band, colour in zip(self.t_bands, (theme.band_outer, theme.band_inner), strict=True):
            band.setBrush(pg.mkBrush(colour))
            for line in band.lines:
                line.setPen(self._pen(theme.quiet_text, width=1, style=Qt.PenStyle.DashLine))
        for each, colour in zip(self.d_bands, (theme.band_outer, theme.band_inner), strict=True):
            each.set_colour(colour, 255)
        self.zero.setPen(self._pen(theme.quiet_text, width=1))
        for sim, alpha in zip(self.sim_bands, (45, 85), strict=True):
            sim.set_colour(theme.simulated, alpha)
        self.sim_line.setPen(self._pen(theme.simulated, width=2))
        self.other.setPen(self._pen(theme.text, width=1.4, style=Qt.PenStyle.DashLine))
        self.t_line.setPen(self._pen(theme.quiet_text, width=1, style=Qt.PenStyle.DotLine))
        for line in self.here:
            line.setPen(self._pen(theme.accent, width=1.5, style=Qt.PenStyle.DashDotLine))
        while self.legend_row.count():
            item = self.legend_row.takeAt(0)
            if item is not None and (widget := item.widget()) is not None:
                widget.setParent(None)
        self.legend_row.addWidget(legend(theme))

    def _pen(self, colour: str, **how: Any) -> Any:
        """A pen as thick on a fine screen as on a coarse one."""
        return pg.mkPen(colour, **how | {"width": how.get("width", 1) * self.devicePixelRatioF()})

    @property
    def shows_difference(self) -> bool:
        """Whether the lower plot shows the relative difference, not t'."""
        return self.below.currentText() == _DIFFERENCE

    def _below_changed(self, *, draw: bool = True) -> None:
        difference = self.shows_difference
        self.t_plot.setLabel("left", "ΔR / R  (%)" if difference else "t′", **self._label)
        for band in self.t_bands:
            band.setVisible(not difference)
        for band in self.d_bands:
            band.setVisible(difference)
        if draw:
            self.fit()

    def refresh(self, changes: Changes) -> None:
        """Draw again what has changed."""
        if changes.scan:
            if self.plane not in self.model.planes:
                self.plane = None
            self._offer_planes()
            self.fit()
        elif self.plane in changes.planes:
            self._draw()

    def _offer_planes(self) -> None:
        """Planes that can be drawn beside the one that is shown; the choice stands while they are the same."""
        if self._offered == list(self.model.planes):
            return
        self._offered = list(self.model.planes)
        self.beside.blockSignals(True)
        self.beside.clear()
        self.beside.addItem("no other plane", None)
        one_wavelength = len({plane.wavelength for plane in self.model.planes}) == 1
        for plane in self.model.planes:
            self.beside.addItem(f"beside: {words.plane_title(plane, not one_wavelength)}", tuple(plane))
        self.beside.blockSignals(False)

    def _draw_other(self) -> list[Point]:
        """The measured values of the plane that is chosen beside; returns its points."""
        key = self.beside.currentData()
        other = PlaneKey(*key) if key else None
        points = [] if other in (None, self.plane) else self.model.plane_points(other)
        points = [point for point in points if point.brf is not None]
        self.other.setData([p.geometry.sensor_zenith for p in points], [p.brf for p in points])
        return points

    def show_plane(self, plane: PlaneKey | None) -> None:
        """Show another plane."""
        if plane != self.plane:
            self.plane = plane
            self.readout.setText(_HINT)
            self._by_hand = False
            self._pending = self._pending.joined(Changes(scan=plane is None, planes={plane} if plane else set()))
            self.fell_behind.emit()

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = theme
        self._style()
        self._draw()

    def fit(self) -> None:
        """Let the axes follow the data again."""
        self._by_hand = False
        self._ranges = ()
        self._draw()

    def _moved_by_hand(self, *_: object) -> None:
        self._by_hand = True
        self._ranges = ()

    def _draw(self) -> None:
        points = self.model.plane_points(self.plane) if self.plane is not None else []
        self._show_heading(points)
        self._draw_simulated([p for p in points if p.simulated is not None])
        self._draw_measured([p for p in points if p.brf is not None])
        self._draw_scores([p for p in points if p.score is not None])
        self._draw_marks(points)
        other = self._draw_other()
        if not self._by_hand:
            self._set_ranges(points, other)

    def _show_heading(self, points: list[Point]) -> None:
        if self.plane is None:
            self.heading.setText("No plane to show yet")
            return
        text = words.plane_title(self.plane).capitalize()
        if text != self.heading.text():
            self.heading.setText(text)
            self.heading.setToolTip(text)
        if self.readout.text() in (_HINT, _NOTHING):
            self.readout.setText(_HINT if any(p.brf is not None for p in points) else _NOTHING)

    def _draw_simulated(self, points: list[Point]) -> None:
        x = [p.geometry.sensor_zenith for p in points]
        y = [p.simulated or 0.0 for p in points]
        u = [p.u_simulated or 0.0 for p in points]
        for band, k in zip(self.sim_bands, (2.0, 1.0), strict=True):
            low = [a - k * b for a, b in zip(y, u, strict=True)]
            band.set_data(x, low, [a + k * b for a, b in zip(y, u, strict=True)])
        self.sim_line.setData(x, y)

    def _draw_measured(self, points: list[Point]) -> None:
        x = np.array([p.geometry.sensor_zenith for p in points], dtype=float)
        y = np.array([p.brf for p in points], dtype=float)
        u = np.array([p.u_brf for p in points], dtype=float)
        self.u2.setData(x=x, y=y, height=4 * u, beam=1.2, pen=self._pens[0])
        self.u1.setData(x=x, y=y, height=2 * u, beam=0, pen=self._pens[1])
        self.measured.setData(x=x, y=y, symbol="o", size=6.5, brush=self._surface, pen=self._pens[2])

    def _draw_scores(self, points: list[Point]) -> None:
        x = [p.geometry.sensor_zenith for p in points]
        t = [self._lower(p) for p in points]
        self.t_line.setData(x, t)
        for band, k in zip(self.d_bands, reversed(T_BANDS), strict=True):
            half = [k * _percent_u(p) for p in points] if self.shows_difference else []
            band.set_data(x if half else [], [-h for h in half], half)
        categories = [p.score.category for p in points if p.score]
        brushes, edge = self._brushes, self._edge
        self.t_points.setData(
            x=x,
            y=t,
            symbol=[marks.CATEGORY_SYMBOL[c] for c in categories],
            size=[_SIZE[c] for c in categories],
            brush=[brushes[c] for c in categories],
            pen=edge,
        )

    def _lower(self, point: Point) -> float:
        """What the lower plot shows of a compared point."""
        assert point.score is not None
        return 100 * point.score.relative_difference if self.shows_difference else point.score.t

    def _draw_marks(self, points: list[Point]) -> None:
        current = self.model.current
        here = current is not None and self.plane is not None and self.model.current_plane == self.plane
        for line in self.here:
            line.setVisible(here)
            if here and current is not None:
                line.setValue(self.model.points[current].geometry.sensor_zenith)
        x = [p.geometry.sensor_zenith for p in points if p.skipped]
        self.missing.setData(
            x=x, y=[0.0] * len(x), symbol="s", size=10, brush=None, pen=pg.mkPen(self.theme.poor, width=1.8)
        )

    def _set_ranges(self, points: list[Point], beside: list[Point]) -> None:
        zeniths = [p.geometry.sensor_zenith for p in points] or [-90.0, 90.0]
        across = (min(zeniths) - 3, max(zeniths) + 3)
        ends = [end for p in (*points, *beside) for end in _extent(p)]
        low, high = (min(ends), max(ends)) if ends else self._ranges[1] if self._ranges else (0.0, 1.0)
        compared = [p for p in points if p.score is not None]
        least = max([3.5 * _percent_u(p) for p in compared] or [4.0]) if self.shows_difference else _T_SPAN
        span = max([least, *(abs(self._lower(p)) * 1.15 for p in compared)])
        shown = self._ranges or (None, None, None)
        upright, below = roomy(low, high, shown[1], 1e-3), roomy(-span, span, shown[2], 1e-3)
        ranges = (across, upright, below)
        if ranges != self._ranges:  # Qt lays the axes out anew even where nothing changes
            self._ranges = ranges
            self.brf_plot.setXRange(*across, padding=0)
            self.brf_plot.setYRange(*upright, padding=0)
            self.t_plot.setYRange(*below, padding=0)

    def _point_at(self, position: Any) -> None:
        """Say what there is to know of the point nearest to the pointer."""
        points = self.model.plane_points(self.plane) if self.plane is not None else []
        for plot in (self.brf_plot, self.t_plot):
            if points and plot.sceneBoundingRect().contains(position):
                x = plot.getViewBox().mapSceneToView(position).x()
                nearest = min(points, key=lambda point: abs(point.geometry.sensor_zenith - x))
                self.readout.setText(words.point_values(nearest))
                return


def _percent_u(point: Point) -> float:
    """Combined standard uncertainty of a compared point, per cent of the measured value."""
    return 100 * hypot(point.u_brf or 0.0, point.u_simulated or 0.0) / abs(point.brf or 1.0)


def _extent(point: Point) -> list[float]:
    """Ends of what is drawn of a point on the BRF axis."""
    ends = []
    if point.brf is not None:
        ends += [point.brf - 2 * (point.u_brf or 0.0), point.brf + 2 * (point.u_brf or 0.0)]
    if point.simulated is not None:
        ends += [point.simulated - 2 * (point.u_simulated or 0.0), point.simulated + 2 * (point.u_simulated or 0.0)]
    return ends


PANEL = PlotsPanel
