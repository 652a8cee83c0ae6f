"""AZ drive and I/O module: frames of the protocol in raw bytes, and pymodbus's own client."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import serial
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusIOException

from sim_fixtures.room import Room

ABSOLUTE_8500 = (
    "01 10 00 58 00 10 20 00 00 00 00 00 00 00 01 00 00 21 34 00 00 07 D0 00 00 05 DC 00 00 05 DC"
    " 00 00 03 E8 00 00 00 01 E3 43"
)


class Bus:
    """Raw bytes on the line."""

    def __init__(self, path: str) -> None:
        self.serial = serial.Serial(path, 115200, timeout=1.0)

    def ask(self, frame: str, size: int, timeout: float = 1.0) -> str:
        self.serial.timeout = timeout
        self.serial.write(bytes.fromhex(frame))
        return self.serial.read(size).hex(" ").upper()


@pytest.fixture
def bus(room: Room) -> Iterator[Bus]:
    bus = Bus(str(room.endpoints.ports["illumination-arm"]))
    yield bus
    bus.serial.close()


class Az:
    """The drive through pymodbus."""

    def __init__(self, client: ModbusSerialClient) -> None:
        self.client = client

    def word(self, address: int) -> int:
        reply = self.client.read_holding_registers(address, count=1, device_id=1)
        assert not reply.isError(), reply
        return reply.registers[0]

    def long(self, address: int) -> int:
        high, low = self.client.read_holding_registers(address, count=2, device_id=1).registers
        value = high << 16 | low
        return value - (1 << 32) if value & 0x80000000 else value

    def press(self, bits: int) -> None:
        for value in (bits, 0):
            assert not self.client.write_register(0x7D, value, device_id=1).isError()

    def write_long(self, address: int, value: int) -> None:
        value &= 0xFFFFFFFF
        assert not self.client.write_registers(address, [value >> 16, value & 0xFFFF], device_id=1).isError()

    def direct(self, position: int, kind: int = 1, speed: int = 2000, rate: int = 1000, trigger: int = 1):
        fields = (0, kind, position & 0xFFFFFFFF, speed, rate, rate, 1000, trigger)
        words = [word for field in fields for word in (field >> 16 & 0xFFFF, field & 0xFFFF)]
        return self.client.write_registers(0x58, words, device_id=1)

    def wait(self) -> None:
        deadline = time.monotonic() + 5.0
        while self.word(0x7F) & 0x2000:
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def home(self) -> None:
        self.press(0x0010)
        self.wait()


@pytest.fixture
def az(room: Room) -> Iterator[Az]:
    client = ModbusSerialClient(str(room.endpoints.ports["illumination-arm"]), baudrate=115200, timeout=0.4, retries=0)
    assert client.connect()
    yield Az(client)
    client.close()


def test_frames_of_the_protocol(bus, room):
    assert bus.ask("01 08 00 00 12 34 ED 7C", 8) == "01 08 00 00 12 34 ED 7C"
    assert bus.ask("01 06 00 7D 00 10 18 1E", 8) == "01 06 00 7D 00 10 18 1E"  # ZHOME on
    time.sleep(0.1)  # 20 s of the laboratory
    assert bus.ask(ABSOLUTE_8500, 8) == "01 10 00 58 00 10 40 16"
    assert bus.ask("01 03 00 7F 00 01 B5 D2", 7)[:8] == "01 03 02"
    time.sleep(0.1)
    assert bus.ask("01 03 00 CC 00 02 04 34", 9) == "01 03 04 00 00 21 34 E3 B4"
    assert room.bench.axes["illumination_zenith"].position() == 85.0


def test_feedback_below_zero_has_the_frame_of_the_protocol(bus, az):
    az.home()
    az.direct(-10)
    az.wait()
    az.client.close()
    assert bus.ask("01 03 00 CC 00 02 04 34", 9) == "01 03 04 FF FF FF F6 3B A1"


def test_a_slave_that_is_not_there_stays_silent(az):
    with pytest.raises(ModbusIOException, match="No response"):
        az.client.read_holding_registers(0xCC, count=2, device_id=7)
    assert az.long(0xCC) == 0


def test_a_frame_with_a_wrong_checksum_stays_unanswered(bus):
    assert bus.ask("01 03 00 CC 00 02 04 35", 9, timeout=0.15) == ""
    assert bus.ask("01 03 00 CC 00 02 04 34", 9) == "01 03 04 00 00 00 00 FA 33"


def test_a_broadcast_is_obeyed_and_not_answered(az, room):
    az.client.write_register(0x7D, 0x0010, device_id=0, no_response_expected=True)
    time.sleep(0.1)
    assert room.bench.axes["illumination_zenith"].homed


def test_registers_that_do_not_exist_are_an_exception(az):
    reply = az.client.read_holding_registers(0x0F00, count=1, device_id=1)
    assert reply.isError()
    assert reply.exception_code == 2


def test_an_absolute_move_needs_a_coordinate_system(az):
    assert not az.direct(1000).isError()
    assert az.long(0x80) == 0x70
    assert az.word(0x7F) & 0x0080
    az.press(0x0080)
    assert az.long(0x80) == 0


def test_homing_sets_home_end_and_absolute_position_enabled(az):
    assert az.word(0x178) & 0b11 == 0
    az.press(0x0010)
    assert az.word(0x7F) & 0x2000
    az.wait()
    assert az.word(0x7F) & 0x4030 == 0x4030
    assert az.word(0x178) & 0b11 == 0b11


def test_status_of_a_move_and_its_end(az):
    az.home()
    az.direct(4000)
    status = az.word(0x7F)
    assert status & 0x2000
    assert not status & 0x4020
    assert az.word(0x179) & 0x40
    assert az.long(0xC6) == 4000
    az.wait()
    assert az.word(0x7F) & 0x4020 == 0x4020
    assert az.long(0xCC) == 4000
    az.direct(-500, kind=2)
    az.wait()
    assert az.long(0xCC) == 3500


def test_a_move_takes_the_time_of_its_trapezoid(az, room):
    az.home()
    clock = room.bench.clock
    begin = clock.now()
    az.direct(4000, speed=1000, rate=500)  # 40 degrees: 2 s up, 2 s of cruise, 2 s down
    az.wait()
    elapsed = clock.now() - begin
    assert elapsed >= 6.0
    assert elapsed < 6.0 + 0.2 * clock.speed


def test_stop_brakes_and_a_trigger_of_zero_starts_nothing(az):
    az.home()
    az.direct(8000)
    az.press(0x0020)
    az.wait()
    position = az.long(0xCC)
    assert 0 < position < 8000
    az.direct(0, trigger=0)
    assert not az.word(0x7F) & 0x2000
    assert az.long(0xCC) == position


def test_stored_operation_data_runs_on_start(az):
    az.home()
    for offset, value in enumerate((1, 1200, 2000, 1000, 1000)):
        az.write_long(0x1800 + 2 * offset, value)
    az.press(0x0008)
    az.wait()
    assert az.long(0xCC) == 1200


def test_start_needs_the_edge(az):
    az.home()
    for offset, value in enumerate((2, 100, 2000, 1000, 1000)):  # 100 steps further, relative to the command
        az.write_long(0x1800 + 2 * offset, value)
    for word, position in ((0x0008, 100), (0x0008, 100), (0x0000, 100), (0x0008, 200)):
        assert not az.client.write_register(0x7D, word, device_id=1).isError()
        az.wait()
        assert az.long(0xCC) == position


def test_soft_limits_raise_their_alarm_and_nothing_moves(az):
    az.home()
    for address, value in ((0x386, 1), (0x388, 3000), (0x38A, -3000)):
        az.write_long(address, value)
    az.direct(3001)
    assert az.long(0x80) == 0x67
    assert az.long(0xCC) == 0
    az.write_long(0x180, 0)
    az.write_long(0x180, 1)
    assert az.long(0x80) == 0
    az.direct(-3000)
    az.wait()
    assert az.long(0xCC) == -3000


def test_data_out_of_range_are_an_exception_and_nothing_moves(az, room):
    az.home()
    reply = az.direct(1000, speed=0)
    assert reply.isError()
    assert (reply.function_code, reply.exception_code) == (0x90, 3)
    assert not az.word(0x7F) & 0x2000
    assert room.bench.motion_commands["illumination_zenith"] == 1


def test_an_alarm_stops_the_motor_and_commands_are_ignored_silently(az, room):
    az.home()
    az.direct(8000)
    room.control("alarm", axis="illumination_zenith")
    assert az.long(0x80) == 0x30
    assert not az.word(0x7F) & 0x2020
    position = az.long(0xCC)
    assert not az.direct(100).isError()
    assert az.long(0xCC) == position


def test_a_limit_switch_is_an_alarm(az, room):
    az.home()
    az.direct(8000)
    room.control("limit_switch", axis="illumination_zenith", direction=1)
    assert az.long(0x80) == 0x66
    assert az.word(0x170) & 1 << 12


def test_lost_replies_and_lost_requests_differ(az, room):
    az.home()
    room.control("drop_replies", device="illumination_zenith")
    with pytest.raises(ModbusIOException):
        az.direct(500)
    az.wait()
    assert az.long(0xCC) == 500
    room.control("lose_requests", device="illumination_zenith")
    with pytest.raises(ModbusIOException):
        az.direct(900)
    az.wait()
    assert az.long(0xCC) == 500


@pytest.fixture
def io(room: Room) -> Iterator[ModbusSerialClient]:
    client = ModbusSerialClient(str(room.endpoints.ports["io"]), baudrate=9600, timeout=1, retries=0)
    assert client.connect()
    yield client
    client.close()


def test_gain_bits_select_the_gain_and_read_back(io, room):
    assert not io.write_coils(0, [True, True, False, True], device_id=1).isError()
    assert room.bench.amplifier.gain == 1e6
    assert io.read_coils(0, count=8, device_id=1).bits == [True, True, False, True, False, False, False, False]
    assert not io.write_coil(2, True, device_id=1).isError()
    assert io.write_coil(0, False, device_id=1).bits == [False]
    assert room.bench.amplifier.code == 0b1110


def test_the_shutter_follows_its_coil_and_reports_back(io, room):
    def feedback() -> bool:
        return io.read_discrete_inputs(0, count=8, device_id=1).bits[1]

    assert not feedback()
    io.write_coil(4, True, device_id=1)
    time.sleep(0.01)
    assert feedback()
    room.control("disconnect", device="io", seconds=0.1)
    time.sleep(0.05)
    assert not room.bench.shutter.is_open()


def test_a_stuck_shutter_gives_itself_away(io, room):
    room.control("stick_shutter")
    io.write_coil(4, True, device_id=1)
    time.sleep(0.01)
    assert io.read_coils(4, count=1, device_id=1).bits[0]
    assert not io.read_discrete_inputs(1, count=1, device_id=1).bits[0]


def test_the_door_and_the_overload_line_are_inputs(io, room):
    bench = room.bench
    inputs = io.read_discrete_inputs(0, count=8, device_id=1).bits
    assert (inputs[0], inputs[2]) == (False, True)
    with bench.lock:
        bench.source.reset_interlock()
        bench.source.power = 1.0
        bench.source.switch(True)
        bench.selector.rf_on, bench.selector.amplitudes[0] = True, 1.0
    io.write_coils(0, [False, False, True, True, True], device_id=1)  # low noise 1e7, shutter open
    time.sleep(0.01)
    assert io.read_discrete_inputs(0, count=1, device_id=1).bits[0]
    room.control("open_interlock")
    inputs = io.read_discrete_inputs(0, count=8, device_id=1).bits
    assert (inputs[0], inputs[2]) == (False, False)


@pytest.mark.parametrize("address", [8, 200])
def test_channels_that_do_not_exist_are_an_exception(io, address):
    reply = io.write_coil(address, True, device_id=1)
    assert reply.isError()
    assert reply.exception_code == 2
