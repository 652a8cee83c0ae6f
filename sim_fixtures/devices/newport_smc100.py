"""Newport SMC100CC/PP: one controller with its stage.

Written from the manual EDH0206En2051 (09/18): states and their codes under ``TS``, error letters under ``TE``. Set
commands are not answered; errors are kept until they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable

from sim_fixtures.bench import Bench
from sim_fixtures.bench.axis import AxisModel
from sim_fixtures.devices.newport_syntax import Command

NOT_REFERENCED_RESET, NOT_REFERENCED_HOMING, NOT_REFERENCED_CONFIGURATION = "0A", "0B", "0C"
NOT_REFERENCED_READY, NOT_REFERENCED_MOVING = "0E", "0F"
CONFIGURATION, HOMING, MOVING = "14", "1E", "28"
READY_FROM_HOMING, READY_FROM_MOVING, READY_FROM_DISABLE = "32", "33", "34"
DISABLE_FROM_READY, DISABLE_FROM_MOVING = "3C", "3D"

#: Letter that refuses a command in a state, by the state's first letter of the manual's table.
_REFUSAL = {"not referenced": "H", "configuration": "I", "disable": "J", "ready": "K", "homing": "L", "moving": "M"}

_ERROR_TEXT = {
    "@": "No error",
    "A": "Unknown message code or floating point controller address",
    "B": "Controller address not correct",
    "C": "Parameter missing or out of range",
    "D": "Command not allowed",
    "E": "Home sequence already started",
    "F": "ESP stage name unknown",
    "G": "Displacement out of limits",
    "H": "Command not allowed in NOT REFERENCED state",
    "I": "Command not allowed in CONFIGURATION state",
    "J": "Command not allowed in DISABLE state",
    "K": "Command not allowed in READY state",
    "L": "Command not allowed in HOMING state",
    "M": "Command not allowed in MOVING state",
    "N": "Current position out of software limit",
    "S": "Communication time out",
}

#: Bits of the error map that ``TS`` shows.
ERROR_BITS = {
    "negative end of run": 0,
    "positive end of run": 1,
    "peak current": 2,
    "rms current": 3,
    "short circuit": 4,
    "following error": 5,
    "homing time-out": 6,
}


class CommandError(Exception):
    """A command is refused; the text is the error letter."""


def _number(value: float) -> str:
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


class Controller:
    """One SMC100 with its stage."""

    def __init__(self, address: int, axis: AxisModel, bench: Bench, limits: tuple[float, float]) -> None:
        self.address, self.axis, self._bench = address, axis, bench
        self._stored_limits = limits
        self._stored_velocity, self._stored_acceleration = axis.design.velocity, axis.design.acceleration
        self._home_type, self._home_time = 2.0, 2.5 * axis.design.homing_time
        self._outputs = 0
        self._reset()

    def _reset(self) -> None:
        self.errors, self._letter = 0, "@"
        self._state = NOT_REFERENCED_RESET
        self._armed: float | None = None
        self._set_point = 0.0
        self.lower, self.upper = self._stored_limits
        self.velocity, self.acceleration = self._stored_velocity, self._stored_acceleration
        self._reference_pending = False
        self._deaf_until = 0.0

    # ---- state -------------------------------------------------------------------------------------------

    def state(self) -> str:
        """Two-digit state code, brought up to the present."""
        if self.axis.at_limit and self._state not in (NOT_REFERENCED_RESET, HOMING) and self._kind() != "disable":
            self.errors |= 1 << (0 if self.axis.at_limit < 0 else 1)
            self._lose_reference(NOT_REFERENCED_MOVING if self._state == MOVING else NOT_REFERENCED_READY)
        if not self.axis.moving():
            if self._state == HOMING:
                self._state = READY_FROM_HOMING if self.axis.homed else NOT_REFERENCED_HOMING
                self._set_point = self.axis.position()
            elif self._state == MOVING:
                self._state = READY_FROM_MOVING
                self._set_point = self.axis.position()
        return self._state

    def _kind(self) -> str:
        if self._state.startswith("0") or self._state == "10":
            return "not referenced"
        if self._state in (READY_FROM_HOMING, READY_FROM_MOVING, READY_FROM_DISABLE):
            return "ready"
        if self._state.startswith("3"):
            return "disable"
        return {CONFIGURATION: "configuration", HOMING: "homing", MOVING: "moving"}[self._state]

    def _lose_reference(self, state: str) -> None:
        self.axis.halt()
        self.axis.lose_home()
        self.axis.release_limit()
        self._state, self._armed = state, None

    def fault(self, name: str) -> None:
        """A drive fault: its bit in the error map; the motor loses its current (DISABLE)."""
        self.errors |= 1 << ERROR_BITS[name]
        was_moving = self.state() == MOVING
        self.axis.halt()
        if self._kind() in ("ready", "moving"):
            self._state = DISABLE_FROM_MOVING if was_moving else DISABLE_FROM_READY
        elif self._state == HOMING:
            self._state = NOT_REFERENCED_HOMING

    # ---- commands ----------------------------------------------------------------------------------------

    def execute(self, command: Command) -> str | None:
        """Carry out a command; the answer without line end, or None."""
        if self._bench.clock.now() < self._deaf_until:
            return None
        self.state()
        handler: Callable[[Command], str | None] | None = getattr(self, f"_do_{command.name.lower()}", None)
        try:
            if handler is None:
                raise CommandError("A")
            answer = handler(command)
        except CommandError as error:
            self._letter = str(error)
            return None
        return None if answer is None else f"{self.address}{command.name}{answer}"

    def _only_in(self, *kinds: str) -> None:
        if self._kind() not in kinds:
            raise CommandError(_REFUSAL[self._kind()])

    def _value(self, command: Command) -> float:
        if command.value is None:
            raise CommandError("C")
        return command.value

    def _do_ts(self, command: Command) -> str:
        answer = f"{self.errors:04X}{self.state()}"
        self.errors = 0
        return answer

    def _do_te(self, command: Command) -> str:
        letter, self._letter = self._letter, "@"
        return letter

    def _do_tb(self, command: Command) -> str:
        if command.letter:
            return f"{command.letter} {_ERROR_TEXT.get(command.letter, 'Unknown')}"
        letter, self._letter = self._letter, "@"
        return f"{letter} {_ERROR_TEXT.get(letter, 'Unknown')}"

    def _do_tp(self, command: Command) -> str:
        return _number(self.axis.position())

    def _do_th(self, command: Command) -> str:
        return _number(self._set_point)

    def _do_id(self, command: Command) -> str:
        return f"SIM-{self.axis.name.upper().replace('_', '-')}"

    def _do_ve(self, command: Command) -> str:
        return " SMC_CC 1.2.1"

    def _do_rb(self, command: Command) -> str:
        return "0"

    def _do_sb(self, command: Command) -> str | None:
        if command.query:
            return str(self._outputs)
        value = self._value(command)
        if not 0 <= value <= 15:
            raise CommandError("C")
        self._outputs = int(value)
        return None

    def _do_pa(self, command: Command) -> str | None:
        if command.query:
            return _number(self._set_point)
        self._bench.motion_commands[self.axis.name] += 1
        self._start(self._value(command))
        return None

    def _do_pr(self, command: Command) -> str | None:
        if command.query:
            return _number(self._set_point)
        self._bench.motion_commands[self.axis.name] += 1
        self._start(self._set_point + self._value(command))
        return None

    def _check_target(self, target: float) -> None:
        self._only_in("ready")
        if not self.lower <= target <= self.upper:
            raise CommandError("G")

    def _start(self, target: float) -> None:
        self._check_target(target)
        self._set_point = target
        if abs(target - self.axis.position()) < self.axis.design.step / 2:
            return  # nothing to do: the state stays what it was
        self._state = MOVING
        self.axis.move(target, self.velocity, self.acceleration)

    def _do_se(self, command: Command) -> str | None:
        if command.query:
            return _number(self._armed if self._armed is not None else self._set_point)
        target = self._value(command)
        self._check_target(target)
        self._armed = target
        return None

    def start_armed(self) -> None:
        """The common start of every armed axis (bare ``SE``)."""
        if self._armed is not None and self._kind() == "ready":
            self._bench.motion_commands[self.axis.name] += 1
            target, self._armed = self._armed, None
            self._start(target)

    def _do_st(self, command: Command) -> str | None:
        self.stop()
        return None

    def stop(self) -> None:
        """Decelerate; a search for the zero is given up."""
        self.state()
        self._armed = None
        if self._state == HOMING:
            self.axis.stop(self.acceleration)
            self._state = NOT_REFERENCED_HOMING
        elif self._state == MOVING:
            self.axis.stop(self.acceleration)

    def _do_or(self, command: Command) -> str | None:
        if self._state == HOMING:
            raise CommandError("E")
        self._only_in("not referenced")
        self._bench.motion_commands[self.axis.name] += 1
        self._state = HOMING
        self.axis.home()
        return None

    def _do_mm(self, command: Command) -> str | None:
        if command.query:
            return self._state
        self._only_in("ready", "disable")
        value = self._value(command)
        if value == 0 and self._kind() == "ready":
            self._state = DISABLE_FROM_READY
        elif value == 1 and self._kind() == "disable":
            self._state, self._set_point = READY_FROM_DISABLE, self.axis.position()
        elif value not in (0, 1):
            raise CommandError("C")
        return None

    def _do_pt(self, command: Command) -> str:
        distance = abs(self._value(command))
        ramp = self.velocity / self.acceleration
        if distance < self.velocity * ramp:
            return _number(2 * (distance / self.acceleration) ** 0.5)
        return _number(distance / self.velocity + ramp)

    def _do_va(self, command: Command) -> str | None:
        self.velocity = self._rate(command, self.velocity, self._stored_velocity)
        return _number(self.velocity) if command.query else None

    def _do_ac(self, command: Command) -> str | None:
        self.acceleration = self._rate(command, self.acceleration, self._stored_acceleration)
        return _number(self.acceleration) if command.query else None

    def _rate(self, command: Command, present: float, largest: float) -> float:
        if command.query:
            return present
        value = self._value(command)
        if self._kind() not in ("ready", "disable", "configuration"):
            raise CommandError(_REFUSAL[self._kind()])
        if not 0 < value <= largest:
            raise CommandError("C")
        return value

    def _do_sl(self, command: Command) -> str | None:
        if command.query:
            return _number(self.lower)
        self._only_in("ready", "disable", "configuration")
        if (value := self._value(command)) > 0:
            raise CommandError("C")
        self.lower = value
        return None

    def _do_sr(self, command: Command) -> str | None:
        if command.query:
            return _number(self.upper)
        self._only_in("ready", "disable", "configuration")
        if (value := self._value(command)) < 0:
            raise CommandError("C")
        self.upper = value
        return None

    def _do_ht(self, command: Command) -> str | None:
        if command.query:
            return _number(self._home_type)
        self._only_in("configuration")
        if (value := self._value(command)) not in (0, 1, 2, 3, 4):
            raise CommandError("C")
        self._home_type = value
        return None

    def _do_ot(self, command: Command) -> str | None:
        if command.query:
            return _number(self._home_time)
        self._only_in("configuration")
        self._home_time = self._value(command)
        return None

    def _do_rs(self, command: Command) -> str | None:
        self.axis.halt()
        self.axis.lose_home()
        self._reset()
        return None

    def _do_pw(self, command: Command) -> str | None:
        value = self._value(command)
        if value == 1:
            self._only_in("not referenced")
            self._state = CONFIGURATION
        elif value == 0:
            self._only_in("configuration")
            self._stored_limits = (self.lower, self.upper)
            self._stored_velocity, self._stored_acceleration = self.velocity, self.acceleration
            self._state = NOT_REFERENCED_CONFIGURATION
            self._deaf_until = self._bench.clock.now() + 10.0
        else:
            raise CommandError("C")
        return None
