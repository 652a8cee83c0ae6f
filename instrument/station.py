"""The connected instrument as a scan uses it: go to a geometry, read, record what every device says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivers.clock import Clock
from drivers.errors import DeviceError
from drivers.interfaces import Laboratory
from instrument.acquisition import Acquisition, Burst
from instrument.control import Controls
from instrument.durations import AXES
from instrument.events import Geometry
from instrument.facility import Arms
from instrument.light import Light
from instrument.motion import Mover
from instrument.safety import Envelope, Pose
from instrument.settings import ScanSettings


class Station:
    """The devices of one laboratory, joined.

    Parameters
    ----------
    laboratory
        Connected devices.
    arms
        What the facility allows.
    decided, noticed
        Record what a person must see (a motion command given anew), and what may be found later (a change of gain).
    """

    def __init__(
        self,
        laboratory: Laboratory,
        arms: Arms,
        clock: Clock,
        controls: Controls,
        settings: ScanSettings,
        decided: Callable[[str], None],
        noticed: Callable[[str], None],
    ) -> None:
        self.laboratory = laboratory
        axes = laboratory.axes()
        self.envelope = Envelope.of(arms, {name: axis.limits for name, axis in axes.items()})
        self.mover = Mover(axes, clock, controls, decided, settings.motion)
        self.light = Light(laboratory.source, laboratory.selector, controls, settings)
        self.acquisition = Acquisition(
            laboratory.detector,
            laboratory.amplifier,
            laboratory.shutter,
            clock,
            controls,
            noticed,
            settings.acquisition,
        )
        self._clock, self._controls, self._settings = clock, controls, settings
        self._commanded: Pose | None = None

    def go(self, geometry: Geometry) -> None:
        """Bring arms and filter to a geometry, one arm after the other, around the cone where need be.

        Raises
        ------
        SafetyError
            If no allowed way leads there.
        MotionFailed, DeviceFault, CommandRefused
            From the arms.
        """
        self.light.select(geometry.wavelength)
        target = Pose.of(geometry)
        for leg in self.envelope.route(self.pose(), target):
            self.mover.move(leg.axis, leg.target)
        self._commanded = target

    def pose(self) -> Pose:
        """Where the arms stand; as commanded, where the readback agrees within tolerance."""
        actual = self.mover.pose()
        if self._commanded is None:
            return actual
        return Pose(
            *(
                wanted if abs(wanted - found) <= self.mover.tolerance(name) else found
                for name, wanted, found in zip(AXES, self._commanded, actual, strict=True)
            )
        )

    def read(self, samples: int) -> tuple[Burst, dict[str, Any]]:
        """Settle, make sure of the light, take one reading.

        Returns
        -------
        Burst
            The reading.
        dict
            What a record of the journal says beside geometry and index: time, readings, readbacks.
        """
        acquisition = self._settings.acquisition
        self._controls.sleep(max(acquisition.settling, self._settings.dwell - self.acquisition.last_duration))
        self.light.check()
        began = self._clock.now()
        burst = self.acquisition.measure(samples)
        self.light.check()
        power, wavelength = self.light.readback()
        return burst, {
            "time": began,
            "signal": burst.samples,
            "dark": burst.dark,
            "gain": burst.gain,
            "quality_flag": burst.quality_flag,
            "readback": self.mover.readback(),
            "source_power": power,
            "wavelength_readback": wavelength,
        }

    def rest(self) -> None:
        """Stop the arms and close the shutter, and make sure of it.

        Raises
        ------
        DeviceError
            If that cannot be known.
        """
        problems = self.mover.stop_all()
        self.acquisition.shut()
        if problems:
            raise problems[0]

    def make_safe(self) -> list[DeviceError]:
        """Arms stopped, shutter closed, emission off, device by device whatever fails; returns what went wrong."""
        problems = self.mover.stop_all()
        for action in (self.acquisition.shut, self.light.off):
            try:
                action()
            except DeviceError as error:
                problems.append(error)
        for device in self.laboratory.devices().values():
            try:
                device.make_safe()
            except DeviceError as error:
                problems.append(error)
        return problems
