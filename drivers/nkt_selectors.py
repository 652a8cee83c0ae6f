"""NKT tunable filters on Interbus: SuperK SELECT (acousto-optic, behind an RF driver) and SuperK VARIA."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, PositiveFloat

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceFault
from drivers.forms import Form
from drivers.nkt_module import STATUS, NktModule
from drivers.transport import Line

Address = Annotated[int, Field(ge=1, le=160)]

#: Status bits of the SELECT (type 67h) that are faults.
SELECT_FAULTS = {
    1: "interlock of the filter open",
    2: "interlock loop in open",
    3: "interlock loop out open",
    15: "error",
}

RF_DRIVER, SELECT, VARIA = 0x66, 0x67, 0x68

RF_POWER, MINIMUM, MAXIMUM, WAVELENGTHS, AMPLITUDES = 0x30, 0x34, 0x35, 0x90, 0xB0
PM_PER_NM = 1000.0

NEUTRAL_DENSITY, UPPER_EDGE, LOWER_EDGE = 0x32, 0x33, 0x34
VARIA_MOVING = 0b111 << 12
VARIA_ERROR = 1 << 15
VARIA_RANGE = (400.0, 840.0)


class SelectForm(Form):
    """Options of the SELECT in ``devices.toml``.

    Attributes
    ----------
    address
        Of the RF driver (type 66h).
    select_address
        Of the SELECT itself (type 67h), where its interlock is to be watched.
    channel
        Acousto-optic line in use; the other lines are left alone.
    amplitude
        Fraction of full RF amplitude.
    """

    address: Address
    select_address: Address | None = None
    channel: Annotated[int, Field(ge=0, le=7)] = 0
    amplitude: Annotated[float, Field(gt=0, le=1)] = 1.0

    def claims(self) -> list[tuple[str, str]]:
        """A line of the RF driver; the SELECT itself is only watched."""
        return [(f"address {self.address}", f"channel {self.channel}")]


class NktSelect:
    """SuperK SELECT. Satisfies :class:`drivers.interfaces.BoundedSelector` and ``ChannelSelector``."""

    options = SelectForm
    line_kinds = ("serial", "tcp")

    def __init__(self, name: str, line: Line, options: SelectForm, clock: Clock) -> None:
        self.name = name
        self._line, self._options = line, options
        self._driver = NktModule(name, line, options.address)
        address = options.select_address
        self._select = NktModule(name, line, address) if address is not None else None
        self._range: tuple[float, float] | None = None
        self.channel, self.amplitude = options.channel, options.amplitude
        line.attach(name)

    def identify(self) -> str:
        """Type and serial number of the RF driver, and of the SELECT where its address is known."""
        identity = self._driver.identify((RF_DRIVER,))
        if self._select is not None:
            identity += "; " + self._select.identify((SELECT,))
        lower, upper = self.wavelength_range()
        return f"{identity}, {lower:g} to {upper:g} nm"

    def wavelength(self) -> float:
        """Centre wavelength read back, nm."""
        return self._driver.read_unsigned(WAVELENGTHS + self._options.channel) / PM_PER_NM

    def set_wavelength(self, wavelength: float) -> None:
        """Tune the channel and switch the RF power on.

        Raises
        ------
        CommandRefused
            If the crystal cannot select the wavelength.
        DeviceFault
            If another wavelength is read back, or the SELECT reports a fault.
        """
        lower, upper = self.wavelength_range()
        if not lower <= wavelength <= upper:
            raise CommandRefused(self.name, f"{wavelength:g} nm is outside {lower:g} to {upper:g} nm")
        channel, picometres = self._options.channel, round(wavelength * PM_PER_NM)
        self._driver.write(WAVELENGTHS + channel, picometres, 4)
        self._driver.write(AMPLITUDES + channel, round(self._options.amplitude * 1000), 2)
        self._driver.write(RF_POWER, 1, 1)
        found = self._driver.read_unsigned(WAVELENGTHS + channel)
        if found != picometres:
            raise DeviceFault(self.name, f"wavelength reads {found / PM_PER_NM:g} nm after {wavelength:g} nm was set")
        if fault := self.fault():
            raise DeviceFault(self.name, fault, "no light passes before that is mended")

    def set_channel(self, channel: int, wavelength: float, amplitude: float) -> None:
        """Tune a channel and open it to a fraction of full RF amplitude; the RF power is switched on where it opens.

        Raises
        ------
        CommandRefused
            If the crystal cannot select the wavelength.
        """
        lower, upper = self.wavelength_range()
        if not lower <= wavelength <= upper:
            raise CommandRefused(self.name, f"{wavelength:g} nm is outside {lower:g} to {upper:g} nm")
        self._driver.write(WAVELENGTHS + channel, round(wavelength * PM_PER_NM), 4)
        self._driver.write(AMPLITUDES + channel, round(amplitude * 1000), 2)
        if amplitude > 0:
            self._driver.write(RF_POWER, 1, 1)

    def channel_amplitude(self, channel: int) -> float:
        """Amplitude of a channel read back, fraction of full RF amplitude."""
        return self._driver.read_unsigned(AMPLITUDES + channel) / 1000

    def fault(self) -> str:
        """What the SELECT reports, in words; empty where nothing is wrong, or its address is not known."""
        if self._select is None:
            return ""
        status = self._select.read_unsigned(STATUS)
        return "; ".join(words for bit, words in SELECT_FAULTS.items() if status >> bit & 1)

    def make_safe(self) -> None:
        """RF power off: no light passes."""
        self._driver.write(RF_POWER, 0, 1)

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)

    def wavelength_range(self) -> tuple[float, float]:
        """What the crystal can select, nm; asked for once."""
        if self._range is None:
            lower, upper = (self._driver.read_unsigned(register) / PM_PER_NM for register in (MINIMUM, MAXIMUM))
            self._range = lower, upper
        return self._range


class VariaForm(Form):
    """Options of the VARIA in ``devices.toml``.

    Attributes
    ----------
    address
        Of the module.
    bandwidth
        Distance of the two edges, nm.
    neutral_density
        Transmission setting of the neutral-density filter in percent; None leaves it alone.
    move_timeout
        Laboratory s that the filters may move.
    change_time
        Laboratory s that a change usually takes, for estimates of how long a scan takes.
    """

    address: Address = 16
    bandwidth: PositiveFloat = 10.0
    neutral_density: Annotated[float, Field(ge=0, le=100)] | None = None
    move_timeout: PositiveFloat = 20.0
    change_time: Annotated[float, Field(ge=0)] = 1.0

    def claims(self) -> list[tuple[str, str]]:
        """The module."""
        return [(f"address {self.address}", "")]


class NktVaria:
    """SuperK VARIA. Satisfies :class:`drivers.interfaces.BoundedSelector`."""

    options = VariaForm
    line_kinds = ("serial", "tcp")

    def __init__(self, name: str, line: Line, options: VariaForm, clock: Clock) -> None:
        self.name = name
        self.change_time = options.change_time
        self._line, self._options, self._clock = line, options, clock
        self._module = NktModule(name, line, options.address)
        line.attach(name)

    def identify(self) -> str:
        """Type and serial number."""
        return self._module.identify((VARIA,))

    def wavelength(self) -> float:
        """Middle between the two edges read back, nm."""
        edges = self._module.read_unsigned(UPPER_EDGE) + self._module.read_unsigned(LOWER_EDGE)
        return edges / 20.0

    def wavelength_range(self) -> tuple[float, float]:
        """Centres with both edges inside 400 to 840 nm."""
        half = self._options.bandwidth / 2
        return VARIA_RANGE[0] + half, VARIA_RANGE[1] - half

    def set_wavelength(self, wavelength: float) -> None:
        """Move both edges and wait until the filters stand still (``move_timeout`` at most).

        Raises
        ------
        CommandRefused
            If an edge lies outside 400 to 840 nm.
        DeviceFault
            If the filters report an error or do not stop.
        """
        half = self._options.bandwidth / 2
        if wavelength - half < VARIA_RANGE[0] or wavelength + half > VARIA_RANGE[1]:
            raise CommandRefused(
                self.name, f"{wavelength:g} nm with {half:g} nm to either side is outside 400 to 840 nm"
            )
        if self._options.neutral_density is not None:
            self._module.write(NEUTRAL_DENSITY, round(self._options.neutral_density * 10), 2)
        edges = {UPPER_EDGE: round((wavelength + half) * 10), LOWER_EDGE: round((wavelength - half) * 10)}
        # The edge that moves outwards goes first, so that the lower one never passes the upper one.
        first = UPPER_EDGE if edges[UPPER_EDGE] >= self._module.read_unsigned(UPPER_EDGE) else LOWER_EDGE
        for register in (first, LOWER_EDGE if first == UPPER_EDGE else UPPER_EDGE):
            self._module.write(register, edges[register], 2)
        self._wait_until_still()
        found = {register: self._module.read_unsigned(register) for register in edges}
        if found != edges:
            raise DeviceFault(self.name, f"edges read {found} after {edges} was set (registers in 0.1 nm)")

    def make_safe(self) -> None:
        """Nothing to do: a filter at rest is safe."""

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)

    def _wait_until_still(self) -> None:
        deadline = self._clock.monotonic() + self._options.move_timeout
        while True:
            late = self._clock.monotonic() > deadline
            status = self._module.read_unsigned(STATUS)
            if status & VARIA_ERROR:
                raise DeviceFault(self.name, f"error reported (status {status:04X}h)")
            if not status & VARIA_MOVING:
                return
            if late:
                raise DeviceFault(self.name, f"filters still move after {self._options.move_timeout:g} s")
            self._clock.sleep(0.1)
