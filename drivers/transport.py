"""A line: one wire on which one request at a time is answered, or not.

Replies of most protocols carry no number, so a late reply would be taken for the next one. A line therefore
lets one request be in flight, throws away what arrived before it, and after a time-out waits until the wire is
silent before it sends anything again. It never sends anything twice: whether a request may be repeated is
known to the driver alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.errors import CommunicationError
from drivers.ports import SerialWire, TcpWire, Wire
from drivers.sharing import SharedLine

__all__ = ["Line", "NoReply", "SerialWire", "TcpWire", "Wire", "line_ends_with"]

#: Looks at everything received so far; returns the reply once it is complete, None before.
Complete = Callable[[bytes], bytes | None]

#: Silence in s that ends the wait for late replies after a time-out.
QUIET = 0.06


class NoReply(CommunicationError):
    """The deadline of a reply passed."""


def line_ends_with(terminator: bytes) -> Complete:
    """A reply is complete with its terminator; what follows it is dropped."""

    def complete(received: bytes) -> bytes | None:
        head, found, _ = received.partition(terminator)
        return head + found if found else None

    return complete


class Line(SharedLine):
    """A wire with deadlines.

    Parameters
    ----------
    name
        Name of the line in ``devices.toml``.
    wire
        Serial port or TCP connection; opened here.
    timeout
        Longest wait for a reply in wall-clock s, where a request names no other.

    Raises
    ------
    OSError
        If the wire cannot be opened.
    """

    def __init__(self, name: str, wire: Wire, timeout: float = 1.0) -> None:
        super().__init__(name)
        self.timeout = timeout
        self._wire = wire
        self._suspect = False
        self._wire.open()

    def exchange(self, device: str, request: bytes, complete: Complete, timeout: float | None = None) -> bytes:
        """Send a request and wait for its reply.

        Parameters
        ----------
        device
            Who asks, for errors.
        request
            Bytes on the wire.
        complete
            Recognises a complete reply.
        timeout
            Longest wait in wall-clock s.

        Raises
        ------
        NoReply
            If no complete reply came in time; the message quotes what did come.
        CommunicationError
            If the connection is lost; the next exchange tries to restore it.
        """
        with self.transaction(device):
            self._ready(device)
            # Until the reply is there, whatever ends the wait (an interrupt too) leaves it on its way.
            self._suspect = True
            try:
                self._wire.write(request)
                reply = self._receive(device, request, complete, timeout or self.timeout)
                self._suspect = False
                return reply
            except OSError as error:
                raise self._lost(device, error) from error

    def gather(self, device: str, request: bytes) -> bytes:
        """Send a request and take all that comes until the wire is silent: two devices at one address both answer.

        Raises
        ------
        CommunicationError
            If the connection is lost.
        """
        with self.transaction(device):
            self._ready(device)
            self._suspect = True
            try:
                self._wire.write(request)
                received, last = b"", time.monotonic()
                while time.monotonic() - last < (QUIET if received else self.timeout):
                    if piece := self._wire.read():
                        received, last = received + piece, time.monotonic()
            except OSError as error:
                raise self._lost(device, error) from error
            self._suspect = False
            return received

    def send(self, device: str, request: bytes, pause: float = 0.0) -> None:
        """Send a request that has no reply, and leave ``pause`` seconds of silence behind it.

        Raises
        ------
        CommunicationError
            If the connection is lost.
        """
        with self.transaction(device):
            self._ready(device)
            try:
                self._wire.write(request)
            except OSError as error:
                raise self._lost(device, error) from error
            time.sleep(pause)

    def _receive(self, device: str, request: bytes, complete: Complete, timeout: float) -> bytes:
        deadline = time.monotonic() + timeout
        received = b""
        while time.monotonic() < deadline:
            received += self._wire.read()
            reply = complete(received)
            if reply is not None:
                return reply
        came = f"only {received[:80]!r}" if received else "nothing"
        raise NoReply(
            device,
            f"no reply to {request!r} on line {self.name!r} within {timeout:g} s; {came} came",
            "check power, cable, address and baud rate",
        )

    def _ready(self, device: str) -> None:
        """Restore the connection where it was lost and throw stale input away."""
        try:
            if not self._wire.is_open:
                self._wire.open()
            self._drain(QUIET if self._suspect else 0.0)
        except OSError as error:
            raise self._lost(device, error) from error
        self._suspect = False

    def _drain(self, quiet: float) -> None:
        """Read until nothing has come for ``quiet`` seconds, at most for the time-out of the line."""
        limit = time.monotonic() + max(self.timeout, quiet)
        silent_since = time.monotonic()
        while time.monotonic() < limit:
            if self._wire.read_waiting():
                silent_since = time.monotonic()
            elif time.monotonic() - silent_since >= quiet:
                return
            else:
                time.sleep(0.005)

    def _lost(self, device: str, error: OSError) -> CommunicationError:
        self._close_wire()
        self._suspect = True
        return CommunicationError(
            device, f"connection lost on line {self.name!r} ({self._wire}): {error}", "check the cable; it is reopened"
        )

    def _close_wire(self) -> None:
        self._wire.close()
