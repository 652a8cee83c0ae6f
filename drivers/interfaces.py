"""What the instrument needs of any device. A driver is a class that satisfies one of these protocols.

Angles are degrees of the laboratory frame (scale, sign and zero of a stage are the driver's configuration),
wavelengths nanometres, voltages volts, gains V/A. No method blocks longer than one exchange on the wire
except where it says so. Errors are those of :mod:`drivers.errors`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable


@dataclass(frozen=True)
class AxisStatus:
    """State of an axis at one moment.

    Attributes
    ----------
    moving
        True while the drive moves or homes.
    homed
        True when positions refer to a known zero.
    in_position
        True when the drive says that the last move is complete.
    fault
        What is wrong, in words; empty when nothing is.
    """

    moving: bool
    homed: bool
    in_position: bool
    fault: str = ""


@dataclass(frozen=True)
class AxisLimits:
    """Travel in degree, top speed in degree/s and acceleration in degree/s^2 of an axis.

    Attributes
    ----------
    approach
        From which side a target is always reached, so that play in the gears does not show: 1 on rising angles, -1 on
        falling ones, 0 from either.
    backlash
        How far beyond a target an axis goes first that would come from the wrong side, degree.
    """

    lower: float
    upper: float
    velocity: float
    acceleration: float
    approach: int = 0
    backlash: float = 0.0


@runtime_checkable
class Device(Protocol):
    """Anything on a wire."""

    name: str

    def identify(self) -> str:
        """Ask the device who it is; proves that the connection works."""
        ...

    def make_safe(self) -> None:
        """Bring the device into its safe state (stop, emission off, shutter closed). May be repeated."""
        ...

    def close(self) -> None:
        """Release the wire. May be repeated."""
        ...


@runtime_checkable
class Axis(Device, Protocol):
    """A motorised arm."""

    limits: AxisLimits
    tolerance: float  # degree; largest |position - target| that counts as in position

    def home(self) -> None:
        """Start the search for the zero; returns at once, ``status().homed`` tells when it is done."""
        ...

    def position(self) -> float:
        """Actual position, degree."""
        ...

    def status(self) -> AxisStatus:
        """State of the axis now."""
        ...

    def start_move(self, target: float) -> None:
        """Send one motion command to ``target`` (degree); never re-sent. Returns when it was accepted."""
        ...

    def stop(self) -> None:
        """Decelerate and stop. May be repeated."""
        ...


@runtime_checkable
class LightSource(Device, Protocol):
    """The laser."""

    def emission(self) -> bool:
        """True while light is emitted."""
        ...

    def set_emission(self, on: bool) -> None:
        """Switch the emission; with ``on`` the watchdog of the source is armed as well."""
        ...

    def power(self) -> float:
        """Set power, fraction of full power (0 to 1)."""
        ...

    def set_power(self, fraction: float) -> None:
        """Set the power, 0 to 1."""
        ...

    def fault(self) -> str:
        """What is wrong (interlock open, temperature ...), in words; empty when nothing is."""
        ...

    def keep_alive(self) -> None:
        """Feed the watchdog of the source; called at least every few seconds while emission is on."""
        ...


@runtime_checkable
class WavelengthSelector(Device, Protocol):
    """The tunable filter."""

    def set_wavelength(self, wavelength: float) -> None:
        """Select a centre wavelength in nm."""
        ...

    def wavelength(self) -> float:
        """Centre wavelength read back, nm."""
        ...


@runtime_checkable
class BoundedSelector(WavelengthSelector, Protocol):
    """A filter that knows what it can select; a plan that asks for more is then refused before anything moves."""

    def wavelength_range(self) -> tuple[float, float]:
        """Shortest and longest centre wavelength, nm."""
        ...


@runtime_checkable
class ChannelSelector(WavelengthSelector, Protocol):
    """A filter that can let several wavelengths through at once: two beams for a test of the detector's linearity."""

    channel: int  # the one that scans use
    amplitude: float  # of a channel in use, fraction

    def set_channel(self, channel: int, wavelength: float, amplitude: float) -> None:
        """Tune a channel (nm) and open it to a fraction; 0 closes it."""
        ...

    def channel_amplitude(self, channel: int) -> float:
        """How far a channel is open, read back."""
        ...


@dataclass(frozen=True)
class Reading:
    """A burst of detector voltages.

    Attributes
    ----------
    samples
        Volts, in the order in which they were taken.
    overload
        True when the meter or the amplifier reported an overload during the burst.
    """

    samples: tuple[float, ...]
    overload: bool = False


@runtime_checkable
class Detector(Device, Protocol):
    """The voltmeter behind the amplifier."""

    full_scale: float  # V; above this a reading counts as saturated

    def read(self, samples: int) -> Reading:
        """Take ``samples`` readings in one burst; blocks for their integration time."""
        ...


@runtime_checkable
class Amplifier(Device, Protocol):
    """The transimpedance amplifier."""

    gains: tuple[float, ...]  # V/A, ascending
    settling_time: float  # s after a change of gain

    def gain(self) -> float:
        """Gain in use, V/A."""
        ...

    def set_gain(self, gain: float) -> None:
        """Select one of ``gains``."""
        ...

    def overload(self) -> bool:
        """State of the overload line."""
        ...


@runtime_checkable
class Shutter(Device, Protocol):
    """Blocks the beam; closed when the bus or the power is lost."""

    def is_open(self) -> bool:
        """State read back."""
        ...

    def open(self) -> None:
        """Let the light through."""
        ...

    def shut(self) -> None:
        """Block the light."""
        ...


#: Roles that a scan needs, and the protocol each has to satisfy.
ROLES: dict[str, type] = {
    "illumination_zenith": Axis,
    "sensor_zenith": Axis,
    "sensor_azimuth": Axis,
    "source": LightSource,
    "selector": WavelengthSelector,
    "detector": Detector,
    "amplifier": Amplifier,
    "shutter": Shutter,
}

#: Roles that a laboratory may have besides, and the protocol each has to satisfy where it is filled.
OPTIONAL_ROLES: dict[str, type] = {"sample_rotation": Axis, "polarizer": Axis}


@dataclass
class Laboratory:
    """The connected devices of one instrument, by role; made by :func:`drivers.configuration.connect`."""

    illumination_zenith: Axis
    sensor_zenith: Axis
    sensor_azimuth: Axis
    source: LightSource
    selector: WavelengthSelector
    detector: Detector
    amplifier: Amplifier
    shutter: Shutter
    others: dict[str, Device] = field(default_factory=dict)

    def devices(self) -> dict[str, Device]:
        """Every device by its role."""
        return {role: getattr(self, role) for role in ROLES} | self.others

    def axes(self) -> dict[str, Axis]:
        """The arms by their role, in the order in which a scan moves them."""
        return {
            "illumination_zenith": self.illumination_zenith,
            "sensor_azimuth": self.sensor_azimuth,
            "sensor_zenith": self.sensor_zenith,
        }

    def stages(self) -> dict[str, Axis]:
        """Motorised axes beside the arms by their role: a stage that turns the sample, a polariser."""
        stages = {role: self.others[role] for role in ("sample_rotation", "polarizer") if role in self.others}
        return {role: stage for role, stage in stages.items() if isinstance(stage, Axis)}

    def close(self) -> None:
        """Release every wire."""
        for device in self.devices().values():
            device.close()
