"""The multimeter over its socket: commands, errors, bursts, triggers, overload."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from sim_fixtures.devices.keysight_34465a import headers, short_form
from sim_fixtures.room import Room


class Meter:
    """A socket to the instrument."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=5.0)
        self._file = self.socket.makefile("rb")

    def send(self, *lines: str) -> None:
        for line in lines:
            self.socket.sendall(line.encode("ascii") + b"\n")

    def ask(self, line: str) -> str:
        self.send(line)
        return self._file.readline().decode("ascii").rstrip("\n")

    def numbers(self, line: str) -> list[float]:
        return [float(text) for text in self.ask(line).split(",")]

    def error(self) -> int:
        return int(self.ask("SYST:ERR?").split(",")[0])

    def close(self) -> None:
        self._file.close()
        self.socket.close()


@pytest.fixture
def meter(room: Room) -> Iterator[Meter]:
    meter = Meter(room.endpoints.meter)
    yield meter
    meter.close()


@pytest.fixture
def lit(meter: Meter, room: Room) -> Meter:
    """One volt of light at the input."""
    bench = room.bench
    with bench.lock:
        bench.source.reset_interlock()
        bench.source.power = 0.6
        bench.source.switch(True)
        bench.selector.rf_on, bench.selector.amplitudes[0] = True, 1.0
        bench.shutter.command(True)
        bench.amplifier.select(11)
    time.sleep(0.01)
    meter.send("CONF:VOLT:DC 10", "SENS:VOLT:DC:NPLC 1", "SENS:VOLT:DC:ZERO:AUTO 0")
    return meter


def test_identity_has_four_fields(meter):
    maker, model, *_ = fields = meter.ask("*IDN?").split(",")
    assert (maker, model, len(fields)) == ("Keysight Technologies", "34465A", 4)


def test_no_error_reads_as_the_guide_says(meter):
    assert meter.ask("SYST:ERR?") == '+0,"No error"'


def test_errors_queue_first_in_first_out_and_clear(meter):
    meter.send("NONSENSE", "SAMP:COUN 0", "SENS:VOLT:RANG 5000", "TRIG:SOUR MOON", "SAMP:COUN")
    assert [meter.error() for _ in range(6)] == [-113, -222, -222, -224, -109, 0]
    meter.send("NONSENSE", "*CLS")
    assert meter.error() == 0


def test_a_full_queue_says_so(meter):
    meter.send(*["NONSENSE"] * 25)
    codes = [meter.error() for _ in range(21)]
    assert codes == [-113] * 19 + [-350, 0]


def test_nine_samples_come_as_nine_numbers(lit):
    lit.send("SAMP:COUN 9")
    volts = lit.numbers("READ?")
    assert len(volts) == 9
    assert np.mean(volts) == pytest.approx(0.99 * np.cos(np.deg2rad(12.0)) / np.cos(np.deg2rad(15.0)), rel=2e-3)
    assert lit.error() == 0


@pytest.mark.parametrize(("autozero", "expected"), [(0, 9 * 0.2), (1, 9 * 0.4)])
def test_a_burst_takes_its_integration_time(lit, room, autozero, expected):
    lit.send("SENS:VOLT:DC:NPLC 10", f"SENS:VOLT:DC:ZERO:AUTO {autozero}", "SAMP:COUN 9")
    begin = room.bench.clock.now()
    lit.numbers("READ?")
    elapsed = room.bench.clock.now() - begin
    assert expected <= elapsed < expected + 0.15 * room.bench.clock.speed


def test_bus_trigger_holds_the_burst_until_it_comes(lit, room):
    lit.send("TRIG:SOUR BUS", "SAMP:COUN 3", "INIT")
    time.sleep(0.05)
    assert room.bench.readings == 0
    assert lit.error() == 0
    lit.send("*TRG")
    assert len(lit.numbers("FETC?")) == 3
    assert len(lit.numbers("FETC?")) == 3  # the same readings again
    lit.send("*TRG")
    assert lit.error() == -211


def test_fetch_without_readings_and_a_second_init_are_errors(lit):
    lit.send("FETC?")
    assert lit.error() == -230
    lit.send("TRIG:SOUR BUS", "INIT", "INIT")
    assert lit.error() == -213
    lit.send("ABOR", "INIT")
    assert lit.error() == 0
    lit.send("ABOR", "READ?")
    assert lit.error() == -211


def test_above_the_range_the_reading_is_overload_and_no_error(lit):
    lit.send("SENS:VOLT:DC:RANG 0.1", "SAMP:COUN 2")
    assert lit.numbers("READ?") == [9.9e37, 9.9e37]
    assert lit.error() == 0
    assert lit.ask("STAT:QUES?") == "1"
    assert lit.ask("STAT:QUES:EVEN?") == "0"


