"""What goes wrong on a wire: requests and replies that are lost, late, garbled, split, merged or another unit's."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

#: Faults of requests, and of replies.
REQUESTS = ("lose", "mislead", "refuse", "deny")
REPLIES = ("drop", "corrupt", "late", "split", "merge", "stray")

Change = Callable[[bytes], bytes]


class Faults:
    """Counts of requests and replies of one line that still have to suffer.

    ============ ==========================================================================================
    ``lose``     the request never arrives
    ``mislead``  the request arrives as another valid one: a digit is changed (text without a checksum)
    ``refuse``   the request is answered by "busy" instead of being carried out (Modbus exception 06h)
    ``deny``     the request is answered by "device failure" (Modbus exception 04h)
    ``drop``     the reply never arrives
    ``corrupt``  one byte of the reply is garbled
    ``late``     the reply comes after :attr:`delay`
    ``split``    the reply comes in two pieces, the second after :attr:`delay`
    ``merge``    the reply is held back and comes together with the next one
    ``stray``    the reply is, by its address, another unit's
    ============ ==========================================================================================

    Attributes
    ----------
    delay
        Wall-clock s of ``late`` and ``split``.
    change
        What a line's protocol makes of a reply or a request, by the name of the fault: ``mislead``, ``refuse``,
        ``deny`` and ``stray`` exist where there is one.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._left = dict.fromkeys((*REQUESTS, *REPLIES), 0)
        self._only = b""
        self._held = b""
        self.delay = 1.0
        self.change: dict[str, Change] = {}

    def set(self, kind: str, count: int, delay: float | None = None, only: bytes = b"") -> None:
        """Let the next ``count`` requests or replies suffer.

        Parameters
        ----------
        only
            What a request has to contain to be lost, misled or refused; any, where empty.

        Raises
        ------
        ValueError
            If there is no such fault on this line.
        """
        if kind not in self._left:
            raise ValueError(f"fault: found {kind!r}; expected one of {', '.join(self._left)}")
        if kind in ("mislead", "refuse", "deny", "stray") and kind not in self.change:
            raise ValueError(f"fault: {kind!r} does not exist on this line")
        with self._lock:
            self._left[kind] = int(count)
            self._only = only
            if delay is not None:
                self.delay = float(delay)

    def left(self, kind: str) -> int:
        """How many are still to suffer."""
        with self._lock:
            return self._left[kind]

    def request_lost(self, request: bytes = b"") -> bool:
        """Whether the request that is just arriving never does."""
        return self._takes("lose", request)

    def misled(self, request: bytes) -> bytes:
        """The request as it arrives."""
        return self.change["mislead"](request) if self._takes("mislead", request) else request

    def refusal(self, request: bytes) -> bytes:
        """The exception that answers a request; empty where it is carried out."""
        for kind in ("refuse", "deny"):
            if self._takes(kind, request):
                return self.change[kind](request)
        return b""

    def apply(self, reply: bytes) -> list[tuple[float, bytes]]:
        """The reply as it arrives: pieces, each after so many wall-clock seconds; none when it is lost."""
        with self._lock:
            kind = next((name for name in REPLIES if self._left[name] > 0), "")
            if kind:
                self._left[kind] -= 1
            if kind == "merge":
                self._held += reply
                return []
            held, self._held = self._held, b""
        middle = max(len(reply) // 2, 1)
        if kind == "drop":
            return [(0.0, held)] if held else []
        if kind == "corrupt":
            reply = reply[:middle] + bytes([reply[middle] ^ 0x15]) + reply[middle + 1 :]
        if kind == "stray":
            reply = self.change["stray"](reply)
        if kind == "split":
            return [(0.0, held + reply[:middle]), (self.delay, reply[middle:])]
        return [(self.delay if kind == "late" else 0.0, held + reply)]

    def _takes(self, kind: str, request: bytes) -> bool:
        with self._lock:
            hit = self._left[kind] > 0 and self._only in request
            self._left[kind] -= hit
            return hit


def deliver(reply: bytes, faults: Faults, send: Callable[[bytes], None]) -> None:
    """Send a reply through the faults of its line."""
    if not reply:
        return
    for delay, piece in faults.apply(reply):
        if delay > 0:
            timer = threading.Timer(delay, send, (piece,))
            timer.daemon = True
            timer.start()
        else:
            send(piece)


class OutputBuffer:
    """What one controller sends: a reply that is late holds up those behind it.

    Parameters
    ----------
    send
        The wire.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._lock = threading.Lock()
        self._waiting: deque[tuple[float, bytes]] = deque()

    def deliver(self, reply: bytes, faults: Faults) -> None:
        """Send a reply through the faults of its line, after all that were given before."""
        if not reply:
            return
        with self._lock:
            for delay, piece in faults.apply(reply):
                self._waiting.append((time.monotonic() + delay, piece))
            self._send_what_is_due()

    def _send_what_is_due(self) -> None:
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            self._send(self._waiting.popleft()[1])
        if self._waiting:
            timer = threading.Timer(self._waiting[0][0] - time.monotonic(), self._later)
            timer.daemon = True
            timer.start()

    def _later(self) -> None:
        with self._lock:
            self._send_what_is_due()


def changed_digit(request: bytes) -> bytes:
    """The last digit of a text replaced by another, so that it stays a number: what a line without checksum may do."""
    for place in range(len(request) - 1, 0, -1):
        if request[place : place + 1].isdigit():
            digit = b"0123456789"[(request[place] - 48 + 3) % 10]
            return request[:place] + bytes([digit]) + request[place + 1 :]
    return request
