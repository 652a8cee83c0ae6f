"""Warm-up: readings until their slope is small for sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from instrument.errors import InputError
from instrument.procedures.reading import Level, Reader, least_squares
from instrument.procedures.results import Finding, Quantity
from instrument.procedures.room import Room


@dataclass(frozen=True)
class Slope:
    """Relative slope of the last readings and its standard error, 1/h."""

    per_hour: float
    u: float

    def surely_below(self, limit: float) -> bool:
        """Whether the slope is below a limit with 95 % confidence: a noisy reading is not taken for a stable one."""
        return abs(self.per_hour) + 2 * self.u < limit


def slope_of(levels: Sequence[Level]) -> Slope:
    """Straight line through readings, relative to their mean, an hour."""
    times = np.array([level.time for level in levels]) / 3600.0
    volts = np.array([level.volts for level in levels])
    errors = np.maximum([level.u for level in levels], 1e-7 * volts)
    design = np.stack([np.ones_like(times), times - times.mean()], axis=1)
    parameters, covariance, _ = least_squares(design, volts, errors)
    return Slope(float(parameters[1] / parameters[0]), float(np.sqrt(covariance[1, 1]) / parameters[0]))


def warm_up(
    room: Room,
    wavelength: float = 500.0,
    limit: float = 0.005,
    interval: float = 60.0,
    window: int = 10,
    longest: float = 7200.0,
    samples: int = 9,
) -> Finding:
    """Read the reference until the light is stable, from the moment at which the source is switched on.

    Parameters
    ----------
    limit
        Relative change in an hour below which the light counts as stable.
    interval
        Laboratory seconds from reading to reading.
    window
        Number of last readings whose slope is tested.
    longest
        Laboratory seconds after which the procedure gives up (and fails).
    """
    if window < 4:
        raise InputError(f"--window: found {window}; expected at least 4 readings")
    room.home()
    room.mount("reference")
    room.station.light.off()
    reader = Reader(room, samples)
    room.light()
    began = room.clock.monotonic()
    room.go_to_reference(wavelength)
    gain = _gain(reader)
    levels: list[Level] = []
    slope: Slope | None = None
    while True:
        level = reader.level(gain)
        assert level is not None
        levels.append(level)
        elapsed = level.time - began
        if len(levels) >= window:
            slope = slope_of(levels[-window:])
            room.say(f"{elapsed / 60:.0f} min: {100 * slope.per_hour:+.2f} ± {100 * slope.u:.2f} % an hour")
            if slope.surely_below(limit):
                return _finding(levels, began, slope, elapsed, limit, stable=True)
        if elapsed >= longest:
            slope = slope or slope_of(levels)
            return _finding(levels, began, slope, elapsed, limit, stable=False)
        room.controls.sleep(max(0.0, level.time + interval - room.clock.monotonic()))


def _gain(reader: Reader) -> float:
    """The highest gain that does not come close to saturation."""
    for gain in reversed(reader.gains):
        level = reader.level(gain, may_saturate=True)
        if level is not None and level.volts < 0.8 * reader.full_scale:
            return gain
    return reader.gains[0]


def _finding(levels: list[Level], began: float, slope: Slope, elapsed: float, limit: float, *, stable: bool) -> Finding:
    change = levels[-1].volts / levels[0].volts - 1
    state = "stable" if stable else "not stable"
    summary = f"{state} after {elapsed / 60:.0f} min: {100 * slope.per_hour:+.2f} ± {100 * slope.u:.2f} % an hour"
    return Finding(
        verdict="passed" if stable else "failed",
        summary=f"{summary} (limit {100 * limit:g} %); {100 * change:+.2f} % since the start",
        values={
            "warm-up time": Quantity(value=elapsed, unit="s"),
            "slope": Quantity(value=slope.per_hour, u=slope.u, unit="h-1"),
            "change since start": Quantity(value=change, unit="1"),
        },
        advice=() if stable else ("wait longer, or look at the source's cooling and its coupling into the fibre",),
        readings=tuple(level.record(since_start=level.time - began) for level in levels),
    )
