"""An exclusive lock on an instrument, so that two programs never drive one.

One lock file stands for one wire (a serial port, a host and port, a VISA resource). The kernel holds the locks
(``flock``): they vanish with the process, however it ends, and a stale file blocks nobody.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import re
import socket
import tempfile
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO

from drivers.errors import DeviceError

#: Overrides where lock files lie.
DIRECTORY_VARIABLE = "GONIOTWIN_LOCK_DIR"


class InstrumentBusy(DeviceError):
    """Another program holds the instrument; the message names it."""


def lock_directory() -> Path:
    """Where lock files lie: one place for all users of a machine, since they share its instrument."""
    if named := os.environ.get(DIRECTORY_VARIABLE):
        return Path(named)
    shared = Path("/run/lock")
    return shared if os.access(shared, os.W_OK) else Path(tempfile.gettempdir())


class InstrumentLock:
    """Holds every wire of an instrument; a context manager.

    Parameters
    ----------
    endpoints
        What is locked, as names that every program writes alike (``/dev/ttyUSB0``, ``192.168.0.3:5025``). Links to
        a device are followed.
    directory
        Where the lock files lie; :func:`lock_directory` by default.
    """

    def __init__(self, endpoints: Iterable[str], directory: Path | None = None) -> None:
        self.endpoints = tuple(sorted({_canonical(endpoint) for endpoint in endpoints}))
        self._directory = directory or lock_directory()
        self._held: list[IO[str]] = []

    def acquire(self) -> None:
        """Take all locks or none.

        Raises
        ------
        InstrumentBusy
            If another process, or another lock of this one, holds any of them; names its process id.
        """
        try:
            for endpoint in self.endpoints:
                self._held.append(self._take(endpoint))
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Let go. May be repeated."""
        while self._held:
            handle = self._held.pop()
            handle.seek(0)
            handle.truncate()
            handle.close()

    def __enter__(self) -> InstrumentLock:
        self.acquire()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def path(self, endpoint: str) -> Path:
        """The lock file of an endpoint."""
        digest = hashlib.sha256(_canonical(endpoint).encode()).hexdigest()[:16]
        return self._directory / f"goniotwin-{digest}.lock"

    def _take(self, endpoint: str) -> IO[str]:
        handle = _open(self.path(endpoint))
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = _holder(handle)
            handle.close()
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                raise
            raise InstrumentBusy(
                endpoint, f"in use by {holder}", "end that program first; two programs must not drive one instrument"
            ) from None
        handle.seek(0)
        handle.truncate()
        json.dump(
            {
                "pid": os.getpid(),
                "host": socket.gethostname(),
                "since": datetime.now(UTC).isoformat(timespec="seconds"),
                "endpoint": endpoint,
            },
            handle,
        )
        handle.flush()
        return handle


def _open(path: Path) -> IO[str]:
    """Open for reading and writing, and for every user; never create over another user's file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        try:
            return os.fdopen(os.open(path, os.O_RDWR | os.O_CLOEXEC), "r+", encoding="utf-8")
        except FileNotFoundError:
            pass
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            continue
        os.fchmod(descriptor, 0o666)
        return os.fdopen(descriptor, "r+", encoding="utf-8")


def _holder(handle: IO[str]) -> str:
    try:
        handle.seek(0)
        who = json.load(handle)
        return f"process {who['pid']} on {who['host']} since {who['since']}"
    except (ValueError, KeyError, TypeError):
        return "another process"


#: Names of this machine on its own network; one port must have one name.
_LOOPBACK = re.compile(r"(?<![\w.:-])(localhost(\.localdomain)?|127(\.\d{1,3}){3}|\[?::1\]?)(?![\w.])", re.IGNORECASE)
_VISA = re.compile(r"[A-Za-z]+\d*::")


def _canonical(endpoint: str) -> str:
    """One name for what several names stand for: links, this machine, a host's and a resource's capitals."""
    if endpoint.startswith("/"):
        return os.path.realpath(endpoint)
    if _VISA.match(endpoint):
        parts = [_LOOPBACK.sub("127.0.0.1", part) for part in endpoint.upper().split("::")]
        return "::".join([re.sub(r"^(TCPIP|GPIB|USB|ASRL)$", r"\g<1>0", parts[0]), *parts[1:]])
    return _LOOPBACK.sub("127.0.0.1", endpoint.lower())
