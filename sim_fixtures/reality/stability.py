"""Instability of the instrument as a function of the geometry: unit variance, repeatable, correlated in four ways."""

from __future__ import annotations

import numpy as np

from instrument.angles import direction
from sim_fixtures.reality.imperfections import CUT, StabilityKind

_FEATURES = 256
_CORRELATION_LENGTH = 25.0  # degree


class Stability:
    """A draw of the instability of one run.

    Parameters
    ----------
    kind
        Correlation: ``slice``, ``angle`` (a normal process of 25 degree correlation length), ``global``,
        ``independent``, or ``none``.
    seed
        Of the draw.
    """

    def __init__(self, kind: StabilityKind, seed: int) -> None:
        self._kind, self._seed = kind, seed
        generator = np.random.default_rng((seed, 3))
        # Random Fourier features (Rahimi and Recht 2007) of a Gaussian covariance over the unit sphere of sensor
        # directions and the illumination zenith, both in units of the correlation length.
        self._frequency = generator.standard_normal((_FEATURES, 4)) * (180.0 / np.pi / _CORRELATION_LENGTH)
        self._phase = generator.uniform(0.0, 2.0 * np.pi, _FEATURES)

    def value(self, illumination_zenith: float, sensor_zenith: float, sensor_azimuth: float) -> float:
        """The draw at a geometry (degree), of zero mean and about unit standard deviation over seeds."""
        if self._kind == "none":
            return 0.0
        if self._kind == "global":
            return float(np.clip(self._hashed(), -CUT, CUT))
        if self._kind == "slice":
            return self._hashed(round(2 * illumination_zenith), round(2 * sensor_azimuth))
        if self._kind == "independent":
            return self._hashed(*(round(10 * angle) for angle in (illumination_zenith, sensor_zenith, sensor_azimuth)))
        place = np.append(direction(sensor_zenith, sensor_azimuth), np.deg2rad(illumination_zenith))
        return float(np.sqrt(2.0 / _FEATURES) * np.sum(np.cos(self._frequency @ place + self._phase)))

    def _hashed(self, *key: int) -> float:
        words = [self._seed, *(part % 2**32 for part in key)]
        return float(np.random.default_rng((4, *words)).standard_normal())
