"""Keysight 34465A multimeter: its SCPI commands and its measurements.

After the Truevolt programming guide: commands end with LF, several may be joined by semicolons, errors queue (20
at most) until ``SYST:ERR?`` reads them, an overload reads +9.9E37. Only DC voltage is simulated.
"""

from __future__ import annotations

import re
import threading
from collections import deque
from collections.abc import Callable, Iterator

from sim_fixtures.bench import Bench, MonitorBench
from sim_fixtures.devices.keysight_settings import KeptSettings

IDENTITY = "Keysight Technologies,34465A,MY00000000,A.03.00-03.15-03.00-00.52-02-01"
OVERLOAD = 9.9e37
RANGES = (0.1, 1.0, 10.0, 100.0, 1000.0)
INTEGRATION_TIMES = (0.001, 0.002, 0.006, 0.02, 0.06, 0.2, 1.0, 10.0, 100.0)  # power line cycles
_OVERRANGE = 1.2
_QUEUE = 20

ERRORS = {
    -109: "Missing parameter",
    -113: "Undefined header",
    -148: "Character data not allowed",
    -211: "Trigger ignored",
    -213: "Init ignored",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -230: "Data stale",
    -350: "Error queue overflow",
}


class ScpiError(Exception):
    """A command is refused; carries the error number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def short_form(header: str) -> str:
    """Reduce a header to short keywords: ``SENSe:VOLTage:DC:NPLCycles`` to ``VOLT:NPLC``.

    The optional nodes ``SENSe``, ``DC``, ``UPPer``, ``NEXT`` and ``IMMediate`` are dropped.
    """
    words = [word for word in header.upper().lstrip(":").split(":") if word]
    short = [_KEYWORDS.get(word, word) for word in words]
    kept = [word for word in short if word not in ("SENS", "DC", "NEXT", "IMM")]
    return ":".join(kept or short)


def headers(line: str) -> Iterator[tuple[str, str]]:
    """Split a line into commands: full header in short form, and parameter.

    After a semicolon a header goes on from the node of the one before it, unless it begins with a colon
    (IEEE 488.2 common commands, with their asterisk, leave the node as it is).
    """
    node = ""
    for command in line.split(";"):
        header, _, parameter = command.strip().partition(" ")
        if not header:
            continue
        if header.startswith("*"):
            yield header.upper(), parameter.strip()
            continue
        full = header if header.startswith(":") else node + header
        node = full.rpartition(":")[0] + ":" if ":" in full.lstrip(":") else ""
        question = "?" if full.endswith("?") else ""
        yield short_form(full.rstrip("?")) + question, parameter.strip()


def _abbreviations() -> dict[str, str]:
    long = (
        "SENSe VOLTage RANGe AUTO NPLCycles ZERO TRIGger SOURce COUNt DELay SAMPle CONFigure INITiate FETCh READ "
        "DISPlay STATe TEXT CLEar PRETrigger TIMer LEVel SLOPe RESolution ENABled LFRequency LICense CATalog "
        "ABORt SYSTem ERRor NEXT IMMediate MEASure IMPedance APERture STATus QUEStionable EVENt CONDition FUNCtion"
    )
    table = {}
    for word in long.split():
        short = "".join(letter for letter in word if letter.isupper())
        table[word.upper()] = table[short] = short
    return table


_KEYWORDS = _abbreviations()


class Burst(threading.Thread):
    """A measurement under way."""

    def __init__(self, bench: Bench | MonitorBench, count: int, integration: float, delay: float) -> None:
        super().__init__(name="meter burst", daemon=True)
        self.triggered = threading.Event()
        self.cancelled = threading.Event()
        self.volts: list[float] = []
        self._failure: BaseException | None = None
        self._bench, self._count, self._integration, self._delay = bench, count, integration, delay

    def run(self) -> None:
        self.triggered.wait()
        if self.cancelled.is_set():
            return
        self._bench.clock.wait_until(self._bench.clock.now() + self._delay, self.cancelled)
        try:
            self.volts = self._bench.measure(self._count, self._integration, self.cancelled)
        except BaseException as error:
            self._failure = error
            raise

    def finish(self) -> list[float]:
        """Wait for the readings."""
        self.join()
        if self._failure is not None:
            raise RuntimeError("the bench could not compute a reading") from self._failure
        return self.volts

    def cancel(self) -> None:
        """Give up."""
        self.cancelled.set()
        self.triggered.set()
        self.join(timeout=5.0)


class Multimeter:
    """State of the instrument and its command table.

    Parameters
    ----------
    bench
        Gives the voltage at the input.
    line_frequency
        Hz, of the mains; an integration time is so many of its periods.
    """

    def __init__(self, bench: Bench | MonitorBench, line_frequency: float = 50.0) -> None:
        self._bench, self._line_frequency = bench, line_frequency
        self._errors: deque[int] = deque()
        self._burst: Burst | None = None
        self._questionable = 0
        self._kept = KeptSettings(ScpiError)
        self._reset()
        self._commands: dict[str, Callable[[str], str | None]] = {
            "*IDN?": lambda _: IDENTITY,
            "*RST": self._do_reset,
            "*CLS": self._do_clear,
            "*OPC?": lambda _: "1",
            "*OPC": lambda _: None,
            "*WAI": lambda _: None,
            "*TRG": self._do_trigger,
            "*STB?": lambda _: str(bool(self._questionable) << 3 | bool(self._errors) << 2),
            "*ESR?": lambda _: "0",
            "CONF:VOLT": self._do_configure,
            "CONF?": lambda _: f'"VOLT {self._range:+.8E},{self._range * 1e-6:+.8E}"',
            "FUNC": self._do_function,
            "FUNC?": lambda _: '"VOLT"',
            "VOLT:RANG": self._do_range,
            "VOLT:RANG?": lambda _: f"{self._range:+.8E}",
            "VOLT:RANG:AUTO": self._do_autorange,
            "VOLT:RANG:AUTO?": lambda _: str(int(self._autorange)),
            "VOLT:NPLC": self._do_nplc,
            "VOLT:NPLC?": lambda _: f"{self._nplc:+.8E}",
            "VOLT:ZERO:AUTO": self._do_autozero,
            "VOLT:ZERO:AUTO?": lambda _: str(int(self._autozero)),
            "VOLT:IMP:AUTO": self._do_impedance,
            "VOLT:IMP:AUTO?": lambda _: str(int(self._high_impedance)),
            "TRIG:SOUR": self._do_trigger_source,
            "TRIG:SOUR?": lambda _: self._source,
            "TRIG:COUN": self._do_trigger_count,
            "TRIG:COUN?": lambda _: f"{1:+.8E}",
            "TRIG:DEL": self._do_trigger_delay,
            "TRIG:DEL?": lambda _: f"{self._delay:+.8E}",
            "SAMP:COUN": self._do_samples,
            "SAMP:COUN?": lambda _: f"{self._samples:+d}",
            "INIT": self._do_initiate,
            "FETC?": self._do_fetch,
            "READ?": self._do_read,
            "ABOR": self._do_abort,
            "SYST:ERR?": self._do_next_error,
            "SYST:ERR:COUN?": lambda _: f"{len(self._errors):+d}",
            "SYST:VERS?": lambda _: "1994.0",
            "SYST:LFR?": lambda _: f"{self._line_frequency:+.0f}",
            "STAT:QUES?": self._do_questionable,
            "STAT:QUES:EVEN?": self._do_questionable,
            "STAT:QUES:COND?": lambda _: str(self._questionable),
        } | self._kept.commands()

    def _reset(self) -> None:
        self._kept.reset()
        self._range, self._autorange = 10.0, True
        self._nplc, self._autozero, self._high_impedance = 10.0, True, False
        self._source, self._samples, self._delay = "IMM", 1, 0.0

    def execute(self, line: str) -> str | None:
        """Carry out a line of commands; the joined answers, or None where nothing was asked."""
        answers = []
        for header, parameter in headers(line):
            try:
                handler = self._commands.get(header)
                if handler is None:
                    raise ScpiError(-113)
                answer = handler(parameter.strip())
            except ScpiError as error:
                self._queue(error.number)
            else:
                if answer is not None:
                    answers.append(answer)
        return ";".join(answers) if answers else None

    def _queue(self, number: int) -> None:
        if len(self._errors) == _QUEUE:
            self._errors[-1] = -350
        else:
            self._errors.append(number)

    # ---- configuration -----------------------------------------------------------------------------------

    def _do_reset(self, _: str) -> None:
        self._do_abort("")
        self._reset()

    def _do_clear(self, _: str) -> None:
        self._errors.clear()
        self._questionable = 0

    def _do_configure(self, parameter: str) -> None:
        """``CONF:VOLT:DC`` puts everything but the input impedance back to its default."""
        self._do_abort("")
        impedance = self._high_impedance
        self._reset()
        self._high_impedance = impedance
        first = parameter.split(",")[0].strip().upper()
        if first and first not in ("AUTO", "DEF"):
            self._do_range(first)

    def _do_function(self, parameter: str) -> None:
        if parameter.strip("\"'").upper() not in ("VOLT", "VOLT:DC", "VOLTAGE", "VOLTAGE:DC"):
            raise ScpiError(-224)

    def _do_range(self, parameter: str) -> None:
        value = _number(parameter, {"MIN": RANGES[0], "MAX": RANGES[-1], "DEF": 10.0})
        fitting = [size for size in RANGES if abs(value) <= size * _OVERRANGE]
        if not fitting:
            raise ScpiError(-222)
        self._range, self._autorange = fitting[0], False

    def _do_autorange(self, parameter: str) -> None:
        self._autorange = _switch(parameter)

    def _do_nplc(self, parameter: str) -> None:
        value = _number(parameter, {"MIN": INTEGRATION_TIMES[0], "MAX": INTEGRATION_TIMES[-1], "DEF": 10.0})
        fitting = [time for time in INTEGRATION_TIMES if value <= time]
        if not fitting or value <= 0:
            raise ScpiError(-222)
        self._nplc = fitting[0]

    def _do_autozero(self, parameter: str) -> None:
        self._autozero = True if parameter.upper() == "ONCE" else _switch(parameter)

    def _do_impedance(self, parameter: str) -> None:
        self._high_impedance = _switch(parameter)

    def _do_trigger_source(self, parameter: str) -> None:
        source = {"IMMEDIATE": "IMM", "EXTERNAL": "EXT", "INTERNAL": "INT"}.get(parameter.upper(), parameter.upper())
        if source not in ("IMM", "BUS", "EXT", "INT"):
            raise ScpiError(-224)
        self._source = source

    def _do_trigger_count(self, parameter: str) -> None:
        if _number(parameter, {"MIN": 1, "DEF": 1}) != 1:
            raise ScpiError(-222)

    def _do_trigger_delay(self, parameter: str) -> None:
        value = _number(parameter, {"MIN": 0.0, "MAX": 3600.0, "DEF": 0.0})
        if not 0 <= value <= 3600:
            raise ScpiError(-222)
        self._delay = value
        self._kept.set("TRIG:DEL:AUTO", "0")

    def _do_samples(self, parameter: str) -> None:
        value = _number(parameter, {"MIN": 1, "MAX": 1_000_000, "DEF": 1})
        if not 1 <= value <= 1_000_000 or value != int(value):
            raise ScpiError(-222)
        self._samples = int(value)

    # ---- measurement -------------------------------------------------------------------------------------

    def _do_initiate(self, _: str) -> None:
        if self._burst is not None and self._burst.is_alive():
            raise ScpiError(-213)
        period = self._nplc / self._line_frequency * (2 if self._autozero else 1)
        self._questionable = 0
        self._burst = Burst(self._bench, self._samples, period, self._delay)
        self._burst.start()
        if self._source == "IMM":
            self._burst.triggered.set()

    def _do_trigger(self, _: str) -> None:
        if self._burst is None or self._source != "BUS" or self._burst.triggered.is_set():
            raise ScpiError(-211)
        self._burst.triggered.set()

    def _do_fetch(self, _: str) -> str | None:
        if self._burst is None or not self._burst.triggered.is_set():
            raise ScpiError(-230)
        volts = self._burst.finish()
        if not volts:
            raise ScpiError(-230)
        return ",".join(f"{self._reading(volt):+.8E}" for volt in volts)

    def _reading(self, volts: float) -> float:
        span = RANGES[-1] if self._autorange else self._range
        if abs(volts) > span * _OVERRANGE:
            self._questionable |= 1
            return OVERLOAD if volts > 0 else -OVERLOAD
        return volts

    def _do_read(self, _: str) -> str | None:
        if self._source == "BUS":
            raise ScpiError(-211)
        self._do_abort("")
        self._do_initiate("")
        return self._do_fetch("")

    def _do_abort(self, _: str) -> None:
        if self._burst is not None and self._burst.is_alive():
            self._burst.cancel()
            self._burst = None

    def _do_next_error(self, _: str) -> str:
        number = self._errors.popleft() if self._errors else 0
        return f'{number:+d},"{ERRORS.get(number, "No error")}"'

    def _do_questionable(self, _: str) -> str:
        value, self._questionable = self._questionable, 0
        return str(value)


def _number(text: str, words: dict[str, float]) -> float:
    if not text:
        raise ScpiError(-109)
    if text.upper() in words:
        return words[text.upper()]
    if re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", text) is None:
        raise ScpiError(-148)
    return float(text)


def _switch(text: str) -> bool:
    states = {"0": False, "OFF": False, "1": True, "ON": True}
    if text.upper() not in states:
        raise ScpiError(-109 if not text else -224)
    return states[text.upper()]
