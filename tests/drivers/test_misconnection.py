"""Wrong ports, rates and addresses, on the pseudo-terminals of the simulated laboratory: what a person is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers import probes
from drivers.check import check_devices
from drivers.configuration import connect, read_devices
from drivers.errors import CommandRefused, ConfigurationError, DeviceError
from drivers.misconnection import find_key
from instrument.facility import UNKNOWN_FACILITY
from sim_fixtures.bench import Bench, BenchClock, lambertian_flux
from sim_fixtures.devices.newport_chain import Smc100Chain
from sim_fixtures.devices.wire import SerialLine
from sim_fixtures.laboratory import SimulatedLaboratory

Wrong = Callable[[str], str]


@pytest.fixture(autouse=True)
def _quick_ears(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated devices answer at once."""
    monkeypatch.setattr(probes, "LISTEN", 0.06)


@pytest.fixture
def told(devices: Path, tmp_path: Path) -> Callable[[Wrong], dict[str, str]]:
    """Causes by role, of a file that is wrong in one way."""

    def check(wrong: Wrong) -> dict[str, str]:
        file = tmp_path / "devices.toml"
        file.write_text(wrong(devices.read_text()).replace("timeout = 0.4", "timeout = 0.15"))
        results = check_devices(read_devices(file))
        assert all(result.cause for result in results if not result.ok), results
        return {result.role: result.cause.removeprefix(str(file)) for result in results if not result.ok}

    return check


def line_number(text: str, line: str) -> int:
    return text.splitlines().index(line) + 1


def port(simulation: SimulatedLaboratory, line: str) -> str:
    return str(simulation.endpoints["ports"][line])


def test_an_address_where_nobody_is(told: Callable[[Wrong], dict[str, str]], devices: Path) -> None:
    causes = told(lambda text: text.replace("address = 2\n", "address = 9\n"))
    number = line_number(devices.read_text(), "address = 2")
    assert causes == {
        "sensor_zenith": f":{number}: devices.sensor_zenith.address = 9: expected Newport SMC100 at address 9 on line"
        " 'sensor-arms'; answered: Newport SMC100 at address 1 (SMC_CC 1.2.1), Newport SMC100 at address 2"
        " (SMC_CC 1.2.1)"
    }


def test_a_port_that_does_not_exist(told: Callable[[Wrong], dict[str, str]]) -> None:
    causes = told(lambda text: text.replace("laser.tty", "leaser.tty"))
    assert set(causes) == {"source", "selector"}
    assert "lines.laser.port = " in causes["source"]
    assert causes["source"].endswith("at address 15 on line 'laser'; answered: nobody: No such file or directory")


def test_the_port_of_another_line(
    told: Callable[[Wrong], dict[str, str]], simulation: SimulatedLaboratory, devices: Path
) -> None:
    one, other = port(simulation, "io"), port(simulation, "illumination-arm")
    causes = told(lambda text: text.replace(one, "@").replace(other, one).replace("@", other))
    assert set(causes) == {"illumination_zenith", "shutter", "amplifier"}
    assert "devices.illumination_zenith.line" in causes["illumination_zenith"]
    assert (
        "answered: here Modbus I/O module at address 1; the one expected is on line 'io'"
        in causes["illumination_zenith"]
    )


def test_another_kind_of_device_on_the_line(
    told: Callable[[Wrong], dict[str, str]], simulation: SimulatedLaboratory
) -> None:
    causes = told(lambda text: text.replace(port(simulation, "sensor-arms"), port(simulation, "esp301")))
    assert set(causes) == {"sensor_azimuth", "sensor_zenith"}
    assert "expected Newport SMC100 at address 1" in causes["sensor_azimuth"]
    assert "answered: Newport ESP301 (ESP301 Version" in causes["sensor_azimuth"]


def test_addresses_of_two_modules_that_are_swapped(told: Callable[[Wrong], dict[str, str]]) -> None:
    causes = told(lambda text: text.replace("address = 18\nselect_address = 16", "address = 16\nselect_address = 18"))
    assert set(causes) == {"selector"}
    assert "devices.selector.address = 16: expected NKT RF driver at address 16" in causes["selector"]
    assert "NKT SuperK SELECT at address 16, NKT RF driver at address 18" in causes["selector"]


