"""Newport ESP301: three axes behind one port.

Written from what the protocol notes collect of the manual and of open drivers. Commands are ``nnAAxx`` and end with
CR, ``;`` joins several of a line; only queries are answered, with CR LF and without echo. Errors wait in one queue
for the whole controller: below 100 they are general, otherwise the hundreds name the axis.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from sim_fixtures.bench import Bench
from sim_fixtures.bench.axis import AxisModel

_COMMAND = re.compile(r"(?P<axis>\d*)(?P<name>[A-Z]{2})(?P<value>\?|[+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+)?)?$", re.I)
_QUEUE = 10
_LONGEST_LINE = 80

UNKNOWN, OUT_OF_RANGE, AXIS_NUMBER, AXIS_MISSING, PARAMETER_MISSING = 6, 7, 9, 37, 38
FOLLOWING_ERROR, UPPER_SWITCH, LOWER_SWITCH, UPPER_LIMIT, LOWER_LIMIT = 3, 4, 5, 6, 7
NO_STAGE, VELOCITY, ACCELERATION, MOTOR_OFF, HOMING_ABORTED = 8, 10, 11, 13, 20

_TEXT = {
    0: "NO ERROR DETECTED",
    UNKNOWN: "COMMAND DOES NOT EXIST",
    OUT_OF_RANGE: "PARAMETER OUT OF RANGE",
    AXIS_NUMBER: "AXIS NUMBER OUT OF RANGE",
    AXIS_MISSING: "AXIS NUMBER MISSING",
    PARAMETER_MISSING: "COMMAND PARAMETER MISSING",
}
_AXIS_TEXT = {
    FOLLOWING_ERROR: "FOLLOWING ERROR THRESHOLD EXCEEDED",
    UPPER_SWITCH: "POSITIVE HARDWARE LIMIT DETECTED",
    LOWER_SWITCH: "NEGATIVE HARDWARE LIMIT DETECTED",
    UPPER_LIMIT: "POSITIVE SOFTWARE LIMIT DETECTED",
    LOWER_LIMIT: "NEGATIVE SOFTWARE LIMIT DETECTED",
    NO_STAGE: "MOTOR / STAGE NOT CONNECTED",
    VELOCITY: "MAXIMUM VELOCITY EXCEEDED",
    ACCELERATION: "MAXIMUM ACCELERATION EXCEEDED",
    MOTOR_OFF: "MOTOR NOT ENABLED",
    HOMING_ABORTED: "HOMING ABORTED",
}
#: Code of the unit "degree" under ``SN``.
_DEGREE = 7
#: Laboratory s after which ``WS`` gives up waiting for an arm that never stops.
_LONGEST_WAIT = 120.0


class CommandError(Exception):
    """A command is refused; carries the error code without its axis."""

    def __init__(self, code: int, *, of_axis: bool = False) -> None:
        super().__init__(code)
        self.code, self.of_axis = code, of_axis


@dataclass(frozen=True)
class Command:
    """One command of a line."""

    axis: int | None
    name: str
    query: bool
    value: float | None


def parse(text: str) -> Command | None:
    """Parse one command, blanks removed; None where it is none."""
    match = _COMMAND.match(re.sub(r"\s", "", text))
    if match is None:
        return None
    value = match["value"]
    number = float(value) if value not in (None, "?") else None
    return Command(int(match["axis"]) if match["axis"] else None, match["name"].upper(), value == "?", number)


def _number(value: float) -> str:
    return f"{value:.6g}" if value else "0"


class EspAxis:
    """What the controller keeps of one axis."""

    def __init__(self, axis: AxisModel, limits: tuple[float, float]) -> None:
        self.model = axis
        self.powered = False
        self.offset = 0.0
        self.lower, self.upper = limits
        self.velocity, self.acceleration = axis.design.velocity, axis.design.acceleration
        self.deceleration = axis.design.acceleration
        self.at_switch = 0
        self.searching = False

    def position(self) -> float:
        """The counter."""
        return self.model.position() + self.offset


class Esp301:
    """The controller; a wire handler (see :class:`~sim_fixtures.devices.wire.Handler`).

    Parameters
    ----------
    bench
        What the stages are part of.
    axes
        Name of the bench's axis by its number, 1 to 3.
    """

    def __init__(self, bench: Bench, axes: dict[int, str]) -> None:
        self._bench, self._buffer = bench, b""
        self.request_lost: Callable[[bytes], bool] = lambda _: False
        self._errors: deque[int] = deque(maxlen=_QUEUE)
        self.axes = {
            number: EspAxis(bench.axes[name], getattr(bench.facility.arms, name)) for number, name in axes.items()
        }

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes from the line; a command is taken with its CR."""
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\r")
        answers: list[bytes] = []
        for line in lines:
            answers += self._line(line.decode("latin-1").strip())
        return answers

    def fault(self, name: str) -> None:
        """A following error of an axis: its motor loses power."""
        for number, axis in self.axes.items():
            if axis.model.name == name:
                axis.model.halt()
                axis.powered = axis.searching = False
                self._errors.append(100 * number + FOLLOWING_ERROR)

    def _line(self, line: str) -> list[bytes]:
        if not line or self.request_lost(line.encode("latin-1")):
            return []
        if len(line) > _LONGEST_LINE:
            self._errors.append(OUT_OF_RANGE)
            return []
        answers = (self._one(text) for text in line.split(";") if text.strip())
        return [f"{answer}\r\n".encode("ascii") for answer in answers if answer is not None]

    def _one(self, text: str) -> str | None:
        command = parse(text)
        if command is not None and command.name == "WS":
            self._wait(command)
            return None
        with self._bench.lock:
            self._supervise()
            return self._execute(command)

    def _execute(self, command: Command | None) -> str | None:
        axis = command.axis if command else None
        try:
            handler = getattr(self, f"_do_{command.name.lower()}", None) if command else None
            if command is None or handler is None:
                raise CommandError(UNKNOWN)
            answer: str | None = handler(command)
        except CommandError as error:
            self._errors.append(error.code + (100 * (axis or 0) if error.of_axis else 0))
            return None
        return answer

    def _supervise(self) -> None:
        """Post what happened to the axes since the last look."""
        for number, axis in self.axes.items():
            switch = axis.model.at_limit
            if switch and not axis.at_switch:
                self._errors.append(100 * number + (UPPER_SWITCH if switch > 0 else LOWER_SWITCH))
            axis.at_switch = switch
            if axis.searching and not axis.model.moving():
                axis.searching = False
                if axis.model.homed:
                    axis.offset = 0.0

    def _wait(self, command: Command) -> None:
        """``WS``: nothing further is executed before the axis stands, and so many ms more have passed."""
        end = self._bench.clock.now() + _LONGEST_WAIT
        wanted = [command.axis] if command.axis else list(self.axes)
        while self._bench.clock.now() < end:
            with self._bench.lock:
                if not any(self.axes[number].model.moving() for number in wanted if number in self.axes):
                    break
            self._bench.clock.wait_until(self._bench.clock.now() + 0.05)
        self._bench.clock.wait_until(self._bench.clock.now() + (command.value or 0.0) / 1000.0)

    # ---- what a command needs --------------------------------------------------------------------------------

    def _axis(self, command: Command) -> EspAxis:
        if command.axis is None:
            raise CommandError(AXIS_MISSING)
        if not 1 <= command.axis <= 3:
            raise CommandError(AXIS_NUMBER)
        if command.axis not in self.axes:
            raise CommandError(NO_STAGE, of_axis=True)
        return self.axes[command.axis]

    def _value(self, command: Command) -> float:
        if command.value is None:
            raise CommandError(PARAMETER_MISSING)
        return command.value

    # ---- the controller --------------------------------------------------------------------------------------

    def _do_ve(self, command: Command) -> str:
        return "ESP301 Version 3.0.1 6/1/99"

    def _do_te(self, command: Command) -> str:
        return str(self._errors.popleft() if self._errors else 0)

    def _do_tb(self, command: Command) -> str:
        code = self._errors.popleft() if self._errors else 0
        text = _TEXT.get(code) if code < 100 else f"AXIS-{code // 100} {_AXIS_TEXT.get(code % 100, 'ERROR')}"
        return f"{code}, {int(self._bench.clock.now() * 2500)}, {text or 'ERROR'}"

    def _do_ts(self, command: Command) -> str:
        moving = sum(1 << (number - 1) for number, axis in self.axes.items() if axis.model.moving())
        return chr(0x40 | moving | (any(axis.powered for axis in self.axes.values()) << 4))

    def _do_ph(self, command: Command) -> str:
        switches = 0
        for number, axis in self.axes.items():
            switches |= (axis.model.at_limit > 0) << (number - 1) | (axis.model.at_limit < 0) << (number + 7)
        return f"{switches:X}H, 0H"

    def _do_ab(self, command: Command) -> None:
        for axis in self.axes.values():
            self._stop(axis)

    # ---- one axis ----------------------------------------------------------------------------------------------

    def _do_id(self, command: Command) -> str:
        return f"SIM-{self._axis(command).model.name.upper().replace('_', '-')}, SN0001"

    def _do_sn(self, command: Command) -> str | None:
        self._axis(command)
        if not command.query and self._value(command) != _DEGREE:
            raise CommandError(OUT_OF_RANGE)
        return str(_DEGREE) if command.query else None

    def _do_mo(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return str(int(axis.powered))
        axis.powered = True
        return None

    def _do_mf(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return str(int(axis.powered))
        axis.model.halt()
        axis.powered = axis.searching = False
        return None

    def _do_md(self, command: Command) -> str:
        return str(int(not self._axis(command).model.moving()))

    def _do_tp(self, command: Command) -> str:
        return _number(self._axis(command).position())

    def _do_dp(self, command: Command) -> str:
        return self._do_tp(command)

    def _do_tv(self, command: Command) -> str:
        return _number(self._axis(command).model.velocity())

    def _do_pa(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return _number(axis.model.target() + axis.offset)
        self._start(axis, self._value(command))
        return None

    def _do_pr(self, command: Command) -> None:
        axis = self._axis(command)
        self._start(axis, axis.position() + self._value(command))

    def _start(self, axis: EspAxis, target: float) -> None:
        self._bench.motion_commands[axis.model.name] += 1
        if not axis.powered:
            raise CommandError(MOTOR_OFF, of_axis=True)
        if target > axis.upper:
            raise CommandError(UPPER_LIMIT, of_axis=True)
        if target < axis.lower:
            raise CommandError(LOWER_LIMIT, of_axis=True)
        axis.model.release_limit()
        axis.model.move(target - axis.offset, axis.velocity, axis.acceleration, axis.deceleration)

    def _do_or(self, command: Command) -> None:
        axis = self._axis(command)
        self._bench.motion_commands[axis.model.name] += 1
        if not axis.powered:
            raise CommandError(MOTOR_OFF, of_axis=True)
        if command.value is not None and command.value not in range(7):
            raise CommandError(OUT_OF_RANGE)
        axis.model.release_limit()
        axis.searching = True
        axis.model.home()

    def _do_dh(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return _number(axis.offset)
        axis.offset = (command.value or 0.0) - axis.model.position()
        return None

    def _do_st(self, command: Command) -> None:
        for axis in [self._axis(command)] if command.axis else list(self.axes.values()):
            self._stop(axis)

    def _stop(self, axis: EspAxis) -> None:
        if axis.searching:
            number = next(number for number, other in self.axes.items() if other is axis)
            self._errors.append(100 * number + HOMING_ABORTED)
            axis.searching = False
        axis.model.stop(axis.deceleration)

    def _do_va(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return _number(axis.velocity)
        axis.velocity = self._rate(command, axis.model.design.velocity, VELOCITY)
        return None

    def _do_ac(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return _number(axis.acceleration)
        axis.acceleration = self._rate(command, axis.model.design.acceleration, ACCELERATION)
        return None

    def _do_ag(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return _number(axis.deceleration)
        axis.deceleration = self._rate(command, axis.model.design.acceleration, ACCELERATION)
        return None

    def _rate(self, command: Command, largest: float, code: int) -> float:
        value = self._value(command)
        if value <= 0:
            raise CommandError(OUT_OF_RANGE)
        if value > largest:
            raise CommandError(code, of_axis=True)
        return value

    def _do_vu(self, command: Command) -> str:
        return _number(self._axis(command).model.design.velocity)

    def _do_au(self, command: Command) -> str:
        return _number(self._axis(command).model.design.acceleration)

    def _do_sl(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return _number(axis.lower)
        axis.lower = self._value(command)
        return None

    def _do_sr(self, command: Command) -> str | None:
        axis = self._axis(command)
        if command.query:
            return _number(axis.upper)
        axis.upper = self._value(command)
        return None
