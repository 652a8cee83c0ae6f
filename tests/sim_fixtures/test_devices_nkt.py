"""Interbus modules: frames of the protocol in raw bytes, registers, watchdog, refusals."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from sim_fixtures.devices.nkt_interbus import DATAGRAM, Interbus, encode, unescape
from sim_fixtures.room import Room

HOST = 0xA2
NACK, CRC_ERROR, BUSY, ACK, READ, WRITE = range(6)


class Bus:
    """Raw telegrams on the line."""

    def __init__(self, path: str) -> None:
        self.serial = serial.Serial(path, 115200, timeout=1.0)

    def raw(self, frame: str | bytes, timeout: float = 1.0) -> str:
        self.serial.timeout = timeout
        self.serial.write(bytes.fromhex(frame) if isinstance(frame, str) else frame)
        return self.serial.read_until(b"\n").hex(" ").upper()

    def ask(self, address: int, kind: int, register: int, data: bytes = b"") -> tuple[int, bytes]:
        body = unescape(bytes.fromhex(self.raw(encode(address, HOST, kind, register, data)))[1:-1])
        assert body[:2] == bytes([HOST, address])
        assert body[3] == register
        return body[2], body[4:-2]

    def number(self, address: int, register: int) -> int:
        kind, data = self.ask(address, READ, register)
        assert kind == DATAGRAM
        return int.from_bytes(data, "little")

    def write(self, address: int, register: int, value: int, size: int) -> int:
        return self.ask(address, WRITE, register, value.to_bytes(size, "little"))[0]


@pytest.fixture
def bus(room: Room) -> Iterator[Bus]:
    bus = Bus(str(room.endpoints.ports["laser"]))
    yield bus
    bus.serial.close()


@pytest.fixture
def armed(bus: Bus) -> Bus:
    """With the interlock reset."""
    assert bus.write(15, 0x32, 1, 2) == ACK
    return bus


def test_frames_of_the_protocol(armed, room):
    assert armed.raw("0D 0F A2 05 30 03 BC E1 0A") == "0D A2 0F 03 30 48 2F 0A"
    assert room.bench.source.emitting()
    assert armed.raw("0D 0F A2 04 66 C7 B6 0A") == "0D A2 0F 08 66 01 00 90 A8 0A"
    assert armed.raw("0D 0F A2 05 37 58 02 F0 C0 0A")[:11] == "0D A2 0F 03"
    assert room.bench.source.power == 0.6
    assert armed.raw("0D 0F A2 05 36 5E 4A 87 6E 0A")[:11] == "0D A2 0F 03"  # 10 s: escaped
    assert room.bench.source.watchdog == 10.0
    assert armed.raw("0D 12 A2 05 90 20 A1 07 00 56 00 0A")[:11] == "0D A2 12 03"
    assert room.bench.selector.wavelengths[0] == 500.0
    assert armed.raw("0D 0F A2 05 30 00 8C 82 0A") == "0D A2 0F 03 30 48 2F 0A"
    assert not room.bench.source.emitting()


@pytest.mark.parametrize(("address", "kind"), [(15, 0x60), (16, 0x67), (18, 0x66)])
def test_modules_say_what_they_are(bus, address, kind):
    assert bus.ask(address, READ, 0x61) == (DATAGRAM, bytes([kind]))
    assert bus.ask(address, READ, 0x65)[1].startswith(b"SIM")


def test_an_address_that_is_not_there_stays_silent(bus):
    assert bus.raw(encode(0x20, HOST, READ, 0x61), timeout=0.15) == ""


def test_a_garbled_telegram_is_answered_with_crc_error(bus):
    assert bus.raw("0D 0F A2 04 66 C7 B7 0A")[:11] == "0D A2 0F 01"


def test_unknown_and_read_only_registers_are_refused(bus):
    assert bus.ask(15, READ, 0xEE)[0] == NACK
    assert bus.write(15, 0x11, 5, 2) == NACK
    assert bus.write(15, 0x37, 1001, 2) == NACK
    assert bus.write(15, 0x37, 50, 1) == NACK  # one byte short
    assert bus.write(18, 0x90, 300_000, 4) == NACK


def test_a_busy_module_says_so_and_then_answers(bus, room):
    room.control("busy", count=2)
    assert [bus.ask(15, READ, 0x66)[0] for _ in range(3)] == [BUSY, BUSY, DATAGRAM]


def test_no_emission_before_the_interlock_is_reset(bus, room):
    assert bus.number(15, 0x32) == 1
    assert bus.number(15, 0x66) & 0b10
    assert bus.write(15, 0x30, 3, 1) == NACK
    assert bus.write(15, 0x32, 1, 2) == ACK
    assert bus.number(15, 0x32) == 2
    assert bus.write(15, 0x30, 3, 1) == ACK
    assert room.bench.source.emitting()


def test_an_open_door_switches_off_and_is_named(armed, room):
    armed.write(15, 0x30, 3, 1)
    room.control("open_interlock")
    assert armed.number(15, 0x30) == 0
    assert armed.number(15, 0x32) == 2 << 8  # open; door
    assert armed.number(15, 0x66) & 0b1010 == 0b1010
    assert armed.write(15, 0x32, 1, 2) == ACK
    assert armed.write(15, 0x30, 3, 1) == NACK
    room.control("close_interlock")
    assert armed.number(15, 0x32) == 1


def test_the_watchdog_really_switches_the_emission_off(armed, room):
    armed.write(15, 0x36, 1, 1)
    armed.write(15, 0x30, 3, 1)
    for _ in range(2):
        time.sleep(0.6)
        assert armed.number(15, 0x30) == 3
    time.sleep(1.1)
    assert not room.bench.source.emitting()
    assert armed.number(15, 0x66) & 1 == 0
    assert room.control("state")["watchdog_trips"] == 1


def test_filter_amplitude_and_rf_power_let_the_light_through(bus, room):
    selector = room.bench.selector
    assert selector.transmission() == 0.0
    assert bus.write(18, 0xB0, 1000, 2) == ACK
    assert selector.transmission() == 0.0
    assert bus.write(18, 0x30, 1, 1) == ACK
    assert selector.transmission() == 1.0
    assert bus.write(18, 0x93, 1_550_000, 4) == ACK
    assert bus.number(18, 0x93) == 1_550_000
    assert selector.wavelengths[0] == 500.0
    assert (bus.number(18, 0x34), bus.number(18, 0x35)) == (400_000, 2_000_000)


@pytest.mark.parametrize(("kind", "expected"), [(6, 0b0111), (7, 0b0010), (9, 0b0011)])
def test_set_clear_and_toggle(bus, kind, expected):
    bus.write(15, 0x34, 0b0110, 2)
    assert bus.ask(15, kind, 0x34, (0b0101).to_bytes(2, "little"))[0] == ACK
    assert bus.number(15, 0x34) == expected


def test_noise_before_a_telegram_is_ignored(bus):
    assert bus.raw(b"\x00\xff\x0a" + bytes.fromhex("0D 0F A2 04 66 C7 B6 0A"))[:14] == "0D A2 0F 08 66"


@given(st.binary(min_size=0, max_size=240), st.integers(0, 255), st.integers(0, 255))
def test_frame_bytes_never_stand_inside_a_telegram(data, register, destination):
    telegram = encode(destination, HOST, WRITE, register, data)
    assert telegram[0] == 0x0D
    assert telegram[-1] == 0x0A
    assert not {0x0A, 0x0D} & set(telegram[1:-1])
    assert unescape(telegram[1:-1])[4:-2] == data


@given(st.binary(max_size=60))
def test_no_bytes_upset_the_bus(noise):
    from unittest.mock import MagicMock

    bus = Interbus(MagicMock())
    bus.feed(noise)
    bus._buffer.clear()
    bus._open = False
    replies = bus.feed(bytes.fromhex("0D 0F A2 04 61") + encode(0x0F, HOST, READ, 0x61)[5:])
    assert [reply[3] for reply in replies] in ([BUSY], [DATAGRAM])


@pytest.mark.parametrize(
    ("address", "registers"),
    [(0x10, (0x32, 0x33, 0x34, 0x35, 0x90, 0x91, 0xA0, 0xA1)), (0x12, (0x31, 0x38, 0x3B, 0x3C, 0x75, 0xC0, 0xC7))],
)
def test_the_filter_has_every_register_that_a_full_readout_asks_for(bus, address, registers):
    for register in registers:
        assert bus.ask(address, READ, register)[0] == DATAGRAM, f"{register:02X}h"
