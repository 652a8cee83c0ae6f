"""Numbers as people read them in a report."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike


def number(value: float, digits: int = 4) -> str:
    """A number to so many significant digits; a dash where there is none."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def fixed(value: float, decimals: int) -> str:
    """A number to so many decimals; a dash where there is none."""
    return "-" if not math.isfinite(value) else f"{value:.{decimals}f}"


def span(values: ArrayLike, decimals: int, unit: str = "") -> str:
    """Least and greatest of some values, one where they look the same."""
    array = np.asarray(values, dtype=float)
    if not np.any(np.isfinite(array)):
        return "-"
    low, high = (f"{end:.{decimals}f}" for end in (np.nanmin(array), np.nanmax(array)))
    return (low if low == high else f"{low} to {high}") + (f" {unit}" if unit else "")


def listed(values: Iterable[float]) -> str:
    """Values of a plan in short: steps where they are even, the list where it is not long, else its ends."""
    known = sorted(set(np.round(np.asarray(list(values), dtype=float), 6).tolist()))
    if len(known) > 4:
        steps = np.diff(known)
        if np.allclose(steps, steps[0]):
            return f"{known[0]:g} to {known[-1]:g} in steps of {steps[0]:g}"
    if len(known) <= 12:
        return ", ".join(f"{value:g}" for value in known)
    return f"{len(known)} values from {known[0]:g} to {known[-1]:g}"


def counted(number: int, what: str) -> str:
    """So many of something."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def moment(stamp: str) -> str:
    """Day and time of a record, to the second."""
    return stamp[:19].replace("T", " ")
