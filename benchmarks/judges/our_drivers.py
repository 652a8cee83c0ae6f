"""This project's drivers on simulators that others wrote.

Runs in the judges' environment, where pyvisa-sim and pyModbusTCP are, with this project's drivers on the path.
"""

from __future__ import annotations

import asyncio
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import qcodes.instrument.sims
from protocol import Judge, close_to
from pymodbus.framer import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from pyModbusTCP.server import ModbusServer

from drivers.clock import Clock
from drivers.femto import Femto, FemtoForm
from drivers.keysight_34465a import Keysight34465A, Keysight34465AForm
from drivers.lines import ModbusTcpLineForm, VisaLineForm
from drivers.modbus_io import ModbusShutter, ShutterForm
from drivers.oriental_az import AzForm, OrientalAz

CLOCK = Clock()
#: Short headers as the maker's guide prints them, and the long ones, which are all that the definitions know.
LONG = {"SENS": "SENSe", "VOLT": "VOLTage", "RANG": "RANGe", "SAMP": "SAMPle", "COUN": "COUNt", "TRIG": "TRIGger"}
LONG |= {"SOUR": "SOURce"}


def definitions() -> Path:
    """QCoDeS's definition of the meter, in pyvisa-sim's form."""
    return Path(qcodes.instrument.sims.__file__).parent / "Keysight_34465A.yaml"


def on_pyvisa_sim() -> None:
    """The meter of QCoDeS's definitions: identity, and what becomes of commands that it does not know."""
    judge = Judge("pyvisa-sim", "our keysight-34465a on the 34465A that QCoDeS defines")
    form = VisaLineForm(kind="visa", resource="GPIB0::1::INSTR", backend=f"{definitions()}@sim")
    line = form.open("meter")
    options = Keysight34465AForm(nplc=1.0)
    meter = Keysight34465A("detector", line, options, CLOCK)  # type: ignore[arg-type]
    query: Callable[[str], str] = lambda text: line.query("detector", text)  # type: ignore[attr-defined]  # noqa: E731
    write: Callable[[str], None] = lambda text: line.write("detector", text)  # type: ignore[attr-defined]  # noqa: E731
    judge.check("identity", lambda: query("*IDN?"), lambda value: "34465A" in value)
    judge.refused("a meter that knows no short headers is not taken for configured", meter.identify, "SYST:ERR? gave")
    meter.close()
    # What it did not understand waits in its output for ever: the second meter of the definitions has a clean one.
    line = form.model_copy(update={"resource": "GPIB0::2::INSTR"}).open("meter")
    line.attach("judge")  # type: ignore[attr-defined]

    def long_form(device: str, command: str, *rest: Any) -> str:
        words = re.sub(r"[A-Z]{4,}", lambda word: LONG.get(word[0], word[0]), command)
        return exchange(device, words.replace("VOLTage:NPLC", "VOLT:NPLC").replace("VOLTage:ZERO", "VOLT:ZERO"), *rest)

    exchange = line._exchange  # type: ignore[attr-defined]
    line._exchange = long_form  # type: ignore[attr-defined]
    for command, asked, wanted in (
        ("SENS:VOLT:DC:RANG 10", "SENS:VOLT:DC:RANG?", 10.0),
        ("SENS:VOLT:NPLC 1", "SENS:VOLT:NPLC?", 1.0),
        ("SENS:VOLT:ZERO:AUTO 1", "SENS:VOLT:ZERO:AUTO?", 1.0),
        ("SAMP:COUN 9", "SAMP:COUN?", 9.0),
        ("TRIG:COUN 1", "TRIG:COUN?", 1.0),
    ):
        write(command)
        judge.check(f"{command}, with long headers", lambda asked=asked: query(asked), close_to(wanted, 1e-9))
    judge.check("READ?", lambda: query("READ?"), close_to(10.0))
    line.close()
    judge.done()


