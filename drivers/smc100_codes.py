"""Codes of the Newport SMC100, in words: states and error map (``TS``), command errors (``TE``).

Source: manual EDH0206En2051 09/18, command descriptions of TS, TB and TE.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

#: State by the last two hexadecimal digits of ``TS``.
STATES = {
    0x0A: "not referenced, after a reset",
    0x0B: "not referenced, after homing",
    0x0C: "not referenced, after configuration",
    0x0D: "not referenced, after disable",
    0x0E: "not referenced, after ready",
    0x0F: "not referenced, after moving",
    0x10: "not referenced: ESP stage error",
    0x11: "not referenced, after jogging",
    0x14: "in configuration",
    0x1E: "homing, by command",
    0x1F: "homing, by keypad",
    0x28: "moving",
    0x32: "ready, after homing",
    0x33: "ready, after moving",
    0x34: "ready, after disable",
    0x35: "ready, after jogging",
    0x3C: "disabled, after ready",
    0x3D: "disabled, after moving",
    0x3E: "disabled, after jogging",
    0x46: "jogging, after ready",
    0x47: "jogging, after disable",
}

HOMING = frozenset((0x1E, 0x1F))
NOT_REFERENCED = frozenset(range(0x0A, 0x12))
READY = frozenset((0x32, 0x33, 0x34, 0x35))
#: Under way: a home search counts, although some drivers take only 28 for moving.
BUSY = frozenset((0x1E, 0x1F, 0x28, 0x46, 0x47))
#: The motor has no current; the zero is kept.
DISABLED = frozenset((0x3C, 0x3D, 0x3E))
#: Positions refer to a known zero.
HOMED = READY | DISABLED | {0x28, 0x46, 0x47}
#: Not ready, and not by anyone's command: the zero was lost, the motor is off, or somebody configures.
OUT_OF_ORDER = DISABLED | {0x0D, 0x0E, 0x0F, 0x10, 0x14}

#: Bits of the error map, the first four hexadecimal digits of ``TS``.
ERROR_MAP = {
    0: "negative end of run",
    1: "positive end of run",
    2: "peak current limit",
    3: "RMS current limit",
    4: "short circuit",
    5: "following error",
    6: "homing time-out",
    7: "wrong ESP stage",
    8: "DC voltage too low",
    9: "80 W output power exceeded",
}

#: Answer of ``TE``.
COMMAND_ERRORS = {
    "A": "unknown command or floating-point controller address",
    "B": "wrong controller address",
    "C": "parameter missing or out of range",
    "D": "command not allowed",
    "E": "home sequence already started",
    "F": "unknown ESP stage",
    "G": "displacement out of limits",
    "H": "not allowed while not referenced: home the axis first",
    "I": "not allowed in configuration",
    "J": "not allowed while disabled",
    "K": "not allowed while ready",
    "L": "not allowed while homing",
    "M": "not allowed while moving",
    "N": "position outside the software limits",
    "S": "communication time-out",
    "U": "error of the EEPROM",
    "V": "error during the execution of the command",
    "W": "not allowed for the PP version",
    "X": "not allowed for the CC version",
}


@dataclass(frozen=True)
class State:
    """Answer of ``TS``: state code and faults in words."""

    code: int
    faults: tuple[str, ...]


def parse_state(reply: str) -> State | None:
    """Read the six digits of ``TS`` without their prefix; None where they are no such thing."""
    text = reply.strip()
    if not re.fullmatch(r"[0-9A-Fa-f]{6}", text):
        return None
    errors, code = int(text[:4], 16), int(text[4:], 16)
    return State(code, tuple(words for bit, words in ERROR_MAP.items() if errors >> bit & 1))
