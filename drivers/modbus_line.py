"""A Modbus line: pymodbus speaks, this module keeps order.

pymodbus is told never to retry; ports are opened here, so that a failure has a reason and a pseudo-terminal
works. RTU replies carry neither register address nor transaction number: a late reply of the right length is
taken for the next one. After a time-out the line therefore waits for silence and, with a slave that knows
function 08, sends an echo request with a fresh number, whose reply proves that nothing older is on its way.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.pdu import ExceptionResponse, ModbusPDU

from drivers.errors import CommandRefused, CommunicationError
from drivers.ports import open_port, open_socket
from drivers.sharing import SharedLine

if TYPE_CHECKING:
    from drivers.lines import ModbusSerialLineForm, ModbusTcpLineForm

# Without a handler of its own, the library's error log would be printed over the progress of a scan.
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())

#: Exception codes in words, Modbus Application Protocol 1.1b3, section 7.
EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge: still processing",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not respond",
}

#: Exceptions that say "not now": the same request may succeed a little later.
TRANSIENT = (5, 6)

#: Silence in s that ends the wait for late replies; pause in s that a busy slave is given.
QUIET, BUSY_PAUSE = 0.06, 0.05

Client = ModbusSerialClient | ModbusTcpClient


class ModbusLine(SharedLine):
    """A Modbus line shared by its slaves.

    Parameters
    ----------
    name
        Name of the line in ``devices.toml``.
    client
        Synchronous pymodbus client with ``retries=0``.
    open_socket
        Opens the port or connection for the client; raises OSError with the reason.
    timeout
        Longest wait for a reply in wall-clock s.
    frame_gap
        Silence between two frames in s.

    Raises
    ------
    OSError
        If the port cannot be opened.
    """

    def __init__(
        self, name: str, client: Client, connect: Callable[[], object], timeout: float, frame_gap: float
    ) -> None:
        super().__init__(name)
        self.timeout, self._frame_gap = timeout, frame_gap
        self._client, self._connect = client, connect
        self._echoing: set[int] = set()
        self._numbers = itertools.cycle(range(1, 0xFFFF))
        self._suspect = False
        self._last_frame = 0.0
        self._reopen()

    def slave_echoes(self, slave: int) -> None:
        """Note that a slave answers function 08, which brings the line back into step after a time-out."""
        self._echoing.add(slave)

    def read_registers(self, device: str, slave: int, address: int, count: int = 1) -> list[int]:
        """Holding registers (function 03), 16 bits each."""
        reply = self._ask(
            device,
            slave,
            3,
            f"read of {count} registers at {address:04X}h",
            lambda: self._client.read_holding_registers(address, count=count, device_id=slave),
        )
        return self._of_length(device, list(reply.registers), count)

    def write_register(self, device: str, slave: int, address: int, value: int, *, urgent: bool = False) -> None:
        """Write one register (function 06); an urgent write (a stop) goes out before the line is in step again."""
        what = f"write of {value:04X}h to {address:04X}h"
        reply = self._ask(
            device, slave, 6, what, lambda: self._client.write_register(address, value, device_id=slave), urgent
        )
        self._same(device, what, (reply.address, list(reply.registers)), (address, [value]))

    def write_registers(self, device: str, slave: int, address: int, values: Sequence[int]) -> None:
        """Write registers in one frame (function 10h)."""
        what = f"write of {len(values)} registers at {address:04X}h"
        reply = self._ask(
            device, slave, 16, what, lambda: self._client.write_registers(address, list(values), device_id=slave)
        )
        self._same(device, what, (reply.address, reply.count), (address, len(values)))

    def read_coils(self, device: str, slave: int, address: int, count: int) -> list[bool]:
        """Coils (function 01)."""
        reply = self._ask(
            device,
            slave,
            1,
            f"read of {count} coils at {address}",
            lambda: self._client.read_coils(address, count=count, device_id=slave),
        )
        return self._bits(device, reply, count)

    def read_inputs(self, device: str, slave: int, address: int, count: int) -> list[bool]:
        """Discrete inputs (function 02)."""
        reply = self._ask(
            device,
            slave,
            2,
            f"read of {count} inputs at {address}",
            lambda: self._client.read_discrete_inputs(address, count=count, device_id=slave),
        )
        return self._bits(device, reply, count)

    def write_coil(self, device: str, slave: int, address: int, value: bool) -> None:
        """Write one coil (function 05)."""
        what = f"write of coil {address}"
        reply = self._ask(device, slave, 5, what, lambda: self._client.write_coil(address, value, device_id=slave))
        self._same(device, what, (reply.address, reply.bits[0]), (address, value))

    def write_coils(self, device: str, slave: int, address: int, values: Sequence[bool]) -> None:
        """Write neighbouring coils in one frame (function 0Fh), so that they change together."""
        what = f"write of {len(values)} coils at {address}"
        reply = self._ask(
            device, slave, 15, what, lambda: self._client.write_coils(address, list(values), device_id=slave)
        )
        self._same(device, what, (reply.address, reply.count), (address, len(values)))

    def echo(self, device: str, slave: int) -> None:
        """Send a fresh number with function 08 and wait for the same one, letting older replies pass.

        Raises
        ------
        CommunicationError
            If the number does not come back.
        """
        with self.transaction(device):
            number = next(self._numbers).to_bytes(2, "big")
            self._prepare(device)
            reply = self._execute(device, "echo test", lambda: self._client.diag_query_data(number, device_id=slave))
            if isinstance(reply, ExceptionResponse):
                raise self._refused(device, "echo test", reply)
            if getattr(reply, "message", None) != number:
                self._suspect = True
                raise CommunicationError(device, f"line {self.name!r} is out of step: the echo test got another reply")

    def _ask(
        self, device: str, slave: int, function: int, what: str, call: Callable[[], ModbusPDU], urgent: bool = False
    ) -> ModbusPDU:
        """One request and its reply; the shape of the reply is the caller's to check."""
        with self.transaction(device):
            if self._suspect and slave in self._echoing and not urgent:
                self.echo(device, slave)
            self._prepare(device)
            reply = self._execute(device, what, call)
            if reply.function_code == function:
                return reply
            if reply.function_code == function | 0x80:
                raise self._refused(device, what, reply)
            self._suspect = True
            raise CommunicationError(
                device, f"{what} on line {self.name!r} was answered by function {reply.function_code:02X}h"
            )

    def _execute(self, device: str, what: str, call: Callable[[], ModbusPDU]) -> ModbusPDU:
        # Until the reply is there, whatever ends the wait (an interrupt too) leaves it on its way.
        self._suspect = True
        try:
            reply = call()
            self._suspect = False
            return reply
        except (ConnectionException, OSError) as error:
            self._close_wire()
            raise self._silent(device, what, f"connection lost: {error}") from error
        except ModbusException as error:
            raise self._silent(device, what, f"no valid reply within {self.timeout:g} s") from error
        finally:
            self._last_frame = time.monotonic()

    def _silent(self, device: str, what: str, why: str) -> CommunicationError:
        self._suspect = True
        return CommunicationError(
            device, f"{what} on line {self.name!r}: {why}", "check power, cable, address, baud rate and parity"
        )

    def _prepare(self, device: str) -> None:
        """Restore the connection, let late replies pass, keep the silence between frames."""
        try:
            if not self._client.connected:
                self._reopen()
            if self._suspect:
                self._drain()
        except OSError as error:
            self._close_wire()
            raise self._silent(device, "request", f"the line cannot be reopened: {error}") from error
        self._suspect = False
        pause = self._frame_gap - (time.monotonic() - self._last_frame)
        if pause > 0:
            time.sleep(pause)

    def _drain(self) -> None:
        """Read until nothing has come for :data:`QUIET` seconds, at most for the time-out of the line."""
        limit = time.monotonic() + max(self.timeout, QUIET)
        silent_since = time.monotonic()
        while time.monotonic() < limit and time.monotonic() - silent_since < QUIET:
            if self._read_waiting():
                silent_since = time.monotonic()
            else:
                time.sleep(0.005)

    def _read_waiting(self) -> bytes:
        if isinstance(self._client, ModbusSerialClient):
            port = self._client.socket
            return port.read(port.in_waiting) if port is not None else b""
        connection = self._client.socket
        if connection is None:
            return b""
        connection.settimeout(0.0)
        try:
            data = connection.recv(4096)
        except (TimeoutError, BlockingIOError):
            return b""
        if not data:
            raise ConnectionResetError("the server closed the connection")
        return data

    def _reopen(self) -> None:
        self._client.socket = self._connect()  # type: ignore[assignment]

    def _close_wire(self) -> None:
        self._client.close()

    def _of_length(self, device: str, values: list[int], count: int) -> list[int]:
        if len(values) != count:
            self._suspect = True
            raise CommunicationError(device, f"{len(values)} registers came on line {self.name!r}, expected {count}")
        return values

    def _bits(self, device: str, reply: ModbusPDU, count: int) -> list[bool]:
        expected = (count + 7) // 8 * 8
        if len(reply.bits) != expected:
            self._suspect = True
            raise CommunicationError(device, f"{len(reply.bits)} bits came on line {self.name!r}, expected {expected}")
        return [bool(bit) for bit in reply.bits[:count]]

    def _same(self, device: str, what: str, found: object, expected: object) -> None:
        if found != expected:
            self._suspect = True
            raise CommunicationError(device, f"{what} on line {self.name!r} was confirmed as {found}, not {expected}")

    def _refused(self, device: str, what: str, reply: ModbusPDU) -> CommandRefused | CommunicationError:
        code = reply.exception_code
        problem = f"{what}: exception {code:02X}h, {EXCEPTIONS.get(code, 'unknown')}"
        if code not in TRANSIENT:
            return CommandRefused(device, problem)
        time.sleep(BUSY_PAUSE)
        return CommunicationError(device, problem, "it may be asked again")


def open_serial(name: str, form: ModbusSerialLineForm) -> ModbusLine:
    """Modbus RTU over a serial port or pseudo-terminal."""
    client = ModbusSerialClient(
        form.port, baudrate=form.baudrate, parity=form.parity, stopbits=form.stopbits, timeout=form.timeout, retries=0
    )
    return ModbusLine(name, client, lambda: open_port(form), form.timeout, form.frame_gap)


def open_tcp(name: str, form: ModbusTcpLineForm) -> ModbusLine:
    """Modbus TCP, or RTU frames through a transparent serial server."""
    framer = FramerType.RTU if form.framing == "rtu" else FramerType.SOCKET
    client = ModbusTcpClient(form.host, port=form.port, framer=framer, timeout=form.timeout, retries=0)
    return ModbusLine(
        name, client, lambda: open_socket(form.host, form.port, max(form.timeout, 1.0)), form.timeout, form.frame_gap
    )