@contextmanager
def pymodbus_server(framing: str, port: int) -> Iterator[None]:
    """pymodbus's own server with plain registers."""
    loop = asyncio.new_event_loop()
    ready = threading.Event()
    held: dict[str, Any] = {}

    async def serve() -> None:
        def bits() -> list[SimData]:
            return [SimData(0, count=16, values=[False], datatype=DataType.BITS)]

        holding = [SimData(0, count=0x400, values=0, datatype=DataType.REGISTERS)]
        inputs = [SimData(0, count=16, values=0, datatype=DataType.REGISTERS)]
        device = SimDevice(id=1, simdata=(bits(), bits(), holding, inputs))
        kind = FramerType.RTU if framing == "rtu" else FramerType.SOCKET
        held["server"] = ModbusTcpServer(device, framer=kind, address=("127.0.0.1", port))
        await held["server"].serve_forever(background=True)
        ready.set()
        await held["server"].serving

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    if not ready.wait(20.0):
        raise RuntimeError("pymodbus's server did not start")
    yield
    asyncio.run_coroutine_threadsafe(held["server"].shutdown(), loop).result(10.0)
    thread.join(10.0)


@contextmanager
def pymodbustcp_server(framing: str, port: int) -> Iterator[None]:
    """pyModbusTCP's server, which shares no code with pymodbus."""
    server = ModbusServer("127.0.0.1", port, no_block=True)
    server.start()
    yield
    server.stop()


def on_modbus(package: str, server: Callable[[str, int], Any], framing: str, port: int) -> None:
    """Shutter, amplifier and drive on plain coils and registers."""
    judge = Judge(package, f"our modbus-shutter, femto and oriental-az on its server, framing {framing!r}")
    with server(framing, port):
        form = ModbusTcpLineForm(kind="modbus-tcp", host="127.0.0.1", port=port, framing=framing, timeout=5.0)  # type: ignore[arg-type]
        line: Any = form.open("io")
        shutter = ModbusShutter("shutter", line, ShutterForm(coil=4, travel_time=0.0), CLOCK)
        amplifier = Femto("amplifier", line, FemtoForm(coils=(0, 1, 2, 3)), CLOCK)
        judge.check("shutter identity", shutter.identify, lambda value: "outputs 00000000" in value)
        shutter.open()
        judge.check("shutter open", shutter.is_open, bool)
        shutter.make_safe()
        judge.check("shutter closed", shutter.is_open, lambda value: not value)
        for gain in amplifier.gains:
            amplifier.set_gain(gain)
            judge.check(f"gain {gain:g} V/A", amplifier.gain, lambda value, gain=gain: value == gain)
        judge.check("overload line", amplifier.overload, lambda value: value is False)
        arm = AzForm(
            address=1, steps_per_degree=100.0, lower=-85.0, upper=85.0, velocity=10.0, acceleration=20.0, tolerance=0.02
        )
        drive = OrientalAz("illumination_zenith", line, arm, CLOCK)
        line.write_registers("test", 1, 0x00CC, [0xFFFF, 0xFB1E])
        judge.check("negative feedback position", drive.position, close_to(-12.5, 1e-9))
        line.write_registers("test", 1, 0x0178, [0x0002, 0x0002])
        line.write_registers("test", 1, 0x0080, [0, 0x30])
        judge.check("alarm in words", lambda: drive.status().fault, lambda value: "30h: overload" in value)
        line.write_registers("test", 1, 0x0178, [0x0002, 0x0018])
        judge.refused("a drive that never moves is noticed", lambda: drive.start_move(5.0), "ignored the move")
        judge.refused("an address outside is an exception", lambda: line.read_registers("test", 1, 0xFFF0, 20), "")
        for device in (shutter, amplifier, drive):
            device.close()
    judge.done()


TRIALS: dict[str, Callable[[], None]] = {
    "pyvisa-sim": on_pyvisa_sim,
    "pymodbus-socket": lambda: on_modbus("pymodbus", pymodbus_server, "socket", 15021),
    "pymodbus-rtu": lambda: on_modbus("pymodbus", pymodbus_server, "rtu", 15022),
    "pyModbusTCP": lambda: on_modbus("pyModbusTCP", pymodbustcp_server, "socket", 15023),
}

if __name__ == "__main__":
    TRIALS[sys.argv[2]]()
