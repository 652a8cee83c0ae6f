# %% [markdown]
# # Add a device
# A device family is one module: its keys in `devices.toml`, what it says on the wire, and nothing else. Here it is a
# thermometer that answers `T?` with a number and `ID?` with its name. docs/adding_a_device.md is a longer one, with its
# registration and its tests.

# %%
from pathlib import Path
from tempfile import mkdtemp
from typing import Annotated

from pydantic import Field

from drivers.clock import Clock
from drivers.errors import CommunicationError
from drivers.forms import Form
from drivers.interfaces import Device
from drivers.lines import SerialLineForm
from drivers.transport import Line, NoReply, line_ends_with
from sim_fixtures.devices.faults import Faults
from sim_fixtures.devices.wire import SerialLine


class ThermometerForm(Form):
    """Its keys in devices.toml, beside `driver` and `line`; unknown keys are errors."""

    offset: Annotated[float, Field(ge=-5, le=5)] = 0.0  # degree Celsius, added to every reading


class Thermometer:
    """The driver: it satisfies `drivers.interfaces.Device` and inherits nothing."""

    options = ThermometerForm
    line_kinds = ("serial", "tcp")

    def __init__(self, name: str, line: Line, options: ThermometerForm, clock: Clock) -> None:
        self.name, self._line, self._options = name, line, options
        line.attach(name)

    def identify(self) -> str:
        """What the device says of itself."""
        return self._ask(b"ID?")

    def temperature(self) -> float:
        """Degree Celsius."""
        reply = self._ask(b"T?")
        try:
            return float(reply) + self._options.offset
        except ValueError:
            raise CommunicationError(self.name, f"T? gave {reply!r}, expected a number") from None

    def make_safe(self) -> None:
        """Nothing to do: it only listens."""

    def close(self) -> None:
        """Let go of the line."""
        self._line.release(self.name)

    def _ask(self, command: bytes) -> str:
        # A question changes nothing, so it may be asked again; a command of motion never is.
        for _ in range(2):
            try:
                return self._once(command)
            except NoReply:
                continue
        return self._once(command)

    def _once(self, command: bytes) -> str:
        return self._line.exchange(self.name, command + b"\n", line_ends_with(b"\n")).decode("ascii", "replace").strip()


# %% [markdown]
# The other end, written from the manual and not from the driver, on a real pseudo-terminal. Wires can be made to fail.


# %%
class ThermometerServer:
    """Two commands, one line a reply."""

    request_lost = staticmethod(lambda _: False)

    def feed(self, data: bytes) -> list[bytes]:
        """Replies to what arrived."""
        replies = {b"ID?": b"ACME T-1\n", b"T?": b"21.37\n"}
        return [replies[word] for word in data.split(b"\n") if word in replies]


folder = Path(mkdtemp(prefix="goniotwin-example-"))
wire = SerialLine(folder / "acme.tty", Faults())
wire.serve(ThermometerServer())

# %% [markdown]
# `goniotwin devices check` does what follows for every table of `devices.toml`:
#
# ```toml
# [lines.acme]
# kind = "serial"
# port = "/dev/ttyUSB3"
#
# [devices.temperature]
# driver = "acme-thermometer"     # the name of its entry point, group goniotwin.devices
# line = "acme"
# offset = -0.2
# ```

# %%
line = SerialLineForm(kind="serial", port=str(wire.link), timeout=2.0).open("acme")
thermometer = Thermometer("temperature", line, ThermometerForm(offset=-0.2), Clock())
assert isinstance(thermometer, Device)
print(thermometer.identify(), f"{thermometer.temperature():.2f} degree Celsius")

# %% [markdown]
# A lost reply is asked for again, on a line that has fallen silent first.

# %%
wire.faults.set("drop", 1)
print(f"after a lost reply: {thermometer.temperature():.2f} degree Celsius")
thermometer.close()
line.close()
wire.close()
