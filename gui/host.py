"""The process that runs a scan for the windows: it lives on when they are closed, or killed.

``python -m gui.host FOLDER`` reads the request in the folder, runs the scan as every other program does
(:class:`instrument.session.ScanSession`), writes every event to a file there, and sends that file to whoever connects
to its socket, from the first line on. A window that joins late, or is slow, reads the same lines; it holds nobody up.
Nothing here needs Qt.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import sys
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType

from gui.control import SessionController
from gui.notices import Notice
from gui.sessions import ABOUT, REQUEST, SOCKET, SPOOL
from gui.wire import COMMANDS, answer_of, encode
from instrument.events import Event, ScanStarted
from instrument.files import write_atomically
from instrument.request import ScanRequest

_PIECE = 1 << 16
_LAST_WORDS_WALL = 20.0  # how long a window may take to read the end


class Spool:
    """Lines in a file, which any number of readers follow, each at its own pace."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("wb", buffering=0)
        self._changed = threading.Condition()
        self._length = 0
        self._closed = False

    def append(self, line: str) -> None:
        """Add a line."""
        data = line.encode() + b"\n"
        with self._changed:
            if self._closed:
                return
            self._file.write(data)
            self._length += len(data)
            self._changed.notify_all()

    def close(self) -> None:
        """No more lines will come."""
        with self._changed:
            self._closed = True
            self._file.close()
            self._changed.notify_all()

    def follow(self, line: socket.socket) -> None:
        """Send everything from the first line on, until no more will come or nobody reads."""
        sent = 0
        with self.path.open("rb") as file:
            while True:
                with self._changed:
                    while sent == self._length and not self._closed:
                        self._changed.wait()
                    if sent == self._length:
                        return
                piece = file.read(_PIECE)
                line.sendall(piece)
                sent += len(piece)


class Host:
    """Runs one scan and serves windows.

    Parameters
    ----------
    folder
        Of the session (:mod:`gui.sessions`).
    """

    def __init__(self, folder: Path) -> None:
        content = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
        self.folder = folder
        self.spool = Spool(folder / SPOOL)
        self.controller = SessionController(ScanRequest.model_validate(content["request"]), self)
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._clients: list[threading.Thread] = []
        self._about = {"pid": os.getpid(), "started": datetime.now(UTC).isoformat(), "title": "", "run_dir": ""}

    def on_event(self, event: Event | Notice) -> None:
        """Keep an event for the windows."""
        self.spool.append(encode(event))
        if isinstance(event, ScanStarted):
            self._tell(title=event.title, run_dir=event.run_dir)

    def run(self) -> None:
        """Serve until the scan is over and every window has read it."""
        self._server.bind(str(self.folder / SOCKET))
        self._server.listen()
        self._tell()
        threading.Thread(target=self._accept, name="windows", daemon=True).start()
        self.controller.start()
        while not self.controller.join(0.5):  # a chance for signals
            pass
        self.spool.close()
        deadline = time.monotonic() + _LAST_WORDS_WALL
        for client in list(self._clients):
            client.join(max(deadline - time.monotonic(), 0.0))
        self._server.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def end(self, number: int, frame: FrameType | None) -> None:
        """A request to terminate ends the scan in an orderly way."""
        self.controller.abort()

    def _tell(self, **more: str) -> None:
        self._about.update(more)
        write_atomically(self.folder / ABOUT, json.dumps(self._about).encode())

    def _accept(self) -> None:
        while True:
            try:
                line, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._obey, args=(line,), name="commands", daemon=True).start()
            client = threading.Thread(target=self._serve, args=(line,), name="a window", daemon=True)
            self._clients = [each for each in self._clients if each.is_alive()] + [client]
            client.start()

    def _serve(self, line: socket.socket) -> None:
        try:
            self.spool.follow(line)
            line.shutdown(socket.SHUT_WR)
        except OSError:
            return  # the window is gone; the scan goes on

    def _obey(self, line: socket.socket) -> None:
        with line, line.makefile("rb") as words:
            try:
                for word in words:
                    self.obey(word.decode().strip())
            except OSError:
                return

    def obey(self, line: str) -> None:
        """Carry out a command of a window; anything else is no command and is not obeyed.

        ``done`` may be followed by the answer, as JSON.
        """
        controller = self.controller
        word, _, rest = line.partition(" ")
        if word not in COMMANDS or (rest and word != "done"):
            return
        if word == "pause_now":
            controller.pause(now=True)
        elif word == "give_up":
            controller.answer(False)
        elif word == "done":
            with contextlib.suppress(ValueError):  # an answer that cannot be read is none: the question stands
                controller.answer(True, answer_of(rest))
        else:
            getattr(controller, word)()


def main() -> None:
    """Run the session whose folder is the only argument."""
    host = Host(Path(sys.argv[1]))
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, host.end)
    host.run()


if __name__ == "__main__":
    main()
