"""Questions that find out who answers on a wire, whatever the configuration says; nothing moves by any of them.

One question of each known protocol, asked on the bare wire: replies are only read, counted and put into words.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.lines import LineForm, ModbusSerialLineForm, ModbusTcpLineForm, SerialLineForm, TcpLineForm
from drivers.nkt_interbus import Kind, Telegram, TelegramError, build, parse, split
from drivers.nkt_module import TYPE, TYPES
from drivers.ports import SerialWire, TcpWire, Wire

#: Wall-clock s without an answer after which nobody is there, and the silence that ends an answer.
LISTEN, QUIET = 0.25, 0.06
SMC100, ESP301, AZ, MODBUS_IO = "Newport SMC100", "Newport ESP301", "Oriental Motor AZ", "Modbus I/O module"
OTHER_SLAVE = "Modbus slave of another kind"
#: Rates in use, by how often they are met.
RATES = (9600, 19200, 38400, 57600, 115200)


@dataclass(frozen=True)
class Answer:
    """Who answered: its kind, its address (None where the protocol has none) and what it said."""

    kind: str
    unit: int | None
    words: str = ""

    def __str__(self) -> str:
        where = "" if self.unit is None else f" at address {self.unit}"
        return f"{self.kind}{where}" + (f" ({self.words})" if self.words else "")


@dataclass(frozen=True)
class Probe:
    """A protocol: the addresses worth asking, the question to each, and what replies say.

    Attributes
    ----------
    units
        None where there is one device a wire.
    """

    name: str
    units: tuple[int | None, ...]
    question: Callable[[int | None], bytes]
    answers: Callable[[bytes], list[Answer]]


class Listener:
    """One wire, opened for questions.

    Parameters
    ----------
    form
        The line, of any kind but VISA and Modbus TCP, which :func:`can_listen` tells.
    baudrate
        In place of the configured one.

    Raises
    ------
    OSError
        If it cannot be opened.
    """

    def __init__(self, form: LineForm, baudrate: int | None = None) -> None:
        if isinstance(form, SerialLineForm | ModbusSerialLineForm):
            self._wire: Wire = SerialWire(form.model_copy(update={"baudrate": baudrate or form.baudrate}))
        elif isinstance(form, TcpLineForm | ModbusTcpLineForm):
            self._wire = TcpWire(form.host, form.port)
        else:
            raise TypeError(f"no probe for lines of kind {form.kind}")
        self.noise = b""
        self._wire.open()

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._wire.close()

    def ask(self, probe: Probe, units: Iterable[int | None] | None = None) -> list[Answer]:
        """Ask each address; what is no answer is added to ``noise``."""
        found: list[Answer] = []
        for unit in probe.units if units is None else units:
            received = self._exchange(probe.question(unit))
            answers = probe.answers(received)
            if received and not answers:
                self.noise += received
            found += answers
        return found

    def _exchange(self, request: bytes) -> bytes:
        self._wire.read_waiting()
        self._wire.write(request)
        received, began = b"", time.monotonic()
        last = began
        while time.monotonic() - last < (QUIET if received else LISTEN) and time.monotonic() - began < 4 * LISTEN:
            if piece := self._wire.read():
                received, last = received + piece, time.monotonic()
        return received


def can_listen(form: LineForm) -> bool:
    """Whether the wire carries plain bytes: not VISA, and not Modbus in TCP's own frames."""
    return form.kind != "visa" and not (isinstance(form, ModbusTcpLineForm) and form.framing == "socket")


def _smc100(received: bytes) -> list[Answer]:
    found = re.findall(rb"^\s*(\d{1,2})VE *([ -~]*)\r?$", received, re.MULTILINE)
    return [Answer(SMC100, int(unit), words.decode().strip()) for unit, words in found]


def _esp301(received: bytes) -> list[Answer]:
    return [Answer(ESP301, None, words.decode().strip()) for words in re.findall(rb"ESP30\d[ -~]*", received)]


def _interbus(received: bytes) -> list[Answer]:
    found = []
    for frame in split(received)[0]:
        try:
            telegram = parse(frame)
        except TelegramError:
            continue
        if telegram.kind == Kind.DATAGRAM and telegram.register == TYPE:
            kind = int.from_bytes(telegram.data, "little")
            found.append(Answer(f"NKT {TYPES.get(kind, f'module of type {kind:02X}h')}", telegram.source))
    return found


def _modbus(kind: str, function: int, length: int) -> Callable[[bytes], list[Answer]]:
    def answers(received: bytes) -> list[Answer]:
        found: list[Answer] = []
        while len(received) >= 5:
            refused = received[1] == function | 0x80
            size = 5 if refused else length
            frame, received = received[:size], received[size:]
            if len(frame) < size or crc16(frame[:-2]) != frame[-2:] or frame[1] & 0x7F != function:
                return found
            words = f"exception {frame[2]:02X}h" if refused else ""
            found.append(Answer(OTHER_SLAVE if refused else kind, frame[0], words))
        return found

    return answers


def crc16(body: bytes) -> bytes:
    """CRC-16 of Modbus RTU (polynomial A001h reflected, start FFFFh), low byte first."""
    crc = 0xFFFF
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return crc.to_bytes(2, "little")


def _frame(unit: int | None, rest: str) -> bytes:
    body = bytes([unit or 0]) + bytes.fromhex(rest)
    return body + crc16(body)


_SLAVES = (1, 2, 3, 4, 5)
#: Every protocol that is known. Text begins with an end of line, behind what garbage may have gone before.
PROBES = {
    "smc100": Probe("smc100", (1, 2, 3, 4, 5), lambda unit: f"\r\n{unit}VE\r\n".encode(), _smc100),
    "esp301": Probe("esp301", (None,), lambda _: b"\rVE?\r", _esp301),
    "interbus": Probe(
        "interbus", (15, 16, 17, 18), lambda unit: build(Telegram(unit or 0, 0xA1, Kind.READ, TYPE)), _interbus
    ),
    # Feedback position of an AZ drive (00CCh), inputs of a module: either kind refuses the other's question.
    "az": Probe("az", _SLAVES, lambda unit: _frame(unit, "03 00 CC 00 02"), _modbus(AZ, 3, 9)),
    "io": Probe("io", _SLAVES, lambda unit: _frame(unit, "02 00 00 00 08"), _modbus(MODBUS_IO, 2, 6)),
}
