"""How the errors of a run's readings may be correlated, when nobody says so.

A budget names a standard deviation for the stability of the instrument, not its correlation. Whether it is a new draw
at each point, one for a slice, or a slow wander decides what counts as a gap: with the wrong choice almost every sound
run is declared faulty. So every plausible structure is kept, and the conclusions are averaged over them, weighted by
how well each explains the run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from instrument.angles import FloatArray, direction
from twin.diagnosis.observation import Observation
from twin.diagnosis.turned import ROTATION, from_sample

#: Correlation lengths in the sensor zenith of a wander within a slice, degree.
LENGTHS = (6.0, 10.0, 16.0, 25.0, 40.0, 60.0)
#: The same of a wander over all directions, one slice after the other.
OVER_DIRECTIONS = (12.0, 25.0, 45.0)
#: Standard deviation of the stability over the stated one, and prior weights.
SCALES = {0.6: 0.2, 1.0: 0.55, 1.5: 0.25}
#: Points of a block: what one may be read of a session between two looks at the reference.
BLOCKS = (6, 11, 20, 30, 45)
#: Correlation times of a wander, as shares of the run.
TIMES = (0.03, 0.1, 0.3)
#: Shares of the variance when a file states nothing but the combined uncertainty.
_NOISE_SHARE, _STABILITY_SHARE = 0.25, 0.5
#: Components that are neither noise nor stability are systematic: the physics of their effects describes them.
INDEPENDENT, UNSTATED = "noise", "stability"


@dataclass(frozen=True)
class Structure:
    """One way in which the readings' errors may be correlated.

    Attributes
    ----------
    name
        In words.
    weight
        Prior probability.
    covariance, shape (point, point)
        Of relative errors: noise and stability.
    """

    name: str
    weight: float
    covariance: FloatArray


def structures(run: Observation) -> list[Structure]:
    """Every structure that is considered, with prior weights that add up to 1."""
    noise, stability = noise_and_stability(run)
    if not np.any(stability > 0):
        return [Structure("none", 1.0, np.diag(noise**2))]
    found = []
    for name, weight, correlation in correlations(run):
        for scale, share in SCALES.items():
            spread = scale * stability
            covariance = np.diag(noise**2) + correlation * np.outer(spread, spread)
            found.append(Structure(f"{name}, {scale:g} times the budget", weight * share, covariance))
    found.append(Structure("noise alone", 0.05, np.diag(noise**2)))
    total = sum(s.weight for s in found)
    return [Structure(s.name, s.weight / total, s.covariance) for s in found]


def noise_and_stability(run: Observation) -> tuple[FloatArray, FloatArray]:
    """Relative standard deviations of independent noise and of the stability, shape (point,) each."""
    if INDEPENDENT in run.components and UNSTATED in run.components:
        return run.components[INDEPENDENT] / run.brf, run.components[UNSTATED] / run.brf
    u = run.relative_u
    return np.sqrt(_NOISE_SHARE) * u, np.sqrt(_STABILITY_SHARE) * u


def correlations(run: Observation) -> list[tuple[str, float, FloatArray]]:
    """Name, weight and correlation matrix of the kinds of stability."""
    plane, zenith = run.plane, run.columns["sensor_zenith"]
    same = (plane[:, None] == plane[None, :]).astype(float)
    count = len(run)
    slow = {length: same * _bell(zenith, length) for length in LENGTHS}
    kinds = [
        ("independent", 0.12, np.eye(count)),
        ("one factor", 0.12, np.ones((count, count))),
        ("one factor a slice", 0.2, same),
        *((f"wander over {length:g} degrees", 0.3 / len(LENGTHS), matrix) for length, matrix in slow.items()),
        ("half a slice, half wander", 0.06, 0.5 * same + 0.5 * slow[25.0]),
        ("half a slice, half independent", 0.04, 0.5 * same + 0.5 * np.eye(count)),
        *(
            (f"smooth over directions, {length:g} degrees", 0.12 / len(OVER_DIRECTIONS), over_directions(run, length))
            for length in OVER_DIRECTIONS
        ),
        *(
            (f"wander in time, {share:g} of the run", 0.08 / len(TIMES), _decaying(run.progress, share))
            for share in TIMES
        ),
    ]
    order = np.argsort(np.argsort(run.progress, kind="stable"), kind="stable")
    for length in BLOCKS:
        block = order // length
        kinds.append(
            (f"blocks of {length} points", 0.08 / len(BLOCKS), (block[:, None] == block[None, :]).astype(float))
        )
    return kinds


def _bell(place: FloatArray, length: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * ((place[:, None] - place[None, :]) / length) ** 2))


def _decaying(place: FloatArray, length: float) -> FloatArray:
    """Of a random walk that is pulled back (Ornstein and Uhlenbeck)."""
    return np.asarray(np.exp(-np.abs(place[:, None] - place[None, :]) / length))


def over_directions(run: Observation, length_deg: float) -> FloatArray:
    """Smooth over sensor directions and illumination zenith."""
    columns = run.columns
    view = direction(columns["sensor_zenith"], columns["sensor_azimuth"])
    light = np.deg2rad(columns["illumination_zenith"])
    return _near(np.concatenate([view, light[:, None]], axis=1), length_deg)


def _near(place: FloatArray, length_deg: float) -> FloatArray:
    squared = np.sum((place[:, None] - place[None, :]) ** 2, axis=2)
    return np.asarray(np.exp(-0.5 * squared / np.deg2rad(length_deg) ** 2))


def _over_gap_directions(run: Observation, length_deg: float) -> FloatArray:
    """Smooth over directions of the laboratory; where the sample is turned, half of it over those that it sees.

    Whether a gap of unknown cause turns with the sample is not known.
    """
    of_laboratory = over_directions(run, length_deg)
    if ROTATION not in run.columns:
        return of_laboratory
    seen = from_sample(run.columns)
    view = direction(seen["sensor_zenith"], seen["sensor_azimuth"])
    light = direction(seen["illumination_zenith"], seen["illumination_azimuth"])
    return 0.5 * (of_laboratory + _near(np.concatenate([view, light], axis=1), length_deg))


def smooth_gap(run: Observation) -> list[tuple[str, FloatArray]]:
    """Correlation matrices of a gap of unknown cause, unit variance: smooth in direction, in time, or steps."""
    columns = run.columns
    zenith, same_light = columns["sensor_zenith"], run.illumination[:, None] == run.illumination[None, :]
    progress = run.progress
    along = _bell(zenith, 20.0)
    steps = 1.0 - np.abs(progress[:, None] - progress[None, :])
    return [
        ("smooth over directions, 20 degrees", _over_gap_directions(run, 20.0)),
        ("smooth over directions, 45 degrees", _over_gap_directions(run, 45.0)),
        ("the same in every plane", along),
        ("the same in the planes of an illumination", along * same_light),
        ("a sequence of steps in time", steps),
        ("local, 8 degrees", _over_gap_directions(run, 8.0)),
    ]
