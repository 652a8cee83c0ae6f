"""A picture of the window in the middle of a scan, for the documentation."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QObject, QTimer
from PySide6.QtWidgets import QApplication

from gui.model import Changes
from gui.window import MainWindow
from instrument.errors import EXIT_DONE, EXIT_INCOMPLETE

SHARE = 0.45  # of the points, before the picture is taken


class Photographer(QObject):
    """Starts a scan, waits until it is well under way and the twin has kept up, saves a picture, ends the scan.

    Attributes
    ----------
    status
        Exit status: 1 where the scan ended before there was anything to see.
    """

    def __init__(self, window: MainWindow, file: Path) -> None:
        super().__init__(window)
        self.window, self.file = window, file
        self.status = EXIT_INCOMPLETE
        window.bridge.changed.connect(self._look)
        QTimer.singleShot(0, lambda: window.do("start"))

    def _look(self, changes: Changes) -> None:
        model = self.window.model
        due = self.status == EXIT_INCOMPLETE and model.total and model.settled >= SHARE * model.total
        shown = self.window.plots.plane
        points = model.plane_points(shown) if shown else []
        scored = sum(point.score is not None for point in points)
        if due and points and (scored >= 0.6 * len(points) or model.end is not None):
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.window.grab().save(str(self.file))
            self.status = EXIT_DONE
            self.window._abort()
        if not model.connected and model.state != "idle":
            for line in model.messages if self.status else ():
                print(f"{line.level}: {line.text} {line.advice}")
            QApplication.exit(self.status)
