"""Newport ESP300, ESP301 and ESP302 controllers: up to three axes behind one port.

After the command set that EPICS, PyMeasure and InstrumentKit agree on. Only queries are answered, without any echo;
errors of all axes wait in one queue, which ``TE?`` empties. The controller does not say whether an axis has found
its zero, so the driver trusts only a search that it has seen to its end, and only while the motor keeps its power.
A move is sent once: where its fate is not clear the axis is stopped, looked at, and the caller decides.
"""

from __future__ import annotations

import re
import time
import weakref
from collections.abc import Callable
from typing import Annotated

from pydantic import Field, PositiveFloat

from drivers.arm import ArmForm, ArmScale, stop_surely
from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceError, DeviceFault
from drivers.esp301_codes import ALL_AXES, error_words
from drivers.interfaces import AxisStatus
from drivers.transport import Line, NoReply

#: Silence in s behind a command that is not answered.
COMMAND_PAUSE = 0.02
QUERY_ATTEMPTS = 3
#: Errors that the controller keeps.
ERROR_QUEUE = 10
#: Wall-clock s within which a command of motion must show, and between two looks.
ACCEPT_DEADLINE, ACCEPT_PAUSE = 0.3, 0.02

#: What answers a question looks like: nothing else tells it from a line that was garbled or meant for another.
_FLAG, _CODE = re.compile(rb"[01]"), re.compile(rb"\d{1,3}")
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_VERSION = re.compile(rb"ESP30\d", re.I)
_TEXT = re.compile(rb"(?![Ee]rr)[ -~]+")


class Esp301Form(ArmForm):
    """Options of an ESP301 axis in ``devices.toml``, beside those of every arm.

    Attributes
    ----------
    axis
        Number of the axis, 1 to 3.
    units_per_degree
        User units of the stage in one degree; 1 for a rotary stage in degrees.
    home_type
        What ``OR`` looks for: 0 the counter's zero, 1 home switch and index, 2 home switch, 3 and 4 positive and
        negative limit, 5 and 6 the same with index.
    """

    axis: Annotated[int, Field(ge=1, le=3)]
    units_per_degree: PositiveFloat = 1.0
    home_type: Annotated[int, Field(ge=0, le=6)] = 1

    def claims(self) -> list[tuple[str, str]]:
        """The axis."""
        return [("the controller", f"axis {self.axis}")]


