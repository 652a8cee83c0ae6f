"""Opening ports: serial ports, pseudo-terminals and TCP connections, as plain byte wires."""

from __future__ import annotations

import errno
import os
import socket
import termios
from typing import TYPE_CHECKING, Protocol

import serial

if TYPE_CHECKING:
    from drivers.lines import ModbusSerialLineForm, SerialLineForm

#: Longest wait of one read of the port in s; deadlines are kept to this precision.
POLL = 0.02


#: URLs that lead to a port; others of the library write files (``spy``) or name classes (``alt``).
SCHEMES = ("socket", "rfc2217", "loop", "hwgrep")


class Wire(Protocol):
    """Bytes in and out. Every method raises OSError when the connection is lost."""

    @property
    def is_open(self) -> bool:
        """True between ``open`` and ``close``."""
        ...

    def open(self) -> None:
        """Open, or open again."""
        ...

    def close(self) -> None:
        """Close. May be repeated."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        ...

    def read(self) -> bytes:
        """What has arrived; waits at most :data:`POLL` seconds for the first byte."""
        ...

    def read_waiting(self) -> bytes:
        """What has arrived, without waiting."""
        ...


def is_pseudo_terminal(port: str) -> bool:
    """True where the port is a pseudo-terminal, which has neither parity nor flow control."""
    return os.path.realpath(port).startswith(("/dev/pts/", "/dev/ttys"))


def open_port(form: SerialLineForm | ModbusSerialLineForm) -> serial.Serial:
    """Open a serial port as the form says, locked against other programs.

    A pseudo-terminal refuses parity (the C library reports EINVAL where the kernel ignored it) and would
    swallow XON and XOFF bytes, so it is opened raw whatever the form says.

    Raises
    ------
    OSError
        If the port is missing, locked by another program or refuses its settings.
    ValueError
        If it is a URL of another scheme than :data:`SCHEMES`.
    """
    scheme = form.port.partition("://")[0] if "://" in form.port else ""
    if scheme and scheme not in SCHEMES:
        raise ValueError(f"port: found {form.port!r}; expected the name of a port, or {', '.join(SCHEMES)}://...")
    raw = is_pseudo_terminal(form.port)
    exclusive = {"exclusive": True} if os.name == "posix" and "://" not in form.port else {}
    try:
        return serial.serial_for_url(
            form.port,
            baudrate=form.baudrate,
            bytesize=getattr(form, "bytesize", 8),
            parity="N" if raw else form.parity,
            stopbits=1 if raw else form.stopbits,
            xonxoff=not raw and getattr(form, "xonxoff", False),
            rtscts=not raw and getattr(form, "rtscts", False),
            timeout=POLL,
            write_timeout=max(form.timeout, 1.0),
            **exclusive,
        )
    except serial.SerialException as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EAGAIN):
            raise OSError(f"{form.port} is in use by another program") from error
        raise
    except termios.error as error:
        raise OSError(f"{form.port} refuses its settings: {error}") from error


class SerialWire:
    """A serial port or pseudo-terminal."""

    def __init__(self, form: SerialLineForm | ModbusSerialLineForm) -> None:
        self._form = form
        self._port: serial.Serial | None = None

    def __str__(self) -> str:
        return self._form.port

    @property
    def is_open(self) -> bool:
        """True between ``open`` and ``close``."""
        return self._port is not None

    def open(self) -> None:
        """Open the port, or open it again."""
        self.close()
        self._port = open_port(self._form)

    def close(self) -> None:
        """Close the port. May be repeated."""
        if self._port is not None:
            self._port.close()
        self._port = None

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        if self._port is None:
            raise OSError(f"{self} is not open")
        self._port.write(data)

    def read(self) -> bytes:
        """What has arrived; waits at most :data:`POLL` seconds for the first byte."""
        if self._port is None:
            raise OSError(f"{self} is not open")
        first = self._port.read(1)
        return first + self.read_waiting() if first else first

    def read_waiting(self) -> bytes:
        """What has arrived, without waiting."""
        if self._port is None:
            raise OSError(f"{self} is not open")
        return self._port.read(self._port.in_waiting)


class TcpWire:
    """A plain TCP connection."""

    def __init__(self, host: str, port: int, connect_timeout: float = 3.0) -> None:
        self._address = (host, port)
        self._connect_timeout = connect_timeout
        self._socket: socket.socket | None = None

    def __str__(self) -> str:
        return f"{self._address[0]}:{self._address[1]}"

    @property
    def is_open(self) -> bool:
        """True between ``open`` and ``close``."""
        return self._socket is not None

    def open(self) -> None:
        """Connect, or connect again."""
        self.close()
        self._socket = open_socket(*self._address, self._connect_timeout)

    def close(self) -> None:
        """Close the connection. May be repeated."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        if self._socket is None:
            raise OSError(f"{self} is not connected")
        self._socket.settimeout(self._connect_timeout)
        self._socket.sendall(data)

    def read(self) -> bytes:
        """What has arrived; waits at most :data:`POLL` seconds for the first byte."""
        return self._receive(POLL)

    def read_waiting(self) -> bytes:
        """What has arrived, without waiting."""
        return self._receive(0.0)

    def _receive(self, wait: float) -> bytes:
        if self._socket is None:
            raise OSError(f"{self} is not connected")
        self._socket.settimeout(wait)
        try:
            data = self._socket.recv(4096)
        except (TimeoutError, BlockingIOError):
            return b""
        if not data:
            raise ConnectionResetError(f"{self} closed the connection")
        return data


def open_socket(host: str, port: int, timeout: float) -> socket.socket:
    """Connect to a TCP server without the delay of Nagle's algorithm."""
    connection = socket.create_connection((host, port), timeout=timeout)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection
