"""Numbers and names in the words a person reads."""

from __future__ import annotations

from datetime import datetime
from math import isfinite, log10
from pathlib import Path

from gui.points import PlaneKey, Point

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MINUS = "\u2212"


def number(value: float, digits: int = 4) -> str:
    """A value with a fixed number of decimals and a true minus sign."""
    return f"{value:.{digits}f}".replace("-", MINUS) if isfinite(value) else "not a number"


def angle(value: float) -> str:
    """An angle in degree without needless decimals: 30°, −7.5°."""
    return f"{value:g}°".replace("-", MINUS)


def sentence(text: str) -> str:
    """A reason of the engine as a sentence."""
    text = text.strip().rstrip(".")
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def current(amperes: float) -> str:
    """A photocurrent with four significant digits: 1.654 µA, 31.00 nA."""
    for factor, unit in ((1e3, "mA"), (1e6, "µA"), (1e9, "nA"), (1e12, "pA")):
        value = amperes * factor
        if abs(value) >= 1 or unit == "pA":
            return f"{value:#.4g} {unit}".replace("-", MINUS)
    raise AssertionError("unreachable")


def gain(volts_per_ampere: float) -> str:
    """A gain with its power of ten: 10⁷ V/A."""
    exponent = round(log10(volts_per_ampere)) if volts_per_ampere > 0 else 0
    if volts_per_ampere != 10.0**exponent:
        return f"{volts_per_ampere:.3g} V/A"
    return f"10{str(exponent).translate(_RAISED)} V/A"


def place(path: Path) -> str:
    """A path as seen from where the program was started, where it lies below; else from the home folder, or whole."""
    path = path.absolute()
    for base, prefix in ((Path.cwd(), ""), (Path.home(), "~/")):
        if path.is_relative_to(base):
            return f"{prefix}{path.relative_to(base)}"
    return str(path)


def duration(seconds: float) -> str:
    """A duration as a person says it: 45 s, 12 min, 2 h 05 min."""
    seconds = max(round(seconds), 0)
    if seconds < 60:
        return f"{seconds} s"
    minutes, rest = divmod(seconds, 60)
    if minutes < 10:
        return f"{minutes} min {rest:02d} s"
    if minutes < 60:
        return f"{round(seconds / 60)} min"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min"


def clock_time(moment: datetime) -> str:
    """Time of day, UTC."""
    return f"{moment:%H:%M:%S}"


def plane_title(plane: PlaneKey, with_wavelength: bool = True) -> str:
    """Name of a plane."""
    parts = [f"{plane.wavelength:g} nm"] if with_wavelength else []
    parts.append(f"illumination zenith {angle(plane.illumination_zenith)}")
    if plane.illumination_azimuth:
        parts.append(f"illumination azimuth {angle(plane.illumination_azimuth)}")
    parts.append(f"sensor azimuth {angle(plane.sensor_azimuth)}")
    return ", ".join(parts)


def point_values(point: Point) -> str:
    """One line that says all there is to know of a point."""
    parts = [f"sensor zenith {angle(point.geometry.sensor_zenith)}"]
    if point.skipped:
        parts.append(f"not measured: {point.skipped}")
    if point.brf is not None:
        parts.append(f"measured {number(point.brf)} ± {number(point.u_brf or 0.0)}")
    if point.simulated is not None:
        parts.append(f"simulated {number(point.simulated)} ± {number(point.u_simulated or 0.0)}")
    if point.score is not None:
        parts.append(f"t′ {number(point.score.t, 2)} ({point.score.category})")
    if point.time is not None:
        parts.append(f"{clock_time(point.time)} UTC")
    return "   ".join(parts)
