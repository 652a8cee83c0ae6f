"""Linearity of the detector by flux superposition: two beams, each alone and both together.

A linear detector reads the sum of what it reads of each. Where it does not, its departure follows without any standard:
let the light be proportional to V - a V^2 with V the net volts; then of beams A and B

    V(AB) - V(A) - V(B) = a (V(AB)^2 - V(A)^2 - V(B)^2),

linear in a. The two beams are two lines of an acousto-optic filter at different wavelengths (they do not interfere), or
two apertures that a person opens and closes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, Protocol

import numpy as np

from drivers.errors import DeviceFault
from drivers.interfaces import ChannelSelector
from instrument.control import ensure
from instrument.errors import InputError
from instrument.procedures.reading import Level, Reader, beyond, least_squares, mean_of_repeats, worst
from instrument.procedures.results import Finding, Quantity
from instrument.procedures.room import Room
from instrument.prompts import Prompt

Way = Literal["channels", "apertures"]
#: Of full scale, both beams together at full light; each next level has half of it.
_TARGET = 0.9
#: Order of the readings: each state's mean belongs to the same moment, so that a steady drift cancels.
_ORDER = ("a", "b", "ab", "ab", "b", "a")


class Beams(Protocol):
    """Two beams that can be let through one by one."""

    def show(self, which: str) -> None:
        """Let ``a``, ``b`` or ``ab`` through."""
        ...


class ChannelBeams:
    """Two lines of a filter; the second one is closed again by :func:`two_beams`."""

    def __init__(self, selector: ChannelSelector, wavelength: float, distance: float) -> None:
        self._selector = selector
        self._lines = {"a": (selector.channel, wavelength), "b": ((selector.channel + 1) % 8, wavelength + distance)}

    def show(self, which: str) -> None:
        """Open the lines that are wanted and close the others."""
        for name, (channel, wavelength) in self._lines.items():
            wanted = self._selector.amplitude if name in which else 0.0
            ensure(
                lambda c=channel, w=wavelength, v=wanted: self._selector.set_channel(c, w, v),  # type: ignore[misc]
                lambda c=channel, v=wanted: abs(self._selector.channel_amplitude(c) - v) < 0.002,  # type: ignore[misc]
                "selector",
            )

    def close(self) -> None:
        """Only the usual line is left open."""
        self.show("a")


class ApertureBeams:
    """Two apertures in the beam, in a person's hands."""

    def __init__(self, room: Room) -> None:
        self._room = room

    def show(self, which: str) -> None:
        """Have the apertures set."""
        states = ", ".join(f"aperture {name.upper()} {'open' if name in which else 'closed'}" for name in "ab")
        self._room.ask(Prompt(key=f"apertures:{which}", title=f"Set {states}", text="The shutter is closed."))


@contextmanager
def two_beams(room: Room, way: Way, wavelength: float, distance: float) -> Iterator[Beams]:
    """The beams of a way; afterwards the light is as a scan expects it.

    Raises
    ------
    InputError
        If the filter has no channels that can be opened together.
    """
    if way == "apertures":
        apertures = ApertureBeams(room)
        yield apertures
        apertures.show("ab")
        return
    selector = room.laboratory.selector
    if not isinstance(selector, ChannelSelector):
        raise InputError("this filter has one channel; add fluxes with two apertures: --way apertures")
    lines = ChannelBeams(selector, wavelength, distance)
    try:
        yield lines
    finally:
        lines.close()


def linearity(
    room: Room,
    wavelength: float = 500.0,
    way: Way = "channels",
    gain: float | None = None,
    levels: int = 4,
    repeats: int = 3,
    samples: int = 9,
    distance: float = 30.0,
) -> Finding:
    """Measure how far the detector's response departs from a straight line, with the reference on the stage.

    Parameters
    ----------
    gain
        V/A; the highest of the amplifier by default.
    levels
        Number of levels of light, each half of the one before.
    distance
        Between the wavelengths of two lines, nm.

    Raises
    ------
    InputError
        If there is no such gain, or the filter cannot add.
    """
    room.home()
    room.mount("reference")
    room.light()
    room.go_to_reference(wavelength)
    reader = Reader(room, samples)
    chosen = max(reader.gains) if gain is None else gain
    if chosen not in reader.gains:
        raise InputError(f"--gain: found {chosen:g}; expected one of {', '.join(f'{g:g}' for g in reader.gains)} V/A")
    rows: list[list[Level]] = []
    with two_beams(room, way, wavelength, distance) as beams:
        beams.show("ab")
        top = reader.tune_power(chosen, _TARGET * reader.full_scale)
        for number in range(levels):
            power = reader.set_power(top / 2**number)
            room.say(f"{100 * power:.1f} % power")
            for _ in range(repeats):
                rows.append(_added(reader, beams, chosen))
    return _finding(room, rows, chosen, levels)


def _added(reader: Reader, beams: Beams, gain: float) -> list[Level]:
    """Net levels of A, B and both, each from two readings around the same moment."""
    seen: dict[str, list[Level]] = {"a": [], "b": [], "ab": []}
    shown = ""
    for which in _ORDER:
        if which != shown:
            beams.show(which)
            shown = which
        level = reader.level(gain)
        assert level is not None
        seen[which].append(level)
    means = []
    for pair in seen.values():
        volts, u = mean_of_repeats([p.volts for p in pair], [p.u for p in pair])
        means.append(Level(volts, u, pair[0].dark, gain, (pair[0].time + pair[1].time) / 2))
    return means


def _finding(room: Room, rows: list[list[Level]], gain: float, levels: int) -> Finding:
    a, b, both = (np.array([row[column].volts for row in rows]) for column in range(3))
    # Pooled: what scatters is the source, in proportion to the light, and the read-out.
    relative = np.sqrt(np.mean([(level.u / level.volts) ** 2 for row in rows for level in row]))
    errors = relative * np.sqrt(a**2 + b**2 + both**2)
    if not np.all(errors > 0):
        raise DeviceFault(
            "detector", "readings do not scatter at all", "look whether the meter triggers anew each time"
        )
    parameter, covariance, chi_square = least_squares((both**2 - a**2 - b**2)[:, None], both - a - b, errors)
    slope, u_slope = float(parameter[0]), float(np.sqrt(covariance[0, 0]))
    full = room.laboratory.detector.full_scale
    departure, u = slope * full, u_slope * full
    top = float(both.max())
    allowed = worst(room.facility.budget.detector_linearity)
    failed = beyond(slope * top, u_slope * top, allowed)
    values = {
        "departure at full scale": Quantity(value=departure, u=u, unit="1"),
        "departure at the top level": Quantity(value=slope * top, u=u_slope * top, unit="1"),
        "coefficient": Quantity(value=slope, u=u_slope, unit="V-1"),
        "top level": Quantity(value=top, unit="V"),
        "lowest level": Quantity(value=float(min(a.min(), b.min())), unit="V"),
        "reduced chi-square": Quantity(value=chi_square if np.isfinite(chi_square) else 0.0, unit="1"),
    }
    seen = f"{100 * slope * top:+.3f} ± {100 * u_slope * top:.3f} % at {top:.3g} V, {gain:g} V/A, {levels} levels"
    advice = ("measure at lower signals, or state the departure in the budget's row detector_linearity",)
    return Finding(
        verdict="failed" if failed else "passed",
        summary=f"response departs from a straight line by {seen}",
        values=values,
        advice=advice if failed else (),
        readings=tuple(
            level.record(beam=name) for row in rows for name, level in zip(("a", "b", "ab"), row, strict=True)
        ),
    )
