"""Where measurement and simulation differ: points, and regions said in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import log_sum
from twin.diagnosis.likelihood import Normal
from twin.diagnosis.observation import Observation
from twin.diagnosis.turned import in_words, rotation
from twin.diagnosis.unknown import UNKNOWN_SIZES

#: Regions of fewer points are left to the union of their illumination zenith.
_FEWEST = 3
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Region:
    """Points that differ, and why they belong together.

    Attributes
    ----------
    points
        Numbers along the run's usable points.
    description
        In words.
    strength
        Root mean square of the gap there over the combined uncertainty.
    """

    points: IntArray
    description: str
    strength: float


def regions(run: Observation, gap: FloatArray) -> list[Region]:
    """Regions where a gap exceeds the run's uncertainty.

    Parameters
    ----------
    gap, shape (point,)
        Relative, without noise.
    """
    size = np.abs(gap) / run.relative_u
    found = []
    turned = rotation(run.columns)
    for number, angle in np.unique(np.stack([run.illumination, turned], axis=1), axis=0):
        here = (run.illumination == number) & (turned == angle)
        for name, side in _sides(run.columns["sensor_zenith"]):
            points = np.flatnonzero(here & side & (size > 1.0))
            if len(points) >= _FEWEST:
                found.append(_region(run, points, gap, name))
        rest = np.flatnonzero(here & (size > 1.0))
        left = np.setdiff1d(rest, np.concatenate([r.points for r in found]) if found else rest[:0])
        if len(left):
            found.append(_region(run, left, gap, "single directions"))
    return sorted(found, key=lambda region: -region.strength)


def _sides(zenith: FloatArray) -> list[tuple[str, NDArray[np.bool_]]]:
    return [
        ("sensor zenith below -10 degrees", zenith < -10),
        ("sensor zenith from -10 to 10 degrees", np.abs(zenith) <= 10),
        ("sensor zenith above 10 degrees", zenith > 10),
    ]


def _region(run: Observation, points: IntArray, gap: FloatArray, name: str) -> Region:
    zenith = run.columns["sensor_zenith"][points]
    azimuths = np.unique(np.round(run.columns["sensor_azimuth"][points], 2))
    light = run.columns["illumination_zenith"][points[0]]
    size = float(np.sqrt(np.mean((gap[points] / run.relative_u[points]) ** 2)))
    sign = "higher" if np.mean(gap[points]) > 0 else "lower"
    where = name if name.startswith("single") else f"sensor zenith {zenith.min():g} to {zenith.max():g} degrees"
    every = "every azimuth" if len(azimuths) == _planes(run, points) else _listed(azimuths)
    text = (
        f"measurement {sign} by {100 * np.sqrt(np.mean(gap[points] ** 2)):.1f} % at {where}, {every},"
        f" illumination zenith {light:g} degrees{in_words(run.columns, int(points[0]))}"
    )
    return Region(points, text, size)


def _planes(run: Observation, points: IntArray) -> int:
    turned = rotation(run.columns)
    same = (run.illumination == run.illumination[points[0]]) & (turned == turned[points[0]])
    return len(np.unique(np.round(run.columns["sensor_azimuth"][same], 2)))


def _listed(azimuths: FloatArray) -> str:
    return f"azimuth {', '.join(f'{a:g}' for a in azimuths)}"


def unknown_gap(
    residual: FloatArray, members: Sequence[Normal], shapes: Sequence[tuple[str, FloatArray]], relative_u: FloatArray
) -> FloatArray:
    """Posterior mean of a smooth gap of unknown cause, shape (point,), in the logarithm."""
    means, weights = [], []
    for member in members:
        for _, shape in shapes:
            for size in UNKNOWN_SIZES:
                gap = shape * np.outer(size * relative_u, size * relative_u)
                wide = Normal(member.name, member.log_weight, member.covariance + gap)
                white = wide.white(residual)
                means.append(gap @ (wide.whitener.T @ white))
                weights.append(wide.log_density(residual) + member.log_weight)
    share = np.exp(np.array(weights) - log_sum(np.array(weights)))
    return np.asarray(share @ np.array(means))


def dark_uncertainty(residual: FloatArray, members: Sequence[Normal], shapes: Sequence[FloatArray]) -> float:
    """Relative standard uncertainty missing from the budget: the size of an extra error that explains the run best.

    Parameters
    ----------
    shapes
        Correlation matrices that the extra error may have.
    """
    best, found = -np.inf, 0.0
    for size in (0.0, *np.geomspace(0.001, 0.1, 15)):
        for shape in shapes[: 1 if size == 0 else None]:
            values = [
                Normal(m.name, m.log_weight, m.covariance + size**2 * shape).log_density(residual) + m.log_weight
                for m in members
            ]
            density = float(log_sum(np.array(values)))
            if density > best:
                best, found = density, float(size)
    return found
