"""Amplifier and shutter on a Modbus I/O module."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from pydantic import ValidationError
from scripted_peer import Late, Peer, Step, rtu

from drivers import modbus_line
from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.femto import Femto, FemtoForm
from drivers.interfaces import Amplifier, Shutter
from drivers.lines import ModbusSerialLineForm
from drivers.modbus_io import ModbusShutter, ShutterForm
from drivers.modbus_line import ModbusLine

Converse = Callable[..., Peer]


def coils(bits: int) -> Step:
    return rtu("01 01 00 00 00 08"), rtu(f"01 01 01 {bits:02X}")


def inputs(bits: int) -> Step:
    return rtu("01 02 00 00 00 08"), rtu(f"01 02 01 {bits:02X}")


def write(coil: int, on: bool) -> Step:
    frame = rtu(f"01 05 00 {coil:02X} {'FF' if on else '00'} 00")
    return frame, frame


def code(value: int) -> Step:
    return rtu(f"01 0F 00 00 00 04 01 {value:02X}"), rtu("01 0F 00 00 00 04")


@contextmanager
def line_to(peer: Peer, timeout: float = 0.2) -> Iterator[ModbusLine]:
    line = ModbusSerialLineForm(kind="modbus-serial", port=peer.port, timeout=timeout).open("io")
    assert isinstance(line, ModbusLine)
    yield line
    line.close()


def amplifier(line: ModbusLine, **changes: Any) -> Femto:
    return Femto("amplifier", line, FemtoForm.model_validate({"coils": [0, 1, 2, 3]} | changes), Clock())


def shutter(line: ModbusLine, **changes: Any) -> ModbusShutter:
    options = {"coil": 4, "feedback_input": 1, "travel_time": 0.05} | changes
    return ModbusShutter("shutter", line, ShutterForm.model_validate(options), Clock())


def test_they_satisfy_their_roles(converse: Converse) -> None:
    with line_to(converse()) as line:
        assert isinstance(amplifier(line), Amplifier)
        assert isinstance(shutter(line), Shutter)


@pytest.mark.parametrize(
    ("mode", "codes", "gains"),
    [("high-speed", range(7), range(5, 12)), ("low-noise", range(8, 15), range(3, 10))],
)
def test_every_gain_of_the_dlpca_200_has_its_code(converse: Converse, mode: str, codes: range, gains: range) -> None:
    # Code table of the protocol description: mode << 3 | G3 << 2 | G2 << 1 | G1.
    script = [step for value in codes for step in (code(value), coils(value), coils(value))]
    with line_to(converse(*script)) as line:
        device = amplifier(line, mode=mode)
        assert device.gains == tuple(10.0**exponent for exponent in gains)
        for gain in device.gains:
            device.set_gain(gain)
            assert device.gain() == gain


def test_calibrated_gains_replace_the_nominal_ones(converse: Converse) -> None:
    with line_to(converse(code(11), coils(0xFB))) as line:
        device = amplifier(line, codes=[10, 11], gains=[1.002e5, 9.97e5])
        device.set_gain(9.97e5)
        with pytest.raises(CommandRefused, match=r"no gain of 1e\+06 V/A; expected one of 100200, 997000"):
            device.set_gain(1e6)


def test_bits_on_scattered_outputs_are_written_one_by_one(converse: Converse) -> None:
    with line_to(converse(write(0, False), write(2, True), write(5, True), coils(0b100100))) as line:
        amplifier(line, model="custom", coils=[5, 0, 2], codes=[5], gains=[1e6]).set_gain(1e6)


def test_a_code_that_is_not_in_use_is_a_fault(converse: Converse) -> None:
    with line_to(converse(coils(0xF7))) as line, pytest.raises(DeviceFault, match="gain bits hold code 7"):
        amplifier(line).gain()


def test_gain_bits_that_do_not_read_back_are_a_fault(converse: Converse) -> None:
    with (
        line_to(converse(code(9), coils(8))) as line,
        pytest.raises(DeviceFault, match=r"outputs \[0\] do not read back"),
    ):
        amplifier(line).set_gain(1e4)


def test_the_overload_line_is_an_input(converse: Converse) -> None:
    with line_to(converse(inputs(0b001), inputs(0b110))) as line:
        device = amplifier(line, overload_input=0)
        assert device.overload()
        assert not device.overload()
        assert not amplifier(line).overload()


def test_coupling_is_set_when_it_is_wired(converse: Converse) -> None:
    with line_to(converse(write(5, True), coils(0x20), inputs(0), coils(0x20))) as line:
        assert "slave 1" in amplifier(line, coupling_coil=5).identify()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"codes": [7]}, r"codes \[7\] do not exist"),
        ({"gains": [1.0]}, "1 gains for 7 codes"),
        ({"coils": [0, 1, 1, 2]}, "one output twice"),
        ({"coils": [0, 1, 2]}, "more than 3 coils"),
        ({"codes": [9, 8]}, "must ascend"),
        ({"coupling_coil": 3}, "coupling_coil is one of coils"),
        ({"model": "custom"}, "needs codes and gains"),
        ({"model": "ddpca-300", "mode": "high-speed"}, "has no mode"),
    ],
)
def test_options_that_contradict_themselves_are_refused(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValidationError, match=problem):
        FemtoForm.model_validate({"coils": [0, 1, 2, 3]} | changes)


def test_the_shutter_opens_and_closes_by_its_feedback(converse: Converse) -> None:
    peer = converse(
        write(4, True), coils(0x10), inputs(0b00), inputs(0b10), write(4, False), coils(0x00), inputs(0b00)
    )  # fmt: skip
    with line_to(peer) as line:
        device = shutter(line, travel_time=1.0)
        device.open()
        device.shut()


def test_without_feedback_the_output_is_read_back(converse: Converse) -> None:
    with line_to(converse(write(4, True), coils(0x10), coils(0x10))) as line:
        device = shutter(line, feedback_input=None)
        device.open()
        assert device.is_open()


def test_a_shutter_that_does_not_open_is_a_fault(converse: Converse) -> None:
    peer = converse(write(4, True), coils(0x10), inputs(0))
    with line_to(peer) as line, pytest.raises(DeviceFault, match="did not open within 0 s"):
        shutter(line, travel_time=0.0).open()


def test_closing_is_tried_again_until_it_is_confirmed(converse: Converse) -> None:
    frame = write(4, False)[0]
    peer = converse((frame, None), write(4, False), (rtu("01 01 00 00 00 08"), None), coils(0), inputs(0))
    with line_to(peer, timeout=0.15) as line:
        shutter(line).make_safe()


def test_a_module_that_never_answers_is_an_error(converse: Converse) -> None:
    frame = write(4, False)[0]
    problem = "shutter: write of coil 4 on line 'io': no valid reply"
    peer = converse(*[(frame, None)] * 3)
    with line_to(peer, timeout=0.15) as line, pytest.raises(CommunicationError, match=problem):
        shutter(line).make_safe()


def test_a_confirmation_of_another_coil_is_not_taken(converse: Converse) -> None:
    peer = converse((write(4, False)[0], write(3, False)[0]), write(4, False), coils(0), inputs(0))
    with line_to(peer, timeout=0.15) as line:
        shutter(line).shut()


def test_a_late_reply_of_the_same_length_is_not_taken_for_the_next_one(
    converse: Converse, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The module knows no echo test: silence alone brings the line back into step."""
    monkeypatch.setattr(modbus_line, "QUIET", 0.6)  # longer than a busy machine is late
    request, reply = coils(0b10000)
    assert isinstance(reply, bytes)
    second, closed = coils(0)
    assert isinstance(closed, bytes)
    # Asked again at once, the late reply would come before the one that was asked for.
    with line_to(converse((request, Late(0.8, reply)), (second, Late(0.4, closed))), timeout=0.5) as line:
        assert not shutter(line, feedback_input=None).is_open()


def test_a_busy_module_is_asked_again_and_one_that_has_failed_is_believed(converse: Converse) -> None:
    question = rtu("01 02 00 00 00 08")
    busy, failed = (question, rtu("01 82 06")), (question, rtu("01 82 04"))
    with line_to(converse(busy, inputs(0b10), failed)) as line:
        device = shutter(line)
        assert device.is_open()
        with pytest.raises(CommandRefused, match="exception 04h, device failure"):
            device.is_open()