class EspController:
    """What the axes of one controller share: the wire's step, and the queue of errors.

    Parameters
    ----------
    line
        The port.
    """

    def __init__(self, line: Line) -> None:
        self._line = line
        self._out_of_step = False
        self._waiting: dict[int, list[int]] = {1: [], 2: [], 3: []}

    def errors_of(self, device: str, axis: int) -> list[int]:
        """Empty the controller's queue; what concerns other axes is kept for them.

        Returns
        -------
        list
            Codes of this axis, and general ones that answer the command just sent.
        """
        general: list[int] = []
        for _ in range(ERROR_QUEUE + 1):
            code = int(self.query(device, "TE?", _CODE))
            if code == 0:
                break
            if code in ALL_AXES:
                for codes in self._waiting.values():
                    codes.append(code)
            elif code < 100:
                general.append(code)
            else:
                self._waiting.setdefault(code // 100, []).append(code)
        own, self._waiting[axis] = self._waiting[axis], []
        return own + general

    def query(self, device: str, query: str, looks_like: re.Pattern[bytes]) -> str:
        """Ask until an answer of the right looks comes: nothing else tells one reply from another.

        Raises
        ------
        CommunicationError
            If none came, after some attempts.
        """
        for attempt in range(1, QUERY_ATTEMPTS + 1):
            try:
                with self._line.transaction(device):
                    if self._out_of_step:
                        # Replies come in order: once this one is there, a late one has passed.
                        self._ask(device, "VE?", _VERSION)
                    return self._ask(device, query, looks_like)
            except NoReply:
                if attempt == QUERY_ATTEMPTS:
                    raise
        raise AssertionError("not reached")

    def _ask(self, device: str, query: str, looks_like: re.Pattern[bytes]) -> str:
        whole = query != "VE?"

        def complete(received: bytes) -> bytes | None:
            # A controller may also report an error that nobody asked for, on a line that begins with E.
            for line in (part.strip() for part in received.split(b"\r\n")[:-1]):
                if looks_like.fullmatch(line) if whole else looks_like.search(line):
                    return line
            return None

        self._out_of_step = True
        reply = self._line.exchange(device, f"{query}\r".encode("ascii"), complete)
        self._out_of_step = False
        return reply.decode("ascii", "replace")


_CONTROLLERS: weakref.WeakKeyDictionary[Line, EspController] = weakref.WeakKeyDictionary()


class NewportEsp301:
    """One axis. Satisfies :class:`drivers.interfaces.Axis`."""

    options = Esp301Form
    line_kinds = ("serial", "tcp")

    def __init__(self, name: str, line: Line, options: Esp301Form, clock: Clock) -> None:
        self.name = name
        self.limits = options.limits
        self.tolerance = options.tolerance
        self._line, self._options = line, options
        self._controller = _CONTROLLERS.setdefault(line, EspController(line))
        self._scale = ArmScale(options, options.units_per_degree)
        self._prepared = self._homed = self._homing = False
        self._faults: tuple[str, ...] = ()
        line.attach(name)

    def identify(self) -> str:
        """Firmware of the controller and model of the stage; errors of the past are forgotten."""
        version = self._controller.query(self.name, "VE?", _VERSION)
        self._controller.errors_of(self.name, self._options.axis)
        stage = self._query("ID?", _TEXT)
        return f"Newport {version}, axis {self._options.axis}: {stage}"

    def position(self) -> float:
        """Actual position, degree."""
        return self._scale.to_laboratory(self._number("TP"))

    def status(self) -> AxisStatus:
        """State of the axis now; a fault stays until the axis is homed or the fault cleared."""
        with self._line.transaction(self.name):
            self._collect_faults()
            standing, powered = self._standing(), self._powered()
            if not powered and (self._homed or self._homing):
                self._fault("motor is off: the zero is not trusted any more")
                self._homed = self._homing = self._prepared = False
            if self._homing and standing:
                self._homing = False
                # A search may end by an error that came after the first look.
                self._collect_faults()
                self._homed = not self._faults
        return AxisStatus(
            moving=not standing,
            homed=self._homed,
            in_position=standing and powered and self._homed and not self._faults,
            fault="; ".join(self._faults),
        )

    def home(self) -> None:
        """Switch the motor on and start the search for the zero; an axis that has it keeps it.

        Raises
        ------
        CommandRefused
            If the controller refuses.
        CommunicationError
            If it is not clear whether the search began; the axis is stopped.
        """
        with self._line.transaction(self.name):
            status = self.status()
            if (status.homed and not status.fault) or (self._homing and status.moving):
                return
            self._faults, self._prepared, self._homed = (), False, False
            self._command("MO")
            before = self._number("TP")
            try:
                self._command(f"OR{self._options.home_type}")
                began = self._shows(lambda: self._number("TP") != before)
            except CommunicationError as error:
                raise self._stopped_after("OR", error) from error
            if not began:
                raise CommunicationError(self.name, "the search for the zero did not begin: OR was lost", "home again")
            self._homing = True

    def start_move(self, target: float) -> None:
        """Send one move to ``target`` (degree) and confirm that it began, or that the axis is there.

        Raises
        ------
        CommandRefused
            If the target is outside the travel, or the controller refuses; nothing moves.
        CommunicationError
            If the command was lost (the axis stands still), or its fate is not clear (the axis is stopped).
        """
        self._scale.check_target(self.name, target)
        with self._line.transaction(self.name):
            self._require_ready()
            self._prepare()
            wanted = self._scale.to_stage(target)
            close = self.tolerance * self._options.units_per_degree
            try:
                self._command(f"PA{_text(wanted)}")
                began = self._shows(lambda: abs(self._number("DP?") - wanted) <= close)
            except CommunicationError as error:
                raise self._stopped_after("PA", error) from error
            if not began:
                raise CommunicationError(
                    self.name,
                    f"the move to {target:g} degree was lost: the axis stands at {self.position():g} degree",
                    "the move may be asked for again",
                )

    def stop(self) -> None:
        """Decelerate and stop; returns once the controller has answered after it. May be repeated."""
        with self._line.transaction(self.name):
            self._send("ST")
            self._homing = False
            self._standing()

    def make_safe(self) -> None:
        """Stop; tried three times before the failure is reported."""
        stop_surely(self.stop)

    def clear_fault(self) -> None:
        """Forget the faults and switch the motor on again; a lost zero needs ``home``."""
        with self._line.transaction(self.name):
            self._controller.errors_of(self.name, self._options.axis)
            self._faults = ()
            self._command("MO")

    def set_enabled(self, on: bool) -> None:
        """Motor on (``MO``) or off (``MF``): off, the arm may be turned by hand, and has to be homed afterwards.

        Raises
        ------
        CommandRefused
            If the arm moves.
        """
        with self._line.transaction(self.name):
            if not self._standing():
                raise CommandRefused(self.name, "cannot be switched while it moves", "stop it")
            self._command("MO" if on else "MF")

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)

    # ---- what commands need -----------------------------------------------------------------------------------

    def _require_ready(self) -> None:
        status = self.status()
        if status.fault:
            raise DeviceFault(self.name, status.fault, "remove the cause and home the axis")
        if not status.homed:
            raise CommandRefused(self.name, "cannot move before its zero is known", "home the axis first")
        if status.moving:
            raise CommandRefused(self.name, "cannot move while it is moving", "stop it or wait")

    def _prepare(self) -> None:
        """Velocity, accelerations and software limits, which a reset forgets."""
        if self._prepared:
            return
        units = self._options.units_per_degree
        lower, upper = self._scale.stage_travel()
        acceleration = self.limits.acceleration * units
        settings = {"AC": acceleration, "AG": acceleration, "VA": self.limits.velocity * units, "SL": lower}
        for command, value in (settings | {"SR": upper}).items():
            if not _same(self._number(f"{command}?"), value):
                self._command(f"{command}{_text(value)}")
            found = self._number(f"{command}?")
            if not _same(found, value):
                raise CommunicationError(self.name, f"{command} reads {found:g} after {value:g} was set")
        self._prepared = True

    def _shows(self, arrived: Callable[[], bool]) -> bool:
        """Whether a command of motion has an effect: the axis moves, or has already arrived."""
        deadline = time.monotonic() + ACCEPT_DEADLINE
        while True:
            late = time.monotonic() > deadline
            if not self._standing() or arrived():
                return True
            if late:
                return False
            time.sleep(ACCEPT_PAUSE)

    def _stopped_after(self, command: str, error: CommunicationError) -> CommunicationError:
        """Stop the axis after a motion command of unknown fate; what to raise, with what was read back."""
        try:
            self.stop()
            outcome = f"the axis was stopped; it is {'standing' if self._standing() else 'slowing down'}"
        except DeviceError as second:
            outcome = f"the stop could not be confirmed either: {second.problem}"
        return CommunicationError(
            self.name, f"{command}: {error.problem}; {outcome}", "read position and state before moving again"
        )

    def _collect_faults(self) -> None:
        for code in self._controller.errors_of(self.name, self._options.axis):
            if code in ALL_AXES or code >= 100:
                self._fault(error_words(code))

    def _fault(self, words: str) -> None:
        if words not in self._faults:
            self._faults += (words,)

    # ---- the wire -----------------------------------------------------------------------------------------------

    def _standing(self) -> bool:
        return self._query("MD?", _FLAG) != "0"

    def _powered(self) -> bool:
        return self._query("MO?", _FLAG) != "0"

    def _send(self, command: str) -> None:
        self._line.send(self.name, f"{self._options.axis}{command}\r".encode("ascii"), COMMAND_PAUSE)

    def _command(self, command: str) -> None:
        """Send a command once and ask whether it was refused; older errors are faults, and not its own."""
        with self._line.transaction(self.name):
            self._collect_faults()
            self._send(command)
            refused = self._controller.errors_of(self.name, self._options.axis)
            if refused:
                raise CommandRefused(self.name, f"{command}: {'; '.join(map(error_words, refused))}")

    def _number(self, query: str) -> float:
        return float(self._query(query, _NUMBER))

    def _query(self, query: str, looks_like: re.Pattern[bytes]) -> str:
        return self._controller.query(self.name, f"{self._options.axis}{query}", looks_like)


def _text(value: float) -> str:
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def _same(found: float, wanted: float) -> bool:
    return abs(found - wanted) <= 1e-4 * max(1.0, abs(wanted))
