"""Straight above the sample: at the sensor's zenith 0 the azimuth between light and sensor cannot matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.observation import Observation
from twin.diagnosis.turned import rotation

_SAME = 0.05
#: Points and span of azimuths (degree) that a fit needs at least.
_FEWEST, _SPAN = 4, 60.0
#: An amplitude of fewer standard uncertainties is not told from chance.
_CLEAR = 2.0
#: Powers of tan(illumination zenith) that still count as growth with it.
_POWERS = (0.5, 1.7)


@dataclass(frozen=True)
class Nadir:
    """How the reading straight above the sample depends on the azimuth, at one illumination zenith.

    Attributes
    ----------
    illumination_zenith
        Degree.
    amplitude, u
        Of a constant plus amplitude sin(azimuth), relative to the mean, with standard uncertainty from the scatter.
    points
        Of the fit.
    """

    illumination_zenith: float
    amplitude: float
    u: float
    points: int

    @property
    def tilt_deg(self) -> float:
        """Tilt of the sample that would make it: light falls on it with the cosine changed by tan(zenith) tilt."""
        return float(np.rad2deg(abs(self.amplitude) / np.tan(np.deg2rad(self.illumination_zenith))))


def at_nadir(run: Observation, left_out: NDArray[np.int64]) -> tuple[Nadir, ...]:
    """The azimuth's effect at sensor zenith 0 and oblique light, for each illumination zenith.

    Parameters
    ----------
    left_out
        Points that are not used.
    """
    columns = run.columns
    azimuth = columns["sensor_azimuth"] - columns["illumination_azimuth"]
    # Of a sample turned by hands the arm may come from the other side: at zenith 0 the sign alone tells so.
    other_side = (rotation(columns) != 0) & np.signbit(columns["sensor_zenith"])
    azimuth = azimuth + np.where(other_side, 180.0, 0.0)
    above = np.abs(columns["sensor_zenith"]) < _SAME
    above[left_out] = False
    found = []
    for light in np.unique(np.round(columns["illumination_zenith"][above], 2)):
        here = above & (np.abs(columns["illumination_zenith"] - light) < _SAME)
        if abs(light) < 1.0 or np.sum(here) < _FEWEST or np.ptp(azimuth[here]) < _SPAN:
            continue
        found.append(_sine(float(light), np.deg2rad(azimuth[here]), run.brf[here]))
    return tuple(found)


def _sine(light: float, azimuth_rad: FloatArray, brf: FloatArray) -> Nadir:
    """The azimuth of the light counts from the sensor's: that of the sensor from the light, reversed."""
    basis = np.stack([np.ones_like(azimuth_rad), np.sin(-azimuth_rad)], axis=1)
    relative = brf / np.mean(brf)
    solution, *_ = np.linalg.lstsq(basis, relative, rcond=None)
    rest = relative - basis @ solution
    variance = float(rest @ rest) / (len(brf) - 2)
    u = np.sqrt(variance * np.linalg.inv(basis.T @ basis)[1, 1])
    return Nadir(light, float(solution[1]), float(u), len(brf))


def in_words(found: Sequence[Nadir]) -> list[str]:
    """What the azimuth does straight above the sample, and what that suggests."""
    clear = [n for n in found if abs(n.amplitude) > _CLEAR * n.u]
    if not clear:
        return []
    sizes = ", ".join(f"{100 * n.amplitude:.2f} +- {100 * n.u:.2f} % at {n.illumination_zenith:g}" for n in found)
    text = "At sensor zenith 0 the azimuth cannot matter; the reading varies as sin(azimuth of the light) by"
    lines = [f"{text} {sizes} degrees illumination zenith."]
    power = growth(found)
    alike = len({np.sign(n.amplitude) for n in clear}) == 1
    if len(clear) >= 2 and alike and power is not None and _POWERS[0] <= power <= _POWERS[1]:
        tilts = [n.tilt_deg for n in clear]
        lines.append(
            f"That grows about as tan(illumination zenith) (power {power:.1f}): the sign of a sample tilted by"
            f" {min(tilts):.1f} to {max(tilts):.1f} degrees against the axis about which the light is turned."
        )
        lines.append(
            "It cannot confirm a tilt: a light beam that wanders off the sample's centre as it is turned, or a wedge,"
            " looks alike; turn the sample by 180 degrees on its mount and repeat: a tilt of the sample changes sign."
        )
    else:
        lines.append("It does not grow as tan(illumination zenith) with one sign: no tilt alone makes it.")
    return lines


def growth(found: Sequence[Nadir]) -> float | None:
    """Power of tan(illumination zenith) with which the amplitude grows; None with fewer than two angles."""
    used = [n for n in found if n.amplitude != 0]
    if len(used) < 2:
        return None
    tangent = np.log([np.tan(np.deg2rad(abs(n.illumination_zenith))) for n in used])
    return float(np.polyfit(tangent, np.log([abs(n.amplitude) for n in used]), 1)[0])
