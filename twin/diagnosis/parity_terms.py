"""Simple causes of an asymmetry: how each changes the reading of a direction, and how large it would have to be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from instrument.angles import FloatArray
from twin.diagnosis.observation import Observation
from twin.diagnosis.turned import from_sample

IntArray = NDArray[np.int64]
_DEGREE = np.pi / 180
#: A pattern that changes no pair by more than this (relative, for one unit) is not seen.
_UNSEEN = 1e-9


@dataclass(frozen=True)
class Term:
    """A simple cause of asymmetry, and how large it would have to be.

    Attributes
    ----------
    name, meaning
        In words.
    unit
        Of the amplitude.
    amplitude, u
        With standard uncertainty (k = 1).
    p_value
        Probability of an amplitude so far from zero by chance, after the number of terms that were tried.
    explained
        Share of the asymmetry's chi-square beyond chance that the term explains.
    """

    name: str
    meaning: str
    unit: str
    amplitude: float
    u: float
    p_value: float
    explained: float


@dataclass(frozen=True)
class Place:
    """Angles of points in rad, shape (point,), and their progress in the run from 0 to 1.

    Azimuths of the arms, and of sensor and light as a sample sees them that may have been turned.
    """

    sensor_zenith_rad: FloatArray
    sensor_azimuth_rad: FloatArray
    light_zenith_rad: FloatArray
    light_azimuth_rad: FloatArray
    seen_sensor_azimuth_rad: FloatArray
    seen_light_azimuth_rad: FloatArray
    progress: FloatArray

    @classmethod
    def of(cls, run: Observation) -> Place:
        """Of a run's points."""
        names = ("sensor_zenith", "sensor_azimuth", "illumination_zenith", "illumination_azimuth")
        zenith, azimuth, light_zenith, light_azimuth = (np.deg2rad(run.columns[name]) for name in names)
        seen = from_sample(run.columns)
        sensor, light = (np.deg2rad(seen[name]) for name in ("sensor_azimuth", "illumination_azimuth"))
        return cls(zenith, azimuth, light_zenith, light_azimuth, sensor, light, run.progress)


Pattern = Callable[[Place], FloatArray]


@dataclass(frozen=True)
class _Cause:
    """Relative change of a reading by one unit of a cause, to first order, for a nearly diffuse sample."""

    name: str
    meaning: str
    unit: str
    pattern: Pattern


#: A sample tilted by small angles (x, y) has the normal (y, -x, 1): the cosine to a direction changes relatively by
#: tan(zenith) (y cos(azimuth) - x sin(azimuth)).
_CAUSES = (
    _Cause(
        "tilt about x",
        "a tilt of the sample about the x axis (or a wedge), as the sensor sees it",
        "degree",
        lambda p: -_DEGREE * np.tan(p.sensor_zenith_rad) * np.sin(p.seen_sensor_azimuth_rad),
    ),
    _Cause(
        "tilt about y",
        "a tilt of the sample about the y axis (or a wedge), as the sensor sees it",
        "degree",
        lambda p: _DEGREE * np.tan(p.sensor_zenith_rad) * np.cos(p.seen_sensor_azimuth_rad),
    ),
    _Cause(
        "tilt about x, light",
        "a tilt of the sample about the axis of illumination azimuth 0 (or a wedge), as the light sees it",
        "degree",
        lambda p: -_DEGREE * np.tan(p.light_zenith_rad) * np.sin(p.seen_light_azimuth_rad),
    ),
    _Cause(
        "tilt about y, light",
        "a tilt of the sample about the axis of illumination azimuth 90 (or a wedge), as the light sees it",
        "degree",
        lambda p: _DEGREE * np.tan(p.light_zenith_rad) * np.cos(p.seen_light_azimuth_rad),
    ),
    _Cause(
        "illumination out of its plane",
        "light from beside the plane of incidence",
        "degree",
        lambda p: (
            _DEGREE
            * np.tan(p.light_zenith_rad)
            * np.sin(p.sensor_azimuth_rad - p.light_azimuth_rad)
            * np.sign(p.sensor_zenith_rad)
        ),
    ),
    _Cause(
        "sensor zenith zero",
        "an error of the sensor zenith's zero",
        "degree",
        lambda p: -_DEGREE * np.tan(p.sensor_zenith_rad),
    ),
    _Cause(
        "sensor axis beside the centre",
        "a sensor axis displaced sideways, or a beam off the centre",
        "per cent at 90 degrees",
        lambda p: 0.01 * np.sin(p.sensor_zenith_rad),
    ),
    _Cause(
        "polarisation",
        "a detector that responds to polarisation, or an anisotropic sample",
        "per cent at 90 degrees",
        lambda p: 0.01 * np.cos(2 * p.sensor_azimuth_rad) * np.sin(p.sensor_zenith_rad) ** 2,
    ),
    _Cause("drift", "a drift of source or detector", "per cent over the run", lambda p: 0.01 * p.progress),
)


def fit_terms(
    run: Observation, pairs: IntArray, difference: FloatArray, covariances: Sequence[FloatArray], weights: FloatArray
) -> tuple[Term, ...]:
    """Every simple cause alone, the most significant first.

    Parameters
    ----------
    pairs, shape (pair, 2), difference, shape (pair,)
        Points that should read alike, and the logarithm of the ratio of their readings.
    covariances, weights
        Of the differences, for every structure of the errors.
    """
    place, rank, found = Place.of(run), len(difference), []
    total = float(weights @ np.array([square(difference, c) for c in covariances]))
    for cause in _CAUSES:
        column = cause.pattern(place)
        slope = column[pairs[:, 0]] - column[pairs[:, 1]]
        if np.sqrt(np.mean(slope**2)) < _UNSEEN:
            continue
        fits = [_amplitude(slope, difference, c) for c in covariances]
        value = float(weights @ np.array([a for a, _, _ in fits]))
        variance = float(weights @ np.array([u**2 + (a - value) ** 2 for a, u, _ in fits]))
        gain = float(weights @ np.array([g for _, _, g in fits]))
        p_value = min(1.0, 2 * float(norm.sf(abs(value) / np.sqrt(variance))) * len(_CAUSES))
        explained = min(1.0, gain / max(total - rank, gain, 1e-12))
        found.append(Term(cause.name, cause.meaning, cause.unit, value, float(np.sqrt(variance)), p_value, explained))
    return tuple(sorted(found, key=lambda term: (term.p_value, -term.explained)))


def _amplitude(slope: FloatArray, difference: FloatArray, covariance: FloatArray) -> tuple[float, float, float]:
    """Generalised least squares of one amplitude: value, standard uncertainty, decrease of chi-square."""
    weighed = np.linalg.solve(covariance, slope)
    information = float(slope @ weighed)
    value = float(weighed @ difference) / information
    return value, float(1 / np.sqrt(information)), value**2 * information


def square(difference: FloatArray, covariance: FloatArray) -> float:
    """Chi-square of differences."""
    return float(difference @ np.linalg.solve(covariance, difference))
