"""Conversations with an Oriental Motor AZ drive; the frames of the protocol description byte for byte."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted_peer import Late, Peer, Step, rtu, unhex

from drivers import modbus_line
from drivers.az_codes import signed, words
from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.interfaces import Axis
from drivers.lines import ModbusSerialLineForm
from drivers.modbus_line import ModbusLine
from drivers.oriental_az import AzForm, OrientalAz

Converse = Callable[..., Peer]
OPTIONS: dict[str, Any] = {
    "address": 1,
    "steps_per_degree": 100.0,
    "lower": -90.0,
    "upper": 90.0,
    "velocity": 20.0,
    "acceleration": 15.0,
    "tolerance": 0.02,
}

ALARM, READY, MOVE = 1 << 1, 1 << 4, 1 << 6
HOME_END, ABSPEN = 1 << 0, 1 << 1


def status(drive: int = READY, origin: int = ABSPEN) -> Step:
    return rtu("01 03 01 78 00 02"), rtu(f"01 03 04 {origin:04X} {drive:04X}")


def long(address: int, value: int) -> Step:
    return rtu(f"01 03 {address:04X} 00 02"), rtu(f"01 03 04 {value & 0xFFFFFFFF:08X}")


def pulse(value: int) -> list[Step]:
    return [(rtu(f"01 06 00 7D {v:04X}"), rtu(f"01 06 00 7D {v:04X}")) for v in (value, 0)]


#: Absolute move to 8500 steps, 2000 Hz, 1.5 kHz/s, full current: the frame of the protocol description.
MOVE_8500: Step = (
    unhex(
        "01 10 00 58 00 10 20 00 00 00 00 00 00 00 01 00 00 21 34 00 00 07 D0 00 00 05 DC 00 00 05 DC "
        "00 00 03 E8 00 00 00 01 E3 43"
    ),
    unhex("01 10 00 58 00 10 40 16"),
)
ECHO: Step = (rtu("01 08 00 00 00 01"), rtu("01 08 00 00 00 01"))


@contextmanager
def axis_on(peer: Peer, timeout: float = 0.2, **changes: Any) -> Iterator[OrientalAz]:
    form = ModbusSerialLineForm(kind="modbus-serial", port=peer.port, baudrate=115200, parity="E", timeout=timeout)
    line = form.open("arm")
    assert isinstance(line, ModbusLine)
    axis = OrientalAz("illumination_zenith", line, AzForm.model_validate(OPTIONS | changes), Clock())
    try:
        yield axis
    finally:
        axis.close()


def test_it_is_an_axis(converse: Converse) -> None:
    with axis_on(converse()) as axis:
        assert isinstance(axis, Axis)


def test_feedback_position_frames(converse: Converse) -> None:
    with axis_on(converse((unhex("01 03 00 CC 00 02 04 34"), unhex("01 03 04 FF FF FF F6 3B A1")))) as axis:
        assert axis.position() == pytest.approx(-0.10)


def test_status_word_frame_and_echo_frame(converse: Converse) -> None:
    peer = converse(
        (unhex("01 03 00 7F 00 01 B5 D2"), rtu("01 03 02 20 00")),
        (unhex("01 08 00 00 12 34 ED 7C"), unhex("01 08 00 00 12 34 ED 7C")),
    )
    form = ModbusSerialLineForm(kind="modbus-serial", port=peer.port, timeout=0.3)
    line = form.open("arm")
    assert isinstance(line, ModbusLine)
    assert line.read_registers("arm", 1, 0x7F) == [0x2000]
    line._numbers = iter([0x1234])  # type: ignore[assignment]
    line.echo("arm", 1)
    line.close()


def test_stop_frames_set_and_clear_the_bit(converse: Converse) -> None:
    frame = unhex("01 06 00 7D 00 20 18 0A")
    with axis_on(converse((frame, frame), pulse(0)[1])) as axis:
        axis.stop()


def test_home_frames_set_and_clear_the_bit(converse: Converse) -> None:
    frame = unhex("01 06 00 7D 00 10 18 1E")
    with axis_on(converse(status(), (frame, frame), pulse(0)[1], status(MOVE))) as axis:
        axis.home()


def test_bits_that_the_drive_has_reassigned_are_configuration(converse: Converse) -> None:
    with axis_on(converse(*pulse(0x0400)), stop_bit=10) as axis:
        axis.stop()


def test_a_move_is_one_frame_confirmed_by_its_target_and_by_motion(converse: Converse) -> None:
    with axis_on(converse(status(), MOVE_8500, long(0x5C, 8500), status(MOVE))) as axis:
        axis.start_move(85.0)


def test_a_move_that_is_over_before_the_first_look_counts(converse: Converse) -> None:
    with axis_on(converse(status(), MOVE_8500, long(0x5C, 8500), status(READY), long(0xC6, 8500))) as axis:
        axis.start_move(85.0)


def test_a_move_that_the_drive_ignores_is_an_error(converse: Converse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.oriental_az.ACCEPT_DEADLINE", -1.0)
    peer = converse(status(), MOVE_8500, long(0x5C, 8500), status(READY), long(0xC6, 0))
    with axis_on(peer) as axis, pytest.raises(CommunicationError, match="ignored the move without an alarm"):
        axis.start_move(85.0)


def test_a_lost_reply_to_a_move_stops_the_axis_and_nothing_is_sent_again(converse: Converse) -> None:
    peer = converse(status(), (MOVE_8500[0], None), *pulse(0x20), status(READY), long(0xCC, 120))
    with (
        axis_on(peer, timeout=0.15) as axis,
        pytest.raises(CommunicationError, match=r"it is standing at 1\.200 degree"),
    ):
        axis.start_move(85.0)


def test_a_stop_goes_out_although_the_line_is_out_of_step(converse: Converse) -> None:
    request = rtu("01 03 00 CC 00 02")
    echoes = [(rtu(f"01 08 00 00 00 {number:02X}"), None) for number in (1, 2)]
    problem = "illumination_zenith: echo test on line 'arm': no valid reply"
    with axis_on(converse((request, None), *echoes, *pulse(0x20)), timeout=0.15) as axis:
        with pytest.raises(CommunicationError, match=problem):
            axis.position()
        axis.stop()


def test_an_exception_to_a_move_is_told_in_words(converse: Converse) -> None:
    peer = converse(status(), (MOVE_8500[0], unhex("01 90 03 0C 01")))
    with axis_on(peer) as axis, pytest.raises(CommandRefused, match="exception 03h, illegal data value"):
        axis.start_move(85.0)


def test_a_block_that_was_written_in_part_stops_the_axis(converse: Converse) -> None:
    peer = converse(status(), MOVE_8500, long(0x5C, 0), *pulse(0x20), status(), long(0xCC, 0))
    with axis_on(peer) as axis, pytest.raises(CommunicationError, match="target reads 0 steps, 8500 were sent"):
        axis.start_move(85.0)


@pytest.mark.parametrize(
    ("drive", "origin", "problem"),
    [(MOVE, ABSPEN, "still moving"), (0, ABSPEN, "not ready"), (READY, 0, "no coordinates")],
)
def test_a_move_that_cannot_be_is_refused(converse: Converse, drive: int, origin: int, problem: str) -> None:
    with axis_on(converse(status(drive, origin))) as axis, pytest.raises(CommandRefused, match=problem):
        axis.start_move(1.0)


def test_an_alarm_is_told_in_words(converse: Converse) -> None:
    reverse = rtu("01 03 01 70 00 01"), rtu("01 03 02 20 00")
    peer = converse(status(ALARM), long(0x80, 0x66), reverse, status(ALARM), long(0x80, 0x30))
    with axis_on(peer) as axis:
        with pytest.raises(DeviceFault, match="alarm 66h: hardware overtravel, reverse limit sensor active"):
            axis.start_move(1.0)
        assert axis.status().fault == "alarm 30h: overload"


@pytest.mark.parametrize(("feedback", "in_position"), [(8500, True), (8502, True), (8503, False)])
def test_in_position_means_that_feedback_agrees_with_the_command(
    converse: Converse, feedback: int, in_position: bool
) -> None:
    with axis_on(converse(status(), long(0xC6, 8500), long(0xCC, feedback))) as axis:
        state = axis.status()
    assert (state.moving, state.homed, state.in_position, state.fault) == (False, True, in_position, "")


def test_a_late_reply_of_the_same_length_is_not_taken_for_the_next_one(
    converse: Converse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(modbus_line, "QUIET", 0.5)  # longer than a busy machine is late
    request = rtu("01 03 00 CC 00 02")
    peer = converse((request, Late(0.35, rtu("01 03 04 00 00 00 01"))), ECHO, (request, rtu("01 03 04 00 00 00 C8")))
    with axis_on(peer, timeout=0.15) as axis:
        assert axis.position() == 2.0


def test_a_reply_that_comes_while_the_line_gets_back_into_step_is_not_taken_either(converse: Converse) -> None:
    request = rtu("01 03 00 CC 00 02")
    second = rtu("01 08 00 00 00 02")
    peer = converse(
        (request, Late(0.27, rtu("01 03 04 00 00 00 01"))), (ECHO[0], Late(0.1, ECHO[1])), (second, second),
        (request, rtu("01 03 04 00 00 00 C8")),
    )  # fmt: skip
    with axis_on(peer, timeout=0.2) as axis:
        assert axis.position() == 2.0


def test_a_garbled_reply_is_asked_for_again(converse: Converse) -> None:
    request = rtu("01 03 00 CC 00 02")
    peer = converse((request, unhex("01 03 04 FF FF FF F7 3B A1")), ECHO, (request, rtu("01 03 04 00 00 00 C8")))
    with axis_on(peer, timeout=0.15) as axis:
        assert axis.position() == 2.0


def test_identity_comes_after_an_echo_and_a_check_of_the_word_order(converse: Converse) -> None:
    temperatures = (rtu("01 03 00 F8 00 04"), rtu("01 03 08 00 00 01 38 00 00 01 1F"))
    with axis_on(converse(ECHO, temperatures)) as axis:
        assert axis.identify() == "Oriental Motor AZ, slave 1, driver 31.2 degC, motor 28.7 degC"
    problem = "make no sense with word_order 'little', and do with 'big'"
    peer = converse(ECHO, temperatures)
    with axis_on(peer, word_order="little") as axis, pytest.raises(CommandRefused, match=problem):
        axis.identify()


def test_the_little_word_order_reaches_the_wire(converse: Converse) -> None:
    with axis_on(converse((rtu("01 03 00 CC 00 02"), rtu("01 03 04 FF F6 FF FF"))), word_order="little") as axis:
        assert axis.position() == pytest.approx(-0.10)


@given(st.integers(-(2**31), 2**31 - 1), st.sampled_from(["big", "little"]))
def test_32_bit_values_survive_their_registers(value: int, order: Any) -> None:
    registers = words(value, order)
    assert all(0 <= register < 65536 for register in registers)
    assert signed(registers, order) == value


@pytest.mark.parametrize("value", [2**31, -(2**31) - 1])
def test_a_value_that_does_not_fit_is_refused(value: int) -> None:
    with pytest.raises(OverflowError):
        words(value)


def test_excitation_is_a_bit_that_stays(converse: Converse) -> None:
    free, hold = rtu("01 06 00 7D 00 40"), rtu("01 06 00 7D 00 00")
    with axis_on(converse(status(), (free, free), status(), (hold, hold), status(MOVE))) as axis:
        axis.set_enabled(False)
        axis.set_enabled(True)
        with pytest.raises(CommandRefused, match="while it moves"):
            axis.set_enabled(False)
