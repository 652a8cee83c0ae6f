"""The bench: everything the simulated devices share."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from instrument.facility import Facility
from sim_fixtures.bench.axis import AxisDesign, AxisModel
from sim_fixtures.bench.clock import Time
from sim_fixtures.bench.detector import Amplifier, Electronics, Noise, output_voltage
from sim_fixtures.bench.flux import FluxAhead, FluxFunction, Geometry, Mounted
from sim_fixtures.bench.light import Selector, Shutter, Source

AXES = ("illumination_zenith", "sensor_zenith", "sensor_azimuth")

#: Encoder step (degree) and where the arm stands at power-on.
_STEP = {"illumination_zenith": 0.01, "sensor_zenith": 0.0005, "sensor_azimuth": 0.0005}
_PARKED = {"illumination_zenith": 7.5, "sensor_zenith": -12.0, "sensor_azimuth": 20.0}
#: Limit switches lie this far outside the range of use, degree.
_MARGIN = 5.0


class Snapshot(NamedTuple):
    """What decides a reading at one moment; ``light`` is relative to nominal power, 0 in the dark."""

    geometry: Geometry
    light: float
    gain: float


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
        self.axes = {name: AxisModel(name, _design(name, facility), clock) for name in AXES}
        self.source, self.selector, self.shutter = Source(), Selector(), Shutter(clock)
        self.amplifier = Amplifier(clock, self.electronics.settling)
        self.mounted: Mounted = "reference"
        self.motion_commands: Counter[str] = Counter()
        self.readings = 0
        self._noise = Noise(seed, facility.budget.measurement_noise, self.electronics)
        self._flux = FluxAhead(flux)
        for axis in self.axes.values():
            axis.on_target = self._expect

    def close(self) -> None:
        """End the background computation."""
        self._flux.close()

    def mount(self, what: Mounted) -> None:
        """Put the reference or the sample on the stage.

        Raises
        ------
        ValueError
            If it is neither.
        """
        if what not in ("reference", "sample"):
            raise ValueError(f"mount: found {what!r}; expected 'reference' or 'sample'")
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

    def snapshot(self) -> Snapshot:
        """The state that decides a reading now."""
        with self.lock:
            geometry = self._geometry(lambda axis: axis.true_position()).rounded()
            on = self.source.emitting() and self.shutter.is_open()
            light = self.source.power / self.electronics.nominal_power * self.selector.transmission() if on else 0.0
            return Snapshot(geometry, light, self.amplifier.effective_gain())

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
                "readings": self.readings,
                "motion_commands": dict(self.motion_commands),
            }

    def _expect(self) -> None:
        """Have the flux computed at the geometry that all arms are bound for."""
        self._flux.expect(self._geometry(lambda axis: axis.target()))

    def _geometry(self, angle: Callable[[AxisModel], float]) -> Geometry:
        illumination_zenith, sensor_zenith, sensor_azimuth = (angle(self.axes[name]) for name in AXES)
        wavelength = self.selector.wavelengths[0]
        return Geometry(self.mounted, illumination_zenith, sensor_zenith, sensor_azimuth, wavelength)

    def _current(self, moment: Snapshot) -> float:
        if moment.light == 0.0:
            return 0.0
        return self.electronics.current * moment.light * self._flux.value(moment.geometry)

    def _voltage(self, moment: Snapshot) -> float:
        current = self._current(moment)
        with self.lock:
            self.readings += 1
            relative, additive = self._noise.draw((*moment.geometry, moment.light > 0))
        current *= 1 + self._noise.relative(moment.geometry.mounted, moment.geometry.sensor_zenith) * relative
        return output_voltage(current, moment.gain, self.electronics, self.electronics.readout_noise * additive)


def _design(name: str, facility: Facility) -> AxisDesign:
    lower, upper = getattr(facility.arms, name)
    return AxisDesign(lower - _MARGIN, upper + _MARGIN, _STEP[name], parked=_PARKED[name])
