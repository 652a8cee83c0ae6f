"""NKT Photonics Interbus: SuperK source and SELECT filter on one virtual serial port.

Telegram ``0D | destination source type register data.. crcH crcL | 0A`` with 0A, 0D and 5E between the frame bytes
sent as ``5E, byte + 40h``; CRC-16/XMODEM. Registers after NKT's register files 60 (SuperK), 66 (RF driver) and
67 (SELECT).
"""

from __future__ import annotations

import binascii
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from sim_fixtures.bench import Bench
from sim_fixtures.bench.light import INTERLOCK_CLOSED

START, END, ESCAPE = 0x0D, 0x0A, 0x5E
NACK, CRC_ERROR, BUSY, ACK, READ, WRITE, WRITE_SET, WRITE_CLEAR, WRITE_TOGGLE, DATAGRAM = 0, 1, 2, 3, 4, 5, 6, 7, 9, 8
_WRITES = (WRITE, WRITE_SET, WRITE_CLEAR, WRITE_TOGGLE)

#: Of the crystal, pm.
SHORTEST, LONGEST = 400_000, 2_000_000

MODULE_TYPE, FIRMWARE, SERIAL_NUMBER, STATUS, ERROR_CODE = 0x61, 0x64, 0x65, 0x66, 0x67


def encode(destination: int, source: int, kind: int, register: int, data: bytes = b"") -> bytes:
    """Telegram with its frame."""
    body = bytes([destination, source, kind, register]) + data
    body += binascii.crc_hqx(body, 0).to_bytes(2, "big")
    escaped = bytearray()
    for byte in body:
        escaped += bytes([ESCAPE, byte + 0x40]) if byte in (START, END, ESCAPE) else bytes([byte])
    return bytes([START]) + bytes(escaped) + bytes([END])


def unescape(body: bytes) -> bytes:
    """What stands between the frame bytes, without escapes."""
    result, raw = bytearray(), iter(body)
    for byte in raw:
        result.append((next(raw, 0x40) - 0x40) & 0xFF if byte == ESCAPE else byte)
    return bytes(result)


def of_next_module(telegram: bytes) -> bytes:
    """A telegram as if the module after its sender had sent it."""
    destination, source, kind, register, *data = unescape(telegram[1:-1])[:-2]
    return encode(destination, source + 1, kind, register, bytes(data))


@dataclass
class Register:
    """A register: ``get`` gives its bytes; ``put`` takes bytes and says whether it accepts them."""

    size: int
    get: Callable[[], int]
    put: Callable[[int], bool] | None = None


@dataclass
class Module:
    """A device on the bus; text registers stand beside the numeric ones."""

    kind: int
    registers: dict[int, Register]
    texts: dict[int, bytes]

    def read(self, register: int) -> bytes | None:
        """Little-endian content, or None where there is no such register."""
        if register == MODULE_TYPE:
            return bytes([self.kind])
        if register in self.texts:
            return self.texts[register]
        if register not in self.registers:
            return None
        entry = self.registers[register]
        return (entry.get() & (256**entry.size - 1)).to_bytes(entry.size, "little")

    def write(self, kind: int, register: int, data: bytes) -> bool:
        """Carry out a write; False where it is refused."""
        entry = self.registers.get(register)
        if entry is None or entry.put is None or len(data) != entry.size:
            return False
        value, present = int.from_bytes(data, "little"), entry.get()
        combined = {
            WRITE: value,
            WRITE_SET: present | value,
            WRITE_CLEAR: present & ~value,
            WRITE_TOGGLE: present ^ value,
        }
        return entry.put(combined[kind])


