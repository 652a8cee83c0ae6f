"""``devices.toml``: what is wrong with it is said in one line that names file and key."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from scripted_peer import Peer

from drivers import configuration
from drivers.clock import Clock
from drivers.configuration import connect, installed_drivers, parse_devices, planned, read_devices
from drivers.errors import CommunicationError, ConfigurationError, DeviceFault
from drivers.forms import Form
from drivers.interfaces import ROLES
from drivers.lines import OpenLine

EXAMPLE = Path(__file__).parents[2] / "docs" / "devices.example.toml"
DRIVERS = {
    "newport-esp301", "newport-smc100", "oriental-az", "nkt-superk", "nkt-select", "nkt-varia", "keysight-34465a",
    "femto", "modbus-shutter",
}  # fmt: skip


def example() -> dict[str, Any]:
    return tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))


def test_the_documented_example_is_valid_and_fills_every_role() -> None:
    form = read_devices(EXAMPLE)
    assert {plan.role for plan in planned(form)} == set(ROLES)
    assert form.clock.speed == 1.0
    assert form.source == str(EXAMPLE)


def test_every_driver_is_registered() -> None:
    assert set(installed_drivers()) >= DRIVERS


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        ("version", 2, "version: found 2; Input should be 1"),
        ("clok", {}, "clok: unknown key"),
        ("clock.speed", 0, "clock.speed: found 0; Input should be greater than 0"),
        ("lines.laser.baud", 9600, r"lines\.laser\.serial\.baud: unknown key|lines\.laser\.baud: unknown key"),
        ("lines.laser.kind", "usb", "lines.laser.kind: found 'usb'; expected one of 'serial', 'tcp'"),
        ("lines.laser.kind", None, "lines.laser.kind: missing"),
        ("lines.io.parity", "even", "parity: found 'even'"),
        ("lines.laser.timeout", -1, "timeout: found -1"),
        ("devices.source", None, "devices.source: missing"),
        ("devices.source.line", "lasr", "devices.source.line: found 'lasr'; expected one of"),
        ("devices.source.driver", "nkt", "devices.source.driver: found 'nkt'; expected one of .*'nkt-superk'"),
        (
            "devices.source.watchdog",
            300,
            "devices.source.watchdog: found 300; Input should be less than",
        ),
        ("devices.source.wachdog", 3, "devices.source.wachdog: unknown key"),
        ("devices.source.line", "io", "'io' is of kind 'modbus-serial'; nkt-superk needs serial or tcp"),
        ("devices.sensor_zenith.address", None, "devices.sensor_zenith.address: missing"),
        ("devices.sensor_zenith.lower", 90.0, r"devices.sensor_zenith: .*lower \(90\) must be less than upper \(85\)"),
        ("devices.sensor_zenith.sign", 2, "devices.sensor_zenith.sign: found 2"),
        ("devices.detector.range", 7, "devices.detector.range: found 7; expected one of 0.1, 1, 10, 100, 1000"),
        ("devices.amplifier.coils", [0, 0], "devices.amplifier: .*coils name one output twice"),
    ],
)
def test_a_wrong_key_is_named_with_file_found_and_expected(tmp_path: Path, path: str, value: Any, problem: str) -> None:
    import tomli_w

    data = example()
    *above, key = path.split(".")
    place = data
    for part in above:
        place = place[part]
    if value is None:
        del place[key]
    else:
        place[key] = value
    file = tmp_path / "room.toml"
    file.write_text(tomli_w.dumps(data), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=problem) as caught:
        read_devices(file)
    assert str(caught.value).startswith(f"{file}: ")


@pytest.mark.parametrize(
    ("content", "problem"),
    [(b"version = ", "not valid TOML"), (b"\xff\xfe", "not a text file"), (None, "No such file")],
)
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None, problem: str) -> None:
    file = tmp_path / "room.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"room.toml: .*{problem}"):
        read_devices(file)


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="Is a directory"):
        read_devices(tmp_path)


# ---- connecting, with drivers of a third party ----------------------------------------------------------------------


class NoOptions(Form):
    """A driver without options."""


class Recorder:
    """A device that is no axis, laser or the like, and remembers what happened to it."""

    options = NoOptions
    line_kinds = ("serial", "visa", "modbus-serial")
    made: list[Recorder] = []  # noqa: RUF012 - shared on purpose
    fails = ""

    def __init__(self, name: str, line: Any, options: NoOptions, clock: Clock) -> None:
        self.name, self.line, self.clock = name, line, clock
        self.closed = 0
        line.attach(name)
        Recorder.made.append(self)

    def identify(self) -> str:
        """Who it is."""
        if self.name == Recorder.fails:
            raise DeviceFault(self.name, "smells burnt", "switch it off")
        return f"recorder {self.name}"

    def make_safe(self) -> None:
        """Nothing."""

    def close(self) -> None:
        """Release the line."""
        self.closed += 1
        self.line.release(self.name)


class Anything(Recorder):
    """Claims to be every kind of device."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *_: None


