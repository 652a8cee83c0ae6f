"""``devices.toml`` of the simulated laboratory, in the form that ``docs/devices.example.toml`` documents."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from instrument.facility import Facility
from sim_fixtures.room import AZ_ADDRESS, ESP301_AXES, IO_ADDRESS, SMC100_ADDRESSES, STAGE_ADDRESSES

#: Arms: degree/s, degree/s^2; a step of 5 degrees takes 1.4 s.
_ARM = {"velocity": 20.0, "acceleration": 10.0}
#: Codes of the amplifier's low-noise mode for 1e5, 1e6 and 1e7 V/A.
_GAIN_CODES = [10, 11, 12]


def write_devices(path: Path, ports: Mapping[str, str], meter: int, speed: float, facility: Facility) -> None:
    """Write the connections.

    Parameters
    ----------
    path
        The file.
    ports
        Pseudo-terminal of each line.
    meter
        TCP port of the multimeter on the loopback interface.
    speed
        Laboratory seconds a wall-clock second.
    facility
        Travel of the arms.
    """
    form = {
        "version": 1,
        "clock": {"speed": float(speed)},
        "lines": _lines(ports, meter),
        "devices": _arms(facility) | _stages(ports, facility) | _optics() | _detection(),
    }
    path.write_text("# Connections of the simulated laboratory.\n" + tomli_w.dumps(form), encoding="utf-8")


def write_alternative(path: Path, ports: Mapping[str, str], meter: int, speed: float, facility: Facility) -> None:
    """The same room with all three arms on an ESP301; parameters as in :func:`write_devices`."""
    arms = {
        name: {"driver": "newport-esp301", "line": "esp301", "axis": number, "tolerance": 0.02}
        | _travel(facility, name)
        for number, name in ESP301_AXES.items()
    }
    lines = {name: line for name, line in _lines(ports, meter).items() if not name.endswith(("-arms", "-arm"))}
    lines["esp301"] = {"kind": "serial", "port": ports["esp301"], "baudrate": 19200, "rtscts": True, "timeout": 1.0}
    form = {
        "version": 1,
        "clock": {"speed": float(speed)},
        "lines": lines,
        "devices": arms | _stages(ports, facility) | _optics() | _detection(),
    }
    path.write_text("# The simulated laboratory, its arms on an ESP301.\n" + tomli_w.dumps(form), encoding="utf-8")


def add_monitor(devices: Path, path: Path, port: int) -> None:
    """Write connections anew with a monitor photodiode whose meter answers at a TCP port of the loopback interface."""
    form = tomllib.loads(devices.read_text(encoding="utf-8"))
    form["lines"]["monitor"] = form["lines"]["meter"] | {"resource": f"TCPIP0::127.0.0.1::{port}::SOCKET"}
    form["devices"]["monitor"] = form["devices"]["detector"] | {"line": "monitor"}
    text = "# The simulated laboratory with a monitor photodiode.\n" + tomli_w.dumps(form)
    path.write_text(text, encoding="utf-8")


def _lines(ports: Mapping[str, str], meter: int) -> dict[str, Any]:
    # Replies may wait for the optical model on a busy machine: time-outs leave room for that. Lines run at the highest
    # rate the devices can be set to: Modbus clients keep a silence of some characters, which no clock makes faster.
    stages = {"stages": {"kind": "serial", "port": ports.get("stages", ""), "baudrate": 57600, "timeout": 1.0}}
    return (stages if "stages" in ports else {}) | {
        "sensor-arms": {"kind": "serial", "port": ports["sensor-arms"], "baudrate": 57600, "timeout": 1.0},
        "illumination-arm": {
            "kind": "modbus-serial",
            "port": ports["illumination-arm"],
            "baudrate": 115200,
            "timeout": 1.0,
            "frame_gap": 0.0,
        },
        "laser": {"kind": "serial", "port": ports["laser"], "baudrate": 115200, "timeout": 1.0},
        "io": {
            "kind": "modbus-serial",
            "port": ports["io"],
            "baudrate": 115200,
            "timeout": 3.0,
            "frame_gap": 0.0,
        },
        "meter": {"kind": "visa", "resource": f"TCPIP0::127.0.0.1::{meter}::SOCKET", "timeout": 5.0},
    }


def _arms(facility: Facility) -> dict[str, Any]:
    travel = {name: _travel(facility, name) for name in ESP301_AXES.values()}
    azimuth, zenith = sorted(SMC100_ADDRESSES, key=lambda address: SMC100_ADDRESSES[address])
    smc100 = {"driver": "newport-smc100", "line": "sensor-arms", "tolerance": 0.002}
    return {
        "illumination_zenith": {
            "driver": "oriental-az",
            "line": "illumination-arm",
            "address": AZ_ADDRESS,
            "steps_per_degree": 100.0,
            "tolerance": 0.02,
            **travel["illumination_zenith"],
        },
        "sensor_azimuth": smc100 | {"address": azimuth} | travel["sensor_azimuth"],
        "sensor_zenith": smc100 | {"address": zenith} | travel["sensor_zenith"],
    }


def _stages(ports: Mapping[str, str], facility: Facility) -> dict[str, Any]:
    """What the facility has beside the arms."""
    if "stages" not in ports:
        return {}
    smc100 = {"driver": "newport-smc100", "line": "stages", "tolerance": 0.002}
    return {
        name: smc100 | {"address": address} | _travel(facility, name)
        for address, name in STAGE_ADDRESSES.items()
        if getattr(facility.arms, name) is not None
    }


def _travel(facility: Facility, arm: str) -> dict[str, Any]:
    lower, upper = getattr(facility.arms, arm)
    return {"lower": float(lower), "upper": float(upper), **_ARM}


def _optics() -> dict[str, Any]:
    return {
        "source": {
            "driver": "nkt-superk",
            "line": "laser",
            "address": 15,
            "watchdog": 20,
            "reset_interlock": True,
            "power": 0.6,
        },
        "selector": {
            "driver": "nkt-select",
            "line": "laser",
            "address": 18,
            "select_address": 16,
            "channel": 0,
            "amplitude": 1.0,
        },
        "shutter": {
            "driver": "modbus-shutter",
            "line": "io",
            "address": IO_ADDRESS,
            "coil": 4,
            "feedback_input": 1,
            "travel_time": 0.2,
        },
    }


def _detection() -> dict[str, Any]:
    return {
        "detector": {
            "driver": "keysight-34465a",
            "line": "meter",
            "range": 10.0,
            "full_scale": 10.0,
            "nplc": 10.0,
            "line_frequency": 50.0,
            "auto_zero": True,
        },
        "amplifier": {
            "driver": "femto",
            "line": "io",
            "address": IO_ADDRESS,
            "model": "dlpca-200",
            "mode": "low-noise",
            "coils": [0, 1, 2, 3],
            "codes": _GAIN_CODES,
            "overload_input": 0,
            "settling_time": 0.2,
        },
    }
