"""The window's side of the instrument's own window: started by a button, told what has changed."""

from __future__ import annotations

import json
import sys
from typing import Any

from PySide6.QtCore import QObject, QProcess, QProcessEnvironment, Signal
from PySide6.QtGui import QGuiApplication

_BEHIND = 1 << 16  # bytes that it may be behind; what is not said then is said by the next line


class Apart(QObject):
    """One such window at a time.

    Parameters
    ----------
    command
        What is started, :mod:`gui.solid.own_window` where it is not given.

    Signals
    -------
    ended
        It is closed; why, where no person did it.
    """

    ended = Signal(str)

    def __init__(self, parent: QObject | None = None, command: list[str] | None = None) -> None:
        super().__init__(parent)
        self._command = command or [sys.executable, "-m", "gui.solid.own_window"]
        self._process: QProcess | None = None

    @property
    def open(self) -> bool:
        """Whether the window is there."""
        return self._process is not None

    def start(self) -> None:
        """Open it; does nothing where it is open."""
        if self._process is not None:
            return
        process = QProcess(self)
        environment = QProcessEnvironment.systemEnvironment()
        if QGuiApplication.platformName().startswith("wayland"):
            environment.insert("QT_QPA_PLATFORM", "xcb")  # VTK draws into windows of X alone
        process.setProcessEnvironment(environment)
        process.setStandardOutputFile(QProcess.nullDevice())
        process.finished.connect(self._finished)
        process.errorOccurred.connect(self._failed)
        self._process = process
        process.start(self._command[0], self._command[1:])

    def tell(self, request: dict[str, Any]) -> None:
        """Say what is to be seen."""
        process = self._process
        if process is not None and process.bytesToWrite() < _BEHIND:
            process.write(json.dumps(request).encode() + b"\n")

    def close(self) -> None:
        """Close it."""
        if self._process is not None:
            self._process.closeWriteChannel()

    def _finished(self, status: int, how: QProcess.ExitStatus) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        said = bytes(process.readAllStandardError().data()).decode(errors="replace").strip().splitlines()
        process.deleteLater()
        well = status == 0 and how is QProcess.ExitStatus.NormalExit
        self.ended.emit("" if well else (said[-1].strip() if said else f"it ended with status {status}"))

    def _failed(self, error: QProcess.ProcessError) -> None:
        if error is QProcess.ProcessError.FailedToStart and self._process is not None:
            self._process.deleteLater()
            self._process = None
            self.ended.emit("it cannot be started")
