"""Rests during a scan: because a person asked, or because the laboratory cannot measure now."""

from __future__ import annotations

from collections.abc import Callable

from instrument.control import Controls, PauseNow
from instrument.light import LightLost
from instrument.reporter import Reporter
from instrument.settings import ScanSettings
from instrument.states import State
from instrument.station import Station


class Attendance:
    """Does pieces of work, and rests before or during them where need be."""

    def __init__(self, station: Station, report: Reporter, controls: Controls, settings: ScanSettings) -> None:
        self._station, self._report, self._controls, self._settings = station, report, controls, settings

    def attended(self, state: State, work: Callable[[], None]) -> None:
        """Do one piece of work; after a rest in its midst it is done anew.

        Parameters
        ----------
        state
            Where to go on after a rest.

        Raises
        ------
        LightLost
            If nobody dealt with the light in time.
        """
        while True:
            try:
                if (reason := self._controls.pause_reason) is not None:
                    raise PauseNow(reason)
                work()
                return
            except PauseNow as request:
                self._pause(request.reason, state)
            except LightLost as cause:
                self._suspend(cause, state)

    def light_up(self) -> None:
        """Switch the source on and let it warm up."""
        self._station.light.on()
        self._controls.sleep(self._settings.warm_up)

    def _pause(self, reason: str, state: State) -> None:
        self._station.rest()
        self._report.to(State.PAUSING, reason)
        self._report.to(State.PAUSED, reason)
        self._controls.rest(None)
        self._report.to(state, "resumed")

    def _suspend(self, cause: LightLost, state: State) -> None:
        """Wait for a person to deal with the light; it is never switched on again without one."""
        while True:
            self._station.rest()
            self._station.light.off()
            self._report.to(State.SUSPENDED, cause.problem)
            self._report.tell("error", str(cause), "the scan waits: deal with the cause and resume it, or abort it")
            self._controls.pause(now=False, reason=cause.problem)
            if not self._controls.rest(self._settings.suspend_limit):
                raise cause
            try:
                self.light_up()
            except LightLost as again:
                cause = again
            else:
                self._report.to(state, "resumed")
                return
