"""A scripted peer on a real pseudo-terminal: driver tests read like a conversation."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Late:
    """A reply that is sent so many wall-clock seconds after the request."""

    delay: float
    data: bytes


Reply = bytes | Late | None
Step = tuple[bytes, Reply]


class Peer:
    """Expects requests in order, byte for byte, and answers each as the script says."""

    def __init__(self, script: Sequence[Step]) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        os.close(slave)
        self._script = list(script)
        self.surprises: list[str] = []
        self._stop = threading.Event()
        self._timers: list[threading.Timer] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Send bytes that nobody asked for."""
        os.write(self._master, data)

    def hang_up(self) -> None:
        """Cut the line."""
        self._stop.set()
        self._thread.join()
        if self._master >= 0:
            os.close(self._master)
        self._master = -1

    def finish(self) -> None:
        """Assert that the whole script was spoken, and nothing else."""
        deadline = time.monotonic() + 1.0
        while self._script and not self.surprises and time.monotonic() < deadline:
            time.sleep(0.005)
        for timer in self._timers:
            timer.join()
        self.hang_up()
        assert not self.surprises, self.surprises
        assert not self._script, f"never asked: {[request for request, _ in self._script]}"

    def _run(self) -> None:
        received = b""
        while not self._stop.is_set():
            received += self._read()
            if not received:
                continue
            if not self._script:
                self.surprises.append(f"not expected any more: {received!r}")
                return
            wanted, reply = self._script[0]
            if received.startswith(wanted):
                received = received[len(wanted) :]
                self._script.pop(0)
                self._answer(reply)
            elif not wanted.startswith(received):
                self.surprises.append(
                    f"expected {wanted!r} ({wanted.hex(' ')}), got {received!r} ({received.hex(' ')})"
                )
                return

    def _read(self) -> bytes:
        try:
            ready, _, _ = select.select([self._master], [], [], 0.01)
            return os.read(self._master, 4096) if ready else b""
        except OSError:  # nobody has opened the other end yet, or any more
            time.sleep(0.005)
            return b""

    def _answer(self, reply: Reply) -> None:
        if isinstance(reply, Late):
            timer = threading.Timer(reply.delay, self.send, (reply.data,))
            self._timers.append(timer)
            timer.start()
        elif reply:
            self.send(reply)


def unhex(text: str) -> bytes:
    """Bytes of a frame written in hexadecimal."""
    return bytes.fromhex(text)


def rtu(text: str) -> bytes:
    """A Modbus RTU frame: the bytes with their CRC-16 (polynomial A001h, initial value FFFFh), low byte first."""
    body = unhex(text)
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return body + crc.to_bytes(2, "little")
