"""Over time: drift of the reference, dark level, scatter of the samples and gain."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pyqtgraph as pg
from PySide6.QtCore import QTimer
from PySide6.QtGui import QFont
from PySide6.QtWidgets import QApplication, QWidget

from gui import words
from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet
from gui.theme import Theme

_EVERY_MS = 500
_SYMBOLS = ("o", "t1", "s", "d", "star", "p", "h", "+")
_ROWS = ("reference (%)", "dark level (mV)", "scatter (%)", "gain (log₁₀ V/A)")
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
        for row, name in enumerate(_ROWS):
            plot = self.graphics.addPlot(row=row, col=0)
            for side in ("left", "bottom"):
                plot.getAxis(side).enableAutoSIPrefix(False)
            plot.setLabel("left", name)
            plot.showGrid(x=True, y=True, alpha=0.15)
            plot.setMenuEnabled(False)
            plot.hideButtons()
            plot.getAxis("left").setWidth(72)
            if self.plots:
                plot.setXLink(self.plots[0])
            self.plots.append(plot)
        self.plots[-1].setLabel("bottom", "hours since the start")
        self.reference = pg.ScatterPlotItem()
        self.plots[0].addItem(self.reference)
        self.lines = [pg.PlotDataItem(autoDownsample=True, clipToView=False) for _ in _ROWS[1:]]
        for plot, line in zip(self.plots[1:], self.lines, strict=True):
            plot.addItem(line)
        self._due = QTimer(self)
        self._due.setSingleShot(True)
        self._due.setInterval(_EVERY_MS)
        self._due.timeout.connect(self._draw)
        self.graphics.scene().sigMouseMoved.connect(self._point_at)
        self._style()
        self._draw()

    def refresh(self, changes: Changes) -> None:
        """Draw again, not oftener than twice a second."""
        if changes.scan:
            self._draw()
        if (changes.scan or changes.current) and not self._due.isActive():
            self._due.start()

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = theme
        self._style()
        self._draw()

    def _style(self) -> None:
        theme = self.theme
        self.graphics.setBackground(theme.surface)
        font = QFont(QApplication.font())
        for plot in self.plots:
            for side in ("left", "bottom"):
                axis = plot.getAxis(side)
                axis.setPen(pg.mkPen(theme.line))
                axis.setTextPen(theme.quiet_text)
                axis.setStyle(tickFont=font)
        for line, colour in zip(self.lines, (theme.measured, theme.simulated, theme.quiet_text), strict=True):
            line.setPen(pg.mkPen(colour, width=1.6 * self.devicePixelRatioF()))

    def _hours(self, time: datetime) -> float:
        start = self.model.started or time
        return (time - start).total_seconds() / 3600

    def _draw(self) -> None:
        first: dict[float, float] = {}
        x, y, symbols = [], [], []
        for reading in self.model.references:
            origin = first.setdefault(reading.sensor_azimuth, reading.current)
            x.append(self._hours(reading.time))
            y.append(100 * (reading.current / origin - 1) if origin else 0.0)
            symbols.append(_SYMBOLS[list(first).index(reading.sensor_azimuth) % len(_SYMBOLS)])
        ink = pg.mkPen(self.theme.measured, width=1.4)
        self.reference.setData(x=x, y=y, symbol=symbols, size=9, pen=ink, brush=pg.mkBrush(self.theme.surface))
        health = list(self.model.health)
        hours = [self._hours(each.time) for each in health]
        self.lines[0].setData(hours, [1e3 * each.dark for each in health])
        self.lines[1].setData(hours, [100 * each.noise for each in health])
        self.lines[2].setData(hours, [words.decades(each.gain) for each in health])
        known = [*x, *hours[:1], *hours[-1:]]
        if known:
            self.plots[0].setXRange(min(known), max(*known, min(known) + 0.01), padding=0.03)

    def _point_at(self, position: Any) -> None:
        for row, plot in enumerate(self.plots):
            if not plot.sceneBoundingRect().contains(position):
                continue
            x = plot.getViewBox().mapSceneToView(position).x()
            if row == 0 and self.model.references:
                near = min(self.model.references, key=lambda each: abs(self._hours(each.time) - x))
                self.readout.setText(
                    f"{words.clock_time(near.time)} UTC   sensor azimuth {words.angle(near.sensor_azimuth)}"
                    f"   {words.current(near.current)} ± {100 * near.relative_standard_error:.2g} %"
                )
            elif row and self.model.health:
                here = min(self.model.health, key=lambda each: abs(self._hours(each.time) - x))
                self.readout.setText(
                    f"{words.clock_time(here.time)} UTC   dark {here.dark * 1e3:.3g} mV"
                    f"   scatter {100 * here.noise:.2g} %   gain {words.gain(here.gain)}"
                )
            return


PANEL = HistoryPanel