def test_configure_resets_what_reset_resets(lit):
    lit.send("SAMP:COUN 9", "TRIG:SOUR BUS", "CONF:VOLT:DC")
    assert (lit.ask("SAMP:COUN?"), lit.ask("TRIG:SOUR?")) == ("+1", "IMM")
    assert float(lit.ask("SENS:VOLT:DC:NPLC?")) == 10.0


@pytest.mark.parametrize(("asked", "set_to"), [("0.1", 0.1), ("0.11", 0.1), ("0.13", 1.0), ("MAX", 1000.0)])
def test_a_range_is_the_smallest_that_holds_the_value(meter, asked, set_to):
    meter.send(f"SENS:VOLT:DC:RANG {asked}")
    assert float(meter.ask("SENS:VOLT:DC:RANG?")) == set_to
    assert meter.ask("SENS:VOLT:DC:RANG:AUTO?") == "0"


def test_commands_of_a_line_share_their_node(meter):
    assert meter.ask("SENS:VOLT:DC:RANG 10;NPLC 1;:SAMP:COUN 4;*OPC?;COUN?") == "1;+4"
    meter.send("SENS:VOLT:DC:NPLC 1;SAMP:COUN 4")
    assert meter.error() == -113


@pytest.mark.parametrize(
    ("header", "short"),
    [
        ("SENSe:VOLTage:DC:NPLCycles", "VOLT:NPLC"),
        (":sens:volt:rang:auto", "VOLT:RANG:AUTO"),
        ("SYSTem:ERRor:NEXT", "SYST:ERR"),
        ("INITiate:IMMediate", "INIT"),
    ],
)
def test_long_and_short_headers_are_the_same(header, short):
    assert short_form(header) == short
    assert list(headers(f"{header} 1")) == [(short, "1")]


def test_a_late_reply_stays_for_the_next_question(meter, room):
    room.control("late_reply", device="detector", delay=0.2)
    meter.send("*IDN?")
    assert meter.ask("SYST:ERR?").startswith("+0")
    assert meter._file.readline().startswith(b"Keysight")


def test_a_broken_connection_can_be_made_anew(meter, room):
    assert meter.ask("*IDN?")  # until it is served, a connection is none that could be broken
    room.control("disconnect", device="meter")
    with contextlib.suppress(ConnectionError):  # end of file or reset, as the system sees it
        assert meter.ask("*IDN?") == ""
    again = Meter(room.endpoints.meter)
    assert again.ask("*IDN?").startswith("Keysight")
    again.close()


def test_a_second_client_waits_for_the_burst_of_the_first(lit, room):
    lit.send("SENS:VOLT:DC:NPLC 100", "SAMP:COUN 9")
    reader = threading.Thread(target=lit.ask, args=("READ?",))
    reader.start()
    time.sleep(0.02)
    other = Meter(room.endpoints.meter)
    assert other.ask("SYST:ERR?").startswith("+0")
    reader.join(5.0)
    assert room.bench.readings == 9
    other.close()


def test_settings_that_frameworks_make_are_kept_and_reset(meter):
    kept = {"SAMPle:SOURce": "TIM", "TRIGger:SLOPe": "POS", "DISPlay:STATe": "0", "SENSe:VOLTage:APERture:ENABled": "1"}
    for header, value in kept.items():
        meter.send(f"{header} {value}")
        assert meter.ask(f"{header}?") == value
    meter.send("SAMPle:TIMer 0.5", "TRIGger:DELay 0.1", 'DISPlay:TEXT "goniotwin"')
    assert meter.numbers("SAMPle:TIMer?") == [0.5]
    assert meter.ask("TRIGger:DELay:AUTO?") == "0"
    assert meter.ask("DISPlay:TEXT?") == '"goniotwin"'
    assert meter.numbers("SAMPle:TIMer? MAX") == [3600.0]
    assert meter.ask("SYSTem:LFRequency?") == "+50"
    meter.send("*RST")
    assert meter.ask("SAMP:SOUR?") == "IMM"
    assert meter.ask("TRIG:DEL:AUTO?") == "1"
    assert meter.error() == 0


@pytest.mark.parametrize(
    ("command", "error"), [("SAMP:SOUR", -109), ("SAMP:SOUR X", -224), ("SAMP:TIM 4000", -222), ("TRIG:LEV x", -148)]
)
def test_settings_that_make_no_sense_are_refused(meter, command, error):
    meter.send(command)
    assert meter.error() == error
