"""Oriental Motor AZ (AZD-KD) drives on Modbus RTU.

Registers after the maker's own Modbus master for ROS (om_modbus_master, AZ samples) and its direct data operation:
one write of sixteen registers at 0058h carries a whole move and its trigger. Inputs of the remote I/O word act on
their edge: a bit is set and then cleared. A drive may ignore a command without any alarm, so a move counts as
accepted only when the drive moves or stands at the target. A move is sent once.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat

from drivers.arm import ArmForm, ArmScale, stop_surely
from drivers.az_codes import (
    ALARM_A,
    COORDINATES_SET,
    HARDWARE_OVERTRAVEL,
    LIMIT_SENSORS,
    MOVE,
    READY,
    SOFTWARE_LIMITS,
    alarm_words,
    signed,
    words,
)
from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceError, DeviceFault
from drivers.interfaces import AxisStatus
from drivers.modbus_line import ModbusLine

DIRECT_DATA, TARGET = 0x0058, 0x005C
REMOTE_INPUT = 0x007D
ALARM_CODE = 0x0080
COMMAND_POSITION, FEEDBACK_POSITION = 0x00C6, 0x00CC
TEMPERATURES = 0x00F8
LIMIT_SENSOR_WORD, STATUS_WORDS = 0x0170, 0x0178
ALARM_RESET = 0x0180

ABSOLUTE, TRIGGER_ALL = 1, 1
FULL_CURRENT = 1000

#: Wall-clock s within which a drive must show that it took a command, and between two looks.
ACCEPT_DEADLINE, ACCEPT_PAUSE = 0.4, 0.01

#: Reads change nothing, so one that was lost is asked for again.
READ_ATTEMPTS = 3


class AzForm(ArmForm):
    """Options of an AZ axis in ``devices.toml``, beside those of every arm.

    Attributes
    ----------
    address
        Slave number, 1 to 31.
    steps_per_degree
        Steps of the drive in one degree of the arm, gears and electronic gear included.
    current
        Fraction of the rated motor current.
    word_order
        Of 32-bit values: ``big`` (high word at the lower address) or ``little``, as the drive is set up.
    zhome_bit, stop_bit, free_bit
        Bits of the remote I/O input word 007Dh, which a drive may have re-assigned.
    """

    address: Annotated[int, Field(ge=1, le=31)]
    steps_per_degree: PositiveFloat
    current: Annotated[float, Field(gt=0, le=1)] = 1.0
    word_order: Literal["big", "little"] = "big"
    zhome_bit: Annotated[int, Field(ge=0, le=15)] = 4
    stop_bit: Annotated[int, Field(ge=0, le=15)] = 5
    free_bit: Annotated[int, Field(ge=0, le=15)] = 6

    def claims(self) -> list[tuple[str, str]]:
        """The drive."""
        return [(f"address {self.address}", "")]


class OrientalAz:
    """One drive with its arm. Satisfies :class:`drivers.interfaces.Axis`."""

    options = AzForm
    line_kinds = ("modbus-serial", "modbus-tcp")

    def __init__(self, name: str, line: ModbusLine, options: AzForm, clock: Clock) -> None:
        self.name = name
        self.limits = options.limits
        self.tolerance = max(options.tolerance, 0.5 / options.steps_per_degree)
        self._line, self._options = line, options
        self._scale = ArmScale(options, options.steps_per_degree)
        line.attach(name)
        line.slave_echoes(options.address)

    def identify(self) -> str:
        """Echo test, word order, temperatures.

        Raises
        ------
        CommandRefused
            If 32-bit values only make sense in the other word order.
        """
        self._line.echo(self.name, self._options.address)
        driver, motor = self._temperatures()
        temperatures = f"driver {driver / 10:.1f} degC, motor {motor / 10:.1f} degC"
        return f"Oriental Motor AZ, slave {self._options.address}, {temperatures}"

    def position(self) -> float:
        """Feedback position, degree."""
        return self._scale.to_laboratory(self._long(FEEDBACK_POSITION))

    def status(self) -> AxisStatus:
        """State of the axis now."""
        origin, drive = self._read(STATUS_WORDS, 2)
        faults = []
        if drive & ALARM_A:
            faults.append(self._alarm())
        faults += [text for bit, text in SOFTWARE_LIMITS.items() if origin & bit]
        moving = bool(drive & MOVE)
        at_target = bool(drive & READY) and not moving and not drive & ALARM_A and self._at_command()
        return AxisStatus(moving, bool(origin & COORDINATES_SET), at_target, "; ".join(faults))

    def home(self) -> None:
        """Start the return to the home position (ZHOME); the bit is cleared again.

        Raises
        ------
        DeviceFault
            If the drive has an alarm.
        CommunicationError
            If it is not clear whether the return began; the axis is stopped.
        """
        with self._line.transaction(self.name):
            self._require_ready()
            try:
                self._pulse(self._options.zhome_bit)
            except CommunicationError as error:
                raise self._stopped_after("ZHOME", error) from error
            self._wait_accepted("the return to home", self._stands_at_home)

    def start_move(self, target: float) -> None:
        """Send one move to ``target`` (degree) and confirm that the drive took it.

        Raises
        ------
        CommandRefused
            If the target is outside the travel, or the drive is not ready; nothing moves.
        DeviceFault
            If the drive has an alarm.
        CommunicationError
            If the fate of the command is not clear (the axis is stopped), or the drive ignores it.
        """
        self._scale.check_target(self.name, target)
        with self._line.transaction(self.name):
            origin = self._require_ready()
            if not origin & COORDINATES_SET:
                raise CommandRefused(self.name, "the drive has no coordinates", "home the axis first")
            steps = round(self._scale.to_stage(target))
            try:
                self._line.write_registers(self.name, self._options.address, DIRECT_DATA, self._direct_data(steps))
                accepted = self._long(TARGET)
            except CommunicationError as error:
                raise self._stopped_after("move", error) from error
            if accepted != steps:
                raise self._stopped_after(
                    "move", CommunicationError(self.name, f"target reads {accepted} steps, {steps} were sent")
                )
            self._wait_accepted("the move", lambda: self._long(COMMAND_POSITION) == steps)

    def stop(self) -> None:
        """Decelerate and stop; the bit is cleared again. May be repeated."""
        self._pulse(self._options.stop_bit, urgent=True)

    def make_safe(self) -> None:
        """Stop; tried three times before the failure is reported."""
        stop_surely(self.stop)

    def clear_fault(self) -> None:
        """Reset an alarm whose cause is gone; some need the drive's power to be switched."""
        for value in (0, 1):
            self._line.write_registers(self.name, self._options.address, ALARM_RESET, self._words(value))

    def set_enabled(self, on: bool) -> None:
        """Excitation on or off (FREE): off, the arm may be turned by hand; the next command excites it again.

        Raises
        ------
        CommandRefused
            If the arm moves.
        """
        with self._line.transaction(self.name):
            if self._read(STATUS_WORDS, 2)[1] & MOVE:
                raise CommandRefused(self.name, "cannot be switched while it moves", "stop it")
            word = 0 if on else 1 << self._options.free_bit
            self._line.write_register(self.name, self._options.address, REMOTE_INPUT, word)

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)

    # ---- motion ---------------------------------------------------------------------------------------------------

    def _direct_data(self, steps: int) -> list[int]:
        rate = round(self.limits.acceleration * self._options.steps_per_degree)
        fields = (
            0,
            ABSOLUTE,
            steps,
            round(self.limits.velocity * self._options.steps_per_degree),
            rate,
            rate,
            round(self._options.current * FULL_CURRENT),
            TRIGGER_ALL,
        )
        return [word for value in fields for word in self._words(value)]

    def _pulse(self, bit: int, *, urgent: bool = False) -> None:
        """Set an input of the remote I/O word, and clear the word whatever happens."""
        try:
            self._line.write_register(self.name, self._options.address, REMOTE_INPUT, 1 << bit, urgent=urgent)
        finally:
            self._line.write_register(self.name, self._options.address, REMOTE_INPUT, 0, urgent=urgent)

    def _require_ready(self) -> int:
        """Refuse where the drive cannot move now; returns the word with the coordinate bits."""
        origin, drive = self._read(STATUS_WORDS, 2)
        if drive & ALARM_A:
            raise DeviceFault(self.name, self._alarm(), "remove the cause and reset the alarm")
        if drive & MOVE:
            raise CommandRefused(self.name, "the drive is still moving", "stop it or wait")
        if not drive & READY:
            raise CommandRefused(self.name, "the drive is not ready", "check excitation and stop inputs")
        return origin

    def _wait_accepted(self, what: str, arrived: Callable[[], bool]) -> None:
        """Wait until the drive moves or has arrived; ``arrived`` is asked for once it does not move."""
        deadline = time.monotonic() + ACCEPT_DEADLINE
        while True:
            _, drive = self._read(STATUS_WORDS, 2)
            if drive & ALARM_A:
                raise DeviceFault(self.name, self._alarm(), "remove the cause, reset the alarm")
            if drive & MOVE or arrived():
                return
            if time.monotonic() > deadline:
                raise CommunicationError(self.name, f"the drive ignored {what} without an alarm", "it stands still")
            time.sleep(ACCEPT_PAUSE)

    def _stopped_after(self, command: str, error: CommunicationError) -> CommunicationError:
        """Stop the axis after a motion command of unknown fate; what to raise, with what was read back."""
        try:
            self.stop()
            _, drive = self._read(STATUS_WORDS, 2)
            state = "still moving" if drive & MOVE else "standing"
            outcome = f"the axis was stopped; it is {state} at {self.position():.3f} degree"
        except DeviceError as second:
            outcome = f"the stop could not be confirmed either: {second.problem}"
        return CommunicationError(
            self.name, f"{command}: {error.problem}; {outcome}", "read position and state before moving again"
        )

    def _alarm(self) -> str:
        """The alarm in words; at an overtravel also which limit sensor is active."""
        code = self._long(ALARM_CODE)
        if code != HARDWARE_OVERTRAVEL:
            return alarm_words(code)
        sensors = self._read(LIMIT_SENSOR_WORD, 1)[0]
        active = [text for bit, text in LIMIT_SENSORS.items() if sensors & bit]
        return ", ".join([alarm_words(code), *active])

    def _stands_at_home(self) -> bool:
        origin, _ = self._read(STATUS_WORDS, 2)
        return bool(origin & COORDINATES_SET) and abs(self._long(COMMAND_POSITION)) <= 1

    def _at_command(self) -> bool:
        command, feedback = self._long(COMMAND_POSITION), self._long(FEEDBACK_POSITION)
        return abs(command - feedback) <= self.tolerance * self._options.steps_per_degree

    # ---- registers --------------------------------------------------------------------------------------------------

    def _read(self, address: int, count: int) -> list[int]:
        for _ in range(READ_ATTEMPTS - 1):
            with contextlib.suppress(CommunicationError):
                return self._line.read_registers(self.name, self._options.address, address, count)
        return self._line.read_registers(self.name, self._options.address, address, count)

    def _long(self, address: int) -> int:
        return signed(self._read(address, 2), self._options.word_order)

    def _words(self, value: int) -> list[int]:
        return words(value, self._options.word_order)

    def _temperatures(self) -> tuple[int, int]:
        """Driver and motor temperature in 0.1 degC, which show whether the word order is right."""
        registers = self._read(TEMPERATURES, 4)
        order = self._options.word_order
        other: Literal["big", "little"] = "little" if order == "big" else "big"
        driver, motor = signed(registers[:2], order), signed(registers[2:], order)
        if not _plausible(driver, motor) and _plausible(signed(registers[:2], other), signed(registers[2:], other)):
            raise CommandRefused(
                self.name,
                f"32-bit values make no sense with word_order {order!r}, and do with {other!r}",
                f"set word_order = {other!r}, or change the drive's parameter",
            )
        return driver, motor


def _plausible(*tenths: int) -> bool:
    return all(-400 <= value <= 2000 for value in tenths)
