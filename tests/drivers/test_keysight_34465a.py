"""Conversations with a Keysight 34465A over a TCP socket."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import pyvisa
from pydantic import ValidationError

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.interfaces import Detector
from drivers.keysight_34465a import Keysight34465A, Keysight34465AForm
from drivers.lines import VisaLineForm
from drivers.sharing import SharedLine
from drivers.visa_line import VisaLine

IDENTITY = "Keysight Technologies,34465A,MY54500001,A.02.14"
NO_ERROR = '+0,"No error"'
SETTINGS = [
    "ABOR", "*CLS", "CONF:VOLT:DC", "SENS:VOLT:DC:RANG 10", "SENS:VOLT:NPLC 1", "SENS:VOLT:ZERO:AUTO 1",
    "TRIG:SOUR IMM", "TRIG:COUN 1",
]  # fmt: skip
NINE = ",".join(f"+{value}.00000000E-01" for value in range(1, 10))

#: Answer to a query: text, None for silence, seconds and text for a late one.
Answer = str | None | tuple[float, str]
HANG_UP = "hang up"


class Meter:
    """Answers queries in order, over any number of connections; remembers every command by connection."""

    def __init__(self, *answers: Answer) -> None:
        self._answers = list(answers)
        self.heard: list[list[str]] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.resource = f"TCPIP0::127.0.0.1::{self._server.getsockname()[1]}::SOCKET"
        self._timers: list[threading.Timer] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        if self._server.fileno() < 0:
            return
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._thread.join(2.0)
        for timer in self._timers:
            timer.join()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self.heard.append([])
            with connection, connection.makefile("rb") as lines:
                for line in lines:
                    self.heard[-1].append(line.decode().strip())
                    if self.heard[-1][-1].endswith("?") and self._answer(connection) == HANG_UP:
                        break

    def _answer(self, connection: socket.socket) -> Answer:
        answer = self._answers.pop(0) if self._answers else None
        if isinstance(answer, tuple):
            self._timers.append(threading.Timer(answer[0], self._send, (connection, answer[1])))
            self._timers[-1].start()
        elif answer is not None and answer != HANG_UP:
            self._send(connection, answer)
        return answer

    @staticmethod
    def _send(connection: socket.socket, text: str) -> None:
        try:
            connection.sendall(text.encode("latin-1") + b"\n")
        except OSError:
            return  # a late answer on a connection that was given up


@pytest.fixture
def meet() -> Iterator[Callable[..., tuple[Keysight34465A, Meter]]]:
    """Make meters and their drivers."""
    made: list[tuple[Keysight34465A, Meter]] = []

    def make(*answers: Answer, timeout: float = 0.3, **options: Any) -> tuple[Keysight34465A, Meter]:
        meter = Meter(*answers)
        line = VisaLine("meter", VisaLineForm(kind="visa", resource=meter.resource, timeout=timeout))
        form = Keysight34465AForm.model_validate({"nplc": 1} | options)
        made.append((Keysight34465A("detector", line, form, Clock(speed=100.0)), meter))
        return made[-1]

    yield make
    for driver, meter in made:
        driver.close()
        driver.close()
        meter.close()


Meet = Callable[..., tuple[Keysight34465A, Meter]]


def test_it_is_a_detector_and_configures_the_meter(meet: Meet) -> None:
    driver, meter = meet(IDENTITY, NO_ERROR)
    assert isinstance(driver, Detector)
    assert driver.identify() == IDENTITY
    assert meter.heard == [["*IDN?", *SETTINGS, "SYST:ERR?"]]


def test_nine_readings_come_in_one_burst(meet: Meet) -> None:
    driver, meter = meet(IDENTITY, NO_ERROR, NINE, NINE)
    driver.identify()
    reading = driver.read(9)
    assert reading.samples == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
    assert not reading.overload
    driver.read(9)
    assert meter.heard[0][10:] == ["SAMP:COUN 9", "READ?", "READ?"]


@pytest.mark.parametrize("value", ["+9.90000000E+37", "-9.90000000E+37"])
def test_an_overload_is_recognised_by_its_value(meet: Meet, value: str) -> None:
    driver, _ = meet(NO_ERROR, f"+1.0E+00,{value}")
    assert driver.read(2).overload


def test_another_instrument_is_told(meet: Meet) -> None:
    driver, _ = meet("HEWLETT-PACKARD,34401A,0,11-5-2")
    with pytest.raises(CommandRefused, match=r"detector: 'HEWLETT-PACKARD,34401A,0,11-5-2' answered, expected one of"):
        driver.identify()


def test_refused_settings_are_quoted_and_the_queue_is_emptied(meet: Meet) -> None:
    errors = ['-222,"Data out of range"', '-113,"Undefined header"']
    driver, meter = meet(IDENTITY, *errors, NO_ERROR)
    with pytest.raises(DeviceFault, match='-222,"Data out of range"; -113,"Undefined header"'):
        driver.identify()
    assert meter.heard[0].count("SYST:ERR?") == 3


@pytest.mark.parametrize("reply", ["ERROR", "", '"No error"', "9.9E37"])
def test_what_is_no_entry_of_the_error_queue_is_told(meet: Meet, reply: str) -> None:
    driver, meter = meet(IDENTITY, reply)
    with pytest.raises(CommunicationError, match=r"SYST:ERR\? gave .*, expected a number and a text"):
        driver.identify()
    assert meter.heard[0].count("SYST:ERR?") == 1


def test_a_late_burst_dies_with_its_connection_and_another_one_is_taken(meet: Meet) -> None:
    driver, meter = meet(NO_ERROR, (0.6, "+9.0E+00"), NO_ERROR, "+1.5E+00")
    assert driver.read(1).samples == (1.5,)
    assert len(meter.heard) == 2
    assert meter.heard[1][:8] == SETTINGS


def test_two_bursts_lost_in_a_row_are_an_error(meet: Meet) -> None:
    driver, _ = meet(NO_ERROR, None, NO_ERROR, None)
    with pytest.raises(CommunicationError, match=r"detector: no reply to 'READ\?' on line 'meter' within"):
        driver.read(1)


@pytest.mark.parametrize("garbled", ["+1.0E+00,+2.0", "+1.0E+00,+2.0E+00,x", "\xff\xfe"])
def test_a_torn_burst_is_never_taken(meet: Meet, garbled: str) -> None:
    driver, _ = meet(NO_ERROR, garbled, NO_ERROR, "+1.0E+00,+2.0E+00,+3.0E+00")
    assert driver.read(3).samples == (1.0, 2.0, 3.0)


def test_a_connection_that_the_meter_closed_is_made_anew(meet: Meet) -> None:
    driver, meter = meet(NO_ERROR, HANG_UP, NO_ERROR, "+1.5E+00")
    assert driver.read(1).samples == (1.5,)
    assert len(meter.heard) == 2


def test_a_meter_that_nobody_serves_is_an_error(meet: Meet) -> None:
    driver, meter = meet(NO_ERROR, "+1.5E+00")
    driver.read(1)
    driver._line.reset()
    meter.close()
    with pytest.raises(CommunicationError, match="failed on line 'meter'"):
        driver.read(1)


def test_the_deadline_of_a_burst_follows_integration_time_and_clock(meet: Meet) -> None:
    driver, _ = meet(nplc=10, line_frequency=50, auto_zero=True)
    assert driver.burst_time(9) == pytest.approx(3.6)
    driver, _ = meet(nplc=0.2, line_frequency=60, auto_zero=False)
    assert driver.burst_time(9) == pytest.approx(0.03)


def test_no_readings_at_all_are_refused(meet: Meet) -> None:
    driver, _ = meet()
    with pytest.raises(CommandRefused, match="at least 1"):
        driver.read(0)


@pytest.mark.parametrize("options", [{"range": 5.0}, {"nplc": 3}, {"speed": 1}])
def test_options_that_the_meter_does_not_have_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(options))):
        Keysight34465AForm.model_validate(options)


def test_a_resource_that_cannot_be_cleared_is_opened_anew() -> None:
    """USB and GPIB resources have a device clear, which fails with the cable."""

    class Deaf:
        closed = False

        def clear(self) -> None:
            raise pyvisa.errors.VisaIOError(pyvisa.constants.StatusCode.error_connection_lost)

        def close(self) -> None:
            self.closed = True

    line = VisaLine.__new__(VisaLine)
    SharedLine.__init__(line, "meter")
    line._form = VisaLineForm(kind="visa", resource="USB0::0x2A8D::0x0101::MY1::INSTR")
    deaf = line._resource = Deaf()
    line.reset()
    assert deaf.closed
    assert line._resource is None


def test_a_reply_that_comes_too_late_is_not_taken_for_the_next_one() -> None:
    meter = Meter((0.5, "late"), (0.6, "right"))
    line = VisaLine("meter", VisaLineForm(kind="visa", resource=meter.resource, timeout=0.2))
    with pytest.raises(CommunicationError, match="no reply"):
        line.query("detector", "FIRST?")
    assert line.query("detector", "SECOND?", 2.0) == "right"
    line.close()
    meter.close()
