"""Newport SMC100CC/PP motion controllers on one daisy-chained serial line.

Manual: "SMC100CC & SMC100PP User's Manual", EDH0206En2051 09/18. A command has no acknowledgement and errors are
never sent unasked, so every set command is followed by ``TE`` and every move by a look at set-point and state.
A move is sent once: where its fate is not clear the axis is stopped, looked at, and the caller decides.
"""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import Field, PositiveFloat

from drivers.arm import ArmForm, ArmScale, stop_surely
from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceError, DeviceFault
from drivers.interfaces import AxisStatus
from drivers.smc100_codes import (
    BUSY,
    COMMAND_ERRORS,
    DISABLED,
    HOMED,
    HOMING,
    NOT_REFERENCED,
    OUT_OF_ORDER,
    READY,
    STATES,
    State,
    parse_state,
)
from drivers.transport import Line, NoReply

#: Silence in s behind a command that is not answered; the controller needs it to take the next one.
COMMAND_PAUSE = 0.02

#: Queries change nothing, so a lost reply may be asked for again.
QUERY_ATTEMPTS = 3


class Smc100Form(ArmForm):
    """Options of an SMC100 axis in ``devices.toml``, beside those of every arm.

    Attributes
    ----------
    address
        Of the controller, 1 to 31.
    units_per_degree
        User units of the stage in one degree; 1 for a rotary stage.
    """

    address: Annotated[int, Field(ge=1, le=31)]
    units_per_degree: PositiveFloat = 1.0

    def claims(self) -> list[tuple[str, str]]:
        """The controller."""
        return [(f"address {self.address}", "")]


