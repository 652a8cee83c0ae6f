"""The instrument in a window of its own, which the mouse turns at the speed of the graphics card (pyvistaqt).

It is a process of its own, which reads the same lines as :mod:`gui.solid.process` and never answers: a driver without
OpenGL ends it, and nothing else. ``camera`` of a line counts when it differs from that of the line before.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtWidgets import QApplication, QMainWindow

from gui.solid.geometry import Camera, Stance, between

_EVERY_MS, _SMOOTH_WALL = 50, 0.55
_SIZE = (900, 720)


class Lines(QObject):
    """Reads requests on a thread; only the newest one counts.

    Signals
    -------
    came
        A request.
    ended
        Nobody sends any more.
    """

    came = Signal(object)
    ended = Signal()

    def listen(self) -> None:
        """Begin to read the standard input."""
        threading.Thread(target=self._read, name="lines", daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin.buffer:
            self.came.emit(json.loads(line))
        self.ended.emit()


class OwnWindow(QMainWindow):
    """A window with the scene in it."""

    def __init__(self) -> None:
        super().__init__()
        from pyvistaqt import QtInteractor

        from gui.solid.scene import Scene

        self.setWindowTitle("Instrument – goniotwin")
        self.resize(*_SIZE)
        self.plotter = QtInteractor(self, auto_update=False)
        self.setCentralWidget(self.plotter)
        self.scene = Scene(self.plotter)
        self._folder: str | None = ""
        self._camera: Camera | None = None
        self._from: Stance | None = None
        self._to: Stance | None = None
        self._left = 0.0
        self._clock = QTimer(self)
        self._clock.setInterval(_EVERY_MS)
        self._clock.timeout.connect(self._step)

    def take(self, request: dict[str, Any]) -> None:
        """Show what a line says."""
        from gui.solid.scene import sample_of

        if request["folder"] != self._folder:
            self._folder = request["folder"]
            self.scene.show_sample(sample_of(Path(self._folder) if self._folder else None))
        self.scene.show_theme(request["theme"])
        self.scene.show_light(request["light"])
        now = time.monotonic()
        self._from, self._to, self._left = self._now(now), Stance(*request["stance"]), now
        camera = Camera(*request["camera"])
        if camera != self._camera:
            self._camera = camera
            self.scene.look(camera, self._to)
        self._clock.start()

    def _now(self, now: float) -> Stance | None:
        if self._from is None or self._to is None:
            return self._to
        share = (now - self._left) / _SMOOTH_WALL
        return self._to if share >= 1.0 else between(self._from, self._to, share)

    def _step(self) -> None:
        stance = self._now(time.monotonic())
        assert stance is not None
        self.scene.stand(stance)
        if self._camera is not None and self._camera.view != "free":
            self.scene.look(self._camera, stance)
        self.plotter.render()
        if stance == self._to:
            self._from = self._to
            self._clock.stop()


def main() -> None:
    """Open the window; it closes with the one that sends."""
    os.environ["QT_API"] = "pyside6"
    application = QApplication([sys.argv[0]])
    application.setApplicationName("goniotwin")
    window, lines = OwnWindow(), Lines()
    lines.came.connect(window.take, Qt.ConnectionType.QueuedConnection)
    lines.ended.connect(application.quit, Qt.ConnectionType.QueuedConnection)
    window.show()
    lines.listen()
    status = application.exec()
    sys.stdout.flush()
    os._exit(status)  # VTK and Qt need not agree on who frees the context


if __name__ == "__main__":
    main()
