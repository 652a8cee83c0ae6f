"""The ESP301 driver on the simulated controller, which was written from the protocol alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from drivers.configuration import connect
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.interfaces import Axis, Laboratory
from sim_fixtures.laboratory import SimulatedLaboratory

ARMS = ("illumination_zenith", "sensor_azimuth", "sensor_zenith")


@pytest.fixture(scope="module")
def laboratory(simulation: SimulatedLaboratory) -> Iterator[Laboratory]:
    """Every arm on the ESP301; a lost reply is not waited for as long as usual."""
    devices = simulation.inputs.devices.with_name("devices-esp301.toml")
    assert "timeout = 1.0" in devices.read_text()
    impatient = devices.with_name("impatient-esp301.toml")
    impatient.write_text(devices.read_text().replace("timeout = 1.0", "timeout = 0.4"))
    connected = connect(impatient)
    yield connected
    connected.close()


@pytest.fixture
def axis(laboratory: Laboratory) -> Axis:
    """An arm with its zero."""
    return homed(laboratory.sensor_zenith)


def wait_for(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)


def homed(axis: Axis) -> Axis:
    if not axis.status().homed or axis.status().fault:
        axis.home()
        wait_for(lambda: axis.status().homed and not axis.status().moving)
    return axis


def go(axis: Axis, target: float) -> None:
    axis.start_move(target)
    try:
        wait_for(lambda: axis.status().in_position)
    except AssertionError:
        raise AssertionError(f"not at {target}: {axis.position()}, {axis.status()}") from None
    assert abs(axis.position() - target) <= axis.tolerance


def test_it_says_what_it_is_and_moves_only_with_a_zero(laboratory: Laboratory) -> None:
    arm = laboratory.sensor_azimuth
    assert isinstance(arm, Axis)
    assert arm.identify() == "Newport ESP301 Version 3.0.1 6/1/99, axis 1: SIM-SENSOR-AZIMUTH, SN0001"
    with pytest.raises(CommandRefused, match="before its zero is known"):
        arm.start_move(10.0)


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_goes_where_it_is_sent_with_one_command_each(
    simulation: SimulatedLaboratory, laboratory: Laboratory, name: str
) -> None:
    arm = homed(laboratory.axes()[name])
    before = simulation.control("motion_commands")[name]
    for target in (12.5, 12.5, 3.0, 0.0):
        go(arm, target)
    assert simulation.control("motion_commands")[name] - before == 4


def test_a_stopped_arm_stands_short_of_its_target(axis: Axis) -> None:
    go(axis, 0.0)
    axis.start_move(60.0)
    axis.stop()
    axis.make_safe()
    wait_for(lambda: not axis.status().moving)
    assert axis.position() < 59.0
    go(axis, 0.0)


def test_a_following_error_is_told_in_words_by_its_own_axis_and_needs_a_new_zero(
    simulation: SimulatedLaboratory, laboratory: Laboratory, axis: Axis
) -> None:
    other = homed(laboratory.sensor_azimuth)
    go(axis, 0.0)
    axis.start_move(60.0)
    simulation.control("alarm", axis="sensor_zenith")
    assert other.status().fault == ""
    wait_for(lambda: bool(axis.status().fault))
    assert "error 203: following error" in axis.status().fault
    assert "motor is off" in axis.status().fault
    assert not axis.status().homed
    with pytest.raises(DeviceFault, match="following error"):
        axis.start_move(0.0)
    homed(axis)
    go(axis, 5.0)


def test_a_limit_switch_is_a_fault_of_its_axis(simulation: SimulatedLaboratory, axis: Axis) -> None:
    axis.start_move(60.0)
    simulation.control("limit_switch", axis="sensor_zenith", direction=1)
    wait_for(lambda: "error 204: positive hardware limit" in axis.status().fault)
    simulation.control("limit_switch", axis="sensor_zenith", direction=0)
    homed(axis)


def test_a_lost_move_is_noticed_and_not_sent_again(simulation: SimulatedLaboratory, axis: Axis) -> None:
    go(axis, 0.0)
    before = simulation.control("motion_commands")["sensor_zenith"]
    send = axis._line.send  # type: ignore[attr-defined]

    def lose_move(device: str, request: bytes, pause: float = 0.0) -> None:
        if b"PA" in request:
            simulation.control("lose_requests", device="esp301", count=1)
        send(device, request, pause)

    axis._line.send = lose_move  # type: ignore[attr-defined]
    try:
        with pytest.raises(CommunicationError, match="was lost: the axis stands at 0 degree"):
            axis.start_move(30.0)
    finally:
        axis._line.send = send  # type: ignore[attr-defined]
    assert simulation.control("motion_commands")["sensor_zenith"] == before
    go(axis, 30.0)


def test_a_late_reply_is_never_taken_for_the_next_one(simulation: SimulatedLaboratory, axis: Axis) -> None:
    go(axis, 30.0)
    simulation.control("late_reply", device="esp301", count=1, delay=0.5)  # after the version has been asked for
    assert axis.position() == pytest.approx(30.0, abs=axis.tolerance)
    go(axis, -20.0)
    assert axis.position() == pytest.approx(-20.0, abs=axis.tolerance)


def test_a_pulled_plug_costs_an_error_and_not_the_zero(simulation: SimulatedLaboratory, axis: Axis) -> None:
    go(axis, 10.0)
    simulation.control("disconnect", device="esp301", seconds=0.3)
    with pytest.raises(CommunicationError):
        axis.position()
    time.sleep(0.5)
    wait_for(lambda: answers(axis))
    assert axis.status().homed
    go(axis, 12.0)


def answers(axis: Axis) -> bool:
    try:
        axis.position()
    except CommunicationError:
        return False
    return True
