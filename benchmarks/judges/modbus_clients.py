"""pymodbus's and MinimalModbus's clients on the simulated AZ drive and I/O module."""

from __future__ import annotations

import sys
from typing import Any

import minimalmodbus
from protocol import Judge, close_to, until
from pymodbus.client import ModbusSerialClient


def signed(registers: list[int]) -> int:
    """Signed 32-bit value, high word first."""
    value = registers[0] << 16 | registers[1]
    return value - (1 << 32) if value >= 1 << 31 else value


def words(value: int) -> list[int]:
    """Two registers of a signed 32-bit value."""
    return [value >> 16 & 0xFFFF, value & 0xFFFF]


def with_pymodbus() -> None:
    """Home, move, read; coils, inputs, exceptions and an echo."""
    judge = Judge("pymodbus", "ModbusSerialClient on the simulated AZ drive and I/O module")
    drive = ModbusSerialClient(judge.endpoints["illumination-arm"], baudrate=115200, timeout=3)
    drive.connect()
    read = lambda address, count=2: drive.read_holding_registers(address, count=count, device_id=1)  # noqa: E731
    judge.check("temperatures", lambda: signed(read(0xF8).registers) / 10, lambda value: 0 < value < 80)
    judge.check("echo", lambda: drive.diag_query_data(b"\x12\x34", device_id=1).message, lambda v: b"\x12\x34" in v)
    for value in (0x10, 0):
        drive.write_register(0x7D, value, device_id=1)
    judge.check("homing ends", lambda: until(lambda: bool(read(0x178, 1).registers[0] & 2)), bool)
    move = [word for value in (0, 1, 1250, 2000, 1000, 1000, 1000, 1) for word in words(value)]
    judge.check("direct data operation", lambda: drive.write_registers(0x58, move, device_id=1), no_error)
    judge.check("it arrives", lambda: until(lambda: signed(read(0xCC).registers) == 1250), bool)
    judge.check("READY and not MOVE", lambda: read(0x179, 1).registers[0], lambda v: v & 0x10 and not v & 0x40)
    bad = [word for value in (0, 1, 0, 0, 1000, 1000, 1000, 1) for word in words(value)]
    judge.check("a speed of zero is an exception 03", lambda: drive.write_registers(0x58, bad, device_id=1), code(3))
    judge.check("an address outside is an exception 02", lambda: read(0x9000), code(2))
    drive.close()
    module = ModbusSerialClient(judge.endpoints["io"], baudrate=9600, timeout=3)
    module.connect()
    states = [True, False, True, True]
    judge.check("coils by function 15", lambda: module.write_coils(0, states, device_id=1), no_error)
    judge.check("coils read back", lambda: module.read_coils(0, count=8, device_id=1).bits[:4], lambda v: v == states)
    judge.check("one coil by function 05", lambda: module.write_coil(4, True, device_id=1), no_error)
    opened = lambda: module.read_discrete_inputs(0, count=8, device_id=1).bits[1]  # noqa: E731
    judge.check("the shutter's feedback follows", lambda: until(opened, 10.0), bool)
    module.write_coils(0, [False] * 8, device_id=1)
    judge.check("a ninth coil is an exception 02", lambda: module.write_coil(8, True, device_id=1), code(2))
    module.close()
    judge.done()


def no_error(reply: Any) -> bool:
    """An ordinary reply."""
    return not reply.isError()


def code(number: int) -> Any:
    """An exception of a certain number."""
    return lambda reply: reply.isError() and reply.exception_code == number


def with_minimalmodbus() -> None:
    """The same wires with another implementation of the checksum and the framing."""
    judge = Judge("minimalmodbus", "Instrument on the simulated AZ drive and I/O module")
    drive = minimalmodbus.Instrument(judge.endpoints["illumination-arm"], 1)
    drive.serial.baudrate, drive.serial.timeout = 115200, 3.0
    judge.check("feedback position", lambda: drive.read_long(0xCC, signed=True), lambda value: abs(value) < 10_000)
    judge.check("driver temperature", lambda: drive.read_long(0xF8) / 10, lambda value: 0 < value < 80)
    judge.check("status word", lambda: drive.read_register(0x179), lambda value: value & 0x08)
    move = [word for value in (0, 1, -500, 2000, 1000, 1000, 1000, 1) for word in words(value)]
    judge.check("direct data operation", lambda: drive.write_registers(0x58, move), lambda value: value is None)
    judge.check("it arrives", lambda: until(lambda: drive.read_long(0xCC, signed=True) == -500), bool)
    judge.refused("an address outside is refused", lambda: drive.read_register(0x9000), "illegal")
    drive.serial.close()
    module = minimalmodbus.Instrument(judge.endpoints["io"], 1)
    module.serial.baudrate, module.serial.timeout = 9600, 3.0
    module.write_bit(2, 1)
    judge.check("a coil", lambda: module.read_bit(2, functioncode=1), close_to(1))
    module.write_bits(0, [0] * 8)
    judge.check("coils", lambda: module.read_bits(0, 8, functioncode=1), lambda value: value == [0] * 8)
    judge.check("inputs", lambda: module.read_bits(0, 8, functioncode=2), lambda value: len(value) == 8)
    module.serial.close()
    judge.done()


if __name__ == "__main__":
    {"pymodbus": with_pymodbus, "minimalmodbus": with_minimalmodbus}[sys.argv[2]]()
