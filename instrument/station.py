"""The connected instrument as a scan uses it: go to a geometry, read, record what every device says."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any

from drivers.clock import Clock
from drivers.interfaces import Laboratory
from instrument.acquisition import Acquisition, Burst, NoLight
from instrument.control import Controls, ask
from instrument.durations import AXES
from instrument.events import Geometry, Polarization
from instrument.facility import Arms
from instrument.hindrances import LightUnstable
from instrument.light import Light
from instrument.monitor import monitored
from instrument.motion import MotionFailed, Mover
from instrument.safety import Envelope, Pose
from instrument.settings import ScanSettings
from instrument.sightings import Sightings
from instrument.stages import Stages, mean_of, parts_of

log = logging.getLogger(__name__)


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
    watched
        Hears now and then where the axes stand, degree by role.
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
        watched: Callable[[dict[str, float]], None] | None = None,
    ) -> None:
        self.laboratory = laboratory
        axes = laboratory.axes()
        self.envelope = Envelope.of(arms, {name: axis.limits for name, axis in axes.items()})
        self._sightings = Sightings(watched)
        everything = axes | laboratory.stages()
        self.mover = Mover(everything, clock, controls, decided, settings.motion, self._sightings)
        self.stages = Stages(laboratory.stages(), arms, self.mover)
        self.light = Light(laboratory.source, laboratory.selector, controls, settings)
        self.monitor = monitored(laboratory)
        self.acquisition = Acquisition(
            self.monitor or laboratory.detector,
            laboratory.amplifier,
            laboratory.shutter,
            clock,
            controls,
            noticed,
            settings.acquisition,
        )
        self._clock, self._controls, self._settings = clock, controls, settings
        self._commanded: Pose | None = None
        self._loose = self.envelope.one_sided
        self._polarizations: tuple[Polarization | None, ...] = (None,)

    def go(self, geometry: Geometry) -> None:
        """Bring stages, arms and filter to a geometry, one after the other, around the cone where need be.

        Raises
        ------
        SafetyError
            If no allowed way leads there.
        MotionFailed, DeviceFault, CommandRefused
            From the arms.
        """
        self.light.select(geometry.wavelength)
        self.stages.go(geometry)
        self._polarizations = parts_of(geometry.polarization)
        target, here = Pose.of(geometry), self.pose()
        legs = self.envelope.route(here, target, self._loose | self._displaced(here))
        self._loose = self.envelope.one_sided  # until the way is gone to its end
        for leg in legs:
            self.mover.move(leg.axis, leg.target)
        self._commanded, self._loose = target, frozenset()
        self._sightings.arrived()

    def _displaced(self, here: Pose) -> frozenset[str]:
        """Arms that do not stand where they were sent."""
        if self._commanded is None:
            return frozenset(AXES)
        return frozenset(axis for axis, a, b in zip(AXES, self._commanded, here, strict=True) if a != b)

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
        """Settle, make sure of the light, take one reading; where both polarisations are wanted, one of each.

        Returns
        -------
        Burst
            The reading.
        dict
            What a record of the journal says beside geometry and index: time, readings, readbacks.
        """
        if len(self._polarizations) == 1:
            return self._read_once(samples)
        read = []
        for polarization in self._polarizations:
            self.stages.polarize(polarization)
            read.append((polarization, *self._read_once(samples)))
        return mean_of(read)

    def _read_once(self, samples: int) -> tuple[Burst, dict[str, Any]]:
        acquisition = self._settings.acquisition
        self._controls.sleep(max(acquisition.settling, self._settings.dwell - self.acquisition.last_duration))
        self.light.check()
        began = self._clock.now()
        try:
            burst = self.acquisition.measure(samples)
        except (NoLight, LightUnstable):
            self.light.check()  # light that went out is waited for; the point is not given up
            raise
        self.light.check()
        power, wavelength = self.light.readback()
        return burst, {
            "time": began,
            "signal": burst.samples,
            "dark": burst.dark,
            "dark_signal": burst.dark_samples,
            "gain": burst.gain,
            "quality_flag": burst.quality_flag,
            "readback": self._stood(),
            "source_power": power,
            "wavelength_readback": wavelength,
        } | (self.monitor.beside(burst.samples) if self.monitor else {})

    def _stood(self) -> dict[str, float]:
        """Readback of every arm after a reading, which belongs to where they were sent.

        Raises
        ------
        MotionFailed
            If one has left its place meanwhile.
        """
        readback = self.mover.readback()
        if self._commanded is None:
            return readback
        for name, wanted in zip(AXES, self._commanded, strict=True):
            if abs(readback[name] - wanted) > self.mover.tolerance(name):
                problem = (
                    f"it moved during the reading: it stands at {readback[name]:.4f} instead of {wanted:g} degrees"
                )
                raise MotionFailed(name, problem, at_rest=True)
        return readback

    def rest(self) -> None:
        """Stop the arms and close the shutter, and make sure of it.

        Raises
        ------
        DeviceError
            If that cannot be known.
        """
        if problems := self.secure():
            raise problems[0]

    def secure(self) -> list[Exception]:
        """Close the shutter and stop the arms, whatever fails; returns what cannot be known to be so."""
        return each([*self.mover.stops(), self.acquisition.shut, *self.mover.rests()])

    def zero_monitor(self) -> None:
        """Read the monitor photodiode, where there is one, while the source is off."""
        if self.monitor is not None:
            self.monitor.zero()

    def time(self) -> float:
        """Laboratory seconds."""
        return self._clock.monotonic()

    def answers(self) -> None:
        """Ask every device who it is.

        Raises
        ------
        CommunicationError
            Where one does not answer.
        """
        for device in self.laboratory.devices().values():
            device.identify()

    def bring_to_rest(self) -> dict[str, float]:
        """Stop every arm and read back where it stands, degree; where arms were bound for is forgotten.

        Raises
        ------
        MotionFailed, DeviceFault
        """
        self._commanded, self._loose = None, self.envelope.one_sided
        self.stages.forget()
        self.acquisition.forget_gain()
        self.rest()
        return self.mover.readback()

    def unhomed(self) -> dict[str, str]:
        """Arms that do not know their zero, and what else their drives say."""
        axes = self.laboratory.axes() | self.laboratory.stages()
        statuses = {name: ask(axis.status) for name, axis in axes.items()}
        return {name: status.fault or "no fault" for name, status in statuses.items() if not status.homed}

    def make_safe(self) -> list[Exception]:
        """Emission off, shutter closed, arms stopped and at rest, whatever fails; returns what went wrong.

        Light first: whatever interrupted a move has stopped its arm already, and a mute arm takes long to give up.
        """
        problems = each([self.light.off, self.acquisition.shut, *self.mover.stops()])
        problems += each(device.make_safe for device in self.laboratory.devices().values())
        return problems + each(self.mover.rests())


def each(actions: Iterable[Callable[[], object]]) -> list[Exception]:
    """Do every action; returns what was raised. A step towards safety never keeps the next one from being taken."""
    problems: list[Exception] = []
    for action in actions:
        try:
            action()
        except Exception as error:
            log.debug("a step towards the safe state failed", exc_info=True)
            problems.append(error)
    return problems
