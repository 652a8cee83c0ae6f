"""A command of the program in a process of its own: what it says comes line by line, and it can be answered."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Sequence

from PySide6.QtCore import QObject, QProcess, QProcessEnvironment, Signal

#: How procedures are told that a program shows their prompts (:mod:`instrument.procedures.people`).
PROMPTS = "GONIOTWIN_PROMPTS"
_COLOURS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Child(QObject):
    """One process at a time.

    Signals
    -------
    said
        A piece of what it writes, both channels together.
    ended
        Its exit status; -1 where it could not be started or was killed.
    """

    said = Signal(str)
    ended = Signal(int)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._process: QProcess | None = None

    @property
    def running(self) -> bool:
        """Whether a command runs."""
        return self._process is not None

    def run(self, module: str, arguments: Sequence[str]) -> None:
        """Start ``python -m module arguments``; does nothing while another one runs."""
        if self._process is not None:
            return
        process = QProcess(self)
        environment = QProcessEnvironment.systemEnvironment()
        environment.insert("PYTHONUNBUFFERED", "1")
        environment.insert("COLUMNS", "110")
        environment.insert("NO_COLOR", "1")
        environment.insert(PROMPTS, "json")
        process.setProcessEnvironment(environment)
        process.setProcessChannelMode(QProcess.ProcessChannelMode.MergedChannels)
        process.readyRead.connect(self._read)
        process.finished.connect(self._finished)
        process.errorOccurred.connect(self._failed)
        self._process = process
        process.start(sys.executable, ["-m", module, *arguments])

    def answer(self, line: str) -> None:
        """Send a line to the process."""
        if self._process is not None:
            self._process.write(line.encode() + b"\n")

    def stop(self) -> None:
        """Ask it to end in an orderly way."""
        if self._process is not None:
            self._process.terminate()

    def halt(self) -> None:
        """Its emergency stop (:mod:`instrument.procedures.room`)."""
        if self._process is not None and self._process.processId():
            os.kill(self._process.processId(), signal.SIGQUIT)

    def _read(self) -> None:
        if self._process is not None:
            text = bytes(self._process.readAll().data()).decode(errors="replace")
            self.said.emit(_COLOURS.sub("", text).replace("\r", "\n"))

    def _finished(self, status: int, how: QProcess.ExitStatus) -> None:
        self._read()
        self._drop(status if how is QProcess.ExitStatus.NormalExit else -1)

    def _failed(self, error: QProcess.ProcessError) -> None:
        if error is QProcess.ProcessError.FailedToStart:
            self._drop(-1)

    def _drop(self, status: int) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.deleteLater()
            self.ended.emit(status)
