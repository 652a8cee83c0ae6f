"""Control channel of the simulated laboratory: JSON lines over TCP, loopback only.

A request ``{"action": "mount", "what": "sample"}`` is answered by ``{"ok": true, "result": ...}`` or
``{"ok": false, "error": "..."}``.
"""

from __future__ import annotations

import json
import socket
import socketserver
import threading
from typing import Any, Protocol


class Controllable(Protocol):
    """What the channel acts on."""

    def control(self, action: str, **arguments: Any) -> Any: ...


class ControlServer:
    """Serves the channel in threads of its own; :attr:`port` is chosen by the system."""

    def __init__(self, room: Controllable) -> None:
        class Talk(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                for line in self.rfile:
                    self.wfile.write(json.dumps(_answer(room, line)).encode() + b"\n")

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            block_on_close = False

        self._server = Server(("127.0.0.1", 0), Talk)
        self.port: int = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, name="control", daemon=True).start()

    def close(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()


def _answer(room: Controllable, line: bytes) -> dict[str, Any]:
    try:
        request = json.loads(line)
        action = request.pop("action")
        return {"ok": True, "result": room.control(action, **request)}
    except (ValueError, KeyError, AttributeError) as error:
        return {"ok": False, "error": f"{type(error).__name__}: {error}"}


class ControlClient:
    """The other end of the channel; may be used by several threads."""

    def __init__(self, port: int, timeout: float = 30.0) -> None:
        self._lock = threading.Lock()
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=timeout)
        self._file = self._socket.makefile("rwb")

    def __call__(self, action: str, **arguments: Any) -> Any:
        """Ask for an action.

        Raises
        ------
        ValueError
            If the laboratory refuses it.
        ConnectionError
            If the laboratory has ended.
        """
        with self._lock:
            self._file.write(json.dumps({"action": action, **arguments}).encode() + b"\n")
            self._file.flush()
            line = self._file.readline()
        if not line:
            raise ConnectionError("the simulated laboratory has ended")
        answer = json.loads(line)
        if not answer["ok"]:
            raise ValueError(answer["error"])
        return answer["result"]

    def close(self) -> None:
        """Close the connection. May be repeated."""
        for part in (self._file, self._socket):
            try:
                part.close()
            except OSError:  # the far end has gone first
                continue
