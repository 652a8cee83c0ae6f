"""Readings at a gain that is given, and statistics that several procedures need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from drivers.errors import DeviceFault
from drivers.interfaces import Reading
from instrument.acquisition import Burst
from instrument.angles import FloatArray
from instrument.control import ask, ensure
from instrument.facility import Budgeted
from instrument.procedures.room import Room

_NO_NUMBER = 1e30


@dataclass(frozen=True)
class Level:
    """Light at one gain: mean volts less the dark ones, standard error, middle of the time in laboratory seconds."""

    volts: float
    u: float
    dark: float
    gain: float
    time: float

    def record(self, **more: Any) -> dict[str, Any]:
        """For the result."""
        return more | asdict(self)


class Reader:
    """Takes readings without choosing a gain.

    Parameters
    ----------
    samples
        A burst, of light and of dark.
    """

    def __init__(self, room: Room, samples: int = 9) -> None:
        self._room, self._samples = room, samples
        devices = room.laboratory
        self._detector, self._amplifier, self._shutter = devices.detector, devices.amplifier, devices.shutter
        self._settling = room.settings.acquisition.settling

    @property
    def full_scale(self) -> float:
        """Volts above which the detector saturates."""
        return self._detector.full_scale

    @property
    def gains(self) -> list[float]:
        """V/A, ascending."""
        return sorted(self._amplifier.gains)

    def set_gain(self, gain: float) -> None:
        """Select a gain and let it settle."""
        ensure(
            lambda: self._amplifier.set_gain(gain),
            lambda: math.isclose(ask(self._amplifier.gain), gain, rel_tol=1e-9),
            "amplifier",
        )
        self._room.station.acquisition.forget_gain()
        self._room.controls.sleep(self._amplifier.settling_time)

    def level(self, gain: float, *, may_saturate: bool = False) -> Level | None:
        """One reading with light and one without; None where it saturates and may.

        Raises
        ------
        DeviceFault
            If the detector saturates.
        LightLost
            If the light went out.
        """
        room = self._room
        room.station.light.check()
        self.set_gain(gain)
        ensure(self._shutter.open, lambda: ask(self._shutter.is_open), "shutter")
        try:
            room.controls.sleep(self._settling)
            began = room.clock.monotonic()
            bright = self._burst()
            ended = room.clock.monotonic()
        finally:
            room.station.acquisition.shut()
        room.station.light.check()
        room.controls.sleep(self._settling)
        dark = self._burst()
        if self._saturated(bright):
            if may_saturate:
                return None
            raise DeviceFault(
                "detector", f"saturated at {gain:g} V/A", "reduce the power of the source or choose a lower gain"
            )
        volts, u = mean_of(bright.samples)
        offset, u_offset = mean_of(dark.samples)
        return Level(volts - offset, math.hypot(u, u_offset), offset, gain, (began + ended) / 2)

    def dark(self, gain: float) -> tuple[float, float]:
        """Mean volts with the shutter closed and their standard error."""
        self.set_gain(gain)
        return mean_of(self._burst().samples)

    def set_power(self, fraction: float) -> float:
        """Set the power of the source; returns what it reads back."""
        source = self._room.laboratory.source
        wanted = min(max(fraction, 0.0), 1.0)
        ensure(lambda: source.set_power(wanted), lambda: abs(ask(source.power) - wanted) < 0.002, "source")
        return ask(source.power)

    def tune_power(self, gain: float, target: float) -> float:
        """Find the power that gives so many volts at a gain, as far as the source can; returns the power.

        Raises
        ------
        DeviceFault
            If the lowest power saturates the detector, or there is no light.
        """
        power = 0.02
        for _ in range(5):
            self.set_power(power)
            level = self.level(gain, may_saturate=True)
            if level is None:
                if power <= 0.002:
                    raise DeviceFault("detector", f"saturated at {gain:g} V/A at the lowest power", "use a lower gain")
                power /= 10
                continue
            if level.volts <= 5 * level.u:
                if power >= 0.5:
                    raise DeviceFault("detector", f"no light: {level.volts:.3g} V at {gain:g} V/A", "look at the beam")
                power = min(10 * power, 1.0)
                continue
            better = min(1.0, power * target / level.volts)
            if abs(better / power - 1) < 0.05:
                break
            power = better
        self.set_power(power)
        return power

    def _burst(self) -> Reading:
        self._room.controls.checkpoint()

        def burst() -> Reading:
            reading = self._detector.read(self._samples)
            return Reading(reading.samples, reading.overload or ask(self._amplifier.overload))

        return ask(burst)

    def _saturated(self, reading: Reading) -> bool:
        return reading.overload or max(abs(s) for s in reading.samples) >= self._detector.full_scale


def gain_name(gain: float) -> str:
    """A gain in few characters: ``1e6``."""
    number, _, power = f"{gain:.4e}".partition("e")
    return f"{number.rstrip('0').rstrip('.')}e{int(power)}"


def mean_of(samples: Sequence[float]) -> tuple[float, float]:
    """Mean and its standard error; the latter 0 for a single sample.

    Raises
    ------
    DeviceFault
        If one is no number.
    """
    values = np.asarray(samples, dtype=float)
    if not np.all(np.abs(values) < _NO_NUMBER):
        raise DeviceFault("detector", "overload", "reduce the power of the source or choose a lower gain")
    return float(values.mean()), float(values.std(ddof=1) / math.sqrt(values.size)) if values.size > 1 else 0.0


def mean_of_repeats(values: Sequence[float], u: Sequence[float]) -> tuple[float, float]:
    """Mean of repeated values and its standard error: from their scatter or from their own errors, the larger."""
    data, errors = np.asarray(values, dtype=float), np.asarray(u, dtype=float)
    own = float(np.sqrt(np.sum(errors**2)) / data.size)
    scatter = float(data.std(ddof=1) / math.sqrt(data.size)) if data.size > 1 else 0.0
    return float(data.mean()), max(own, scatter)


def least_squares(design: FloatArray, values: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Weighted linear least squares.

    Parameters
    ----------
    design
        Shape (value, parameter).
    values, u
        Shape (value,).

    Returns
    -------
    tuple
        Parameters, their covariance (widened by the reduced chi-square where that exceeds 1), reduced chi-square
        (nan without degrees of freedom).
    """
    weighted = design / u[:, None]
    covariance: FloatArray = np.asarray(np.linalg.pinv(weighted.T @ weighted), dtype=float)
    parameters: FloatArray = covariance @ (weighted.T @ (values / u))
    freedom = len(values) - design.shape[1]
    if freedom <= 0:
        return parameters, covariance, math.nan
    chi_square = float(np.sum(((values - design @ parameters) / u) ** 2)) / freedom
    return parameters, np.asarray(covariance * max(chi_square, 1.0)), chi_square


def relative_error(burst: Burst) -> float:
    """Relative standard error of a reading, from the scatter of its samples."""
    _, u = mean_of(burst.samples)
    return u / abs(burst.current * burst.gain)


def beyond(value: float, u: float, allowed: float) -> bool:
    """Whether a departure is more than twice what its uncertainty and an allowed standard uncertainty explain."""
    return abs(value) > 2 * math.hypot(u, allowed)


def worst(row: Budgeted) -> float:
    """The larger end of a row of the budget."""
    return max(row) if isinstance(row, tuple) else row
