"""The wires named in ``devices.toml``, and how each is opened."""

from __future__ import annotations

from typing import Annotated, Literal, Protocol, runtime_checkable

from pydantic import Field, PositiveFloat, PositiveInt

from drivers.forms import Form

Parity = Literal["N", "E", "O"]
Timeout = Annotated[float, Field(gt=0, le=60)]
PortNumber = Annotated[int, Field(ge=1, le=65535)]


@runtime_checkable
class OpenLine(Protocol):
    """Any open wire."""

    name: str

    def close(self) -> None:
        """Release the wire. May be repeated."""
        ...


class SerialLineForm(Form):
    """A serial port or pseudo-terminal; ``timeout`` (wall-clock s) bounds the wait for one reply."""

    kind: Literal["serial"]
    port: str
    baudrate: PositiveInt = 9600
    bytesize: Literal[7, 8] = 8
    parity: Parity = "N"
    stopbits: Literal[1, 2] = 1
    xonxoff: bool = False
    rtscts: bool = False
    timeout: Timeout = 1.0

    def open(self, name: str) -> OpenLine:
        """Open the port."""
        from drivers.transport import Line, SerialWire

        return Line(name, SerialWire(self), self.timeout)


class TcpLineForm(Form):
    """A plain TCP connection, as a serial server offers it."""

    kind: Literal["tcp"]
    host: str
    port: PortNumber
    timeout: Timeout = 1.0

    def open(self, name: str) -> OpenLine:
        """Connect."""
        from drivers.transport import Line, TcpWire

        return Line(name, TcpWire(self.host, self.port, connect_timeout=max(self.timeout, 1.0)), self.timeout)


class ModbusSerialLineForm(Form):
    """Modbus RTU over a serial port; ``frame_gap`` is the silence between two frames in s."""

    kind: Literal["modbus-serial"]
    port: str
    baudrate: PositiveInt = 9600
    parity: Parity = "N"
    stopbits: Literal[1, 2] = 1
    timeout: Timeout = 1.0
    frame_gap: Annotated[float, Field(ge=0, le=1)] = 0.003

    def open(self, name: str) -> OpenLine:
        """Open the port."""
        from drivers.modbus_line import open_serial

        return open_serial(name, self)


class ModbusTcpLineForm(Form):
    """Modbus over TCP: ``framing`` is ``socket`` (Modbus TCP) or ``rtu`` (a transparent serial server)."""

    kind: Literal["modbus-tcp"]
    host: str
    port: PortNumber = 502
    framing: Literal["socket", "rtu"] = "socket"
    timeout: Timeout = 1.0
    frame_gap: Annotated[float, Field(ge=0, le=1)] = 0.0

    def open(self, name: str) -> OpenLine:
        """Connect."""
        from drivers.modbus_line import open_tcp

        return open_tcp(name, self)


class VisaLineForm(Form):
    """A VISA resource, opened with ``backend``: ``@py`` is pyvisa-py, ``@ivi`` the library that the system names.

    A library by its path is refused: a file of connections must not be able to load one.
    """

    kind: Literal["visa"]
    resource: str
    backend: Annotated[str, Field(pattern=r"^(@py|@ivi|[^@]*@sim)$")] = "@py"
    timeout: Timeout = 2.0
    connect_timeout: PositiveFloat = 3.0

    def open(self, name: str) -> OpenLine:
        """Open the resource."""
        from drivers.visa_line import VisaLine

        return VisaLine(name, self)


LineForm = Annotated[
    SerialLineForm | TcpLineForm | ModbusSerialLineForm | ModbusTcpLineForm | VisaLineForm,
    Field(discriminator="kind"),
]
