"""Keysight 34465A multimeter (and 34460A, 34461A, 34470A) in SCPI.

Commands after the Truevolt series programming guide: one trigger starts a burst of ``SAMP:COUN`` readings, which
``READ?`` returns together. An overload reads 9.9E37 and queues no error. A burst that did not come in time is
abandoned together with its connection, so that it cannot be taken for the next one; reading again is then safe.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated

from pydantic import AfterValidator, Field, PositiveFloat

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.forms import Form
from drivers.interfaces import Reading
from drivers.transport import NoReply
from drivers.visa_line import VisaLine

MODELS = ("34460A", "34461A", "34465A", "34470A")

RANGES = (0.1, 1.0, 10.0, 100.0, 1000.0)
#: Below 0.02 the meters of this series digitise and need their DIG option.
NPLCS = (0.02, 0.06, 0.2, 1.0, 10.0, 100.0)

#: Magnitude from which on a reading is the sign of an overload.
OVERLOAD = 9.0e37

#: Depth of the error queue, and the form of its entries.
ERROR_QUEUE = 20
_QUEUE_ENTRY = re.compile(r"\s*([+-]?\d+)\s*,")

#: A burst that was lost is taken again.
ATTEMPTS = 2


def _one_of(choices: tuple[float, ...]) -> Callable[[float], float]:
    def check(value: float) -> float:
        if value not in choices:
            raise ValueError(f"expected one of {', '.join(f'{choice:g}' for choice in choices)}")
        return value

    return check


class Keysight34465AForm(Form):
    """Options of the meter in ``devices.toml``.

    Attributes
    ----------
    range
        Measuring range, V.
    full_scale
        Voltage above which a reading counts as saturated; the range where it is not given.
    nplc
        Integration time in periods of the mains.
    line_frequency
        Of the mains, Hz.
    auto_zero
        Whether every reading is followed by one of the shorted input, which doubles its time.
    """

    range: Annotated[float, AfterValidator(_one_of(RANGES))] = 10.0
    full_scale: PositiveFloat | None = None
    nplc: Annotated[float, AfterValidator(_one_of(NPLCS))] = 1.0
    line_frequency: Annotated[float, Field(ge=40, le=70)] = 50.0
    auto_zero: bool = True


class Keysight34465A:
    """The meter. Satisfies :class:`drivers.interfaces.Detector`."""

    options = Keysight34465AForm
    line_kinds = ("visa",)

    def __init__(self, name: str, line: VisaLine, options: Keysight34465AForm, clock: Clock) -> None:
        self.name = name
        self.full_scale = options.full_scale or options.range
        self._line, self._options, self._clock = line, options, clock
        self._configured: int | None = None
        self._samples = 0
        line.attach(name)

    def identify(self) -> str:
        """Ask for maker and model, and configure the meter.

        Raises
        ------
        CommandRefused
            If something else answers, or a setting is refused.
        """
        identity = self._line.query(self.name, "*IDN?")
        if not any(model in identity for model in MODELS):
            raise CommandRefused(self.name, f"{identity!r} answered, expected one of {', '.join(MODELS)}")
        self._configure()
        return identity

    def read(self, samples: int) -> Reading:
        """Take ``samples`` readings in one burst; blocks for their integration time.

        Raises
        ------
        CommandRefused
            If ``samples`` is not positive.
        CommunicationError
            If no complete burst came, twice.
        """
        if samples < 1:
            raise CommandRefused(self.name, f"{samples} readings were asked for; at least 1 is needed")
        with self._line.transaction(self.name):
            for attempt in range(1, ATTEMPTS + 1):
                try:
                    return self._burst(samples)
                except CommunicationError:
                    self._line.reset()
                    if attempt == ATTEMPTS:
                        raise
        raise AssertionError("not reached")

    def make_safe(self) -> None:
        """Nothing to do: a voltmeter harms nothing."""

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)

    def burst_time(self, samples: int) -> float:
        """Laboratory s that a burst takes."""
        once = self._options.nplc / self._options.line_frequency
        return samples * once * (2 if self._options.auto_zero else 1)

    def _burst(self, samples: int) -> Reading:
        if self._line.ready(self.name) != self._configured:
            self._configure()
        if samples != self._samples:
            self._line.write(self.name, f"SAMP:COUN {samples}")
            self._samples = samples
        # Twice the burst for what triggers and range relays take, on top of the time-out of any reply.
        wait = self._line.timeout + 2.0 * self.burst_time(samples) / self._clock.speed
        reply = self._line.query(self.name, "READ?", wait)
        try:
            values = tuple(float(text) for text in reply.split(","))
        except ValueError:
            raise CommunicationError(self.name, f"READ? gave {reply[:60]!r}, expected numbers") from None
        if len(values) != samples:
            self._samples = 0
            raise CommunicationError(self.name, f"READ? gave {len(values)} readings, expected {samples}")
        return Reading(values, overload=any(abs(value) >= OVERLOAD for value in values))

    def _configure(self) -> None:
        """Put the meter into the state that the readings need; a meter that was reset has forgotten it."""
        options = self._options
        with self._line.transaction(self.name):
            generation = self._line.ready(self.name)
            for command in (
                "ABOR",
                "*CLS",
                "CONF:VOLT:DC",
                f"SENS:VOLT:DC:RANG {options.range:g}",
                f"SENS:VOLT:NPLC {options.nplc:g}",
                f"SENS:VOLT:ZERO:AUTO {int(options.auto_zero)}",
                "TRIG:SOUR IMM",
                "TRIG:COUN 1",
            ):
                self._line.write(self.name, command)
            errors = self._errors()
            if errors:
                raise DeviceFault(self.name, f"the meter refuses its settings: {'; '.join(errors)}")
            self._configured, self._samples = generation, 0

    def _errors(self) -> list[str]:
        """Empty the error queue."""
        errors: list[str] = []
        for _ in range(ERROR_QUEUE + 1):
            reply = self._line.query(self.name, "SYST:ERR?")
            number = _QUEUE_ENTRY.match(reply)
            if number is None:
                raise CommunicationError(self.name, f"SYST:ERR? gave {reply[:60]!r}, expected a number and a text")
            if int(number[1]) == 0:
                return errors
            errors.append(reply)
        raise NoReply(self.name, f"the error queue does not end: {errors[-1]}")
