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
        lost: LightLost | None = None
        while True:
            try:
                if lost is not None:
                    self._suspend(lost, state)
                    lost = None
                if (reason := self._controls.pause_reason) is not None:
                    raise PauseNow(reason)
                work()
                return
            except PauseNow as request:
                # Light that is lost stays lost: the rest that was asked for is that of the suspension.
                if lost is None:
                    self._pause(request.reason, state)
            except LightLost as cause:
                if cause is lost:
                    raise  # nobody came
                lost = cause

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
        self._station.rest()
        self._station.light.off()
        # Before anybody hears of it, so that no resume can come too early to count.
        self._controls.pause(now=False, reason=cause.problem)
        self._report.to(State.SUSPENDED, cause.problem)
        self._report.tell("error", str(cause), "the scan waits: deal with the cause and resume it, or abort it")
        if not self._controls.rest(self._settings.suspend_limit):
            raise cause
        self.light_up()
        self._report.to(state, "resumed")
