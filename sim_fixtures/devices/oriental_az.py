"""Oriental Motor AZ series driver (AZD-KD) as a Modbus RTU slave.

Register map: remote I/O at 007Ch-007Fh, direct data operation at 0058h, monitors from 0080h, maintenance at 0180h,
parameters at 0380h, stored operation data 0 at 1800h. 32-bit values have their high word at the lower address.
Inputs act on their rising edge. The drive counts steps; one step is the encoder step of the bench's arm.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymodbus.constants import ExcCodes
from pymodbus.simulator import DataType, SimData, SimDevice

from sim_fixtures.bench import Bench
from sim_fixtures.bench.axis import AxisModel

DIRECT_DATA, DIRECT_TRIGGER, INPUT_WORD = 0x0058, 0x0066, 0x007C
ALARM, COMMUNICATION_ERROR = 0x0080, 0x00AC
COMMAND_POSITION, FEEDBACK_POSITION, SPEED_RPM, SPEED_HZ = 0x00C6, 0x00CC, 0x00CE, 0x00D0
ALARM_RESET, CLEAR_ALARM_RECORDS, CLEAR_COMMUNICATION_RECORDS = 0x0180, 0x0184, 0x0188
SOFT_OVERTRAVEL, UPPER_LIMIT, LOWER_LIMIT = 0x0386, 0x0388, 0x038A
STORED_DATA = 0x1800

#: Bits of the input word 007Dh and of the output word 007Fh.
IN_START, IN_ZHOME, IN_STOP, IN_FREE, IN_ALARM_RESET = 0x0008, 0x0010, 0x0020, 0x0040, 0x0080
OUT_HOME_END, OUT_READY, OUT_ALARM, OUT_MOVE, OUT_IN_POSITION = 0x0010, 0x0020, 0x0080, 0x2000, 0x4000

ALARM_OVERLOAD, ALARM_HOMING, ALARM_HARD_LIMIT, ALARM_SOFT_LIMIT, ALARM_DATA = 0x30, 0x62, 0x66, 0x67, 0x70
ABSOLUTE, RELATIVE_TO_COMMAND, RELATIVE_TO_FEEDBACK = 1, 2, 3

_BLOCKS = ((0x0030, 0x0400 - 0x0030), (STORED_DATA, 12))
_STEPS_PER_REVOLUTION = 1000


def _signed(high: int, low: int) -> int:
    value = high << 16 | low
    return value - (1 << 32) if value & 0x80000000 else value


def _words(value: int) -> list[int]:
    return [(value >> 16) & 0xFFFF, value & 0xFFFF]


@dataclass(frozen=True)
class Operation:
    """Data of one motion, in the drive's units: step, Hz, 0.001 kHz/s."""

    kind: int
    position: int
    speed: int
    starting_rate: int
    stopping_rate: int


