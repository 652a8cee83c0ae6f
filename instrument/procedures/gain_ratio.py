"""Ratios of neighbouring gains: the same light at two gains, alternating so that a slow drift cancels."""

from __future__ import annotations

import math

from instrument.procedures.reading import Level, Reader, beyond, gain_name, mean_of_repeats, worst
from instrument.procedures.results import Finding, Quantity
from instrument.procedures.room import Room

#: Of full scale, at the higher gain.
_TARGET = 0.85
#: With less than that of full scale at the lower gain a ratio says little about the gains.
_LEAST = 0.002


def gain_ratios(room: Room, wavelength: float = 500.0, repeats: int = 3, samples: int = 9) -> Finding:
    """Measure what the amplifier's gains are to each other, with the reference on the stage.

    For each pair the source is set so that the higher gain reads close to full scale; readings go low, high, high,
    low, so that each gain's mean belongs to one moment. Fails where a ratio is further from the one in use than the
    budget's row of detector linearity explains.
    """
    room.home()
    room.mount("reference")
    room.light()
    room.go_to_reference(wavelength)
    reader = Reader(room, samples)
    allowed = worst(room.facility.budget.detector_linearity)
    values: dict[str, Quantity] = {}
    readings, wrong, calibrated = [], [], {reader.gains[0]: (reader.gains[0], 0.0)}
    for low, high in zip(reader.gains, reader.gains[1:], strict=False):
        power = reader.tune_power(high, _TARGET * reader.full_scale)
        room.say(f"{gain_name(low)} and {gain_name(high)} V/A at {100 * power:.1f} % power")
        ratios, errors = [], []
        for _ in range(repeats):
            levels = [reader.level(gain) for gain in (low, high, high, low)]
            readings += [level.record() for level in levels if level]
            ratio, u = _ratio([level for level in levels if level])
            ratios.append(ratio)
            errors.append(u)
        if readings[-1]["volts"] < _LEAST * reader.full_scale:
            room.notes.append(f"little light at {gain_name(low)} V/A: {readings[-1]['volts']:.3g} V")
        ratio, u = mean_of_repeats(ratios, errors)
        name = f"{gain_name(high)}/{gain_name(low)}"
        departure = ratio / (high / low) - 1
        values[f"ratio {name}"] = Quantity(value=ratio, u=u, unit="1")
        values[f"departure {name}"] = Quantity(value=departure, u=u / (high / low), unit="1")
        if beyond(departure, u / (high / low), allowed):
            wrong.append(f"{name}: {100 * departure:+.2f} %")
        gain, u_gain = calibrated[low]
        calibrated[high] = (gain * ratio, gain * ratio * math.hypot(u_gain / gain, u / ratio))
    for nominal, (gain, u_gain) in calibrated.items():
        values[f"gain {gain_name(nominal)}"] = Quantity(value=gain, u=u_gain, unit="V A-1")
    line = ", ".join(f"{gain:.6g}" for gain, _ in calibrated.values())
    advice = (f"devices.toml, amplifier: gains = [{line}]",) if wrong else ()
    summary = (
        "departures " + "; ".join(wrong) if wrong else f"every ratio within {200 * allowed:.2g} % of the one in use"
    )
    return Finding(
        verdict="failed" if wrong else "passed", summary=summary, values=values, advice=advice, readings=tuple(readings)
    )


def _ratio(levels: list[Level]) -> tuple[float, float]:
    """Ratio of the inner two readings to the outer two, and its standard error."""
    low, high = levels[0].volts + levels[3].volts, levels[1].volts + levels[2].volts
    u_low, u_high = math.hypot(levels[0].u, levels[3].u), math.hypot(levels[1].u, levels[2].u)
    return high / low, high / low * math.hypot(u_low / low, u_high / high)
