"""Guesses at the unit of numbers that a person wrote: radians for degrees, micrometres for nanometres."""

from __future__ import annotations

import math
from collections.abc import Sequence

from instrument.errors import InputError

#: Largest angle in radians that an arm could mean, a little above pi/2 and pi.
_LARGEST_RAD = {
    "illumination_zenith": 1.58,
    "sensor_zenith": 1.58,
    "illumination_azimuth": 3.15,
    "sensor_azimuth": 3.15,
}
#: Other units of a wavelength: name, lowest and highest plausible number, nanometres in one.
_WAVELENGTH_UNITS = (
    ("metres", 1.5e-7, 5e-6, 1e9),
    ("millimetres", 1.5e-4, 5e-3, 1e6),
    ("micrometres", 0.15, 5.0, 1e3),
    ("angstroms", 3001.0, 30_000.0, 0.1),
)


def check_units(where: str, key: str, numbers: Sequence[float]) -> None:
    """Refuse numbers that look like another unit.

    Parameters
    ----------
    where, key
        File and key, for the message.
    numbers
        As they were written (start, stop and step of a range).

    Raises
    ------
    InputError
        Asking for the unit that was probably meant.
    """
    if key == "wavelength":
        unit = wavelength_unit(numbers)
        if unit is not None:
            raise InputError(f"{where}: wavelength: found {numbers[0]:g}; expected nm (are these {unit}?)")
    elif key in _LARGEST_RAD and looks_like_radians(numbers, _LARGEST_RAD[key]):
        shown = ", ".join(f"{number:g}" for number in numbers[:4])
        raise InputError(
            f"{where}: {key}: found {shown}{', ...' if len(numbers) > 4 else ''}; expected degrees (are these radians?"
            ' If they are degrees, say so with angle_unit = "degree" at the top of the plan)'
        )


def wavelength_unit(numbers: Sequence[float]) -> str | None:
    """Name of the unit, other than nm, in which all of the numbers would be wavelengths; None when none fits."""
    for name, low, high, _ in _WAVELENGTH_UNITS:
        if numbers and all(low <= number <= high for number in numbers):
            return name
    return None


def looks_like_radians(numbers: Sequence[float], largest: float) -> bool:
    """Whether angles are more plausible as radians than as degrees.

    They are when none is larger than ``largest`` and either they spread over more than one unit (a sweep over a
    degree is rare, one over a radian is not) or each is a whole number of degrees once converted and is
    written with more decimals than anyone gives a degree.
    """
    nonzero = [number for number in numbers if number != 0]
    if not nonzero or max(abs(number) for number in nonzero) > largest:
        return False
    spread = max(numbers) - min(numbers)
    return spread > 1.0 or all(_whole_degrees(number) for number in nonzero)


def _whole_degrees(number: float) -> bool:
    converted = math.degrees(number)
    finely_written = abs(number * 100 - round(number * 100)) > 1e-9
    return finely_written and abs(converted - round(converted)) < 0.03
