"""How far the scan is and when it will be over."""

from __future__ import annotations

import time
from datetime import datetime, timedelta

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QGridLayout, QProgressBar, QWidget

from gui import words
from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet, value
from gui.theme import Theme
from instrument.states import FINAL, State

_RESTING = {State.PAUSED, State.SUSPENDED, State.MOUNTING}


class ProgressPanel(Panel):
    """Bar, counts, time left and the hour of the end. Time left counts down between the engine's estimates."""

    area = "acquire"
    order = 0
    title = "Progress"

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.bar.setAccessibleName("Progress of the scan")
        self.points, self.left, self.end = value(), value(), value()
        self.body.addWidget(self.bar)
        grid = QGridLayout()
        grid.setVerticalSpacing(3)
        for row, (name, label) in enumerate((("Points", self.points), ("Time left", self.left), ("Ends", self.end))):
            grid.addWidget(quiet(name), row, 0)
            grid.addWidget(label, row, 1)
        grid.setColumnStretch(1, 1)
        self.body.addLayout(grid)
        self._estimated_at = time.monotonic()
        self._estimate: float | None = None
        self._second = QTimer(self)
        self._second.setInterval(1000)
        self._second.timeout.connect(self._show_time)
        self._second.start()
        self.refresh(Changes(scan=True))

    def refresh(self, changes: Changes) -> None:
        """Show counts and times."""
        model = self.model
        if not (changes.progress or changes.scan or changes.state):
            return
        if model.time_left_s != self._estimate:
            self._estimate, self._estimated_at = model.time_left_s, time.monotonic()
        self.bar.setUpdatesEnabled(False)  # it would paint the whole window at once
        self.bar.setRange(0, max(model.total, 1))
        self.bar.setValue(model.settled)
        self.bar.setUpdatesEnabled(True)
        missing = f", {model.missing} missing" if model.missing else ""
        share = f" ({100 * model.settled / model.total:.0f} %)" if model.total else ""
        self.points.setText(f"{model.measured} of {model.total}{share}{missing}" if model.total else "–")
        self._show_time()

    def _show_time(self) -> None:
        model = self.model
        if model.state in FINAL or model.time_left_s is None or not model.total:
            self.left.setText("none" if model.state is State.FINISHED else "–")
            ended = model.end is not None and model.latest is not None
            self.end.setText(f"ended {model.latest:%H:%M} UTC" if ended and model.latest else "–")
            return
        resting = model.state in _RESTING
        passed = 0.0 if resting else time.monotonic() - self._estimated_at
        left = max(model.time_left_s - passed, 0.0)
        self.left.setText(words.duration(left) + (" once it goes on" if resting else ""))
        self.end.setText("–" if resting else f"about {datetime.now() + timedelta(seconds=left):%H:%M} local time")


PANEL = ProgressPanel
