"""Moving one arm: when a move is done, and what follows when it is not."""

from __future__ import annotations

import threading

import pytest
from fake_bench import Bench, FakeAxis

from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from instrument.control import AbortAsked, Controls, PauseNow, ask, ensure
from instrument.motion import MotionFailed, Mover
from instrument.settings import MotionSettings


class Arm:
    """The sensor's zenith arm, homed, with everything that was noted."""

    def __init__(self) -> None:
        self.bench = Bench()
        self.axis: FakeAxis = self.bench.axes["sensor_zenith"]
        for axis in self.bench.axes.values():
            axis.homed = True
        self.notes: list[str] = []
        self.controls = Controls(self.bench.clock)
        settings = MotionSettings(wire_wall=0.02, poll_wall=0.0005)
        self.mover = Mover(self.bench.axes, self.bench.clock, self.controls, self.notes.append, settings)

    def move(self, target: float) -> float:
        return self.mover.move("sensor_zenith", target)


@pytest.fixture
def arm() -> Arm:
    return Arm()


def test_a_move_ends_at_its_target_and_at_rest(arm: Arm) -> None:
    assert arm.move(40.0) == pytest.approx(40.0, abs=arm.axis.tolerance)
    assert not arm.axis.busy()
    assert arm.notes == []
    assert arm.axis.commands == [40.0]


def test_a_drive_that_claims_arrival_is_not_believed_without_the_readback(arm: Arm) -> None:
    arm.axis.always = "ignored"
    with pytest.raises(MotionFailed, match=r"stands still at 0\.0000 instead of moving to 40") as failure:
        arm.move(40.0)
    assert failure.value.at_rest
    assert arm.axis.commands == [40.0, 40.0]


@pytest.mark.parametrize("fate", ["ignored", "hangs", "lost_dropped"])
def test_a_command_without_effect_is_given_anew_once_and_recorded_first(arm: Arm, fate: str) -> None:
    arm.axis.script.append(fate)
    assert arm.move(40.0) == pytest.approx(40.0, abs=0.01)
    assert arm.axis.commands == [40.0, 40.0]
    assert len(arm.notes) == 1
    assert "stopped, stands still at 0.0000" in arm.notes[0]


@pytest.mark.parametrize("fate", ["ignored", "hangs", "lost_dropped"])
def test_never_more_than_one_new_command(arm: Arm, fate: str) -> None:
    arm.axis.always = fate
    with pytest.raises(MotionFailed):
        arm.move(40.0)
    assert len(arm.axis.commands) == 2


def test_a_command_whose_reply_was_lost_is_stopped_and_finished_on_its_way(arm: Arm) -> None:
    arm.axis.script.append("lost_taken")
    assert arm.move(80.0) == pytest.approx(80.0, abs=0.01)
    assert len(arm.axis.commands) <= 2


def test_an_obstacle_half_way_is_not_pushed_against(arm: Arm) -> None:
    arm.axis.script.append("half")
    with pytest.raises(MotionFailed, match=r"stands still at 20\.0000 on the way from 0\.0000 to 40"):
        arm.move(40.0)
    assert arm.axis.commands == [40.0]


def test_an_alarm_is_a_fault_at_once(arm: Arm) -> None:
    arm.axis.script.append("alarm")
    with pytest.raises(DeviceFault, match="overload"):
        arm.move(40.0)
    assert len(arm.axis.commands) == 1


def test_a_lost_zero_is_a_fault_and_nothing_is_sent_again(arm: Arm) -> None:
    arm.axis.script.append("lost_zero")
    with pytest.raises(DeviceFault, match="lost its zero"):
        arm.move(40.0)
    assert len(arm.axis.commands) == 1


def test_an_unhealthy_axis_is_not_moved_at_all(arm: Arm) -> None:
    arm.axis.fault = "following error"
    with pytest.raises(DeviceFault, match="following error"):
        arm.move(40.0)
    assert arm.axis.commands == []


def test_a_refusal_is_passed_on(arm: Arm) -> None:
    arm.axis.script.append("refused")
    with pytest.raises(CommandRefused, match="soft limits"):
        arm.move(40.0)
    assert len(arm.axis.commands) == 1


def test_lost_replies_to_questions_are_asked_again(arm: Arm) -> None:
    arm.axis.lost_replies = 2
    assert arm.move(40.0) == pytest.approx(40.0, abs=0.01)
    assert arm.axis.commands == [40.0]


def test_an_axis_that_falls_silent_is_not_called_at_rest(arm: Arm) -> None:
    arm.axis.script.append("lost_taken")
    original = arm.axis.start_move

    def then_silence(target: float) -> None:
        try:
            original(target)
        finally:
            arm.axis.lost_replies = 1000

    arm.axis.start_move = then_silence  # type: ignore[method-assign]
    with pytest.raises(MotionFailed, match="does not answer") as failure:
        arm.move(80.0)
    assert not failure.value.at_rest


@pytest.mark.parametrize(("ask_for", "expected"), [("abort", AbortAsked), ("pause", PauseNow)])
def test_an_interruption_stops_the_arm_before_anything_else(arm: Arm, ask_for: str, expected: type) -> None:
    arm.axis.limits = type(arm.axis.limits)(-91.0, 91.0, 0.1, 1.0)
    asking = {
        "abort": lambda: arm.controls.abort("enough"),
        "pause": lambda: arm.controls.pause(now=True, reason="enough"),
    }
    timer = threading.Timer(0.05, asking[ask_for])
    timer.start()
    with pytest.raises(expected):
        arm.move(90.0)
    assert not arm.axis.busy()
    assert 0.0 < arm.axis.place() < 90.0


def test_homing_is_started_anew_only_after_a_lost_reply_and_once(arm: Arm) -> None:
    arm.axis.homed = False
    arm.axis.homing_script.extend(["lost_dropped", "ok"])
    arm.mover.home("sensor_zenith")
    assert arm.axis.homed
    assert arm.bench.log == ["home sensor_zenith"] * 2
    assert "homing is started anew" in arm.notes[0]


def test_a_zero_that_is_not_found_in_time_is_a_failure(arm: Arm) -> None:
    arm.axis.homed = False
    arm.axis.homing_script.append("ignored")
    with pytest.raises(MotionFailed, match="no zero found"):
        arm.mover.home("sensor_zenith")
    assert arm.bench.log == ["home sensor_zenith"]


def test_an_axis_that_knows_its_zero_is_not_homed(arm: Arm) -> None:
    arm.mover.home("sensor_zenith")
    assert arm.bench.log == []


def test_a_question_is_asked_three_times_at_most() -> None:
    calls = []

    def mute() -> float:
        calls.append(1)
        raise CommunicationError("meter", "no reply")

    with pytest.raises(CommunicationError):
        ask(mute)
    assert len(calls) == 3


def test_a_setting_is_read_back_and_disagreement_is_a_fault() -> None:
    sent: list[int] = []
    with pytest.raises(DeviceFault, match="amplifier: the readback disagrees"):
        ensure(lambda: sent.append(1), lambda: False, "amplifier")
    assert len(sent) == 3
