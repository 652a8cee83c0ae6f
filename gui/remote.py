"""Steers a scan that runs in a process of its own."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gui import sessions
from gui.control import Listener
from gui.notices import ControllerClosed, ControllerFailed, ControllerStarting
from gui.wire import decode

_START_WALL = 60.0  # for a process to answer
_POLL_WALL = 0.05


class RemoteController:
    """A window's side of a session; satisfies :class:`gui.control.Controller`.

    Parameters
    ----------
    listener
        Receives what the session says.
    content
        What to start (:func:`gui.sessions.launch`); None to join a session.
    folder
        Of the session to join.
    """

    detached = True

    def __init__(self, listener: Listener, content: dict[str, Any] | None = None, folder: Path | None = None) -> None:
        self._listener, self._content, self._folder = listener, content, folder
        self._line: socket.socket | None = None
        self._waiting: list[str] = []  # commands given before the process answers
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._left = False

    def start(self) -> None:
        """Start the process, or join it, on a thread of its own."""
        if self._thread is not None:
            return
        self._listener.on_event(ControllerStarting())
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Pause after the point in hand."""
        self._send("pause")

    def pause_now(self) -> None:
        """Pause at once; the point in hand is repeated."""
        self._send("pause_now")

    def resume(self) -> None:
        """Go on."""
        self._send("resume")

    def abort(self) -> None:
        """End in an orderly way."""
        self._send("abort")

    def halt(self) -> None:
        """Stop everything now."""
        self._send("halt")

    def answer(self, done: bool, value: float | str | None = None) -> None:
        """Answer the engine's request to the operator."""
        said = "" if value is None else f" {json.dumps(value)}"
        self._send(f"done{said}" if done else "give_up")

    def leave(self) -> None:
        """Hear no more of the scan; it goes on."""
        with self._lock:
            self._left = True
            if self._line is not None:
                with contextlib.suppress(OSError):
                    self._line.shutdown(socket.SHUT_RDWR)

    def join(self, timeout: float | None = None) -> bool:
        """Wait (wall-clock seconds) until the session has ended, or was left."""
        if self._thread is not None:
            self._thread.join(timeout)
        return self._thread is None or not self._thread.is_alive()

    def _send(self, word: str) -> None:
        with self._lock:
            if self._line is None:
                self._waiting.append(word)
                return
            with contextlib.suppress(OSError):  # the reader notices the end
                self._line.sendall(word.encode() + b"\n")

    def _run(self) -> None:
        try:
            line = self._connected()
        except OSError as error:
            self._fail(str(error), "Nothing has moved. Start again; if it happens again, restart the computer.")
            return
        ended = False
        try:
            with line.makefile("rb") as lines:
                for text in lines:
                    item = decode(text)
                    ended = isinstance(item, ControllerClosed)
                    if not self._left:
                        self._listener.on_event(item)
        except (OSError, ValueError):
            ended = False
        finally:
            line.close()
        if not ended and not self._left:
            self._fail(
                "The process that ran the scan has ended without a word",
                "Look at the instrument: the arms stop at the end of their move and the source ends its emission by"
                " itself. What is measured is kept: go on with the run from the start page.",
            )

    def _connected(self) -> socket.socket:
        process: subprocess.Popen[bytes] | None = None
        if self._folder is None:
            assert self._content is not None
            self._folder, process = sessions.launch(self._content)
        deadline = time.monotonic() + (_START_WALL if process else 2.0)
        while True:
            try:
                line = sessions.connect(self._folder)
                break
            except OSError:
                over = time.monotonic() > deadline or (process is not None and process.poll() is not None)
                if over:
                    raise OSError(f"the session does not answer{self._last_words()}") from None
                time.sleep(_POLL_WALL)
        if process is not None:
            threading.Thread(target=process.wait, name="reaper", daemon=True).start()
        with self._lock:
            self._line = line
            for word in self._waiting:
                line.sendall(word.encode() + b"\n")
            self._waiting.clear()
        return line

    def _last_words(self) -> str:
        with contextlib.suppress(OSError):
            assert self._folder is not None
            lines = (self._folder / sessions.LOG).read_text(errors="replace").strip().splitlines()
            return f": {lines[-1]}" if lines else ""
        return ""

    def _fail(self, text: str, advice: str) -> None:
        self._listener.on_event(ControllerFailed(datetime.now(UTC), text, advice))
        self._listener.on_event(ControllerClosed())
