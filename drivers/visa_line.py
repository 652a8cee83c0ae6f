"""A VISA line: SCPI text over PyVISA, with a clean start after any time-out.

A reading that arrives after its time-out would join the next reply. A raw TCP socket has no device clear (and
pyvisa-py's spins for ever on a connection the other side has closed), so a socket is closed and opened again:
what was late dies with the old connection. Other resources are cleared.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pyvisa

from drivers.errors import CommunicationError
from drivers.sharing import SharedLine
from drivers.transport import NoReply

if TYPE_CHECKING:
    from drivers.lines import VisaLineForm


class VisaLine(SharedLine):
    """A VISA resource with deadlines.

    Parameters
    ----------
    name
        Name of the line in ``devices.toml``.
    form
        Its description there.

    Attributes
    ----------
    generation
        Counts how often the resource was opened: a device that was opened again may have forgotten its settings.

    Raises
    ------
    OSError
        If the resource cannot be opened.
    """

    def __init__(self, name: str, form: VisaLineForm) -> None:
        super().__init__(name)
        self.timeout = form.timeout
        self.generation = 0
        self._form = form
        self._resource: Any = None
        self._open()

    def write(self, device: str, command: str) -> None:
        """Send a command that has no reply.

        Raises
        ------
        CommunicationError
            If the connection is lost.
        """
        self._exchange(device, command, None)

    def query(self, device: str, command: str, timeout: float | None = None) -> str:
        """Send a query and wait for its reply, at most ``timeout`` wall-clock seconds.

        Raises
        ------
        NoReply
            If none came; the line is cleared before its next use.
        CommunicationError
            If the connection is lost.
        """
        return self._exchange(device, command, timeout or self.timeout)

    def reset(self) -> None:
        """Forget every reply that may still be on its way."""
        with self._lock:
            if self._resource is None:
                return
            if self._form.resource.upper().endswith("::SOCKET"):
                self._close_wire()
                return
            try:
                self._resource.clear()
            except (pyvisa.errors.Error, OSError):
                self._close_wire()  # a resource that cannot even be cleared is opened anew

    def ready(self, device: str) -> int:
        """Open the resource where it is not open; returns :attr:`generation`."""
        with self.transaction(device):
            if self._resource is None:
                try:
                    self._open()
                except OSError as error:
                    raise self._failed(device, "opening", error) from error
            return self.generation

    def _exchange(self, device: str, command: str, timeout: float | None) -> str:
        with self.transaction(device):
            self.ready(device)
            started = time.monotonic()
            try:
                if timeout is None:
                    self._resource.write(command)
                    return ""
                self._resource.timeout = timeout * 1000.0
                return str(self._resource.query(command)).strip()
            except pyvisa.errors.VisaIOError as error:
                waited = time.monotonic() - started
                self.reset()
                if error.error_code != pyvisa.constants.StatusCode.error_timeout:
                    raise self._failed(device, repr(command), error) from error
                raise NoReply(
                    device, f"no reply to {command!r} on line {self.name!r} within {waited:.1f} s", "check the cable"
                ) from error
            except (OSError, UnicodeDecodeError) as error:
                self._close_wire()
                raise self._failed(device, repr(command), error) from error
            except BaseException:
                self.reset()  # an interrupt leaves the reply on its way
                raise

    def _failed(self, device: str, what: str, error: Exception) -> CommunicationError:
        return CommunicationError(
            device, f"{what} failed on line {self.name!r} ({self._form.resource}): {error}", "check address and cable"
        )

    def _open(self) -> None:
        manager = pyvisa.ResourceManager(self._form.backend)
        try:
            self._resource = manager.open_resource(
                self._form.resource,
                open_timeout=int(self._form.connect_timeout * 1000),
                timeout=self.timeout * 1000.0,
                read_termination="\n",
                write_termination="\n",
            )
        except Exception as error:
            # pyvisa-py raises bare Exception where a host does not answer, ValueError where a name is malformed.
            raise OSError(str(error)) from error
        self.generation += 1

    def _close_wire(self) -> None:
        resource, self._resource = self._resource, None
        if resource is not None:
            resource.close()
