"""The bench: everything the simulated devices share."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from instrument.facility import STAGES, Facility
from sim_fixtures.bench.axis import AxisDesign, AxisModel
from sim_fixtures.bench.clock import Time
from sim_fixtures.bench.detector import Amplifier, Electronics, Noise, output_voltage
from sim_fixtures.bench.flux import FluxAhead, FluxFunction, Geometry
from sim_fixtures.bench.light import Selector, Shutter, Source
from sim_fixtures.bench.pieces import PIECES, factor, flux_geometry
from sim_fixtures.bench.troubles import Troubles

AXES = ("illumination_zenith", "sensor_zenith", "sensor_azimuth")

#: Encoder step (degree) and where the arm stands at power-on.
_STEP = {
    "illumination_zenith": 0.01,
    "sensor_zenith": 0.0005,
    "sensor_azimuth": 0.0005,
    "sample_rotation": 0.0005,
    "polarizer": 0.0005,
}
_PARKED = {
    "illumination_zenith": 7.5,
    "sensor_zenith": -12.0,
    "sensor_azimuth": 20.0,
    "sample_rotation": 3.0,
    "polarizer": 5.0,
}
#: Of the monitor photodiode: volts at nominal power, and in the dark.
MONITOR_VOLTS, MONITOR_OFFSET = 2.0, 0.003
#: Limit switches lie this far outside the range of use, degree.
_MARGIN = 5.0


class Snapshot(NamedTuple):
    """What decides a reading at one moment.

    ``light`` is relative to nominal power, 0 in the dark; ``further`` is that of the filter's other channels, with
    their wavelengths; ``leak`` what is at the output without any.
    """

    geometry: Geometry
    light: float
    gain: float
    further: tuple[tuple[float, float], ...] = ()
    leak: float = 0.0


class Bench:
    """One physical state, joined to a clock of its own.

    Devices hold :attr:`lock` while they act on it; :meth:`measure` takes it by itself.

    Parameters
    ----------
    facility
        Travel of the arms and the budget's measurement noise.
    flux
        What the detector receives (see :class:`~sim_fixtures.bench.flux.FluxFunction`).
    clock, seed
        Laboratory time, and the seed of the noise.
    """

    def __init__(
        self,
        facility: Facility,
        flux: FluxFunction,
        clock: Time,
        seed: int,
        electronics: Electronics | None = None,
    ) -> None:
        self.facility, self.clock = facility, clock
        self.electronics = electronics or Electronics()
        self.lock = threading.RLock()
        stages = [name for name in STAGES if getattr(facility.arms, name) is not None]
        self.axes = {name: AxisModel(name, _design(name, facility), clock) for name in (*AXES, *stages)}
        self.source, self.selector, self.shutter = Source(now=clock.now), Selector(), Shutter(clock)
        self.amplifier = Amplifier(clock, self.electronics.settling)
        self.mounted: str = "reference"
        self.troubles = Troubles()
        self.apertures = {"a": True, "b": True}
        self.turned_by_hand = 0.0  # degree, the sample on its manual stage
        self.motion_commands: Counter[str] = Counter()
        self.readings = 0
        self._noise = Noise(seed, facility.budget.measurement_noise, self.electronics)
        self._flux = FluxAhead(flux)
        for axis in self.axes.values():
            axis.on_target = self._expect

    def close(self) -> None:
        """End the background computation."""
        self._flux.close()

    def mount(self, what: str) -> None:
        """Put the reference, the sample or another of :data:`~sim_fixtures.bench.pieces.PIECES` on the stage.

        Raises
        ------
        ValueError
            If there is no such piece.
        """
        if what not in PIECES:
            further = ", ".join(repr(piece) for piece in PIECES[2:])
            raise ValueError(f"mount: found {what!r}; expected 'reference' or 'sample' (or {further})")
        with self.lock:
            self.mounted = what
            self._expect()

    def measure(self, count: int, integration: float, cancelled: threading.Event | None = None) -> list[float]:
        """Take readings at the amplifier's output, one after the other.

        Parameters
        ----------
        count
            Number of readings.
        integration
            Laboratory seconds a reading takes; its value belongs to the end of that time.
        cancelled
            Ends the burst early.

        Returns
        -------
        list of float
            Volts; fewer than ``count`` where the burst was cancelled.
        """
        begin = self.clock.now()
        moments: list[Snapshot] = []
        for number in range(count):
            self.clock.wait_until(begin + (number + 1) * integration, cancelled)
            if cancelled is not None and cancelled.is_set():
                break
            moments.append(self.snapshot())
        return [self._voltage(moment) for moment in moments]

    def monitor_volts(self) -> float:
        """What a photodiode beside the beam reads, before filter and shutter: it knows the source's power only."""
        with self.lock:
            power = self.source.power * self._brightness() if self.source.emitting() else 0.0
            return MONITOR_VOLTS * power / self.electronics.nominal_power + MONITOR_OFFSET

    def snapshot(self) -> Snapshot:
        """The state that decides a reading now."""
        with self.lock:
            geometry = self._geometry(lambda axis: axis.true_position()).rounded()
            leak = self.troubles.leak(self.source.emitting())
            gain = self.troubles.gain(self.amplifier.effective_gain())
            if not (self.source.emitting() and self.shutter.is_open()):
                return Snapshot(geometry, 0.0, gain, leak=leak)
            power = self.source.power / self.electronics.nominal_power * self._brightness()
            power *= sum(self.apertures.values()) / len(self.apertures)
            light, *others = (power * self.selector.transmission(channel) for channel in range(8))
            further = tuple(
                (wavelength, value)
                for wavelength, value in zip(self.selector.wavelengths[1:], others, strict=True)
                if value > 0
            )
            return Snapshot(geometry, light, gain, further, leak)

    def overload(self) -> bool:
        """The amplifier's overload line."""
        moment = self.snapshot()
        return abs(self._current(moment) * moment.gain) >= self.electronics.saturation

    def state(self) -> dict[str, Any]:
        """The whole state, for tests and for people."""
        with self.lock:
            axes = {
                name: {
                    "position": axis.position(),
                    "true_position": axis.true_position(),
                    "target": axis.target(),
                    "moving": axis.moving(),
                    "homed": axis.homed,
                    "stalled": axis.stalled,
                }
                for name, axis in self.axes.items()
            }
            return {
                "time": self.clock.now(),
                "speed": self.clock.speed,
                "mounted": self.mounted,
                "axes": axes,
                "emission": self.source.emitting(),
                "power": self.source.power,
                "interlock": self.source.interlock,
                "watchdog": self.source.watchdog,
                "watchdog_trips": self.source.watchdog_trips,
                "wavelength": self.selector.wavelengths[0],
                "transmission": self.selector.transmission(),
                "shutter_open": self.shutter.is_open(),
                "gain": self.amplifier.gain,
                "apertures": dict(self.apertures),
                "readings": self.readings,
                "motion_commands": dict(self.motion_commands),
            }

    def _brightness(self) -> float:
        return self.troubles.brightness(max(self.clock.now() - self.source.switched_on, 0.0))

    def _expect(self) -> None:
        """Have the flux computed at the geometry that all arms are bound for."""
        self._flux.expect(flux_geometry(self.troubles.true(self._geometry(lambda axis: axis.target()))))

    def _geometry(self, angle: Callable[[AxisModel], float]) -> Geometry:
        illumination_zenith, sensor_zenith, sensor_azimuth = (angle(self.axes[name]) for name in AXES)
        wavelength = self.selector.wavelengths[0]
        turned, polarizer = (angle(self.axes[name]) if name in self.axes else None for name in STAGES)
        arms = (illumination_zenith, sensor_zenith, sensor_azimuth)
        return Geometry(self.mounted, *arms, wavelength, (turned or 0.0) + self.turned_by_hand, polarizer)

    def _current(self, moment: Snapshot) -> float:
        beams = ((moment.geometry.wavelength, moment.light), *moment.further)
        return sum(self._of_beam(moment.geometry._replace(wavelength=nm), light) for nm, light in beams if light > 0)

    def _of_beam(self, shown: Geometry, light: float) -> float:
        geometry = self.troubles.true(shown)
        flux = self._flux.value(flux_geometry(geometry)) * factor(geometry, self.facility, self.troubles)
        return self.electronics.current * light * flux

    def _voltage(self, moment: Snapshot) -> float:
        current = self._current(moment)
        with self.lock:
            self.readings += 1
            relative, additive = self._noise.draw((*moment.geometry.arguments(), moment.light > 0))
        current *= 1 + self._noise.relative(moment.geometry.mounted, moment.geometry.sensor_zenith) * relative
        linear = self.troubles.response(current * moment.gain) / moment.gain
        readout = self.electronics.readout_noise * additive + moment.leak
        return output_voltage(linear, moment.gain, self.electronics, readout)


class MonitorBench:
    """The bench as the meter of the monitor photodiode sees it."""

    def __init__(self, bench: Bench) -> None:
        self.clock = bench.clock
        self._bench = bench

    def measure(self, count: int, integration: float, cancelled: threading.Event | None = None) -> list[float]:
        """Readings of the monitor, one after the other; see :meth:`Bench.measure`."""
        begin, volts = self.clock.now(), []
        for number in range(count):
            self.clock.wait_until(begin + (number + 1) * integration, cancelled)
            if cancelled is not None and cancelled.is_set():
                break
            volts.append(self._bench.monitor_volts())
        return volts


def _design(name: str, facility: Facility) -> AxisDesign:
    lower, upper = getattr(facility.arms, name)
    return AxisDesign(lower - _MARGIN, upper + _MARGIN, _STEP[name], parked=_PARKED[name])
