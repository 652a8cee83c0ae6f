"""A wire that several devices share: it is released when the last of them leaves."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.errors import CommunicationError


class SharedLine:
    """Users and the lock of one wire.

    Parameters
    ----------
    name
        Name of the line in ``devices.toml``.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._lock = threading.RLock()
        self._users: set[str] = set()
        self._closed = False

    def attach(self, user: str) -> None:
        """Note that a device uses the line."""
        self._users.add(user)

    def release(self, user: str) -> None:
        """A device leaves; the last one closes the wire. May be repeated."""
        self._users.discard(user)
        if not self._users:
            self.close()

    def close(self) -> None:
        """Release the wire for good. May be repeated."""
        with self._lock:
            self._closed = True
            self._close_wire()

    @contextmanager
    def transaction(self, device: str) -> Iterator[None]:
        """Keep the wire for several exchanges that belong together.

        Raises
        ------
        CommunicationError
            If the line is closed.
        """
        with self._lock:
            if self._closed:
                raise CommunicationError(device, f"line {self.name!r} is closed", "connect again")
            yield

    def _close_wire(self) -> None:
        raise NotImplementedError