def test_a_wrong_baud_rate_and_the_right_one(
    told: Callable[[Wrong], dict[str, str]], simulation: SimulatedLaboratory, devices: Path
) -> None:
    simulation.control("baudrate", line="sensor-arms", rate=9600)
    try:
        causes = told(lambda text: text)
        with pytest.raises(DeviceError, match=r"baudrate = 57600: expected Newport SMC100.*that one, at 9600 baud"):
            connect(devices)
    finally:
        simulation.control("baudrate", line="sensor-arms", rate=0)
    assert set(causes) == {"sensor_azimuth", "sensor_zenith"}
    assert causes["sensor_azimuth"].endswith("answered: that one, at 9600 baud")


def test_a_line_that_nobody_answers_on(told: Callable[[Wrong], dict[str, str]], tmp_path: Path) -> None:
    with_nobody = SerialLine(tmp_path / "empty.tty")
    with_nobody.listen(lambda _: None)
    try:
        causes = told(
            lambda text: (
                text.replace('line = "laser"', 'line = "spare"')
                + f'\n[lines.spare]\nkind = "serial"\nport = "{with_nobody.link}"\nbaudrate = 115200\ntimeout = 0.2\n'
            )
        )
    finally:
        with_nobody.close()
    assert "the one expected is on line 'laser'" in causes["source"]


class Crowd:
    """Two controllers that were left at the same address."""

    def __init__(self, bench: Bench) -> None:
        self.chains = [Smc100Chain(bench, {1: name}) for name in ("sensor_azimuth", "sensor_zenith")]
        self.request_lost = lambda _: False

    def feed(self, data: bytes) -> list[bytes]:
        return [reply for chain in self.chains for reply in chain.feed(data)]


@pytest.fixture
def crowded(tmp_path: Path) -> Iterator[Path]:
    """Port of a line with two controllers at address 1."""
    bench = Bench(UNKNOWN_FACILITY, lambertian_flux, BenchClock(40.0), 1)
    line = SerialLine(tmp_path / "crowded.tty")
    line.serve(Crowd(bench))
    yield line.link
    line.close()
    bench.close()


def test_two_controllers_at_one_address_are_never_moved(
    crowded: Path, devices: Path, simulation: SimulatedLaboratory, tmp_path: Path
) -> None:
    file = tmp_path / "devices.toml"
    file.write_text(devices.read_text().replace(port(simulation, "sensor-arms"), str(crowded)))
    with pytest.raises(CommandRefused, match=r"sensor_azimuth.*2 controllers answer at address 1.*at the same address"):
        connect(file)
    cause = next(result.cause for result in check_devices(read_devices(file)) if result.role == "sensor_azimuth")
    assert "devices.sensor_azimuth.address = 1: expected Newport SMC100 at address 1" in cause
    assert "answered: 2 devices at once, at the same address" in cause


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("address = 2\n", "address = 1\n", "address 1 on line 'sensor-arms' is that of devices.sensor_azimuth already"),
        ("coil = 4\n", "coil = 3\n", "address 1, output 3 on line 'io' is that of devices.shutter already"),
        ("io.tty", "illumination-arm.tty", "is that of lines.illumination-arm already"),
    ],
)
def test_two_devices_in_one_place_are_refused_as_the_file_is_read(
    devices: Path, tmp_path: Path, old: str, new: str, problem: str
) -> None:
    file = tmp_path / "devices.toml"
    file.write_text(devices.read_text().replace(old, new))
    with pytest.raises(ConfigurationError, match=problem):
        read_devices(file)


def test_devices_that_are_alike_are_told_apart_by_what_they_say(devices: Path, tmp_path: Path) -> None:
    file = tmp_path / "devices.toml"
    text = devices.read_text().replace("[devices.sensor_zenith]", '[devices.sensor_zenith]\nidentity = "address 1"')
    file.write_text(text)
    result = next(result for result in check_devices(read_devices(file)) if result.role == "sensor_zenith")
    assert "devices.sensor_zenith.identity: expected 'address 1'; answered: Newport SMC100, address 2" in result.problem
    assert "swapped" in result.problem


def test_keys_are_found_where_they_are_written() -> None:
    text = 'version = 1\n[lines.a]\nport = "x" # here\n\n[devices."b"]\naddress = 3\n[devices.c]\nline = "a"\n'
    assert find_key(text, ("lines", "a", "port")) == (3, '"x"')
    assert find_key(text, ("devices", "b", "address")) == (6, "3")
    assert find_key(text, ("devices", "c", "address")) == (7, "")
    assert find_key(text, ("devices", "d", "address")) == (0, "")
