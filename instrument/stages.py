"""What an instrument may have beside its arms: a stage that turns the sample, and a motorised polariser.

The polariser's axis stands at 0 degrees in the plane of incidence (p) and at 90 across it (s). A point that asks for
the mean is read with both, one after the other, and its reading is the mean of the two.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from drivers.interfaces import Axis, AxisLimits
from instrument.acquisition import Burst
from instrument.approach import Leg, beyond_target, one_sided
from instrument.errors import InputError
from instrument.events import Geometry, Polarization
from instrument.facility import Arms
from instrument.motion import Mover

#: Angle of the polariser's axis from the plane of incidence, degree.
POLARIZER_ANGLES: dict[Polarization, float] = {"s": 90.0, "p": 0.0}
ROTATION, POLARIZER = "sample_rotation", "polarizer"


def parts_of(polarization: Polarization | None) -> tuple[Polarization | None, ...]:
    """Polarisations that a point is read with, one after the other."""
    return ("s", "p") if polarization == "mean" else (polarization,)


class Stages:
    """Moves the stages that are there.

    Parameters
    ----------
    axes
        By role.
    arms
        What the facility allows.
    mover
        Moves them like arms.
    """

    def __init__(self, axes: Mapping[str, Axis], arms: Arms, mover: Mover) -> None:
        self._limits = {name: axis.limits for name, axis in axes.items()}
        self._tolerance = {name: axis.tolerance for name, axis in axes.items()}
        self._arms, self._mover = arms, mover
        self._commanded: dict[str, float] = {}

    def check(self, points: Iterable[Geometry]) -> None:
        """Refuse what no stage is there for, or none can reach; errors as :func:`check_stages`."""
        check_stages(points, self._limits, self._arms)

    def go(self, geometry: Geometry) -> None:
        """Turn the sample, and the polariser to the first of what is to be read; errors as those of an arm."""
        if ROTATION in self._limits:
            self._move(ROTATION, geometry.sample_rotation)
        self.polarize(parts_of(geometry.polarization)[0])

    def polarize(self, polarization: Polarization | None) -> None:
        """Turn the polariser; None leaves it alone."""
        if polarization is not None:
            self._move(POLARIZER, POLARIZER_ANGLES[polarization])

    def forget(self) -> None:
        """Nobody knows any more where the stages were sent."""
        self._commanded.clear()

    def _move(self, name: str, target: float) -> None:
        for leg in self._legs(name, target):
            self._commanded.pop(name, None)
            self._mover.move(name, leg.target)
        self._commanded[name] = target

    def _legs(self, name: str, target: float) -> tuple[Leg, ...]:
        found, commanded = self._mover.readback_of(name), self._commanded.get(name)
        known = commanded is not None and abs(found - commanded) <= self._tolerance[name]
        start = commanded if known and commanded is not None else found
        return one_sided(Leg(name, start, target), self._limits[name], loose=not known)


def check_stages(points: Iterable[Geometry], limits: Mapping[str, AxisLimits], arms: Arms) -> None:
    """Refuse what no stage is there for, or none can reach.

    Parameters
    ----------
    limits
        Of every stage that is connected (of arms too, which are not looked at).

    Raises
    ------
    InputError
        Naming the stage, and what would have to be configured.
    """
    wanted: dict[str, set[float]] = {ROTATION: set(), POLARIZER: set()}
    unsaid = False
    for point in points:
        wanted[ROTATION].add(point.sample_rotation)
        unsaid |= point.polarization is None
        wanted[POLARIZER] |= {POLARIZER_ANGLES[part] for part in parts_of(point.polarization) if part is not None}
    if unsaid and POLARIZER in limits:
        raise InputError(
            "devices: polarizer: found, but the facility has none: nobody knows with which polarisation to measure;"
            " expected arms.polarizer in facility.toml"
        )
    for name, angles in wanted.items():
        needed = angles if name == POLARIZER else angles - {0.0}
        if needed and name not in limits:
            raise InputError(
                f"plan: asks for {name} {max(needed):g}, but devices.toml connects no such device;"
                f" expected a table [devices.{name}]"
            )
        for angle in sorted(angles) if name in limits else ():
            _check_angle(name, angle, limits[name], getattr(arms, name))


def _check_angle(name: str, angle: float, limits: AxisLimits, allowed: tuple[float, float] | None) -> None:
    low, high = (limits.lower, limits.upper) if allowed is None else _common(limits, allowed)
    for value in (angle, beyond_target(angle, limits)):
        if not low <= value <= high:
            first = "" if value == angle else f" (it would go to {value:g} first, to come from the right side)"
            raise InputError(
                f"plan: {name}: found {angle:g} degrees, beyond the stage; expected {low:g} to {high:g}{first}"
            )


def stage_legs(
    stands: dict[str, float], rotation: float, polarization: Polarization | None, limits: Mapping[str, AxisLimits]
) -> list[Leg]:
    """Moves of the stages that there are towards a rotation and a polarisation.

    Parameters
    ----------
    stands
        Where each stage was sent last, degree; brought up to date. One that is not in it stands at its zero.
    """
    wanted = {ROTATION: rotation} if ROTATION in limits else {}
    if POLARIZER in limits and polarization is not None:
        wanted[POLARIZER] = POLARIZER_ANGLES[polarization]
    legs: list[Leg] = []
    for name, target in wanted.items():
        legs += one_sided(Leg(name, stands.get(name, 0.0), target), limits[name], loose=name not in stands)
        stands[name] = target
    return legs


def _common(limits: AxisLimits, allowed: tuple[float, float]) -> tuple[float, float]:
    return max(limits.lower, allowed[0]), min(limits.upper, allowed[1])


def mean_of(read: Sequence[tuple[Polarization | None, Burst, dict[str, Any]]]) -> tuple[Burst, dict[str, Any]]:
    """The reading of a point that was read with several polarisations: the mean, in volts at the first one's gain.

    Returns
    -------
    Burst, dict
        As of a single reading; the record keeps each of them under ``parts``.
    """
    first = read[0][1]
    scale = [first.gain / burst.gain for _, burst, _ in read]
    bursts = [burst for _, burst, _ in read]

    def mean(columns: Sequence[Sequence[float]]) -> tuple[float, ...]:
        weighted = [[factor * value for value in column] for factor, column in zip(scale, columns, strict=True)]
        return tuple(sum(row) / len(row) for row in zip(*weighted, strict=True))

    flags = 0
    for burst in bursts:
        flags |= burst.quality_flag
    dark = mean([(burst.dark,) for burst in bursts])[0]
    whole = Burst(
        mean([burst.samples for burst in bursts]),
        dark,
        first.gain,
        flags,
        mean([burst.dark_samples for burst in bursts]),
    )
    kept = ("time", "signal", "dark", "gain", "quality_flag", "readback")
    record = read[-1][2] | {
        "time": read[0][2]["time"],
        "signal": whole.samples,
        "dark": whole.dark,
        "dark_signal": whole.dark_samples,
        "gain": whole.gain,
        "quality_flag": whole.quality_flag,
        "parts": [{"polarization": name} | {key: record[key] for key in kept} for name, _, record in read],
    }
    return whole, record
