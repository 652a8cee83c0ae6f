"""The window's side of the process that renders: one request at a time, on a thread that waits for the picture."""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from typing import IO, Any

from PySide6.QtCore import QObject, QTimer, Signal
from PySide6.QtGui import QImage

_FIRST_WALL, _NEXT_WALL = 180.0, 60.0  # seconds for loading VTK and a first picture; for any later one
_COMMAND = [sys.executable, "-m", "gui.solid.process"]


class Renderer(QObject):
    """Renders pictures elsewhere; no method waits.

    Parameters
    ----------
    command
        What starts the process, :mod:`gui.solid.process` where it is not given.

    Signals
    -------
    pictured
        A picture and the line that came with it.
    failed
        There will be no picture any more, and why.
    """

    pictured = Signal(object, object)
    failed = Signal(str)
    _gone = Signal(str)

    def __init__(self, parent: QObject | None = None, command: list[str] | None = None) -> None:
        super().__init__(parent)
        self._command = command or _COMMAND
        self._requests: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None
        self.waiting = False
        self.over = False
        self._late = QTimer(self)
        self._late.setSingleShot(True)
        self._late.timeout.connect(lambda: self._fail("it does not answer"))
        self._wait = _FIRST_WALL
        self.pictured.connect(self._answered)
        self._gone.connect(self._fail)
        self.destroyed.connect(_end(self._requests))

    def ask(self, request: dict[str, Any]) -> bool:
        """Order a picture; False where one is on its way, or none will ever come."""
        if self.waiting or self.over:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="pictures", daemon=True)
            self._thread.start()
        self.waiting = True
        self._requests.put(request)
        self._late.start(round(1000 * self._wait))
        return True

    def close(self) -> None:
        """End the process; no signal comes any more."""
        self.over = True
        self._late.stop()
        self._requests.put(None)
        if self._process is not None:
            self._process.kill()

    def _answered(self) -> None:
        self.waiting, self._wait = False, _NEXT_WALL
        self._late.stop()

    def _fail(self, reason: str) -> None:
        if not self.over:
            self.close()
            self.failed.emit(reason)

    # On the thread

    def _run(self) -> None:
        with tempfile.TemporaryFile() as said:
            try:
                self._process = subprocess.Popen(
                    self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said
                )
                self._converse(self._process)
                reason = ""
            except (OSError, ValueError, RuntimeError) as error:  # the last: the window is closed meanwhile
                reason = str(error)
            if self._process is not None:
                self._process.kill()
                status = self._process.wait()
                reason = _last_line(said) or _how(status) or reason
        try:
            self._gone.emit(reason)
        except RuntimeError:
            return  # the window is closed meanwhile

    def _converse(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        with process.stdin, process.stdout:
            while (request := self._requests.get()) is not None and not self.over:
                process.stdin.write(json.dumps(request).encode() + b"\n")
                process.stdin.flush()
                answer = json.loads(process.stdout.readline())
                width, height = answer["width"], answer["height"]
                pixels = process.stdout.read(3 * width * height)
                if len(pixels) < 3 * width * height:
                    raise OSError("a picture broke off")
                picture = QImage(pixels, width, height, 3 * width, QImage.Format.Format_RGB888)
                self.pictured.emit(picture.convertToFormat(QImage.Format.Format_RGB32), answer)


def _end(requests: queue.SimpleQueue[dict[str, Any] | None]) -> Any:
    """Ends the thread, and with it the process, when the object is gone."""
    return lambda: requests.put(None)


def _last_line(said: IO[bytes]) -> str:
    said.seek(0)
    lines = said.read().decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else ""


def _how(status: int) -> str:
    return f"it was ended by {signal.Signals(-status).name}" if status < 0 else f"it ended with status {status}"
