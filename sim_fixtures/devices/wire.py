"""Wires: pseudo-terminals that stand for serial lines."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from sim_fixtures.devices.faults import Faults, OutputBuffer, deliver

#: Wall-clock seconds between looks at a line that nobody has opened.
_IDLE = 0.01


class Handler(Protocol):
    """A device at the end of a line; it asks ``request_lost`` about every request that it has recognised."""

    request_lost: Callable[[bytes], bool]

    def feed(self, data: bytes) -> list[bytes]:
        """Take what arrived, in pieces of any size; return the replies that are due."""
        ...


class SerialLine:
    """A serial line: a pseudo-terminal under a fixed name, with a device behind it.

    The name is a symbolic link, so that the line keeps it when it is cut and comes back.

    Parameters
    ----------
    link
        Path that a client opens.
    faults
        What happens to the replies.
    """

    def __init__(self, link: Path, faults: Faults | None = None) -> None:
        self.link = link
        self.faults = faults or Faults()
        self._lock = threading.Lock()
        self._master: int | None = None
        self._doomed: list[int] = []
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._receive: Callable[[bytes], None] = lambda _: None
        #: Rate of the device; where it is given, a client at another rate and the device do not understand each other.
        self.baudrate: int | None = None
        self._connect()

    def serve(self, handler: Handler, one_device: bool = False) -> None:
        """Answer in a thread of its own.

        Parameters
        ----------
        handler
            What stands at the far end.
        one_device
            Whether that is one device, whose replies never overtake each other; those of several on one bus may.
        """
        buffer = OutputBuffer(self.write)

        def receive(data: bytes) -> None:
            for reply in handler.feed(self.faults.misled(data)):
                if one_device:
                    buffer.deliver(reply, self.faults)
                else:
                    deliver(reply, self.faults, self.write)

        handler.request_lost = self.faults.request_lost
        self.listen(receive)

    def listen(self, receive: Callable[[bytes], None]) -> None:
        """Hand what arrives to a function, in a thread of its own."""
        self._receive = receive
        self._thread = threading.Thread(target=self._read, name=f"line {self.link.name}", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Send bytes to the client; lost while the line is cut."""
        with self._lock:
            if self._master is None:
                return
            with contextlib.suppress(OSError):  # the client has gone away or does not read
                os.write(self._master, self._garbled(data))

    def disconnect(self, seconds: float = 0.0) -> None:
        """Pull the plug; the line comes back under its name after so many wall-clock seconds (0: never)."""
        with self._lock:
            if self._master is not None:
                self._doomed.append(self._master)
                self._master = None
            self.link.unlink(missing_ok=True)
        if self._thread is None or not self._thread.is_alive():
            self._hang_up()
        if seconds > 0:
            timer = threading.Timer(seconds, self._connect)
            timer.daemon = True
            timer.start()

    def close(self) -> None:
        """Remove the line."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        self.disconnect()

    def _connect(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        name = os.ttyname(slave)
        # The far end stays closed: a client that asks for exclusive use must get it again after it has left.
        os.close(slave)
        os.set_blocking(master, False)
        with self._lock:
            if self._stopped.is_set():
                os.close(master)
                return
            self._master = master
            self.link.unlink(missing_ok=True)
            self.link.symlink_to(name)

    def _hang_up(self) -> None:
        """Close what was cut: only the reader may, or the number could name another file while it reads."""
        with self._lock:
            while self._doomed:
                os.close(self._doomed.pop())

    def _read(self) -> None:
        while not self._stopped.is_set():
            self._hang_up()
            master = self._master
            data = _read_available(master) if master is not None else b""
            if data:
                self._receive(self._garbled(data))
            elif data is None or master is None:
                time.sleep(_IDLE)

    def _garbled(self, data: bytes) -> bytes:
        """What arrives of bytes that were sent: something else where the two ends run at different rates."""
        if self.baudrate is None or self._master is None:
            return data
        # The two ends of a pseudo-terminal share their settings, so the rate that the client chose can be read here.
        if termios.tcgetattr(self._master)[4] == getattr(termios, f"B{self.baudrate}"):
            return data
        return bytes((0x9D * byte + 0x3B) & 0xFF for byte in data)


def _read_available(master: int) -> bytes | None:
    """Bytes that have arrived within 0.05 s; None while no client holds the line."""
    try:
        ready, _, _ = select.select([master], [], [], 0.05)
        return os.read(master, 4096) if ready else b""
    except BlockingIOError:
        return b""
    except OSError:  # EIO: nobody has opened the far end
        return None
