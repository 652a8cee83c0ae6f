"""A smooth BRDF through scattered readings: Gaussian-process regression in coordinates that suit a rough surface.

The BRDF of an isotropic surface is a function of three numbers that are smooth everywhere, at the normal too: the
product of the horizontal parts of the two directions, sin i sin o cos phi, and the two cosines. The prior knows what
physics knows: it is the same for both orders of the two directions (reciprocity), and low polynomials of the three
numbers cost nearly nothing, so that beyond the readings the fit goes on like the trend. The rest varies over
:data:`LENGTH` and is small against the level.

The estimate is linear in the readings and its weights depend on the geometry alone. They are kept: another set of
readings in the same geometry costs one product of a matrix with a vector.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.2, 2.7 (explicit basis
functions) and 5.4.2 (leaving one out).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from instrument.angles import FloatArray

#: Distance in the three coordinates over which the deviation from the trend changes.
LENGTH = 0.6
#: Standard deviation of a reading's noise over that of the deviation from the trend.
NOISE = 1 / 30
#: Standard deviation of the trend's coefficients over that of the deviation from it.
_TREND = 10.0


@dataclass(frozen=True)
class Directions:
    """Pairs of directions; arrays of shape (pair,), radians.

    Attributes
    ----------
    incident_rad, emergent_rad
        Zenith angles.
    phi_rad
        Azimuth difference, 0 for backscatter.
    """

    incident_rad: FloatArray
    emergent_rad: FloatArray
    phi_rad: FloatArray

    def __len__(self) -> int:
        return len(self.incident_rad)

    def take(self, chosen: np.ndarray) -> Directions:
        """Some of the pairs."""
        return Directions(self.incident_rad[chosen], self.emergent_rad[chosen], self.phi_rad[chosen])

    def key(self) -> tuple[bytes, bytes, bytes]:
        """Equal for equal pairs."""
        return tuple(np.ascontiguousarray(a, float).tobytes() for a in self._arrays())  # type: ignore[return-value]

    @classmethod
    def of_key(cls, key: tuple[bytes, bytes, bytes]) -> Directions:
        """The pairs of a key."""
        return cls(*(np.frombuffer(part) for part in key))

    def _arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.incident_rad, self.emergent_rad, self.phi_rad


def smooth(readings: Directions, values: FloatArray, wanted: Directions) -> FloatArray:
    """Estimate the BRDF, or the reflectance factor, in other directions.

    Parameters
    ----------
    readings
        Where it was measured.
    values, shape (reading,)
    wanted
        Where it is asked for.
    """
    mean = float(np.mean(values))
    return np.asarray(mean + _weights(readings.key(), wanted.key()) @ (values - mean))


def left_out(readings: Directions, values: FloatArray) -> FloatArray:
    """Estimate at each reading from all the others."""
    inverse = _inverse(readings.key())
    centred = values - float(np.mean(values))
    return np.asarray(values - (inverse @ centred) / np.diag(inverse))


@lru_cache(maxsize=16)
def _weights(readings: tuple[bytes, bytes, bytes], wanted: tuple[bytes, bytes, bytes]) -> FloatArray:
    """Weights of the readings, shape (wanted, reading)."""
    known, asked = Directions.of_key(readings), Directions.of_key(wanted)
    return np.asarray(cho_solve(_factor(readings), _covariance(asked, known).T).T)


@lru_cache(maxsize=4)
def _inverse(readings: tuple[bytes, bytes, bytes]) -> FloatArray:
    return np.asarray(cho_solve(_factor(readings), np.eye(len(readings[0]) // 8)))


@lru_cache(maxsize=8)
def _factor(readings: tuple[bytes, bytes, bytes]) -> tuple[FloatArray, bool]:
    known = Directions.of_key(readings)
    factor, lower = cho_factor(_covariance(known, known) + NOISE**2 * np.eye(len(known)))
    return factor, bool(lower)


def _covariance(a: Directions, b: Directions) -> FloatArray:
    """Prior covariance, reciprocal in both arguments; shape (a, b)."""
    p, q = _coordinates(a), _coordinates(b)
    near = np.exp(-_squared(p, q) / (2 * LENGTH**2))
    swapped = np.exp(-_squared(p[:, [0, 2, 1]], q) / (2 * LENGTH**2))
    return np.asarray((near + swapped) / 2 + _TREND**2 * _trend(p) @ _trend(q).T)


def _coordinates(directions: Directions) -> FloatArray:
    across = np.sin(directions.incident_rad) * np.sin(directions.emergent_rad) * np.cos(directions.phi_rad)
    return np.stack([across, np.cos(directions.incident_rad), np.cos(directions.emergent_rad)], axis=1)


def _trend(coordinates: FloatArray) -> FloatArray:
    across, i, o = coordinates.T
    return np.stack([np.ones_like(across), across, across**2, across**3, i + o, i * o], axis=1)


def _squared(p: FloatArray, q: FloatArray) -> FloatArray:
    return np.asarray(np.sum(p**2, axis=1)[:, None] + np.sum(q**2, axis=1) - 2 * p @ q.T)
