"""NKT SuperK supercontinuum laser on Interbus: main module of type 60h (EXTREME, FIANIUM) or 88h (FIANIUM S4x3).

Registers are those of the maker's register files 60 and 88.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.forms import Form
from drivers.nkt_module import ERROR, STATUS, NktModule
from drivers.transport import Line

EMISSION, MODE, INTERLOCK, WATCHDOG, POWER = 0x30, 0x31, 0x32, 0x36, 0x37
EMISSION_ON, EMISSION_OFF = 3, 0
CONSTANT_POWER = 1
FIANIUM_S4X3 = 0x88

#: Low byte of the interlock register.
INTERLOCK_OPEN, INTERLOCK_WAITING, INTERLOCK_OK = 0, 1, 2

#: High byte of the interlock register: what opened it.
INTERLOCK_CAUSES = {
    0: "no cause given",
    1: "key switch or front panel",
    2: "door",
    3: "external module",
    4: "application",
    5: "internal",
    6: "power failure",
    7: "disabled by the source",
    0xFF: "failure of the interlock circuit",
}

#: Status bits that are faults; bit 0 is the emission, bit 14 a note that the log has entries.
STATUS_FAULTS = {
    2: "interlock power failure",
    3: "interlock loop open",
    4: "disabled by the external input",
    5: "supply voltage low",
    6: "temperature out of range",
    13: "checksum error at start",
    15: "system error",
}

SYSTEM_ERROR = 15

#: Laboratory s within which the status must follow an emission command.
EMISSION_DEADLINE = 3.0


class SuperKForm(Form):
    """Options of the laser in ``devices.toml``.

    Attributes
    ----------
    address
        Interbus address of the main module.
    watchdog
        Seconds without communication after which the laser switches its emission off.
    reset_interlock
        Whether a closed interlock that waits for a reset is reset when emission is asked for; otherwise a person
        has to do it at the laser.
    power
        Fraction of full power to set with every connection; None keeps what the laser has.
    """

    address: Annotated[int, Field(ge=1, le=160)] = 15
    watchdog: Annotated[int, Field(ge=1, le=255)] = 10
    reset_interlock: bool = False
    power: Annotated[float, Field(ge=0, le=1)] | None = None

    def claims(self) -> list[tuple[str, str]]:
        """The main module."""
        return [(f"address {self.address}", "")]


class NktSuperK:
    """The laser. Satisfies :class:`drivers.interfaces.LightSource`."""

    options = SuperKForm
    line_kinds = ("serial", "tcp")

    def __init__(self, name: str, line: Line, options: SuperKForm, clock: Clock) -> None:
        self.name = name
        self._line, self._options, self._clock = line, options, clock
        self._module = NktModule(name, line, options.address)
        self._type: int | None = None
        line.attach(name)

    def identify(self) -> str:
        """Type and serial number; sets the configured power while no light is emitted."""
        identity = self._module.identify((0x60, FIANIUM_S4X3))
        self._type = self._module.module_type()
        if self._options.power is not None and not self.emission():
            self.set_power(self._options.power)
        return identity

    def emission(self) -> bool:
        """True while light is emitted, by the status of the laser."""
        return bool(self._module.read_unsigned(STATUS) & 1)

    def set_emission(self, on: bool) -> None:
        """Switch the emission and wait until the laser's status follows; ``on`` arms the watchdog first.

        Raises
        ------
        DeviceFault
            If the interlock is open, or the status does not follow.
        """
        if on:
            self._close_interlock()
            self._module.write(WATCHDOG, self._options.watchdog, 1)
        self._module.write(EMISSION, EMISSION_ON if on else EMISSION_OFF, 1)
        deadline = self._clock.monotonic() + EMISSION_DEADLINE
        while True:
            # The time is looked at first: a reply may take long on an accelerated clock.
            late = self._clock.monotonic() > deadline
            if self.emission() == on:
                return
            if late:
                state = "on" if on else "off"
                raise DeviceFault(self.name, f"emission did not go {state}: {self.fault() or 'no fault reported'}")
            self._clock.sleep(0.1)

    def power(self) -> float:
        """Set power, fraction of full power."""
        return self._module.read_unsigned(POWER) / 1000.0

    def set_power(self, fraction: float) -> None:
        """Set the power, 0 to 1; the laser is put into constant-power mode.

        Raises
        ------
        CommandRefused
            If ``fraction`` is outside 0 to 1.
        """
        if not 0.0 <= fraction <= 1.0:
            raise CommandRefused(self.name, f"power {fraction:g} is outside 0 to 1")
        if self._module.read_unsigned(MODE) != CONSTANT_POWER:
            self._module.write(MODE, CONSTANT_POWER, 1 if self._kind() == FIANIUM_S4X3 else 2)
        permille = round(fraction * 1000)
        self._module.write(POWER, permille, 2)
        found = self._module.read_unsigned(POWER)
        if found != permille:
            raise DeviceFault(self.name, f"power reads {found / 10:g} % after it was set to {permille / 10:g} %")

    def fault(self) -> str:
        """Interlock and status faults in words; empty when nothing is wrong.

        An interlock that is closed and only waits for a reset is no fault where ``reset_interlock`` lets the next
        ``set_emission`` do it.
        """
        status = self._module.read_unsigned(STATUS)
        problems = [words for bit, words in STATUS_FAULTS.items() if status >> bit & 1]
        if status >> SYSTEM_ERROR & 1:
            problems.append(f"error code {self._module.read_unsigned(ERROR)}: see the manual of the laser")
        interlock = self._module.read_unsigned(INTERLOCK)
        if not (self._options.reset_interlock and interlock & 0xFF == INTERLOCK_WAITING):
            problems.insert(0, interlock_words(interlock))
        return "; ".join(filter(None, problems))

    def keep_alive(self) -> None:
        """Feed the watchdog: any telegram does."""
        self._module.read(STATUS)

    def make_safe(self) -> None:
        """Emission off; a second try where the first one finds no reply."""
        try:
            self.set_emission(False)
        except CommunicationError:
            self.set_emission(False)

    def close(self) -> None:
        """Release the wire; the watchdog, where it is armed, ends a forgotten emission."""
        self._line.release(self.name)

    def _kind(self) -> int:
        if self._type is None:
            self._type = self._module.module_type()
        return self._type

    def _close_interlock(self) -> None:
        state = self._module.read_unsigned(INTERLOCK)
        if state & 0xFF == INTERLOCK_WAITING and self._options.reset_interlock:
            self._module.write(INTERLOCK, 1, 2)
            state = self._module.read_unsigned(INTERLOCK)
        words = interlock_words(state)
        if words:
            raise DeviceFault(self.name, words, "close the interlock and reset it at the laser")


def interlock_words(register: int) -> str:
    """The interlock register in words; empty when the interlock is closed."""
    state, cause = register & 0xFF, register >> 8
    if state == INTERLOCK_OK and cause == 0:
        return ""
    condition = {INTERLOCK_OPEN: "open", INTERLOCK_WAITING: "closed, waiting for reset", INTERLOCK_OK: "closed"}
    words = f"interlock {condition.get(state, f'in unknown state {state}')}"
    return f"{words}: {INTERLOCK_CAUSES.get(cause, f'unknown cause {cause}')}"
