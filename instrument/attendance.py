"""Rests during a scan: because a person asked, or because the laboratory cannot measure now."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

from drivers.errors import CommunicationError, DeviceError
from instrument.control import Controls, PauseNow
from instrument.hindrances import ContactLost, DiskNearlyFull, Hindrance, LightLost, require_room
from instrument.motion import AxisSilent
from instrument.reporter import Reporter
from instrument.settings import ScanSettings
from instrument.states import State
from instrument.station import Station, each

_ADVICE: dict[type[Hindrance], str] = {
    LightLost: "the scan waits: deal with the cause, then resume it or abort it",
    ContactLost: "the scan goes on by itself once every device answers; check cable and power of this one",
    DiskNearlyFull: "the scan goes on by itself once there is room on the disk",
}
_BY_ITSELF = "the scan tries again by itself; resume it to try at once, or abort it"


class Attendance:
    """Does pieces of work, and rests before or during them where need be."""

    def __init__(
        self, station: Station, report: Reporter, controls: Controls, settings: ScanSettings, run_dir: Path
    ) -> None:
        self._station, self._report, self._controls, self._settings = station, report, controls, settings
        self._run_dir = run_dir

    def attended(self, state: State, work: Callable[[], None]) -> None:
        """Do one piece of work; after a rest in its midst it is done anew.

        Parameters
        ----------
        state
            Where to go on after a rest.

        Raises
        ------
        Hindrance
            If the cause did not go away in time, or came back too often.
        """
        cause: Hindrance | None = None
        met: Counter[type[Hindrance]] = Counter()
        pause: str | None = None
        while True:
            try:
                if cause is not None:
                    self._suspend(cause, state)
                    cause = None
                pause = pause or self._controls.pause_reason
                if pause is not None:
                    self._pause(pause, state)
                    pause = None
                self._require_room()
                work()
                return
            except PauseNow as request:
                # What is amiss stays amiss: the rest that was asked for is then that of the suspension.
                pause = request.reason if cause is None else None
            except (Hindrance, AxisSilent, CommunicationError) as error:
                found = as_hindrance(error)
                met[type(found)] += 1
                if found is cause or (found.tries is not None and met[type(found)] > found.tries):
                    raise error from None
                cause = found

    def light_up(self) -> None:
        """Switch the source on and let it warm up."""
        self._station.light.on()
        self._controls.sleep(self._settings.warm_up)

    def _require_room(self) -> None:
        require_room(self._run_dir, self._settings.disk_reserve)

    def _pause(self, reason: str, state: State) -> None:
        self._station.rest()
        self._report.to(State.PAUSING, reason)
        self._report.to(State.PAUSED, reason)
        self._controls.rest()
        self._report.to(state, "resumed")

    def _suspend(self, cause: Hindrance, state: State) -> None:
        """Rest in the safest state that can be reached until the cause is gone, then make the instrument ready."""
        problems = self._secure(cause)
        self._controls.hold()
        self._report.to(State.SUSPENDED, str(cause))
        self._report.tell("error", str(cause), _ADVICE.get(type(cause), _BY_ITSELF))
        for problem in problems:
            self._report.decision(f"while the scan waits: {problem}")
        looks = self._looks(cause)
        if not self._controls.suspended(self._settings.suspend_limit_wall, self._settings.look_wall, looks):
            cause.in_vain = True
            raise cause
        if isinstance(cause, ContactLost):
            self._take_hold()
        if self._station.light.wanted:
            self.light_up()
        self._report.to(state, "resumed")

    def _secure(self, cause: Hindrance) -> list[Exception]:
        """Arms at rest, shutter closed; the light goes off where it is in doubt. What cannot be reached is returned."""
        station = self._station
        problems = station.secure()
        if isinstance(cause, LightLost | ContactLost):
            problems += each([station.light.dark])
        if not isinstance(cause, ContactLost):
            for problem in problems:
                if not isinstance(problem, CommunicationError | AxisSilent):
                    raise problem
        return problems

    def _looks(self, cause: Hindrance) -> Callable[[], bool]:
        """What tells that the scan may go on by itself."""
        if isinstance(cause, LightLost):
            return self._light_may_come_back()
        if isinstance(cause, DiskNearlyFull):
            return partial(_holds, self._require_room)
        if isinstance(cause, ContactLost):
            return partial(_holds, self._station.answers)
        return self._waited()

    def _light_may_come_back(self) -> Callable[[], bool]:
        told = False

        def looks() -> bool:
            nonlocal told
            gone = _holds(self._station.light.require_no_fault)
            if gone and not told and self._settings.relight == "person":
                told = True
                self._report.tell("info", "the source reports no fault any more", "resume to switch it on again")
            return gone and self._settings.relight == "self"

        return looks

    def _waited(self) -> Callable[[], bool]:
        end = self._station.time() + self._settings.recovery
        return lambda: self._station.time() >= end

    def _take_hold(self) -> None:
        """After a lost contact: see where the arms stand, and find the zero of those that have lost it."""
        for axis, position in self._station.bring_to_rest().items():
            self._report.note(f"{axis}: answers again, stands still at {position:.4f} degrees")
        for axis, status in self._station.unhomed().items():
            self._report.decision(f"{axis}: lost its zero while it did not answer ({status}); it is homed again")
            self._station.mover.home(axis)


def as_hindrance(error: DeviceError) -> Hindrance:
    """A lost reply or a silent arm as what it is to a scan: lost contact."""
    if isinstance(error, Hindrance):
        return error
    return ContactLost(error.device, error.problem, error.advice or "check its cable and its power")


def _holds(requirement: Callable[[], None]) -> bool:
    try:
        requirement()
    except (Hindrance, CommunicationError):
        return False
    return True