class Interbus:
    """Modules on one bus; a wire handler (see :class:`~sim_fixtures.devices.wire.Handler`).

    Parameters
    ----------
    bench
        Holds source and filter.
    source, select, driver
        Addresses of the SuperK (type 60h), the SELECT (67h) and its RF driver (66h).
    """

    def __init__(self, bench: Bench, source: int = 0x0F, select: int = 0x10, driver: int = 0x12) -> None:
        self._bench = bench
        self._buffer = bytearray()
        self._open = False
        self.request_lost: Callable[[bytes], bool] = lambda _: False
        self.busy = 0
        self.modules = {source: superk(bench), select: select_filter(bench), driver: rf_driver(bench)}

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes from the line; whatever stands outside a frame is dropped."""
        replies: list[bytes] = []
        for byte in data:
            if byte == START:
                self._buffer.clear()
                self._open = True
            elif byte == END and self._open:
                self._open = False
                replies += self._telegram(unescape(bytes(self._buffer)))
            elif self._open:
                self._buffer.append(byte)
        return replies

    def _telegram(self, body: bytes) -> list[bytes]:
        if len(body) < 6:
            return []
        destination, source, kind, register = body[:4]
        module = self.modules.get(destination)
        if module is None or self.request_lost(body):
            return []
        if binascii.crc_hqx(body[:-2], 0) != int.from_bytes(body[-2:], "big"):
            return [encode(source, destination, CRC_ERROR, register)]
        with self._bench.lock:
            self._bench.source.contact()
            if self.busy > 0:
                self.busy -= 1
                return [encode(source, destination, BUSY, register)]
            return [self._answer(module, destination, source, kind, register, body[4:-2])]

    def _answer(self, module: Module, own: int, host: int, kind: int, register: int, data: bytes) -> bytes:
        if kind == READ:
            content = module.read(register)
            return encode(host, own, NACK if content is None else DATAGRAM, register, content or b"")
        if kind in _WRITES:
            return encode(host, own, ACK if module.write(kind, register, data) else NACK, register)
        return encode(host, own, NACK, register)


def _texts(serial: str) -> dict[int, bytes]:
    return {FIRMWARE: b"\x64\x01v1.00 simulated\x00", SERIAL_NUMBER: serial.encode("ascii")}


def _limited(value: int, largest: int, store: Callable[[int], None]) -> bool:
    if not 0 <= value <= largest:
        return False
    store(value)
    return True


def superk(bench: Bench) -> Module:
    """The source, type 60h."""
    source = bench.source
    plain = {"mode": 1, "ratio": 1, "delay": 0}

    def status() -> int:
        bits = int(source.emitting())
        if source.interlock != INTERLOCK_CLOSED:
            bits |= 1 << 1
        if source.interlock == 0:
            bits |= 1 << 3
        return bits

    def set_interlock(value: int) -> bool:
        if value > 0:
            source.reset_interlock()
        else:
            source.switch(False)
            source.close_interlock()
        return True

    def set_emission(value: int) -> bool:
        return value in (0, 3) and source.switch(value == 3)

    def set_power(value: int) -> bool:
        return _limited(value, 1000, lambda v: setattr(source, "power", v / 1000))

    def set_watchdog(value: int) -> bool:
        source.contact()
        source.watchdog = float(value)
        return True

    def keep(name: str, largest: int) -> Callable[[int], bool]:
        return lambda value: _limited(value, largest, lambda v: plain.__setitem__(name, v))

    registers = {
        0x11: Register(2, lambda: 253),
        0x30: Register(1, lambda: 3 if source.emitting() else 0, set_emission),
        0x31: Register(2, lambda: plain["mode"], keep("mode", 4)),
        0x32: Register(2, lambda: source.interlock | source.interlock_cause << 8, set_interlock),
        0x34: Register(2, lambda: plain["ratio"], keep("ratio", 0xFFFF)),
        0x36: Register(1, lambda: int(source.watchdog), set_watchdog),
        0x37: Register(2, lambda: round(source.power * 1000), set_power),
        0x38: Register(2, lambda: round(source.power * 1000), set_power),
        0x39: Register(2, lambda: plain["delay"], keep("delay", 1023)),
        STATUS: Register(2, status),
        ERROR_CODE: Register(1, lambda: 0),
    }
    return Module(0x60, registers, _texts("SIM60001"))


def select_filter(bench: Bench) -> Module:
    """The SELECT, type 67h: crystal, shutters and monitors."""
    plain = {"switch": 0, "monitor": 0, "gain1": 0, "gain2": 0}

    def keep(name: str, largest: int) -> Callable[[int], bool]:
        return lambda value: _limited(value, largest, lambda v: plain.__setitem__(name, v))

    registers = {
        0x10: Register(2, lambda: round(1000 * bench.selector.transmission() * bench.source.emitting())),
        0x11: Register(2, lambda: 0),
        0x32: Register(1, lambda: plain["gain1"], keep("gain1", 7)),
        0x33: Register(1, lambda: plain["gain2"], keep("gain2", 7)),
        0x34: Register(1, lambda: plain["switch"], keep("switch", 1)),
        0x35: Register(1, lambda: plain["monitor"], keep("monitor", 1)),
        0x90: Register(4, lambda: SHORTEST),
        0x91: Register(4, lambda: LONGEST),
        0xA0: Register(4, lambda: SHORTEST),
        0xA1: Register(4, lambda: LONGEST),
        STATUS: Register(2, lambda: 0),
        ERROR_CODE: Register(1, lambda: 0),
    }
    return Module(0x67, registers, _texts("SIM67001"))


def rf_driver(bench: Bench, shortest: int = SHORTEST, longest: int = LONGEST) -> Module:
    """The RF driver of the SELECT, type 66h: eight channels of wavelength (pm) and amplitude (0.1 %)."""
    selector = bench.selector

    def set_rf(value: int) -> bool:
        return _limited(value, 1, lambda v: setattr(selector, "rf_on", bool(v)))

    def wavelength(channel: int) -> int:
        return round(selector.wavelengths[channel] * 1000)

    def amplitude(channel: int) -> int:
        return round(selector.amplitudes[channel] * 1000)

    def set_wavelength(channel: int, value: int) -> bool:
        if not shortest <= value <= longest:
            return False
        selector.wavelengths[channel] = value / 1000
        return True

    def set_amplitude(channel: int, value: int) -> bool:
        return _limited(value, 1000, lambda v: selector.amplitudes.__setitem__(channel, v / 1000))

    registers = {
        0x30: Register(1, lambda: int(selector.rf_on), set_rf),
        0x31: Register(2, lambda: 0),
        0x34: Register(4, lambda: shortest),
        0x35: Register(4, lambda: longest),
        0x38: Register(2, lambda: 261),
        0x3B: Register(1, lambda: 0),
        0x3C: Register(1, lambda: 0),
        0x75: Register(1, lambda: 1),
        STATUS: Register(2, lambda: int(selector.rf_on)),
        ERROR_CODE: Register(1, lambda: 0),
    }
    for channel in range(8):
        registers[0x90 + channel] = Register(4, partial(wavelength, channel), partial(set_wavelength, channel))
        registers[0xC0 + channel] = Register(2, lambda: 1000)
        registers[0xB0 + channel] = Register(2, partial(amplitude, channel), partial(set_amplitude, channel))
    return Module(0x66, registers, _texts("SIM66001"))
