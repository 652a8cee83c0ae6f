"""The light: source, its watchdog, and the wavelength."""

from __future__ import annotations

import threading
from collections.abc import Iterable

from drivers.errors import DeviceError
from drivers.interfaces import BoundedSelector, LightSource, WavelengthSelector
from instrument.control import Controls, ask, ensure
from instrument.errors import InputError
from instrument.hindrances import LightLost
from instrument.settings import ScanSettings

__all__ = ["Light", "LightLost"]


class Light:
    """Switches the source, and feeds its watchdog for as long as the engine shows signs of life.

    The watchdog of the source is the last line: when this program dies or hangs, emission ends by itself.

    Parameters
    ----------
    controls
        Its heartbeat decides whether the watchdog is fed.

    Attributes
    ----------
    wanted
        Whether the scan wants light; stays while the light is off for a suspension.
    """

    def __init__(
        self,
        source: LightSource,
        selector: WavelengthSelector,
        controls: Controls,
        settings: ScanSettings,
    ) -> None:
        self._source, self._selector = source, selector
        self._controls, self._settings = controls, settings
        self._stop = threading.Event()
        self._feeder: threading.Thread | None = None
        self._wavelength: float | None = None
        self.wanted = False

    def on(self) -> None:
        """Emit, at the power of the settings, and keep the watchdog fed.

        Raises
        ------
        LightLost
            If the source reports a fault or does not emit.
        """
        self.wanted = True
        self.require_no_fault()
        ensure(self._set_power, lambda: abs(ask(self._source.power) - self._settings.source_power) < 0.002, "source")
        ensure(lambda: self._source.set_emission(True), lambda: ask(self._source.emission), "source")
        self._start_feeding()
        self.check()

    def off(self) -> None:
        """End the emission. May be repeated."""
        self.wanted = False
        self.dark()

    def dark(self) -> None:
        """End the emission for a suspension; what was wanted, and what was selected, has to be looked at anew."""
        self._wavelength = None
        self._stop_feeding()
        ensure(lambda: self._source.set_emission(False), lambda: not ask(self._source.emission), "source")

    def check(self) -> None:
        """Make sure that there is light.

        Raises
        ------
        LightLost
        """
        self.require_no_fault()
        if not ask(self._source.emission):
            raise LightLost("source", "emission is off though it was switched on", "look at interlock and key switch")

    def check_range(self, wavelengths: Iterable[float]) -> None:
        """Refuse wavelengths (nm) that the filter cannot select, where it says what it can.

        Raises
        ------
        InputError
        """
        if not isinstance(self._selector, BoundedSelector):
            return
        lower, upper = ask(self._selector.wavelength_range)
        outside = sorted({value for value in wavelengths if not lower <= value <= upper})
        if outside:
            found = ", ".join(f"{value:g}" for value in outside)
            raise InputError(f"plan: wavelength: found {found} nm; the filter reaches {lower:g} to {upper:g} nm")

    def select(self, wavelength: float) -> None:
        """Select a wavelength, nm."""
        if wavelength != self._wavelength:
            self._wavelength = None
            ensure(
                lambda: self._selector.set_wavelength(wavelength),
                lambda: abs(ask(self._selector.wavelength) - wavelength) < 0.1,
                "selector",
            )
            self._wavelength = wavelength

    def readback(self) -> tuple[float, float]:
        """Set power (fraction of full power) and wavelength (nm) as the devices report them."""
        return ask(self._source.power), ask(self._selector.wavelength)

    def _set_power(self) -> None:
        self._source.set_power(self._settings.source_power)

    def require_no_fault(self) -> None:
        """Make sure that the source reports no fault.

        Raises
        ------
        LightLost
        """
        if fault := ask(self._source.fault):
            raise LightLost("source", fault, "deal with the cause, then resume")

    def _start_feeding(self) -> None:
        if self._feeder is None:
            self._stop.clear()
            self._feeder = threading.Thread(target=self._feed, name="source watchdog", daemon=True)
            self._feeder.start()

    def _stop_feeding(self) -> None:
        self._stop.set()
        if self._feeder is not None:
            self._feeder.join(timeout=30.0)
            self._feeder = None

    def _feed(self) -> None:
        period, patience = self._settings.keep_alive_wall, self._settings.heartbeat_wall
        wait = 0.0
        while not self._stop.wait(wait):
            wait = period
            if self._controls.silence_wall() > patience:
                continue
            try:
                self._source.keep_alive()
            except DeviceError:
                # Made good by the next one; if none gets through, the source goes dark by itself and
                # check() finds out before the next reading is taken.
                wait = 0.1 * period
