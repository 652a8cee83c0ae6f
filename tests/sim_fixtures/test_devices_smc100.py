"""The SMC100 chain as the manual describes it, in raw bytes over its pseudo-terminal."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from sim_fixtures.devices.newport_syntax import parse
from sim_fixtures.room import Room


class Port:
    """A terminal program on the line."""

    def __init__(self, path: str) -> None:
        self.serial = serial.Serial(path, 57600, timeout=1.0, exclusive=True)

    def send(self, *lines: str) -> None:
        for line in lines:
            self.serial.write(line.encode("ascii") + b"\r\n")

    def ask(self, line: str, timeout: float = 1.0) -> str:
        self.serial.timeout = timeout
        self.send(line)
        return self.serial.read_until(b"\r\n").decode("ascii").removesuffix("\r\n")

    def wait_for(self, address: int, *states: str) -> str:
        deadline = time.monotonic() + 5.0
        while (reply := self.ask(f"{address}TS"))[-2:] not in states:
            assert time.monotonic() < deadline, f"still {reply}"
            time.sleep(0.005)
        return reply


@pytest.fixture
def port(room: Room) -> Iterator[Port]:
    port = Port(str(room.endpoints.ports["sensor-arms"]))
    yield port
    port.serial.close()


@pytest.fixture
def homed(port: Port) -> Port:
    port.send("1OR", "2OR")
    port.wait_for(1, "32")
    port.wait_for(2, "32")
    return port


def test_power_on_is_not_referenced_and_echoes_address_and_command(port):
    assert port.ask("1TS") == "1TS00000A"
    assert port.ask("2ts") == "2TS00000A"
    assert port.ask(" 1 T P ") == "1TP0"
    assert port.ask("1VA?") == "1VA20"


def test_an_address_that_is_not_there_stays_silent(port):
    assert port.ask("3TS", timeout=0.15) == ""
    assert port.ask("1TS") == "1TS00000A"


def test_a_move_before_homing_is_refused_with_h_and_the_letter_is_read_once(port):
    port.send("1PA10")
    assert port.ask("1TE") == "1TEH"
    assert port.ask("1TE") == "1TE@"
    assert port.ask("2TE") == "2TE@"


def test_homing_passes_through_its_state_and_ends_ready(port):
    port.send("1OR")
    assert port.ask("1TS")[-2:] == "1E"
    port.send("1OR")
    assert port.ask("1TE") == "1TEE"
    port.send("1PA1")
    assert port.ask("1TE") == "1TEL"
    port.wait_for(1, "32")
    port.send("1OR")
    assert port.ask("1TE") == "1TEK"


def test_a_move_is_moving_then_ready_and_arrives_exactly(homed):
    homed.send("2PA-45.5")
    assert homed.ask("2TS") == "2TS000028"
    homed.send("2PA3")
    assert homed.ask("2TE") == "2TEM"
    assert homed.wait_for(2, "33") == "2TS000033"
    assert homed.ask("2TP") == "2TP-45.5"
    assert homed.ask("2PA?") == "2PA-45.5"
    homed.send("2PR0.25")
    homed.wait_for(2, "33")
    assert homed.ask("2TP") == "2TP-45.25"


def test_a_move_to_where_the_arm_stands_leaves_the_state_after_homing(homed):
    homed.send("1PA0")
    assert homed.ask("1TS") == "1TS000032"
    assert homed.ask("1TE") == "1TE@"


def test_what_follows_the_first_command_is_ignored(homed, room):
    homed.send("1PA5;1PA50")
    homed.wait_for(1, "33")
    assert homed.ask("1TP") == "1TP5"
    assert room.bench.motion_commands == {"sensor_azimuth": 2, "sensor_zenith": 1}  # homing counts


def test_software_limits_refuse_with_g_and_can_be_narrowed(homed):
    homed.send("2PA91")
    assert homed.ask("2TE") == "2TEG"
    homed.send("2SR20", "2PA21")
    assert homed.ask("2TE") == "2TEG"
    homed.send("2SR-1")
    assert homed.ask("2TE") == "2TEC"
    assert homed.ask("2SR?") == "2SR20"
    assert homed.ask("2TP") == "2TP0"


def test_unknown_commands_and_missing_values_have_their_letters(port):
    port.send("1ZZ9")
    assert port.ask("1TE") == "1TEA"
    port.send("1PA")
    assert port.ask("1TB").startswith("1TBC ")
    assert port.ask("1TBG") == "1TBG Displacement out of limits"


def test_stop_ends_every_motion_on_the_line(homed):
    homed.send("1PA180", "2PA-80")
    homed.ask("1TS")
    homed.send("ST")
    homed.wait_for(1, "33")
    homed.wait_for(2, "33")
    assert 0 < float(homed.ask("1TP")[3:]) < 180
    assert -80 < float(homed.ask("2TP")[3:]) < 0


def test_armed_axes_start_together(homed):
    homed.send("1SE30", "2SE-20")
    assert homed.ask("1TS")[-2:] == "32"
    homed.send("SE")
    homed.wait_for(1, "33")
    homed.wait_for(2, "33")
    assert (homed.ask("1TP"), homed.ask("2TP")) == ("1TP30", "2TP-20")


def test_disable_and_enable(homed):
    homed.send("1MM0")
    assert homed.ask("1TS")[-2:] == "3C"
    homed.send("1PA1")
    assert homed.ask("1TE") == "1TEJ"
    homed.send("1MM1")
    assert homed.ask("1TS")[-2:] == "34"


def test_the_time_estimate_is_that_of_the_trapezoid(homed):
    assert float(homed.ask("1PT160")[3:]) == pytest.approx(10.0)
    assert float(homed.ask("1PT5")[3:]) == pytest.approx(2**0.5, abs=1e-5)


@pytest.mark.parametrize(("direction", "error"), [(-1, "0001"), (1, "0002")])
def test_a_limit_switch_loses_the_reference_and_shows_once(homed, room, direction, error):
    homed.send("2PA60")
    homed.ask("2TS")
    room.control("limit_switch", axis="sensor_zenith", direction=direction)
    reply = homed.ask("2TS")
    assert reply in (f"2TS{error}0F", f"2TS{error}0E")
    assert homed.ask("2TS")[3:7] == "0000"
    homed.send("2PA1")
    assert homed.ask("2TE") == "2TEH"
    homed.send("2OR")
    homed.wait_for(2, "32")


def test_an_alarm_is_a_following_error_and_disables(homed, room):
    room.control("alarm", axis="sensor_azimuth")
    assert homed.ask("1TS") == "1TS00203C"
    assert homed.ask("1TS") == "1TS00003C"
    assert homed.ask("2TS") == "2TS000032"


def test_a_stalled_axis_moves_for_ever_until_it_is_stopped(homed, room):
    room.control("stall", axis="sensor_zenith")
    homed.send("2PA40")
    time.sleep(0.2)  # 40 s of the laboratory
    assert homed.ask("2TS")[-2:] == "28"
    assert homed.ask("2TP") == "2TP20"
    homed.send("2ST")
    assert homed.ask("2TS")[-2:] == "33"
    homed.send("2PA40")
    homed.wait_for(2, "33")
    assert homed.ask("2TP") == "2TP40"


def test_reset_forgets_the_reference(homed):
    homed.send("1RS")
    assert homed.ask("1TS") == "1TS00000A"


def test_leaving_configuration_makes_the_controller_deaf_for_a_while(port):
    port.send("1PW1")
    assert port.ask("1TS")[-2:] == "14"
    port.send("1VA15", "1PW0")
    assert port.ask("1TS", timeout=0.02) == ""
    time.sleep(0.1)
    assert port.ask("1TS")[-2:] == "0C"
    assert port.ask("1VA?") == "1VA15"
    assert port.ask("2TS")[-2:] == "0A"


def test_lost_late_and_garbled_replies(port, room):
    room.control("drop_replies", device="sensor_zenith")
    assert port.ask("1TS", timeout=0.1) == ""
    room.control("corrupt_reply", device="sensor-arms")
    assert port.ask("1TS") not in ("", "1TS00000A")
    room.control("late_reply", device="sensor-arms", delay=0.2)
    begin = time.monotonic()
    assert port.ask("1TS") == "1TS00000A"
    assert time.monotonic() - begin >= 0.2
    assert port.ask("1TS") == "1TS00000A"


def test_a_lost_request_does_nothing_and_nobody_says_so(homed, room):
    room.control("lose_requests", device="sensor_zenith")
    homed.send("2PA40")
    assert homed.ask("2TE") == "2TE@"
    assert homed.ask("2PA?") == "2PA0"
    assert room.bench.motion_commands["sensor_zenith"] == 1


def test_a_pulled_plug_ends_the_connection_and_the_name_comes_back(port, room):
    path = str(room.endpoints.ports["sensor-arms"])
    room.control("disconnect", device="sensor-arms", seconds=0.2)
    time.sleep(0.1)
    with pytest.raises(serial.SerialException):
        port.ask("1TS")
    with pytest.raises(serial.SerialException):
        serial.Serial(path, 57600)
    time.sleep(0.2)
    again = Port(path)
    assert again.ask("1TS") == "1TS00000A"
    again.serial.close()


def test_the_line_can_be_opened_again_after_exclusive_use(room):
    path = str(room.endpoints.ports["sensor-arms"])
    for _ in range(3):
        port = Port(path)
        assert port.ask("1TS") == "1TS00000A"
        port.serial.close()


@given(
    address=st.integers(1, 31),
    name=st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ", min_size=2, max_size=2),
    value=st.one_of(st.none(), st.floats(-1e4, 1e4).map(lambda x: round(x, 6))),
    blanks=st.integers(0, 3),
)
def test_every_well_formed_line_is_read_back(address, name, value, blanks):
    text = "" if value is None else f"{value:.6f}"
    command = parse(" " * blanks + f"{address}{name.lower()} {text}\r")
    assert command is not None
    assert (command.address, command.name, command.query) == (address, name, False)
    assert command.value == (None if value is None else pytest.approx(value))


@pytest.mark.parametrize("noise", ["", "\r", "?", "12", "1.5TP", "!!"])
def test_noise_is_no_command(noise):
    assert parse(noise) is None
