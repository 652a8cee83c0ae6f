"""Conversations with a Newport ESP301."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from scripted_peer import Late, Peer, Step

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError
from drivers.esp301_codes import error_words
from drivers.lines import SerialLineForm
from drivers.newport_esp301 import Esp301Form, NewportEsp301

Converse = Callable[..., Peer]
OPTIONS: dict[str, Any] = {"axis": 2, "lower": -85.0, "upper": 80.0, "velocity": 20.0, "acceleration": 40.0}
NO_ERROR: Step = (b"TE?\r", b"0\r\n")


def ask(query: str, reply: str) -> Step:
    return f"2{query}\r".encode(), f"{reply}\r\n".encode()


def tell(command: str) -> Step:
    return f"2{command}\r".encode(), None


def state(standing: bool, powered: bool = True, *errors: int) -> list[Step]:
    queue = [(b"TE?\r", f"{code}\r\n".encode()) for code in errors]
    return [*queue, NO_ERROR, ask("MD?", str(int(standing))), ask("MO?", str(int(powered)))]


HOMING = [*state(True, False), NO_ERROR, tell("MO"), NO_ERROR, ask("TP", "7"), NO_ERROR, tell("OR1"), NO_ERROR,
          ask("MD?", "0"), *state(True), NO_ERROR]  # fmt: skip
PREPARED = [step for name, value in (("AC", "40"), ("AG", "40"), ("VA", "20"), ("SL", "-85"), ("SR", "80"))
            for step in (ask(f"{name}?", value), ask(f"{name}?", value))]  # fmt: skip


@contextmanager
def axis_on(peer: Peer, timeout: float = 1.0, **changes: Any) -> Iterator[NewportEsp301]:
    line = SerialLineForm(kind="serial", port=peer.port, baudrate=19200, timeout=timeout).open("arms")
    axis = NewportEsp301("sensor_zenith", line, Esp301Form.model_validate(OPTIONS | changes), Clock())  # type: ignore[arg-type]
    try:
        yield axis
    finally:
        axis.close()


def test_identity_is_firmware_and_stage(converse: Converse) -> None:
    peer = converse((b"VE?\r", b"ESP301 Version 3.0.1\r\n"), NO_ERROR, ask("ID?", "URS100BCC, SN1263"))
    with axis_on(peer) as axis:
        assert axis.identify() == "Newport ESP301 Version 3.0.1, axis 2: URS100BCC, SN1263"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (4, "error 4: emergency stop pressed"),
        (38, "error 38: parameter missing"),
        (100, "error 100: motor type not defined"),
        (203, "error 203: following error"),
        (306, "error 306: positive software limit"),
        (399, "error 399: see the manual of the controller"),
    ],
)
def test_errors_are_told_in_words(code: int, words: str) -> None:
    assert error_words(code) == words


def test_the_zero_is_trusted_only_after_a_search_that_ended_and_while_the_motor_is_on(converse: Converse) -> None:
    peer = converse(*state(True), *HOMING, *state(True, False))
    with axis_on(peer) as axis:
        assert not axis.status().homed
        axis.home()
        assert axis.status().homed
        lost = axis.status()
    assert not lost.homed
    assert "motor is off" in lost.fault


def test_a_search_that_ends_with_an_error_finds_no_zero(converse: Converse) -> None:
    peer = converse(*HOMING[:-4], *state(True, True, 220), NO_ERROR)
    with axis_on(peer) as axis:
        axis.home()
        status = axis.status()
    assert not status.homed
    assert status.fault == "error 220: search for the zero aborted"


def test_a_move_sets_the_axis_up_is_sent_once_and_confirmed(converse: Converse) -> None:
    peer = converse(*HOMING, *state(True), *PREPARED, NO_ERROR, tell("PA30.5"), NO_ERROR, ask("MD?", "0"))
    with axis_on(peer) as axis:
        axis.home()
        assert axis.status().homed
        axis.start_move(30.5)


def test_sign_scale_and_zero_apply_to_position_target_and_limits(converse: Converse) -> None:
    limits = [("AC", "80"), ("AG", "80"), ("VA", "40"), ("SL", "-150"), ("SR", "180")]
    prepared = [ask(f"{name}?", value) for name, value in limits for _ in range(2)]
    move = [NO_ERROR, tell("PA-10"), NO_ERROR, ask("MD?", "0")]
    peer = converse(ask("TP", "-30.5"), *HOMING, *state(True), *prepared, *move)
    with axis_on(peer, sign=-1, zero=5.0, units_per_degree=2.0) as axis:
        assert axis.position() == pytest.approx(5.0 + 15.25)
        axis.home()
        assert axis.status().homed
        axis.start_move(10.0)


def test_a_target_outside_the_travel_is_refused_before_anything_is_sent(converse: Converse) -> None:
    with axis_on(converse()) as axis, pytest.raises(CommandRefused, match="outside the travel"):
        axis.start_move(80.1)


def test_a_refused_command_is_told_in_words(converse: Converse) -> None:
    refused = [NO_ERROR, tell("VA20"), (b"TE?\r", b"210\r\n"), NO_ERROR]
    peer = converse(*HOMING, *state(True), *PREPARED[:4], ask("VA?", "10"), *refused)
    with axis_on(peer) as axis:
        axis.home()
        axis.status()
        with pytest.raises(CommandRefused, match="VA20: error 210: maximum velocity exceeded"):
            axis.start_move(1.0)


def test_an_error_line_that_nobody_asked_for_is_no_reading(converse: Converse) -> None:
    peer = converse((b"2TP\r", b"E00204 HARDWARE LIMIT\r\n12.5\r\n"))
    with axis_on(peer) as axis:
        assert axis.position() == pytest.approx(12.5)


def test_only_0_and_1_say_whether_an_arm_stands_and_has_power(converse: Converse) -> None:
    # A position, say, that was meant for another question.
    stray = [NO_ERROR, (b"2MD?\r", b"30\r\n0\r\n"), (b"2MO?\r", b"-20\r\n1\r\n")]
    with axis_on(converse(*HOMING, *stray)) as axis:
        axis.home()
        axis.status()
        status = axis.status()
    assert (status.moving, status.homed, status.fault) == (True, True, "")


def test_a_position_is_no_error(converse: Converse) -> None:
    with axis_on(converse((b"TE?\r", b"-20.5\r\n0\r\n"), *state(True)[1:])) as axis:
        assert axis.status().fault == ""


def test_after_a_time_out_the_version_is_asked_for_before_anything_else(converse: Converse) -> None:
    peer = converse((b"2TP\r", Late(0.45, b"99\r\n")), (b"VE?\r", b"ESP301 Version 3.0.1\r\n"), ask("TP", "12.5"))
    with axis_on(peer, timeout=0.4) as axis:
        assert axis.position() == pytest.approx(12.5)


def test_a_move_of_unknown_fate_is_stopped_and_not_sent_again(converse: Converse) -> None:
    mute = [(b"TE?\r", None), (b"VE?\r", None), (b"VE?\r", None)]
    after = [tell("ST"), (b"VE?\r", b"ESP301 Version 3.0.1\r\n"), ask("MD?", "1"), ask("MD?", "1")]
    peer = converse(*HOMING, *state(True), *PREPARED, NO_ERROR, tell("PA30"), *mute, *after)
    with axis_on(peer, timeout=0.4) as axis:
        axis.home()
        axis.status()
        with pytest.raises(CommunicationError, match=r"PA: no reply.*the axis was stopped; it is standing"):
            axis.start_move(30.0)


def test_the_motor_is_switched_only_where_the_arm_stands(converse: Converse) -> None:
    peer = converse(ask("MD?", "1"), NO_ERROR, tell("MF"), NO_ERROR, ask("MD?", "0"))
    with axis_on(peer) as axis:
        axis.set_enabled(False)
        with pytest.raises(CommandRefused, match="while it moves"):
            axis.set_enabled(True)
