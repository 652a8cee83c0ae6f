"""All simulated devices of one instrument, wired to one bench and served in one folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from sim_fixtures.bench import Bench, MonitorBench
from sim_fixtures.devices.faults import Faults, changed_digit
from sim_fixtures.devices.keysight_34465a import Multimeter
from sim_fixtures.devices.modbus_io import IoModule
from sim_fixtures.devices.modbus_line import ModbusLine
from sim_fixtures.devices.newport_chain import Smc100Chain, of_next_controller
from sim_fixtures.devices.newport_esp301 import Esp301
from sim_fixtures.devices.nkt_interbus import Interbus, of_next_module
from sim_fixtures.devices.oriental_az import AzDrive
from sim_fixtures.devices.scpi_socket import ScpiServer
from sim_fixtures.devices.wire import SerialLine

#: Address of each arm on its line.
SMC100_ADDRESSES = {1: "sensor_azimuth", 2: "sensor_zenith"}
AZ_ADDRESS, IO_ADDRESS = 1, 1
#: The same arms once more, behind a controller of their own: a room uses either this line or the two others.
ESP301_AXES = {1: "sensor_azimuth", 2: "sensor_zenith", 3: "illumination_zenith"}
#: What a facility may have beside the arms, on a line of its own.
STAGE_ADDRESSES = {1: "sample_rotation", 2: "polarizer"}
_SERIAL = ("sensor-arms", "illumination-arm", "laser", "io", "esp301")

#: Actions on a wire, and what they are called there.
WIRE_FAULTS = {
    "lose_requests": "lose",
    "mislead_requests": "mislead",
    "refuse_requests": "refuse",
    "deny_requests": "deny",
    "drop_replies": "drop",
    "late_reply": "late",
    "corrupt_reply": "corrupt",
    "split_reply": "split",
    "merge_replies": "merge",
    "stray_reply": "stray",
}

#: Line of every role, so that a fault may be asked for by either name.
LINE_OF_ROLE = {
    "sensor_azimuth": "sensor-arms",
    "sensor_zenith": "sensor-arms",
    "sample_rotation": "stages",
    "polarizer": "stages",
    "illumination_zenith": "illumination-arm",
    "source": "laser",
    "selector": "laser",
    "amplifier": "io",
    "shutter": "io",
    "detector": "meter",
}


@dataclass(frozen=True)
class Endpoints:
    """Where the devices answer: pseudo-terminals by line, and the TCP ports of multimeter and monitor photodiode."""

    ports: dict[str, Path]
    meter: int
    monitor: int


class Room:
    """The devices of one instrument.

    Parameters
    ----------
    bench
        What they are joined to.
    folder
        Receives the names of the serial lines (``sensor-arms.tty`` ...).
    """

    def __init__(self, bench: Bench, folder: Path) -> None:
        self.bench = bench
        stages = {address: name for address, name in STAGE_ADDRESSES.items() if name in bench.axes}
        names = (*_SERIAL, "stages") if stages else _SERIAL
        self._lines = {name: SerialLine(folder / f"{name}.tty") for name in names}
        self._chain, self._bus = Smc100Chain(bench, SMC100_ADDRESSES), Interbus(bench)
        self._drive, self._io = AzDrive(bench, "illumination_zenith", AZ_ADDRESS), IoModule(bench, IO_ADDRESS)
        self._esp301 = Esp301(bench, ESP301_AXES)
        self._stages = Smc100Chain(bench, stages)
        if stages:
            self._lines["stages"].serve(self._stages)
        self._lines["sensor-arms"].serve(self._chain)
        self._lines["esp301"].serve(self._esp301, one_device=True)
        self._lines["laser"].serve(self._bus)
        for name, changes in (
            ("sensor-arms", {"mislead": changed_digit, "stray": of_next_controller}),
            ("esp301", {"mislead": changed_digit}),
            ("laser", {"stray": of_next_module}),
        ):
            self._lines[name].faults.change.update(changes)
        self._modbus = [
            ModbusLine(self._lines["illumination-arm"], [self._drive.slave]),
            ModbusLine(self._lines["io"], [self._io.slave]),
        ]
        self._meter = ScpiServer(Multimeter(bench))
        self._monitor = ScpiServer(Multimeter(MonitorBench(bench)))
        links = {name: line.link for name, line in self._lines.items()}
        self.endpoints = Endpoints(links, self._meter.port, self._monitor.port)
        self._actions: dict[str, Callable[..., Any]] = {
            "mount": self._mount,
            "state": bench.state,
            "motion_commands": lambda: dict(bench.motion_commands),
            "stall": self._stall,
            "alarm": self._alarm,
            "limit_switch": self._limit_switch,
            **{action: partial(self._wire, kind) for action, kind in WIRE_FAULTS.items()},
            "faults_left": lambda device, kind: self._faults(device).left(kind),
            "baudrate": self._baudrate,
            "busy": self._busy,
            "disconnect": self._disconnect,
            "open_interlock": self._open_interlock,
            "close_interlock": self._close_interlock,
            "stick_shutter": self._stick_shutter,
            "trouble": self._trouble,
            "apertures": self._apertures,
            "turn": self._turn,
        }

    def control(self, action: str, **arguments: Any) -> Any:
        """Do what a person, or bad luck, does to the room.

        ============================================ ===============================================================
        ``mount`` what                               put the reference, the sample or another piece on the stage
        ``state``                                    the whole state of the bench
        ``motion_commands``                          motion commands (homing too) seen on the wire, by axis
        ``stall`` axis, count                        the next motions stop half-way and the drive does not notice
        ``alarm`` axis                               following error (SMC100, ESP301), overload alarm (AZ)
        ``limit_switch`` axis, direction             -1 or 1 closes a limit switch, 0 releases it
        ``lose_requests`` device, count, only        requests (that contain ``only``) that never arrive
        ``mislead_requests`` device, count, only     requests that arrive with another digit (text)
        ``refuse_requests`` device, count, only      requests that are answered by "busy" (Modbus)
        ``deny_requests`` device, count, only        requests that are answered by "device failure" (Modbus)
        ``drop_replies`` device, count               replies that never arrive
        ``late_reply`` device, count, delay          replies that arrive ``delay`` wall-clock seconds late
        ``corrupt_reply`` device, count              replies with a garbled byte
        ``split_reply`` device, count, delay         replies in two pieces
        ``merge_replies`` device, count              replies that come together with the next one
        ``stray_reply`` device, count                replies that are, by their address, another unit's
        ``faults_left`` device, kind                 how many are still to suffer
        ``baudrate`` line, rate                      a line whose device understands one rate only (0: any)
        ``busy`` count                               telegrams that the laser answers with "busy"
        ``disconnect`` device, seconds               the plug is pulled; back after so many wall-clock seconds
        ``open_interlock``, ``close_interlock``      the door of the laser
        ``stick_shutter`` stuck                      the blade stays shut
        ``trouble`` name, value                      see :class:`sim_fixtures.bench.troubles.Troubles`
        ``turn`` azimuth                             the illumination azimuth set at the manual stage, degree
        ``apertures`` a, b                           which of the two apertures in the beam are open
        ============================================ ===============================================================

        A device is a role (``sensor_zenith``) or a line (``sensor-arms``): the fault lies on the wire.

        Raises
        ------
        ValueError
            If there is no such action, or an argument is wrong.
        """
        if action not in self._actions:
            raise ValueError(f"action: found {action!r}; expected one of {sorted(self._actions)}")
        try:
            return self._actions[action](**arguments)
        except TypeError as error:
            raise ValueError(f"{action}: {error}") from error

    def close(self) -> None:
        """End every server."""
        self._meter.close()
        self._monitor.close()
        for line in self._lines.values():
            line.close()
        for server in self._modbus:
            server.close()
        self.bench.close()

    def _line(self, device: str) -> str:
        line = LINE_OF_ROLE.get(device, device)
        if line not in self._lines and line != "meter":
            known = sorted({*LINE_OF_ROLE, *self._lines, "meter"})
            raise ValueError(f"device: found {device!r}; expected one of {known}")
        return line

    def _faults(self, device: str) -> Faults:
        line = self._line(device)
        return self._meter.faults if line == "meter" else self._lines[line].faults

    def _wire(self, kind: str, device: str, count: int = 1, delay: float | None = None, only: str = "") -> None:
        self._faults(device).set(kind, count, delay, only.encode("latin-1"))

    def _axis(self, name: str) -> str:
        if name not in self.bench.axes:
            raise ValueError(f"axis: found {name!r}; expected one of {sorted(self.bench.axes)}")
        return name

    def _mount(self, what: Any) -> None:
        self.bench.mount(what)

    def _stall(self, axis: str, count: int = 1) -> None:
        with self.bench.lock:
            self.bench.axes[self._axis(axis)].stall(count)

    def _alarm(self, axis: str) -> None:
        with self.bench.lock:
            self._esp301.fault(self._axis(axis))
            controller = self._chain.of_axis(axis) or self._stages.of_axis(axis)
            if controller is not None:
                controller.fault("following error")
            else:
                self._drive.raise_alarm()

    def _limit_switch(self, axis: str, direction: int = 1) -> None:
        with self.bench.lock:
            self.bench.axes[self._axis(axis)].hit_limit(direction)

    def _baudrate(self, line: str, rate: int) -> None:
        self._lines[self._line(line)].baudrate = rate or None

    def _busy(self, count: int = 1) -> None:
        self._bus.busy = int(count)

    def _disconnect(self, device: str, seconds: float = 0.0) -> None:
        line = self._line(device)
        if line == "meter":
            self._meter.disconnect(seconds)
            return
        if line == "io":
            with self.bench.lock:
                self._io.release()
        self._lines[line].disconnect(seconds)

    def _open_interlock(self) -> None:
        with self.bench.lock:
            self.bench.source.open_interlock()

    def _close_interlock(self) -> None:
        with self.bench.lock:
            self.bench.source.close_interlock()

    def _stick_shutter(self, stuck: bool = True) -> None:
        with self.bench.lock:
            self.bench.shutter.stuck = stuck

    def _trouble(self, name: str, value: float) -> None:
        with self.bench.lock:
            self.bench.troubles.set(name, value)

    def _apertures(self, a: bool, b: bool) -> None:
        with self.bench.lock:
            self.bench.apertures = {"a": bool(a), "b": bool(b)}

    def _turn(self, azimuth: float) -> None:
        with self.bench.lock:
            self.bench.turned_by_hand = -float(azimuth)
