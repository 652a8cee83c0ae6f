"""Why a device does not answer as expected: which line of ``devices.toml``, what was expected, what answered."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.lines import ModbusSerialLineForm, SerialLineForm
from drivers.nkt_module import TYPES
from drivers.probes import AZ, ESP301, MODBUS_IO, PROBES, RATES, SMC100, Answer, Listener, Probe, can_listen

if TYPE_CHECKING:
    from drivers.configuration import DevicesForm


@dataclass(frozen=True)
class Expected:
    """What a driver looks for: a probe, the kinds that count, and the key that holds the address."""

    probe: str
    kinds: tuple[str, ...]
    key: str | None = "address"


_IO = Expected("io", (MODBUS_IO,))
#: By driver. A driver of another package is not listed: then only its line is looked at.
EXPECTED = {
    "newport-smc100": Expected("smc100", (SMC100,)),
    "newport-esp301": Expected("esp301", (ESP301,), None),
    "oriental-az": Expected("az", (AZ,)),
    "nkt-superk": Expected("interbus", (f"NKT {TYPES[0x60]}", f"NKT {TYPES[0x88]}")),
    "nkt-select": Expected("interbus", (f"NKT {TYPES[0x66]}",)),
    "nkt-varia": Expected("interbus", (f"NKT {TYPES[0x68]}",)),
    "femto": _IO,
    "modbus-shutter": _IO,
}


class Survey:
    """Looks at the wires of one ``devices.toml``; every line must be free. What was heard on one is kept.

    Parameters
    ----------
    form
        The file.
    """

    def __init__(self, form: DevicesForm) -> None:
        self._form = form
        self._heard: dict[str, tuple[list[Answer], bytes]] = {}
        path = Path(form.source)
        self._text = path.read_text(encoding="utf-8") if path.is_file() else ""

    def explain(self, role: str) -> str:
        """Where ``devices.toml`` and the wires disagree about a device; empty where nothing can be said.

        Returns
        -------
        str
            ``FILE:LINE: KEY = VALUE: expected ...; answered: ...``.
        """
        device = self._form.devices[role]
        line = self._form.lines[device.line]
        if not can_listen(line):
            return self._say(("lines", device.line), role, "nobody that could be asked further")
        expected = EXPECTED.get(device.driver)
        unit = self._unit(role, expected)
        try:
            heard, noise = self._hear(device.line)
        except OSError as error:
            return self._say(("lines", device.line, "port"), role, f"nobody: {_why(error)}")
        if expected is None:
            return self._say(("devices", role, "line"), role, _list(heard, noise))
        own = [answer for answer in heard if answer.unit == unit and answer.kind in expected.kinds]
        if len(own) > 1:
            return self._say(("devices", role, "address"), role, f"{len(own)} devices at once, at the same address")
        if own:
            return ""
        if any(answer.kind in expected.kinds for answer in heard):
            return self._say(("devices", role, "address"), role, _list(heard, b""))
        if not heard and (rate := self._other_rate(device.line, expected, unit)):
            return self._say(("lines", device.line, "baudrate"), role, f"that one, at {rate} baud")
        if other := self._other_line(device.line, expected, unit):
            here = _list(heard, noise)
            return self._say(("devices", role, "line"), role, f"here {here}; the one expected is on line {other!r}")
        if any(answer.unit == unit for answer in heard):
            return self._say(("devices", role, "address"), role, _list(heard, b""))
        key = ("devices", role, "line") if heard else ("lines", device.line, "baudrate" if noise else "port")
        return self._say(key, role, _list(heard, noise))

    def crowd(self, role: str) -> str:
        """Says so where more than one device answers at the address of this one; empty otherwise."""
        device = self._form.devices[role]
        expected, line = EXPECTED.get(device.driver), self._form.lines[device.line]
        if expected is None or not can_listen(line):
            return ""
        with Listener(line) as listener:
            answers = listener.ask(PROBES[expected.probe], (self._unit(role, expected),))
        if len(answers) < 2:
            return ""
        key = expected.key or "line"
        return self._say(("devices", role, key), role, f"{len(answers)} devices at once, at the same address")

    def _hear(self, name: str) -> tuple[list[Answer], bytes]:
        if name not in self._heard:
            with Listener(self._form.lines[name]) as listener:
                heard = [answer for probe in PROBES.values() for answer in listener.ask(probe, self._units(probe))]
                self._heard[name] = _named(heard), listener.noise
        return self._heard[name]

    def _units(self, probe: Probe) -> tuple[int | None, ...]:
        """The usual addresses, and those that the file names."""
        roles = [role for role, device in self._form.devices.items() if _probe(device.driver) == probe.name]
        named = [self._unit(role, EXPECTED[self._form.devices[role].driver]) for role in roles]
        return tuple(dict.fromkeys((*named, *probe.units)))

    def _unit(self, role: str, expected: Expected | None) -> int | None:
        if expected is None or expected.key is None:
            return None
        unit = self._form.devices[role].options().get(expected.key, 15 if expected.probe == "interbus" else 1)
        return int(unit)

    def _other_rate(self, name: str, expected: Expected, unit: int | None) -> int | None:
        line = self._form.lines[name]
        if not isinstance(line, SerialLineForm | ModbusSerialLineForm):
            return None
        for rate in RATES:
            if rate != line.baudrate:
                with Listener(line, rate) as listener:
                    if any(answer.kind in expected.kinds for answer in listener.ask(PROBES[expected.probe], (unit,))):
                        return rate
        return None

    def _other_line(self, name: str, expected: Expected, unit: int | None) -> str | None:
        for other, line in self._form.lines.items():
            if other == name or not can_listen(line):
                continue
            try:
                with Listener(line) as listener:
                    answers = listener.ask(PROBES[expected.probe], (unit,))
            except OSError:
                continue  # what is wrong with that line is said with its own devices
            if any(answer.kind in expected.kinds for answer in answers):
                return other
        return None

    def _say(self, keys: Sequence[str], role: str, answered: str) -> str:
        return f"{where(self._form.source, self._text, keys)}: expected {self._expectation(role)}; answered: {answered}"

    def _expectation(self, role: str) -> str:
        device = self._form.devices[role]
        expected = EXPECTED.get(device.driver)
        who = " or ".join(expected.kinds) if expected else f"what driver {device.driver!r} drives"
        unit = self._unit(role, expected)
        return f"{who}{'' if unit is None else f' at address {unit}'} on line {device.line!r}"


def where(source: str, text: str, keys: Sequence[str]) -> str:
    """``FILE:LINE: KEY = VALUE`` of a key in a TOML text; without line and value where they are not written there."""
    name = ".".join(keys)
    number, value = find_key(text, keys)
    place = f"{source}:{number}" if number else source
    return f"{place}: {name}" + (f" = {value}" if value else "")


def find_key(text: str, keys: Sequence[str]) -> tuple[int, str]:
    """Number of the line (from 1; 0 where there is none) and value of a key under a header ``[a.b]``."""
    table, inside, header = list(keys), False, 0
    for number, line in enumerate(text.splitlines(), 1):
        if match := re.match(r"\s*\[([^\[\]]+)\]", line):
            name = [part.strip().strip("\"'") for part in match[1].split(".")]
            inside = name == table[:-1]
            if name == table or inside:
                header = number
        elif inside and (match := re.match(rf"\s*[\"']?{re.escape(table[-1])}[\"']?\s*=\s*(.*?)\s*(#.*)?$", line)):
            return number, match[1]
    return header, ""


def _why(error: OSError) -> str:
    """Why a port cannot be opened, without the port, which is said beside it."""
    return os.strerror(error.errno) if error.errno else str(error)


def _probe(driver: str) -> str:
    return EXPECTED[driver].probe if driver in EXPECTED else ""


def _named(heard: list[Answer]) -> list[Answer]:
    """Without the refusals of those that another question has named."""
    named = {answer.unit for answer in heard if not answer.kind.startswith("Modbus slave")}
    return [answer for answer in heard if not (answer.kind.startswith("Modbus slave") and answer.unit in named)]


def _list(heard: list[Answer], noise: bytes) -> str:
    if heard:
        return ", ".join(dict.fromkeys(map(str, heard)))
    if noise:
        return (
            f"bytes that mean nothing ({noise[:12].hex(' ')}): wrong baud rate or parity, or two devices at one address"
        )
    return "nobody, at any usual address or baud rate (check power, cable and port)"
