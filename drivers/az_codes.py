"""Bits, alarms and 32-bit values of the Oriental Motor AZ, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

WordOrder = Literal["big", "little"]

#: Word 0178h: coordinates are set (ABSPEN).
COORDINATES_SET = 1 << 1

#: Word 0178h: the software limits.
SOFTWARE_LIMITS = {1 << 9: "forward software limit", 1 << 10: "reverse software limit"}

#: Word 0170h: the limit sensors.
LIMIT_SENSORS = {1 << 12: "forward limit sensor active", 1 << 13: "reverse limit sensor active"}

#: Word 0179h.
ALARM_A, READY, MOVE = 1 << 1, 1 << 4, 1 << 6

#: The alarm of a limit sensor.
HARDWARE_OVERTRAVEL = 0x66

#: Alarm codes, register 0080h.
ALARMS = {
    0x10: "excessive position deviation",
    0x20: "overcurrent",
    0x21: "main circuit overheat",
    0x22: "overvoltage",
    0x25: "undervoltage",
    0x26: "motor overheat",
    0x28: "sensor error",
    0x30: "overload",
    0x31: "overspeed",
    0x33: "absolute position error",
    0x41: "memory error",
    0x4A: "return-to-home incomplete",
    0x60: "both limit sensors active",
    0x61: "limit sensors connected the wrong way round",
    0x62: "return-to-home operation error",
    0x63: "no home sensor",
    0x66: "hardware overtravel",
    0x67: "software overtravel",
    0x68: "safe torque off input (HWTO)",
    0x70: "operation data error",
    0x84: "RS-485 communication error",
    0x85: "RS-485 communication time-out",
}


def alarm_words(code: int) -> str:
    """An alarm in words."""
    return f"alarm {code:02X}h: {ALARMS.get(code, 'see the manual of the drive')}"


def words(value: int, order: WordOrder = "big") -> list[int]:
    """Two registers of a signed 32-bit value.

    Raises
    ------
    OverflowError
        If the value does not fit.
    """
    data = value.to_bytes(4, "big", signed=True)
    high, low = int.from_bytes(data[:2], "big"), int.from_bytes(data[2:], "big")
    return [high, low] if order == "big" else [low, high]


def signed(registers: Sequence[int], order: WordOrder = "big") -> int:
    """Signed 32-bit value of two registers."""
    high, low = registers if order == "big" else reversed(registers)
    value = high << 16 | low
    return value - (1 << 32) if value >= 1 << 31 else value