class NewportSmc100:
    """One controller with its stage. Satisfies :class:`drivers.interfaces.Axis`."""

    options = Smc100Form
    line_kinds = ("serial", "tcp")

    def __init__(self, name: str, line: Line, options: Smc100Form, clock: Clock) -> None:
        self.name = name
        self.limits = options.limits
        self.tolerance = options.tolerance
        self._line, self._options = line, options
        self._scale = ArmScale(options, options.units_per_degree)
        self._prepared = False
        self._out_of_step = False
        # TS clears the error map as it is read: what it said is kept until the axis is in order again.
        self._faults: tuple[str, ...] = ()
        line.attach(name)

    def identify(self) -> str:
        """Stage and firmware of the controller.

        Raises
        ------
        CommandRefused
            If two controllers answer: they would both move.
        """
        received = self._line.gather(self.name, f"{self._options.address}VE\r\n".encode("ascii"))
        answers = re.findall(rf"^{self._options.address}VE([ -~]*)".encode(), received, re.MULTILINE)
        if len(answers) > 1:
            problem = f"{len(answers)} controllers answer at address {self._options.address}"
            raise CommandRefused(self.name, problem, "give each an address of its own (SA)")
        firmware = answers[0].decode("ascii") if answers else self._query("VE")
        stage = self._query("ID?")
        return f"Newport SMC100, address {self._options.address}: {firmware.strip()}, stage {stage}"

    def position(self) -> float:
        """Actual position, degree."""
        return self._scale.to_laboratory(self._number("TP"))

    def status(self) -> AxisStatus:
        """State of the axis now; a fault stays until the axis is ready again, homed or sent somewhere."""
        return self._as_status(self._state())

    def home(self) -> None:
        """Start the search for the zero; an axis that is referenced already keeps its zero.

        Raises
        ------
        CommandRefused
            If the controller refuses.
        CommunicationError
            If it is not clear whether the search began; the axis is stopped.
        """
        with self._line.transaction(self.name):
            state = self._state()
            if state.code in HOMED | HOMING:
                return
            self._faults, self._prepared = (), False
            try:
                self._command("OR")
                began = self._state()
            except CommunicationError as error:
                raise self._stopped_after("OR", error) from error
            if began.code in NOT_REFERENCED and not began.faults:
                raise CommunicationError(self.name, "the search for the zero did not begin: OR was lost", "home again")

    def start_move(self, target: float) -> None:
        """Send one move to ``target`` (degree) and confirm it by the set-point read back.

        Raises
        ------
        CommandRefused
            If the target is outside the travel, or the controller refuses; nothing moves.
        CommunicationError
            If the command was lost (the axis stands still), or its fate is not clear (the axis is stopped).
        """
        self._scale.check_target(self.name, target)
        with self._line.transaction(self.name):
            self._faults = ()
            self._require_ready()
            self._prepare()
            wanted = self._scale.to_stage(target)
            try:
                self._command(f"PA{_text(wanted)}")
                accepted = self._number("PA?")
            except CommunicationError as error:
                raise self._stopped_after("PA", error) from error
            if abs(accepted - wanted) > self.tolerance * self._options.units_per_degree:
                # Lost, or misread on its way by a line without checksums: then the arm moves to where nobody sent it.
                found = f"the set-point is {self._scale.to_laboratory(accepted):g} degree instead of {target:g}"
                raise self._stopped_after("PA", CommunicationError(self.name, found))

    def stop(self) -> None:
        """Decelerate and stop; returns once the controller has answered after it. May be repeated."""
        with self._line.transaction(self.name):
            self._send("ST")
            self._state()

    def make_safe(self) -> None:
        """Stop; tried three times before the failure is reported."""
        stop_surely(self.stop)

    def clear_fault(self) -> None:
        """Switch the motor current on again (``MM1``) after a fault of the drive; a lost zero needs ``home``."""
        with self._line.transaction(self.name):
            if self._state().code in DISABLED:
                self._command("MM1")

    def set_enabled(self, on: bool) -> None:
        """Motor current on (``MM1``) or off (``MM0``): without it the arm may be turned by hand. Its zero is kept.

        Raises
        ------
        CommandRefused
            If the axis is neither ready nor disabled.
        """
        with self._line.transaction(self.name):
            code = self._state().code
            if code not in (DISABLED if on else READY):
                if code in (READY if on else DISABLED):
                    return
                raise CommandRefused(self.name, f"cannot be switched while {STATES.get(code, code)}", "stop or home it")
            self._command("MM1" if on else "MM0")

    def reset(self) -> None:
        """Restart the controller (``RS``): it forgets its zero and has to be homed; takes some seconds."""
        self._send("RS")
        self._prepared, self._faults = False, ()

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)

    # ---- what commands need -----------------------------------------------------------------------------------

    def _require_ready(self) -> None:
        state = self._state()
        if state.code in READY:
            return
        if state.faults:
            raise DeviceFault(self.name, "; ".join(state.faults), "remove the cause and home the axis")
        advice = "home the axis first" if state.code in NOT_REFERENCED else "clear the fault, or wait until it is ready"
        raise CommandRefused(self.name, f"cannot move while {STATES.get(state.code, state.code)}", advice)

    def _prepare(self) -> None:
        """Velocity, acceleration and software limits, which a reset or a new search for the zero forgets."""
        if self._prepared:
            return
        units = self._options.units_per_degree
        lower, upper = self._scale.stage_travel()
        settings = {
            "AC": self.limits.acceleration * units,
            "VA": self.limits.velocity * units,
            # The controller wants SL <= 0 <= SR; the travel itself is checked before a target is sent.
            "SL": min(lower, 0.0),
            "SR": max(upper, 0.0),
        }
        for command, value in settings.items():
            if not _same(self._number(f"{command}?"), value):
                self._command(f"{command}{_text(value)}")
            found = self._number(f"{command}?")
            if not _same(found, value):
                raise CommunicationError(self.name, f"{command} reads {found:g} after {value:g} was set")
        self._prepared = True

    def _stopped_after(self, command: str, error: CommunicationError) -> CommunicationError:
        """Stop the axis after a motion command of unknown fate; what to raise, with what was read back."""
        try:
            self.stop()
            outcome = f"the axis was stopped; it is {STATES.get(self._state().code, 'in an unknown state')}"
        except DeviceError as second:
            outcome = f"the stop could not be confirmed either: {second.problem}"
        return CommunicationError(
            self.name, f"{command}: {error.problem}; {outcome}", "read position and state before moving again"
        )

    def _state(self) -> State:
        reply = self._query("TS")
        state = parse_state(reply)
        if state is None:
            raise CommunicationError(self.name, f"TS gave {reply!r}, expected six hexadecimal digits")
        if state.code in READY and not state.faults:
            self._faults = ()
        self._faults += tuple(fault for fault in state.faults if fault not in self._faults)
        if state.code in NOT_REFERENCED:
            self._prepared = False
        return State(state.code, self._faults)

    def _as_status(self, state: State) -> AxisStatus:
        faults = list(state.faults)
        if state.code not in STATES:
            faults.append(f"unknown state {state.code:02X}")
        elif state.code in OUT_OF_ORDER:
            faults.append(STATES[state.code])
        return AxisStatus(
            moving=state.code in BUSY,
            homed=state.code in HOMED,
            in_position=state.code in READY,
            fault="; ".join(faults),
        )

    # ---- the wire -----------------------------------------------------------------------------------------------

    def _send(self, command: str) -> None:
        self._line.send(self.name, f"{self._options.address}{command}\r\n".encode("ascii"), COMMAND_PAUSE)

    def _command(self, command: str) -> None:
        """Send a set command once and ask whether it was refused."""
        with self._line.transaction(self.name):
            self._query("TE")  # forget an older error, which would be blamed on this command
            self._send(command)
            letter = self._query("TE").strip()
            if letter != "@":
                raise CommandRefused(self.name, f"{command}: {COMMAND_ERRORS.get(letter, f'error {letter!r}')}")

    def _number(self, query: str) -> float:
        reply = self._query(query)
        try:
            return float(reply)
        except ValueError:
            raise CommunicationError(self.name, f"{query} gave {reply!r}, expected a number") from None

    def _query(self, query: str) -> str:
        """Ask until an answer comes; returns what follows the echoed address and command."""
        for attempt in range(1, QUERY_ATTEMPTS + 1):
            try:
                with self._line.transaction(self.name):
                    if self._out_of_step:
                        self._back_into_step()
                    return self._ask(query)
            except NoReply:
                if attempt == QUERY_ATTEMPTS:
                    raise
        raise AssertionError("not reached")

    def _ask(self, query: str) -> str:
        prefix = f"{self._options.address}{query.rstrip('?')}".encode("ascii")

        def complete(received: bytes) -> bytes | None:
            # Lines of other controllers or of an earlier query may still arrive: they have another prefix.
            for line in received.split(b"\r\n")[:-1]:
                if line.strip().upper().startswith(prefix):
                    return line
            return None

        request = f"{self._options.address}{query}\r\n".encode("ascii")
        self._out_of_step = True
        reply = self._line.exchange(self.name, request, complete)
        self._out_of_step = False
        return reply.strip()[len(prefix) :].decode("ascii", "replace")

    def _back_into_step(self) -> None:
        """Replies come in order: once another query is answered, the late answer of the last one has passed."""
        self._ask("VE")


def _text(value: float) -> str:
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def _same(found: float, wanted: float) -> bool:
    return abs(found - wanted) <= 1e-4 * max(1.0, abs(wanted))