class Point:
    """An entry point of another package."""

    def __init__(self, driver: type) -> None:
        self._driver = driver

    def load(self) -> type:
        """Its driver."""
        return self._driver


@pytest.fixture
def room(converse: Callable[..., Peer], monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A room whose eight devices share one line."""
    points = {"anything": Point(Anything), "recorder": Point(Recorder)}
    monkeypatch.setattr(configuration, "installed_drivers", lambda: points)
    monkeypatch.setattr(Recorder, "made", [])
    monkeypatch.setattr(Recorder, "fails", "")
    return {
        "version": 1,
        "clock": {"speed": 7.0},
        "lines": {"bus": {"kind": "serial", "port": converse().port}},
        "devices": {role: {"driver": "anything", "line": "bus"} for role in ROLES},
    }


def test_devices_of_one_line_share_it_and_the_clock(room: dict[str, Any]) -> None:
    room["devices"]["thermometer"] = {"driver": "recorder", "line": "bus"}
    laboratory = connect(parse_devices(room))
    devices = laboratory.devices()
    assert set(devices) == {*ROLES, "thermometer"}
    assert len({id(device.line) for device in Recorder.made}) == 1
    assert {device.clock.speed for device in Recorder.made} == {7.0}
    line: OpenLine = Recorder.made[0].line
    laboratory.close()
    laboratory.close()
    with pytest.raises(CommunicationError, match="is closed"), Recorder.made[0].line.transaction("somebody"):
        pass
    assert line.name == "bus"


def test_a_device_that_does_not_fit_its_role_is_told_and_everything_closed(room: dict[str, Any]) -> None:
    room["devices"]["shutter"]["driver"] = "recorder"
    with pytest.raises(ConfigurationError, match="'recorder' is no Shutter, which the role 'shutter' needs"):
        connect(parse_devices(room, "room.toml"))
    assert all(device.closed for device in Recorder.made[:-1])


def test_a_device_that_fails_to_identify_names_its_line_and_closes_everything(
    room: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recorder, "fails", "selector")
    problem = r"selector: on line 'bus', driver 'anything': smells burnt \(switch it off\)"
    with pytest.raises(DeviceFault, match=problem):
        connect(parse_devices(room))
    assert all(device.closed for device in Recorder.made)
    # The port is free again: it can be opened, and locked, once more.
    monkeypatch.setattr(Recorder, "fails", "")
    connect(parse_devices(room)).close()


def test_a_line_that_cannot_be_opened_is_named(room: dict[str, Any]) -> None:
    room["lines"]["bus"]["port"] = "/dev/no-such-port"
    with pytest.raises(CommunicationError, match=r"illumination_zenith: line 'bus' cannot be opened: .*no-such-port"):
        connect(parse_devices(room))


def test_a_visa_resource_that_makes_no_sense_is_named(room: dict[str, Any]) -> None:
    room["lines"]["meter"] = {"kind": "visa", "resource": "TCPIQ::nowhere"}
    room["devices"]["detector"]["line"] = "meter"
    with pytest.raises(CommunicationError, match="detector: line 'meter' cannot be opened"):
        connect(parse_devices(room))


def test_a_port_that_cannot_be_is_named_and_everything_closed(room: dict[str, Any]) -> None:
    room["lines"]["meter"] = {"kind": "serial", "port": "nonsense://somewhere"}
    room["devices"]["detector"] = room["devices"]["sensor_zenith"] | {"line": "meter"}
    with pytest.raises(ConfigurationError, match=r"lines\.meter: .*nonsense"):
        connect(parse_devices(room))
