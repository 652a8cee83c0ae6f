"""Error codes of the Newport ESP300, 301 and 302, in words.

A code below 100 concerns the controller; n * 100 + e is error e of axis n. Codes that are not listed are named by
their number: the manuals of the three models do not agree on all of them.
"""

from __future__ import annotations

GENERAL = {
    1: "PCI communication time-out",
    4: "emergency stop pressed",
    6: "command does not exist",
    7: "parameter out of range",
    8: "cable interlock open",
    9: "axis number out of range",
    37: "axis number missing",
    38: "parameter missing",
}

#: General errors that are no answer to a command: they stop every axis.
ALL_AXES = frozenset((4, 8))

OF_AXIS = {
    0: "motor type not defined",
    1: "parameter out of range",
    2: "amplifier fault",
    3: "following error",
    4: "positive hardware limit",
    5: "negative hardware limit",
    6: "positive software limit",
    7: "negative software limit",
    8: "no stage connected",
    9: "feedback signal fault",
    10: "maximum velocity exceeded",
    11: "maximum acceleration exceeded",
    13: "motor is off",
    20: "search for the zero aborted",
    29: "digital I/O interlock",
    30: "not allowed during the search for the zero",
}


def error_words(code: int) -> str:
    """An error in words, without its axis."""
    words = GENERAL.get(code) if code < 100 else OF_AXIS.get(code % 100)
    return f"error {code}: {words or 'see the manual of the controller'}"