class AzDrive:
    """One drive with its arm.

    Parameters
    ----------
    bench, axis
        Whose arm is driven.
    address
        Slave address, 1-31.
    """

    def __init__(self, bench: Bench, axis: str, address: int = 1) -> None:
        self._bench, self.axis_name = bench, axis
        self._axis: AxisModel = bench.axes[axis]
        self._inputs = 0
        self._command = 0
        self.alarm = 0
        blocks = [SimData(start, count=size, values=0, datatype=DataType.REGISTERS) for start, size in _BLOCKS]
        self.slave = SimDevice(id=address, simdata=blocks, action=self._access)

    # ---- Modbus ------------------------------------------------------------------------------------------

    async def _access(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """pymodbus's hook around every access to the registers."""
        with self._bench.lock:
            self._supervise()
            if values is None:
                self._refresh(start, registers)
                return None
            return self._write(address - start, start, [int(value) for value in values], registers)

    def _write(self, offset: int, start: int, values: list[int], registers: list[int]) -> ExcCodes | None:
        before = registers[offset : offset + len(values)]
        written = range(start + offset, start + offset + len(values))
        registers[offset : offset + len(values)] = values
        if DIRECT_TRIGGER + 1 in written and self._long(start, registers, DIRECT_TRIGGER) == 1:
            operation = self._operation(start, registers, DIRECT_DATA + 2)
            if (problem := _out_of_range(operation)) is not None:
                registers[offset : offset + len(values)] = before
                return problem
            self._bench.motion_commands[self.axis_name] += 1
            self._begin(operation, start, registers)
        if INPUT_WORD + 1 in written:
            self._inputs_changed(registers[INPUT_WORD + 1 - start], start, registers)
        for command in (ALARM_RESET, CLEAR_ALARM_RECORDS, CLEAR_COMMUNICATION_RECORDS):
            rising = command + 1 in written and before[command + 1 - written.start] == 0
            if rising and registers[command + 1 - start] == 1 and command == ALARM_RESET:
                self._reset_alarm()
        return None

    def _long(self, start: int, registers: list[int], address: int) -> int:
        return _signed(registers[address - start], registers[address + 1 - start])

    def _operation(self, start: int, registers: list[int], address: int) -> Operation:
        return Operation(*(self._long(start, registers, address + 2 * number) for number in range(5)))

    # ---- the drive ---------------------------------------------------------------------------------------

    def raise_alarm(self, code: int = ALARM_OVERLOAD) -> None:
        """The motor loses its current and the drive shows an alarm."""
        self._axis.halt()
        self.alarm = code

    def _reset_alarm(self) -> None:
        self.alarm = 0
        self._axis.release_limit()

    def _ready(self) -> bool:
        return self.alarm == 0 and not self._axis.moving()

    def _inputs_changed(self, inputs: int, start: int, registers: list[int]) -> None:
        risen, self._inputs = inputs & ~self._inputs, inputs
        if risen & IN_ALARM_RESET:
            self._reset_alarm()
        if risen & IN_STOP:
            self._axis.stop()
            self._command = self._steps(self._axis.target())
        if risen & IN_FREE:
            self._axis.halt()
        if inputs & (IN_STOP | IN_FREE):
            return
        if risen & IN_ZHOME:
            self._bench.motion_commands[self.axis_name] += 1
            if self._ready():
                self._command = 0
                self._axis.home()
        if risen & IN_START:
            self._bench.motion_commands[self.axis_name] += 1
            if self._ready():
                self._begin(self._operation(start, registers, STORED_DATA), start, registers)

    def _begin(self, operation: Operation, start: int, registers: list[int]) -> None:
        """Start a motion; a drive with an alarm, or one that homes, ignores it without a word."""
        if self.alarm or self._axis.homing or self._inputs & (IN_STOP | IN_FREE):
            return
        base = {ABSOLUTE: 0, RELATIVE_TO_COMMAND: self._command, RELATIVE_TO_FEEDBACK: self._feedback()}
        if operation.kind not in base or (operation.kind == ABSOLUTE and not self._axis.homed):
            self.raise_alarm(ALARM_DATA)
            return
        target = base[operation.kind] + operation.position
        lower, upper = (self._long(start, registers, address) for address in (LOWER_LIMIT, UPPER_LIMIT))
        if self._long(start, registers, SOFT_OVERTRAVEL) >= 1 and lower < upper and not lower <= target <= upper:
            self.raise_alarm(ALARM_SOFT_LIMIT)
            return
        step, design = self._axis.design.step, self._axis.design
        self._command = target
        self._axis.move(
            target * step,
            min(abs(operation.speed) * step, design.velocity),
            min(operation.starting_rate * step, design.acceleration),
            min(operation.stopping_rate * step, design.acceleration),
        )

    def _supervise(self) -> None:
        """Notice a limit switch that the arm has run into."""
        self._axis.moving()
        if self._axis.at_limit and self.alarm == 0:
            self.raise_alarm(ALARM_HARD_LIMIT)

    def _steps(self, position: float) -> int:
        return round(position / self._axis.design.step)

    def _feedback(self) -> int:
        return self._steps(self._axis.position())

    # ---- monitors ----------------------------------------------------------------------------------------

    def _refresh(self, start: int, registers: list[int]) -> None:
        speed = round(self._axis.velocity() / self._axis.design.step)
        values = {
            ALARM: self.alarm,
            COMMUNICATION_ERROR: 0,
            COMMAND_POSITION: self._command,
            FEEDBACK_POSITION: self._feedback(),
            SPEED_RPM: round(speed * 60 / _STEPS_PER_REVOLUTION),
            SPEED_HZ: speed,
            0x00D6: 0,
            0x00F8: 312,
            0x00FA: 287,
            0x0120: self._feedback(),
            0x0122: self._command,
            0x0146: 240,
            0x0148: 240,
        }
        for address, value in values.items():
            registers[address - start : address - start + 2] = _words(value)
        for address, word in self._status_words().items():
            registers[address - start] = word

    def _status_words(self) -> dict[int, int]:
        moving, ready, homed = self._axis.moving(), self._ready(), self._axis.homed
        arrived = not moving and self._command == self._feedback()
        remote = self._inputs & 0x000F
        remote |= OUT_HOME_END * (homed and not moving) | OUT_READY * ready | OUT_ALARM * bool(self.alarm)
        remote |= OUT_MOVE * moving | OUT_IN_POSITION * arrived
        lower, upper = self._axis.at_limit < 0, self._axis.at_limit > 0
        return {
            0x007E: 0,
            0x007F: remote,
            0x00D4: 0,
            0x0170: upper << 12 | lower << 13,
            0x0178: homed << 0 | homed << 1,
            0x0179: bool(self.alarm) << 1 | (not self.alarm) << 3 | ready << 4 | ready << 5 | moving << 6,
        }


def _out_of_range(operation: Operation) -> ExcCodes | None:
    """Exception 03 for data that no drive takes; nothing of the block is kept then."""
    rates = (operation.starting_rate, operation.stopping_rate)
    if not 0 < abs(operation.speed) <= 4_000_000 or not all(1 <= rate <= 1_000_000_000 for rate in rates):
        return ExcCodes.ILLEGAL_VALUE
    return None
