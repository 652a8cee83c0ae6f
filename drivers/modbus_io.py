"""Eight inputs and eight outputs on Modbus RTU (Waveshare "Modbus RTU IO 8CH" and its like), and a shutter on one.

Outputs are coils 0 to 7, inputs are discrete inputs 0 to 7. What is written is an absolute state, so a frame that
was lost may be sent again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

from pydantic import Field

from drivers.clock import Clock
from drivers.errors import CommunicationError, DeviceFault
from drivers.forms import Form
from drivers.modbus_line import ModbusLine

Channel = Annotated[int, Field(ge=0, le=7)]
SlaveAddress = Annotated[int, Field(ge=1, le=247)]
CHANNELS = 8

#: How often a frame is tried.
ATTEMPTS = 3

T = TypeVar("T")


class ModbusIo:
    """The module, as a device on it uses it.

    Parameters
    ----------
    device
        Name of the device, for errors.
    line
        The Modbus line.
    address
        Slave number of the module.
    """

    def __init__(self, device: str, line: ModbusLine, address: int) -> None:
        self.device, self.line, self.address = device, line, address

    def identify(self) -> str:
        """Read every input and output, which shows that the module answers."""
        inputs, outputs = _digits(self.inputs()), _digits(self.outputs())
        return f"Modbus I/O, slave {self.address}, inputs {inputs}, outputs {outputs} from channel 0"

    def inputs(self) -> list[bool]:
        """All inputs, channel 0 first."""
        return self._try(lambda: self.line.read_inputs(self.device, self.address, 0, CHANNELS))

    def outputs(self) -> list[bool]:
        """All outputs read back, channel 0 first."""
        return self._try(lambda: self.line.read_coils(self.device, self.address, 0, CHANNELS))

    def set_output(self, channel: int, on: bool) -> None:
        """Write one output and read it back.

        Raises
        ------
        DeviceFault
            If another state is read back.
        """
        self.set_outputs({channel: on})

    def set_outputs(self, states: dict[int, bool]) -> None:
        """Write several outputs, neighbours in one frame so that they change together, and read them back.

        Raises
        ------
        DeviceFault
            If another state is read back.
        """
        channels = sorted(states)
        with self.line.transaction(self.device):
            if len(channels) > 1 and channels == list(range(channels[0], channels[-1] + 1)):
                values = [states[channel] for channel in channels]
                self._try(lambda: self.line.write_coils(self.device, self.address, channels[0], values))
            else:
                for channel in channels:
                    self._write_one(channel, states[channel])
            found = self.outputs()
        wrong = [channel for channel in channels if found[channel] != states[channel]]
        if wrong:
            raise DeviceFault(self.device, f"outputs {wrong} do not read back as they were set", "check the module")

    def _write_one(self, channel: int, on: bool) -> None:
        self._try(lambda: self.line.write_coil(self.device, self.address, channel, on))

    def _try(self, call: Callable[[], T]) -> T:
        for _ in range(ATTEMPTS - 1):
            with contextlib.suppress(CommunicationError):
                return call()
        return call()


def io_claims(address: int, outputs: Sequence[int], inputs: Sequence[int]) -> list[tuple[str, str]]:
    """Outputs and inputs of one module, as devices that share it claim them."""
    parts = [f"output {channel}" for channel in outputs] + [f"input {channel}" for channel in inputs]
    return [(f"address {address}", part) for part in parts]


def _digits(bits: Sequence[bool]) -> str:
    return "".join("1" if bit else "0" for bit in bits)


class ShutterForm(Form):
    """Options of the shutter in ``devices.toml``.

    Attributes
    ----------
    address
        Slave number of the module.
    coil
        Output that opens the shutter while it is energised; loss of power closes it.
    feedback_input
        Input that is 1 while the shutter is open; None where it is not wired.
    travel_time
        Laboratory s that opening or closing takes at most.
    """

    address: SlaveAddress = 1
    coil: Channel
    feedback_input: Channel | None = None
    travel_time: Annotated[float, Field(ge=0, le=10)] = 0.2

    def claims(self) -> list[tuple[str, str]]:
        """An output, and an input where it is wired."""
        inputs = [] if self.feedback_input is None else [self.feedback_input]
        return io_claims(self.address, [self.coil], inputs)


class ModbusShutter:
    """A shutter on an output of the module. Satisfies :class:`drivers.interfaces.Shutter`."""

    options = ShutterForm
    line_kinds = ("modbus-serial", "modbus-tcp")

    def __init__(self, name: str, line: ModbusLine, options: ShutterForm, clock: Clock) -> None:
        self.name = name
        # What opening usually takes: with a feedback it is over before the most that is allowed.
        self.moving_time = options.travel_time * (1.0 if options.feedback_input is None else 0.5)
        self._line, self._options, self._clock = line, options, clock
        self._io = ModbusIo(name, line, options.address)
        line.attach(name)

    def identify(self) -> str:
        """State of the module that drives the shutter."""
        return self._io.identify()

    def is_open(self) -> bool:
        """The feedback input, or the output read back where there is none."""
        if self._options.feedback_input is not None:
            return self._io.inputs()[self._options.feedback_input]
        return self._io.outputs()[self._options.coil]

    def open(self) -> None:
        """Let the light through; returns when the shutter is open, within its travel time.

        Raises
        ------
        DeviceFault
            If it does not open.
        """
        self._set(True)

    def shut(self) -> None:
        """Block the light; returns when the shutter is closed, within its travel time.

        Raises
        ------
        DeviceFault
            If it does not close.
        """
        self._set(False)

    def make_safe(self) -> None:
        """Close."""
        self.shut()

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)

    def _set(self, wanted: bool) -> None:
        self._io.set_output(self._options.coil, wanted)
        if self._options.feedback_input is None:
            self._clock.sleep(self._options.travel_time)
            return
        deadline = self._clock.monotonic() + self._options.travel_time
        while True:
            late = self._clock.monotonic() > deadline
            if self.is_open() == wanted:
                return
            if late:
                verb = "open" if wanted else "close"
                raise DeviceFault(self.name, f"the shutter did not {verb} within {self._options.travel_time:g} s")
            self._clock.sleep(self._options.travel_time / 10)
