"""Waveshare "Modbus RTU IO 8CH": eight open-drain outputs, eight opto-isolated inputs.

Coils 0-7 are the outputs, discrete inputs 0-7 the inputs. On the bench outputs 0-3 are the gain bits of the
amplifier (lowest first) and output 4 the shutter, energise to open; input 0 is the amplifier's overload line,
input 1 the shutter's feedback, input 2 the door (1 while the interlock loop is closed).
"""

from __future__ import annotations

from pymodbus.constants import ExcCodes
from pymodbus.simulator import DataType, SimData, SimDevice

from sim_fixtures.bench import Bench
from sim_fixtures.bench.light import INTERLOCK_OPEN

GAIN_BITS, SHUTTER = 0x0F, 0x10
OVERLOAD_INPUT, SHUTTER_INPUT, DOOR_INPUT = 0x01, 0x02, 0x04
_READ_COILS, _READ_INPUTS, _WRITE_COIL, _WRITE_COILS = 1, 2, 5, 15
_CHANNELS = 8


class IoModule:
    """The module and what is wired to it.

    Parameters
    ----------
    bench
        Amplifier and shutter.
    address
        Slave address; 1 as delivered.
    """

    def __init__(self, bench: Bench, address: int = 1) -> None:
        self._bench = bench
        self.outputs = 0

        def bits() -> list[SimData]:
            return [SimData(0, count=_CHANNELS, values=[False], datatype=DataType.BITS)]

        def registers() -> list[SimData]:
            return [SimData(0x4000, count=1, values=address, datatype=DataType.REGISTERS)]

        self.slave = SimDevice(id=address, simdata=(bits(), bits(), registers(), registers()), action=self._access)

    async def _access(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """pymodbus's hook around every access; coils come as bits, the registers hold sixteen of them."""
        if function not in (_READ_COILS, _READ_INPUTS, _WRITE_COIL, _WRITE_COILS):
            return None
        if address + len(values or []) > _CHANNELS or address >= _CHANNELS:
            return ExcCodes.ILLEGAL_ADDRESS
        if function == _READ_INPUTS:
            overload = self._bench.overload()
            with self._bench.lock:
                registers[0] = self._inputs(overload)
            return None
        with self._bench.lock:
            if values is not None:
                for channel, value in enumerate(values, start=address):
                    self.outputs = self.outputs & ~(1 << channel) | bool(value) << channel
                self._drive()
            else:
                registers[0] = self.outputs
        return None

    def release(self) -> None:
        """Bus or power lost: every output opens, the shutter falls shut."""
        self.outputs = 0
        self._drive()

    def _drive(self) -> None:
        self._bench.amplifier.select(self.outputs & GAIN_BITS)
        self._bench.shutter.command(bool(self.outputs & SHUTTER))

    def _inputs(self, overload: bool) -> int:
        door = self._bench.source.interlock != INTERLOCK_OPEN
        return OVERLOAD_INPUT * overload | SHUTTER_INPUT * self._bench.shutter.is_open() | DOOR_INPUT * door
