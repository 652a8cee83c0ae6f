"""Conversations with a Newport SMC100, after its manual."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from scripted_peer import Late, Peer, Step

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.interfaces import Axis
from drivers.lines import SerialLineForm
from drivers.newport_smc100 import NewportSmc100, Smc100Form
from drivers.smc100_codes import ERROR_MAP, parse_state

Converse = Callable[..., Peer]
OPTIONS: dict[str, Any] = {
    "address": 1,
    "lower": -85.0,
    "upper": 80.0,
    "velocity": 20.0,
    "acceleration": 40.0,
    "tolerance": 0.01,
}


def ask(query: str, reply: str) -> Step:
    return f"1{query}\r\n".encode(), f"1{query.rstrip('?')}{reply}\r\n".encode()


def tell(command: str) -> Step:
    return f"1{command}\r\n".encode(), None


def command(text: str, letter: str = "@") -> list[Step]:
    return [ask("TE", "@"), tell(text), ask("TE", letter)]


READY = ask("TS", "000033")
PREPARED = [*(step for name, value in (("AC", "40"), ("VA", "20"), ("SL", "-85"), ("SR", "80"))
              for step in (ask(f"{name}?", value), ask(f"{name}?", value)))]  # fmt: skip


@contextmanager
def axis_on(peer: Peer, timeout: float = 0.25, **changes: Any) -> Iterator[NewportSmc100]:
    line = SerialLineForm(kind="serial", port=peer.port, baudrate=57600, timeout=timeout).open("arms")
    axis = NewportSmc100("sensor_zenith", line, Smc100Form.model_validate(OPTIONS | changes), Clock())  # type: ignore[arg-type]
    try:
        yield axis
    finally:
        axis.close()


def test_it_is_an_axis(converse: Converse) -> None:
    with axis_on(converse()) as axis:
        assert isinstance(axis, Axis)


def test_identity_is_firmware_and_stage(converse: Converse) -> None:
    peer = converse(ask("VE", " SMC100CC 1.2.1"), ask("ID?", "URS100CC"))
    with axis_on(peer) as axis:
        assert axis.identify() == "Newport SMC100, address 1: SMC100CC 1.2.1, stage URS100CC"


@pytest.mark.parametrize(("digits", "bits"), [("0013", {0, 1, 4}), ("004C", {2, 3, 6})])
def test_the_manuals_examples_of_the_error_map(digits: str, bits: set[int]) -> None:
    state = parse_state(f"{digits}0F")
    assert state is not None
    assert state.code == 0x0F
    assert set(state.faults) == {ERROR_MAP[bit] for bit in bits}


@pytest.mark.parametrize("reply", ["00003", "00003G", "", "0000333", "+00033"])
def test_what_is_no_state_is_not_read_as_one(reply: str) -> None:
    assert parse_state(reply) is None


@pytest.mark.parametrize(
    ("code", "moving", "homed", "in_position"),
    [
        ("0A", False, False, False),
        ("1E", True, False, False),
        ("1F", True, False, False),
        ("28", True, True, False),
        ("32", False, True, True),
        ("33", False, True, True),
    ],
)
def test_states_are_read_as_the_manual_means_them(
    converse: Converse, code: str, moving: bool, homed: bool, in_position: bool
) -> None:
    with axis_on(converse(ask("TS", f"0000{code}"))) as axis:
        status = axis.status()
    assert (status.moving, status.homed, status.in_position, status.fault) == (moving, homed, in_position, "")


@pytest.mark.parametrize("code", ["0E", "0F", "10", "14", "3C", "3D"])
def test_states_out_of_order_are_faults(converse: Converse, code: str) -> None:
    with axis_on(converse(ask("TS", f"0000{code}"))) as axis:
        assert axis.status().fault


def test_a_fault_is_kept_although_reading_it_clears_it(converse: Converse) -> None:
    peer = converse(ask("TS", "00020F"), ask("TS", "00000F"))
    with axis_on(peer) as axis:
        assert "positive end of run" in axis.status().fault
        assert "positive end of run" in axis.status().fault


def test_position_follows_sign_scale_and_zero(converse: Converse) -> None:
    peer = converse(ask("TP", "-30.5"), ask("TP", "1.2E+1"))
    with axis_on(peer, sign=-1, zero=5.0, units_per_degree=2.0) as axis:
        assert axis.position() == pytest.approx(5.0 + 15.25)
        assert axis.position() == pytest.approx(5.0 - 6.0)


def test_a_move_sets_the_axis_up_is_sent_once_and_confirmed(converse: Converse) -> None:
    peer = converse(
        READY,
        ask("AC?", "10"), *command("AC40"), ask("AC?", "40"),
        ask("VA?", "10"), *command("VA20"), ask("VA?", "20"),
        ask("SL?", "-90"), *command("SL-85"), ask("SL?", "-85"),
        ask("SR?", "80"), ask("SR?", "80"),
        *command("PA12.5"), ask("PA?", "12.5"),
        # the second move finds the axis set up
        ask("TS", "000032"), *command("PA-3.25"), ask("PA?", "-3.2501"),
    )  # fmt: skip
    with axis_on(peer) as axis:
        axis.start_move(12.5)
        axis.start_move(-3.25)


@pytest.mark.parametrize("target", [80.01, -85.01, float("nan"), float("inf")])
def test_a_target_outside_the_travel_is_refused_before_anything_is_sent(converse: Converse, target: float) -> None:
    with (
        axis_on(converse()) as axis,
        pytest.raises(CommandRefused, match=r"sensor_zenith: target .* is outside the travel"),
    ):
        axis.start_move(target)


def test_a_move_without_a_zero_is_refused(converse: Converse) -> None:
    with axis_on(converse(ask("TS", "00000A"))) as axis, pytest.raises(CommandRefused, match="home the axis first"):
        axis.start_move(1.0)


def test_a_move_after_an_end_of_run_is_a_fault(converse: Converse) -> None:
    with axis_on(converse(ask("TS", "00010F"))) as axis, pytest.raises(DeviceFault, match="negative end of run"):
        axis.start_move(1.0)


def test_a_refusal_of_the_controller_is_told_in_words(converse: Converse) -> None:
    peer = converse(READY, *PREPARED, *command("PA70", "G"))
    with axis_on(peer) as axis, pytest.raises(CommandRefused, match="PA70: displacement out of limits"):
        axis.start_move(70.0)


def test_a_lost_move_is_noticed_and_not_sent_again(converse: Converse) -> None:
    stopped = [tell("ST"), ask("TS", "000033"), ask("TS", "000033")]
    peer = converse(READY, *PREPARED, *command("PA70"), ask("PA?", "10"), *stopped)
    with axis_on(peer) as axis, pytest.raises(CommunicationError, match=r"is 10 degree instead of 70.*stopped"):
        axis.start_move(70.0)


def test_a_move_whose_number_was_garbled_on_the_way_is_stopped_at_once(converse: Converse) -> None:
    stopped = [tell("ST"), ask("TS", "000028"), ask("TS", "000028")]
    peer = converse(READY, *PREPARED, *command("PA70"), ask("PA?", "20"), *stopped)
    with axis_on(peer) as axis, pytest.raises(CommunicationError, match=r"is 20 degree instead of 70.*stopped"):
        axis.start_move(70.0)


def test_a_move_of_unknown_fate_is_stopped_and_read_back(converse: Converse) -> None:
    mute = [tell("TE"), tell("VE"), tell("VE")]
    peer = converse(
        READY, *PREPARED, ask("TE", "@"), tell("PA70"), *mute, tell("ST"), ask("VE", " x"), ask("TS", "000028"),
        ask("TS", "000033"),
    )  # fmt: skip
    with (
        axis_on(peer, timeout=0.15) as axis,
        pytest.raises(CommunicationError, match=r"PA: no reply.*the axis was stopped; it is ready, after moving"),
    ):
        axis.start_move(70.0)


def test_a_lost_answer_to_a_query_is_asked_for_again_once_the_line_is_in_step(converse: Converse) -> None:
    peer = converse(tell("TP"), ask("VE", " x"), ask("TP", "7"))
    with axis_on(peer, timeout=0.15) as axis:
        assert axis.position() == 7.0


def test_a_late_answer_is_not_taken_for_the_next_one(converse: Converse) -> None:
    # The first answer comes while the line is brought back into step, just before the step's own answer.
    peer = converse((b"1TP\r\n", Late(0.27, b"1TP3\r\n")), (b"1VE\r\n", Late(0.1, b"1VE x\r\n")), ask("TP", "7"))
    with axis_on(peer, timeout=0.2) as axis:
        assert axis.position() == 7.0


def test_answers_of_other_controllers_are_passed_over(converse: Converse) -> None:
    peer = converse((b"1TP\r\n", b"2TP99\r\n1TE@\r\n1TP5\r\n"))
    with axis_on(peer) as axis:
        assert axis.position() == 5.0


def test_garbled_answers_are_errors_that_quote_them(converse: Converse) -> None:
    peer = converse((b"1TP\r\n", b"1TP1.\xff2\r\n"), (b"1TS\r\n", b"1TS00zz33\r\n"))
    with axis_on(peer) as axis:
        with pytest.raises(CommunicationError, match="expected a number"):
            axis.position()
        with pytest.raises(CommunicationError, match=r"00zz33.*expected six hexadecimal digits"):
            axis.status()


def test_homing_is_sent_once_and_seen_to_begin(converse: Converse) -> None:
    peer = converse(ask("TS", "00000A"), *command("OR"), ask("TS", "00001E"))
    with axis_on(peer) as axis:
        axis.home()


def test_homing_that_did_not_begin_is_an_error(converse: Converse) -> None:
    peer = converse(ask("TS", "00000A"), *command("OR"), ask("TS", "00000A"))
    with axis_on(peer) as axis, pytest.raises(CommunicationError, match="OR was lost"):
        axis.home()


@pytest.mark.parametrize("code", ["1E", "32", "28"])
def test_an_axis_that_has_its_zero_or_is_at_it_is_left_alone(converse: Converse, code: str) -> None:
    with axis_on(converse(ask("TS", f"0000{code}"))) as axis:
        axis.home()


def test_settings_are_written_again_after_the_zero_was_lost(converse: Converse) -> None:
    peer = converse(
        READY, *PREPARED, *command("PA1"), ask("PA?", "1"),
        ask("TS", "00000A"), *command("OR"), ask("TS", "000032"),
        READY, *PREPARED, *command("PA2"), ask("PA?", "2"),
    )  # fmt: skip
    with axis_on(peer) as axis:
        axis.start_move(1.0)
        axis.home()
        axis.start_move(2.0)


def test_stop_may_be_repeated_and_making_safe_tries_again(converse: Converse) -> None:
    mute = [tell("ST"), tell("TS"), tell("VE"), tell("VE")]
    peer = converse(tell("ST"), ask("TS", "000033"), *mute, tell("ST"), ask("VE", " x"), ask("TS", "000033"))
    with axis_on(peer, timeout=0.15) as axis:
        axis.stop()
        axis.make_safe()


def test_two_controllers_share_one_line(converse: Converse) -> None:
    peer = converse(ask("TP", "1"), (b"2TP\r\n", b"2TP2\r\n"))
    line = SerialLineForm(kind="serial", port=peer.port, timeout=0.3).open("arms")
    first = NewportSmc100("a", line, Smc100Form.model_validate(OPTIONS), Clock())  # type: ignore[arg-type]
    second = NewportSmc100("b", line, Smc100Form.model_validate(OPTIONS | {"address": 2}), Clock())  # type: ignore[arg-type]
    assert first.position() == 1.0
    first.close()
    assert second.position() == 2.0
    second.close()
    with pytest.raises(CommunicationError, match="b: line 'arms' is closed"):
        second.position()


def test_the_motor_current_is_switched_only_where_the_arm_stands(converse: Converse) -> None:
    peer = converse(
        READY, *command("MM0"), ask("TS", "00003C"), ask("TS", "00003C"), *command("MM1"), ask("TS", "000028")
    )
    with axis_on(peer) as axis:
        axis.set_enabled(False)
        axis.set_enabled(False)
        axis.set_enabled(True)
        with pytest.raises(CommandRefused, match="cannot be switched while moving"):
            axis.set_enabled(False)


def test_two_controllers_at_one_address_are_refused(converse: Converse) -> None:
    peer = converse((b"1VE\r\n", b"1VE SMC100CC 1.2.1\r\n1VE SMC100PP 1.0\r\n"))
    with axis_on(peer) as axis, pytest.raises(CommandRefused, match="2 controllers answer at address 1"):
        axis.identify()
