"""SCPI over a TCP socket, as instruments offer it at port 5025: lines that end with LF, both ways."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from typing import Protocol

from sim_fixtures.devices.faults import Faults, deliver


class Interpreter(Protocol):
    """An instrument that understands lines of commands."""

    def execute(self, line: str) -> str | None:
        """Carry out a line; the answer, or None where nothing was asked."""
        ...


class ScpiServer:
    """The instrument's socket, on the loopback interface; one client at a time is usual, more are served.

    Parameters
    ----------
    meter
        Executes the lines.
    faults
        What happens to the replies.
    """

    def __init__(self, meter: Interpreter, faults: Faults | None = None, port: int = 0) -> None:
        self.faults = faults or Faults()
        self._meter = meter
        self._turn = threading.Lock()
        self._clients: set[socket.socket] = set()
        self._closed = False
        self._deaf_until = 0.0
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, name="meter", daemon=True).start()

    def disconnect(self, seconds: float = 0.0) -> None:
        """Break every connection; new ones hold only after so many wall-clock seconds."""
        self._deaf_until = time.monotonic() + seconds
        for client in list(self._clients):
            _hang_up(client)

    def close(self) -> None:
        """End the server."""
        self._closed = True
        _hang_up(self._listener)
        self.disconnect()

    def _accept(self) -> None:
        while not self._closed:
            try:
                client, _ = self._listener.accept()
            except OSError:  # closed
                return
            if time.monotonic() < self._deaf_until:
                client.close()
                continue
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients.add(client)
            threading.Thread(target=self._talk, args=(client,), name="meter client", daemon=True).start()

    def _talk(self, client: socket.socket) -> None:
        def send(data: bytes) -> None:
            try:
                client.sendall(data)
            except OSError:  # the client has gone away
                self._clients.discard(client)

        buffer = b""
        try:
            while data := client.recv(4096):
                *lines, buffer = (buffer + data).split(b"\n")
                for line in lines:
                    if self.faults.request_lost(line):
                        continue
                    with self._turn:
                        answer = self._meter.execute(line.decode("latin-1").strip())
                    if answer is not None:
                        deliver(answer.encode("ascii") + b"\n", self.faults, send)
        except OSError:  # connection reset
            return
        finally:
            self._clients.discard(client)
            client.close()


def _hang_up(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):  # not connected
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()
