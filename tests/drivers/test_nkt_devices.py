"""Conversations with the NKT laser and filters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from scripted_peer import Late, Peer, Step, unhex

from drivers import transport
from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceFault
from drivers.interfaces import LightSource, WavelengthSelector
from drivers.lines import SerialLineForm
from drivers.nkt_interbus import Kind, Telegram, build
from drivers.nkt_selectors import NktSelect, NktVaria, SelectForm, VariaForm
from drivers.nkt_superk import NktSuperK, SuperKForm, interlock_words
from drivers.transport import Line

Converse = Callable[..., Peer]
CLOCK = Clock(speed=50.0)


class Bus:
    """Writes the script of a module, whose host counts its source address up with every telegram."""

    def __init__(self, address: int) -> None:
        self.address, self._source = address, 0xA1

    def ask(self, kind: Kind, register: int, data: bytes, answer: Kind | None, content: bytes = b"") -> Step:
        self._source += 1
        request = build(Telegram(self.address, self._source, kind, register, data))
        if answer is None:
            return request, None
        return request, build(Telegram(self._source, self.address, answer, register, content))

    def read(self, register: int, value: int, size: int = 2) -> Step:
        return self.ask(Kind.READ, register, b"", Kind.DATAGRAM, value.to_bytes(size, "little"))

    def write(self, register: int, value: int, size: int) -> Step:
        return self.ask(Kind.WRITE, register, value.to_bytes(size, "little"), Kind.ACK)


@contextmanager
def line_to(peer: Peer, timeout: float = 0.8) -> Iterator[Line]:
    line = SerialLineForm(kind="serial", port=peer.port, baudrate=115200, timeout=timeout).open("laser")
    assert isinstance(line, Line)
    yield line
    line.close()


def laser(line: Line, **options: object) -> NktSuperK:
    return NktSuperK("source", line, SuperKForm.model_validate(options), CLOCK)


def test_they_satisfy_their_roles(converse: Converse) -> None:
    with line_to(converse()) as line:
        assert isinstance(laser(line), LightSource)
        assert isinstance(NktSelect("selector", line, SelectForm(address=18), CLOCK), WavelengthSelector)
        assert isinstance(NktVaria("selector", line, VariaForm(), CLOCK), WavelengthSelector)


def test_status_frames_of_the_protocol_description(converse: Converse) -> None:
    peer = converse((unhex("0D 0F A2 04 66 C7 B6 0A"), unhex("0D A2 0F 08 66 01 00 90 A8 0A")))
    with line_to(peer) as line:
        assert laser(line).emission()


def test_emission_arms_the_watchdog_first_and_waits_for_the_status(converse: Converse) -> None:
    bus = Bus(15)
    peer = converse(
        bus.read(0x32, 2), bus.write(0x36, 10, 1), bus.write(0x30, 3, 1), bus.read(0x66, 0), bus.read(0x66, 1)
    )
    with line_to(peer) as line:
        laser(line, watchdog=10).set_emission(True)


def test_emission_off_asks_for_no_interlock(converse: Converse) -> None:
    bus = Bus(15)
    with line_to(converse(bus.write(0x30, 0, 1), bus.read(0x66, 0))) as line:
        laser(line).set_emission(False)


def test_an_open_interlock_keeps_the_emission_off(converse: Converse) -> None:
    peer = converse(Bus(15).read(0x32, 0x0200))
    with line_to(peer) as line, pytest.raises(DeviceFault, match="source: interlock open: door"):
        laser(line, reset_interlock=True).set_emission(True)


def test_a_waiting_interlock_is_reset_only_where_that_is_allowed(converse: Converse) -> None:
    bus = Bus(15)
    peer = converse(bus.read(0x32, 0x0001))
    with line_to(peer) as line, pytest.raises(DeviceFault, match="closed, waiting for reset"):
        laser(line).set_emission(True)
    bus = Bus(15)
    peer = converse(
        bus.read(0x32, 1), bus.write(0x32, 1, 2), bus.read(0x32, 2), bus.write(0x36, 10, 1), bus.write(0x30, 3, 1),
        bus.read(0x66, 1),
    )  # fmt: skip
    with line_to(peer) as line:
        laser(line, reset_interlock=True).set_emission(True)


def test_emission_that_does_not_come_is_a_fault(converse: Converse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.nkt_superk.EMISSION_DEADLINE", -1.0)
    bus = Bus(15)
    peer = converse(
        bus.read(0x32, 2), bus.write(0x36, 10, 1), bus.write(0x30, 3, 1), bus.read(0x66, 0), bus.read(0x66, 1 << 6),
        bus.read(0x32, 2),
    )  # fmt: skip
    with line_to(peer) as line, pytest.raises(DeviceFault, match="emission did not go on: temperature out of range"):
        laser(line).set_emission(True)


@pytest.mark.parametrize(
    ("register", "words"),
    [
        (0x0002, ""),
        (0x0000, "interlock open: no cause given"),
        (0x0100, "interlock open: key switch or front panel"),
        (0x0301, "interlock closed, waiting for reset: external module"),
        (0xFF00, "interlock open: failure of the interlock circuit"),
        (0x0709, "interlock in unknown state 9: disabled by the source"),
    ],
)
def test_interlock_words(register: int, words: str) -> None:
    assert interlock_words(register) == words


def test_faults_are_told_in_words(converse: Converse) -> None:
    bus = Bus(15)
    with line_to(converse(bus.read(0x66, 1 << 3 | 1 << 5), bus.read(0x32, 0x0200))) as line:
        assert laser(line).fault() == "interlock open: door; interlock loop open; supply voltage low"


def test_an_error_of_the_laser_is_told_with_its_code(converse: Converse) -> None:
    bus = Bus(15)
    with line_to(converse(bus.read(0x66, 1 << 15), bus.read(0x67, 42, 1), bus.read(0x32, 2))) as line:
        assert laser(line).fault() == "system error; error code 42: see the manual of the laser"


def test_power_is_set_in_constant_power_mode_and_read_back(converse: Converse) -> None:
    bus = Bus(15)
    peer = converse(
        bus.read(0x31, 0), bus.read(0x61, 0x60, 1), bus.write(0x31, 1, 2), bus.write(0x37, 600, 2), bus.read(0x37, 600)
    )
    with line_to(peer) as line:
        laser(line).set_power(0.6)


def test_the_mode_of_type_88_is_one_byte(converse: Converse) -> None:
    bus = Bus(15)
    peer = converse(
        bus.read(0x31, 0, 1), bus.read(0x61, 0x88, 1), bus.write(0x31, 1, 1), bus.write(0x37, 5, 2), bus.read(0x37, 5)
    )
    with line_to(peer) as line:
        laser(line).set_power(0.005)


@pytest.mark.parametrize("fraction", [-0.01, 1.01, float("nan")])
def test_a_power_outside_its_range_is_refused(converse: Converse, fraction: float) -> None:
    with line_to(converse()) as line, pytest.raises(CommandRefused, match="outside 0 to 1"):
        laser(line).set_power(fraction)


def test_another_module_at_the_address_is_told(converse: Converse) -> None:
    peer = converse(Bus(15).read(0x61, 0x68, 1))
    with line_to(peer) as line, pytest.raises(CommandRefused, match=r"module 15 is of type 68h \(SuperK VARIA\)"):
        laser(line).identify()


@pytest.mark.parametrize("answer", [Kind.CRC_ERROR, Kind.BUSY])
def test_a_telegram_that_was_garbled_or_came_too_early_is_sent_again(converse: Converse, answer: Kind) -> None:
    bus = Bus(15)
    with line_to(converse(bus.ask(Kind.READ, 0x66, b"", answer), bus.read(0x66, 1))) as line:
        assert laser(line).emission()


def test_a_lost_and_a_garbled_reply_are_asked_for_again(converse: Converse) -> None:
    bus = Bus(15)
    lost = bus.ask(Kind.READ, 0x66, b"", None)
    request, reply = bus.read(0x66, 1)
    assert isinstance(reply, bytes)
    garbled = (request, reply[:4] + b"\xff" + reply[5:])
    with line_to(converse(lost, garbled, bus.read(0x66, 1)), timeout=0.15) as line:
        assert laser(line).emission()


def test_a_late_reply_is_exposed_by_its_old_source_address(converse: Converse) -> None:
    bus = Bus(15)
    request, stale = bus.read(0x66, 1)
    assert isinstance(stale, bytes)
    again, fresh = bus.read(0x66, 0)
    assert isinstance(fresh, bytes)
    # The stale reply comes after the line fell silent, in front of the fresh one.
    peer = converse((request, None), (again, stale + fresh))
    with line_to(peer, timeout=0.15) as line:
        assert not laser(line).emission()


def test_a_reply_just_past_its_deadline_is_waited_out(converse: Converse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "QUIET", 1.5)  # longer than a busy machine is late
    bus = Bus(15)
    request, late = bus.read(0x66, 1)
    assert isinstance(late, bytes)
    with line_to(converse((request, Late(0.35, late)), bus.read(0x66, 0)), timeout=0.15) as line:
        assert not laser(line).emission()


def test_a_register_that_is_refused_is_not_asked_for_again(converse: Converse) -> None:
    peer = converse(Bus(15).ask(Kind.READ, 0x66, b"", Kind.NACK))
    with line_to(peer) as line, pytest.raises(CommandRefused, match="module 15 refuses register 66h"):
        laser(line).emission()


def test_silence_names_device_and_line(converse: Converse) -> None:
    bus = Bus(15)
    peer = converse(*[bus.ask(Kind.READ, 0x66, b"", None) for _ in range(4)])
    with line_to(peer, timeout=0.12) as line, pytest.raises(CommunicationError, match=r"source: no reply .* 'laser'"):
        laser(line).keep_alive()


def test_making_safe_switches_off_and_tries_again(converse: Converse) -> None:
    bus = Bus(15)
    silent = [bus.ask(Kind.WRITE, 0x30, b"\x00", None) for _ in range(4)]
    with line_to(converse(*silent, bus.write(0x30, 0, 1), bus.read(0x66, 0)), timeout=0.12) as line:
        laser(line).make_safe()


def test_the_select_tunes_its_channel_and_reads_back(converse: Converse) -> None:
    bus = Bus(0x12)
    limits = [bus.read(0x34, 400_000, 4), bus.read(0x35, 1_700_000, 4)]
    tune = [bus.write(0x93, 500_000, 4), bus.write(0xB3, 800, 2), bus.write(0x30, 1, 1), bus.read(0x93, 500_000, 4)]
    with line_to(converse(*limits, *tune, bus.read(0x93, 500_000, 4), bus.write(0x30, 0, 1))) as line:
        select = NktSelect("selector", line, SelectForm(address=0x12, channel=3, amplitude=0.8), CLOCK)
        select.set_wavelength(500.0)
        assert select.wavelength() == 500.0
        with pytest.raises(CommandRefused, match="1800 nm is outside 400 to 1700 nm"):
            select.set_wavelength(1800.0)
        select.make_safe()


def test_the_interlock_of_the_select_is_watched_and_told_in_words(converse: Converse) -> None:
    driver, status = Bus(0x12), Bus(0x10)
    limits = [driver.read(0x34, 400_000, 4), driver.read(0x35, 1_700_000, 4)]
    tune = [driver.write(0x90, 500_000, 4), driver.write(0xB0, 1000, 2), driver.write(0x30, 1, 1)]
    tune.append(driver.read(0x90, 500_000, 4))
    with line_to(converse(*limits, *tune, status.read(0x66, 1 << 1), status.read(0x66, 1 << 8))) as line:
        select = NktSelect("selector", line, SelectForm(address=0x12, select_address=0x10), CLOCK)
        assert select.wavelength_range() == (400.0, 1700.0)
        with pytest.raises(DeviceFault, match="interlock of the filter open"):
            select.set_wavelength(500.0)
        assert select.fault() == ""


def test_the_select_wavelength_frame_of_the_protocol_description(converse: Converse) -> None:
    bus = Bus(0x12)
    bus._source = 0xA1
    assert bus.write(0x90, 500_000, 4)[0] == unhex("0D 12 A2 05 90 20 A1 07 00 56 00 0A")


@pytest.mark.parametrize(
    ("present", "order"), [(4550, ((0x33, 5050), (0x34, 4950))), (6000, ((0x34, 4950), (0x33, 5050)))]
)
def test_the_varia_moves_its_outer_edge_first_and_waits(
    converse: Converse, present: int, order: tuple[tuple[int, int], ...]
) -> None:
    bus = Bus(0x10)
    peer = converse(
        bus.read(0x33, present), *[bus.write(register, value, 2) for register, value in order],
        bus.read(0x66, 1 << 12), bus.read(0x66, 0), bus.read(0x33, 5050), bus.read(0x34, 4950),
        bus.read(0x33, 5050), bus.read(0x34, 4950),
    )  # fmt: skip
    with line_to(peer) as line:
        varia = NktVaria("selector", line, VariaForm(address=0x10, bandwidth=10.0), CLOCK)
        varia.set_wavelength(500.0)
        assert varia.wavelength() == 500.0


def test_varia_filters_that_do_not_stop_are_a_fault(converse: Converse) -> None:
    bus = Bus(0x10)
    move = [bus.read(0x33, 5050), bus.write(0x33, 5050, 2), bus.write(0x34, 4950, 2)]
    peer = converse(*move, bus.read(0x66, 1 << 13))
    with line_to(peer) as line, pytest.raises(DeviceFault, match="filters still move"):
        NktVaria("selector", line, VariaForm(move_timeout=1e-9), CLOCK).set_wavelength(500.0)
