"""The simulated laboratory as a process: its files, its control channel, its end."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from drivers.configuration import connect, read_devices
from drivers.interfaces import Laboratory
from instrument.artifact import read_artifact
from instrument.errors import InputError
from instrument.facility import read_facility
from instrument.laboratories import laboratory_factory
from sim_fixtures.laboratory import SimulatedLaboratory, start_simulated


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., SimulatedLaboratory]]:
    started: list[SimulatedLaboratory] = []

    def start(**options: object) -> SimulatedLaboratory:
        folder = tmp_path / f"laboratory{len(started)}"
        folder.mkdir()
        started.append(start_simulated(folder, **{"speed": 200.0, "flux": "lambertian"} | options))  # type: ignore[arg-type]
        return started[-1]

    yield start
    for laboratory in started:
        laboratory.close()


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedLaboratory]:
    """One for all tests that leave it as it is."""
    with start_simulated(tmp_path_factory.mktemp("laboratory"), speed=200.0, flux="lambertian") as laboratory:
        yield laboratory


def is_running(pid: int) -> bool:
    """Whether a process is there and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_until(condition: Callable[[], bool], seconds: float = 10.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def ask_meter(laboratory: SimulatedLaboratory, *lines: str) -> str:
    """Send lines to the meter; the answer to the last one."""
    with socket.create_connection(("127.0.0.1", laboratory.endpoints["meter"]), timeout=10.0) as connection:
        connection.sendall("".join(line + "\n" for line in lines).encode("ascii"))
        with connection.makefile("rb") as file:
            return file.readline().decode("ascii").strip()


def test_the_entry_point_names_the_factory():
    assert laboratory_factory() is start_simulated


def test_every_file_is_there_and_can_be_read(laboratory):
    inputs = laboratory.inputs
    assert inputs.plan.exists()
    assert inputs.material.exists()
    assert read_facility(inputs.facility).name
    assert len(read_artifact(inputs.artifact).holes) > 0
    form = read_devices(inputs.devices)
    assert form.clock.speed == 200.0
    assert {line.kind for line in form.lines.values()} == {"serial", "modbus-serial", "visa"}


def test_every_line_answers_at_the_address_of_devices_toml(laboratory):
    lines = tomllib.loads(laboratory.inputs.devices.read_text())["lines"]
    with serial.Serial(lines["sensor-arms"]["port"], 57600, timeout=2.0) as port:
        port.write(b"1TS\r\n")
        assert port.read_until(b"\n") == b"1TS00000A\r\n"
    with serial.Serial(lines["laser"]["port"], 115200, timeout=2.0) as port:
        port.write(bytes.fromhex("0D 0F A2 04 66 C7 B6 0A"))
        assert port.read_until(b"\n")[:5] == bytes.fromhex("0D A2 0F 08 66")
    with serial.Serial(lines["illumination-arm"]["port"], 115200, timeout=2.0) as port:
        port.write(bytes.fromhex("01 08 00 00 12 34 ED 7C"))
        assert port.read(8) == bytes.fromhex("01 08 00 00 12 34 ED 7C")
    with serial.Serial(lines["io"]["port"], 9600, timeout=2.0) as port:
        port.write(bytes.fromhex("01 08 00 00 12 34 ED 7C"))
        assert port.read(8) == bytes.fromhex("01 08 00 00 12 34 ED 7C")
    _, host, tcp, _ = lines["meter"]["resource"].split("::")
    assert (host, int(tcp)) == ("127.0.0.1", laboratory.endpoints["meter"])
    assert ask_meter(laboratory, "*IDN?").startswith("Keysight")


def test_the_servers_listen_on_the_loopback_interface_only(laboratory):
    ports = {laboratory.endpoints["meter"], laboratory.endpoints["control"]}
    found = set()
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        address, port = line.split()[1].split(":")
        if int(port, 16) in ports and line.split()[3] == "0A":
            found.add(int(port, 16))
            assert address == "0100007F"
    assert found == ports


def test_the_operator_changes_the_sample(laboratory):
    for what in ("sample", "reference", "sample"):
        laboratory.operator.mount(what)
        assert laboratory.control("state")["mounted"] == what


def test_the_control_channel_explains_what_it_refuses(laboratory):
    with pytest.raises(ValueError, match="expected 'reference' or 'sample'"):
        laboratory.control("mount", what="cat")
    with pytest.raises(ValueError, match="expected one of"):
        laboratory.control("explode")
    with pytest.raises(ValueError, match="axis: found 'nose'"):
        laboratory.control("stall", axis="nose")
    with pytest.raises(ValueError, match="device: found 'nose'"):
        laboratory.control("drop_replies", device="nose")
    with pytest.raises(ValueError, match="axes"):
        laboratory.control("stall", axes="sensor_zenith")


def test_motion_commands_are_counted_as_they_come(laboratory):
    assert laboratory.control("motion_commands") == {}
    with serial.Serial(laboratory.endpoints["ports"]["sensor-arms"], 57600, timeout=2.0) as port:
        port.write(b"2OR\r\n2PA5\r\n2TS\r\n")
        assert port.read_until(b"\n") == b"2TS00001E\r\n"
    assert laboratory.control("motion_commands") == {"sensor_zenith": 2}


def test_a_seed_repeats_in_another_process(start):
    burst = ("CONF:VOLT:DC 10", "SAMP:COUN 9", "READ?")
    first, second = ask_meter(start(), *burst), ask_meter(start(speed=1000.0), *burst)
    assert len(set(first.split(","))) == 9
    assert first == second


def test_leaving_the_context_ends_the_process_and_removes_the_lines(start):
    with start() as laboratory:
        pid = laboratory.pid
        assert is_running(pid)
    assert not is_running(pid)
    assert not any(os.path.lexists(path) for path in laboratory.endpoints["ports"].values())
    with pytest.raises((ConnectionError, ValueError)):
        laboratory.control("state")
    laboratory.close()


_PARENT = """
import sys, time
from pathlib import Path
from sim_fixtures.laboratory import start_simulated
laboratory = start_simulated(Path(sys.argv[1]), speed=200.0, flux="lambertian")
print(laboratory.pid, flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_process_ends_when_its_parent_is_killed(tmp_path, number):
    parent = subprocess.Popen([sys.executable, "-c", _PARENT, str(tmp_path)], stdout=subprocess.PIPE)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert is_running(pid)
    parent.send_signal(number)
    parent.wait(10.0)
    parent.stdout.close()
    assert wait_until(lambda: not is_running(pid))


def test_ctrl_c_at_the_terminal_is_not_for_the_laboratory(laboratory):
    assert os.getpgid(laboratory.pid) != os.getpgid(0)


def test_a_crash_of_the_laboratory_is_an_error_of_the_channel(start):
    laboratory = start()
    os.kill(laboratory.pid, signal.SIGKILL)
    assert wait_until(lambda: not is_running(laboratory.pid))
    with pytest.raises(OSError, match=r"ended|reset|pipe"):
        laboratory.control("state")


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_a_speed_that_is_not_positive_is_refused(tmp_path, speed):
    with pytest.raises(InputError, match="speed"):
        start_simulated(tmp_path, speed=speed)


def test_a_wrong_facility_is_named_and_nothing_starts(tmp_path):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("name = 'x'\n")
    with pytest.raises(InputError, match=r"wrong\.toml|facility\.toml"):
        start_simulated(tmp_path, facility=wrong)
    assert not (tmp_path / "sensor-arms.tty").is_symlink()


def test_a_missing_artifact_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml: no such file"):
        start_simulated(tmp_path, artifact=tmp_path / "nowhere.toml")


def test_a_process_that_does_not_start_quotes_its_last_words(tmp_path):
    with pytest.raises(RuntimeError, match="invalid choice: 'moonlight'"):
        start_simulated(tmp_path, flux="moonlight")


def test_devices_simulate_prints_where_everything_is_and_ends_with_ctrl_c(tmp_path):
    folder = f"Path({str(tmp_path)!r})"
    code = f"from pathlib import Path; from sim_fixtures.commands import simulate; simulate(50.0, 1, {folder})"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, env=os.environ | {"COLUMNS": "200"}
    )
    assert process.stdout is not None
    said = b""
    while b"Ctrl-C" not in said:
        piece = process.stdout.readline()
        assert piece, said
        said += piece
    text = said.decode()
    assert str(tmp_path / "devices.toml") in text
    assert all(name in text for name in ("sensor-arms", "illumination-arm", "laser", "io", "meter", "control"))
    assert read_devices(tmp_path / "devices.toml").clock.speed == 50.0
    process.send_signal(signal.SIGINT)
    assert process.wait(10.0) == 0
    process.stdout.close()


def test_our_drivers_read_the_simulated_reality(start):
    started = start(flux="reality", speed=100.0)
    room = connect(started.inputs.devices)
    try:
        for axis in room.axes().values():
            axis.home()
        wait_for_arms(room)
        room.selector.set_wavelength(500.0)
        room.source.set_emission(True)
        room.amplifier.set_gain(1e6)
        room.shutter.open()
        volts = {}
        for what, zenith in (("reference", 15.0), ("sample", 15.0), ("sample", 60.0)):
            started.operator.mount(what)
            room.sensor_zenith.start_move(zenith)
            wait_for_arms(room)
            time.sleep(0.01)
            reading = room.detector.read(9)
            assert not reading.overload
            volts[what, zenith] = sum(reading.samples) / 9
    finally:
        room.close()
    assert volts["reference", 15.0] == pytest.approx(0.99, rel=0.012)  # true value of the reference: 2 x 0.5 %
    # The artifact is darker than white, and its holes hide more of their walls at grazing view.
    assert 0.3 < volts["sample", 15.0] < 0.8
    assert 0.3 < volts["sample", 60.0] / volts["sample", 15.0] < 0.6
    state = started.control("state")
    assert state["readings"] == 27
    assert state["motion_commands"] == {"illumination_zenith": 1, "sensor_azimuth": 1, "sensor_zenith": 4}


def wait_for_arms(room: Laboratory) -> None:
    """Until every arm has homed and stands."""

    def at_rest() -> bool:
        states = [axis.status() for axis in room.axes().values()]
        return all(state.homed and not state.moving for state in states)

    assert wait_until(at_rest)
