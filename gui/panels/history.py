"""Over time: drift of the reference, dark level, scatter of the samples and gain."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import timedelta
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QTimer
from PySide6.QtGui import QFont
from PySide6.QtWidgets import QApplication, QWidget

from gui import words
from gui.axes import Grid, add_plot, style_axes
from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet
from gui.theme import Theme
from gui.traces import Array, roomy

_EVERY_MS = 500
_SYMBOLS = ("o", "t1", "s", "d", "star", "p", "h", "+")
_ROWS = ("reference (%)", "dark level (mV)", "scatter (%)", "gain (log₁₀ V/A)")
_LEAST = (0.1, 0.01, 0.01, 1.0)  # extents of the ordinates
#: Numbers of the model as they are plotted; all of these rise with them.
_AS_SHOWN: tuple[Callable[[Array], Array], ...] = (
    lambda percent: percent,
    lambda volts: 1e3 * volts,
    lambda share: 100 * share,
    lambda gains: np.log10(np.where(gains > 0, gains, 1.0)),
)
_HINT = "Point at a value to read it. The reference is shown relative to its first reading at the same azimuth."


class HistoryPanel(Panel):
    """Four plots over the time of the scan."""

    area = "centre"
    order = 20
    title = "Over time"
    lazy = True

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setAccessibleName("Reference, dark level, scatter and gain over time")
        self.body.addWidget(self.graphics, 1)
        self.readout = quiet(_HINT)
        self.readout.setWordWrap(True)
        self.body.addWidget(self.readout)
        self.plots: list[Any] = []
        self.grids: list[Grid] = []
        for row, name in enumerate(_ROWS):
            plot = add_plot(self.graphics, row)
            plot.setLabel("left", name)
            plot.enableAutoRange(False)
            plot.getViewBox().sigRangeChangedManually.connect(self._moved_by_hand)
            if self.plots:
                plot.setXLink(self.plots[0])
            if row < len(_ROWS) - 1:
                plot.hideAxis("bottom")
            self.plots.append(plot)
            self.grids.append(Grid(plot))
        self.plots[-1].setLabel("bottom", "hours since the start")
        self.reference = pg.ScatterPlotItem()
        self.plots[0].addItem(self.reference)
        self.lines = [pg.PlotDataItem() for _ in _ROWS[1:]]
        for plot, line in zip(self.plots[1:], self.lines, strict=True):
            plot.addItem(line)
        self._drawn = 0.0
        self._by_hand = False
        self._ranges: dict[int, tuple[float, float]] = {}
        self._due = QTimer(self)
        self._due.setSingleShot(True)
        self._due.timeout.connect(self._draw)
        self.graphics.scene().sigMouseMoved.connect(self._point_at)
        self._style()
        self._draw()

    def refresh(self, changes: Changes) -> None:
        """Draw again, not oftener than twice a second."""
        if changes.scan:
            self._by_hand = False
            self._ranges.clear()
            self._draw()
        if (changes.scan or changes.current) and not self._due.isActive():
            self._due.start(max(round(1e3 * (self._drawn - time.monotonic())) + _EVERY_MS, 0))

    def _moved_by_hand(self, *_: object) -> None:
        self._by_hand = True

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = theme
        self._style()
        self._draw()

    def _style(self) -> None:
        theme = self.theme
        self.graphics.setBackground(theme.surface)
        font = QFont(QApplication.font())
        for plot, grid in zip(self.plots, self.grids, strict=True):
            style_axes(plot, theme.line, theme.quiet_text, font)
            grid.set_colour(theme.quiet_text)
        for line, colour in zip(self.lines, (theme.measured, theme.simulated, theme.quiet_text), strict=True):
            line.setPen(pg.mkPen(colour))  # a thick line of many points takes Qt long

    def _draw(self) -> None:
        self._drawn = time.monotonic()
        first: dict[float, float] = {}
        x, y, symbols = [], [], []
        for reading in self.model.references:
            origin = first.setdefault(reading.sensor_azimuth, reading.current)
            x.append(self.model.hours(reading.time))
            y.append(100 * (reading.current / origin - 1) if origin else 0.0)
            symbols.append(_SYMBOLS[list(first).index(reading.sensor_azimuth) % len(_SYMBOLS)])
        ink = pg.mkPen(self.theme.measured, width=1.4)
        self.reference.setData(x=x, y=y, symbol=symbols, size=9, pen=ink, brush=pg.mkBrush(self.theme.surface))
        for column, line in enumerate(self.lines, start=1):
            hours, values = self.model.health.outline(column)
            line.setData(hours, _AS_SHOWN[column](values))
        if not self._by_hand:
            self._set_ranges(x, y)

    def _set_ranges(self, x: list[float], y: list[float]) -> None:
        """Ranges that do not move with every point: axes are what such a plot costs most."""
        rows = self.model.health.rows
        for row, least in enumerate(_LEAST):
            values = rows[:, row] if row else np.array(y)
            if len(values):
                low, high = _AS_SHOWN[row](np.array([values.min(), values.max()])).tolist()
                self._show_range(row, roomy(low, high, self._ranges.get(row), least))
        times = [*x, *rows[:1, 0].tolist(), *rows[-1:, 0].tolist()]
        if times:
            self._show_range(-1, roomy(min(times), max(times), self._ranges.get(-1), 0.02, ahead=0.2))

    def _show_range(self, row: int, shown: tuple[float, float]) -> None:
        """Show a range of a plot's ordinate; of the abscissa of all for -1."""
        if self._ranges.get(row) == shown:
            return
        self._ranges[row] = shown
        if row < 0:
            self.plots[0].setXRange(*shown, padding=0)
        else:
            self.plots[row].setYRange(*shown, padding=0)

    def _point_at(self, position: Any) -> None:
        for row, plot in enumerate(self.plots):
            if not plot.sceneBoundingRect().contains(position):
                continue
            x = plot.getViewBox().mapSceneToView(position).x()
            if row == 0 and self.model.references:
                near = min(self.model.references, key=lambda each: abs(self.model.hours(each.time) - x))
                self.readout.setText(
                    f"{words.clock_time(near.time)} UTC   sensor azimuth {words.angle(near.sensor_azimuth)}"
                    f"   {words.current(near.current)} ± {100 * near.relative_standard_error:.2g} %"
                )
            elif row and (here := self.model.health.nearest(x)) is not None:
                start = self.model.started
                when = f"{words.clock_time(start + timedelta(hours=here[0]))} UTC   " if start else ""
                dark, scatter = 1e3 * here[1], 100 * here[2]
                self.readout.setText(f"{when}dark {dark:.3g} mV   scatter {scatter:.2g} %   gain {words.gain(here[3])}")
            return


PANEL = HistoryPanel
