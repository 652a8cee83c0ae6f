"""Families of instability: how the instrument's 0.82 % may be correlated along a scan. Nobody is told which."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from instrument.angles import FloatArray, direction
from sim_fixtures.cases.world import Moments, slice_numbers

_FEATURES: Final = 256
_CUT: Final = 1.5  # standard deviations, of a draw that holds for a whole run
_BLOCK: Final = (15, 60)  # shortest and longest run of points between two disturbances

Draw = Callable[[Moments, np.random.Generator], FloatArray]


def _none(moments: Moments, _: np.random.Generator) -> FloatArray:
    return np.zeros(len(moments.order))


def _independent(moments: Moments, generator: np.random.Generator) -> FloatArray:
    return generator.standard_normal(len(moments.order))


def _global(moments: Moments, generator: np.random.Generator) -> FloatArray:
    while abs(draw := generator.standard_normal()) > _CUT:
        pass
    return np.full(len(moments.order), draw)


def _slice(moments: Moments, generator: np.random.Generator) -> FloatArray:
    numbers = slice_numbers(moments).astype(int)
    return np.asarray(generator.standard_normal(numbers[-1] + 1)[numbers])


def _block(moments: Moments, generator: np.random.Generator) -> FloatArray:
    lengths = generator.integers(*_BLOCK, size=len(moments.order) // _BLOCK[0] + 1)
    return np.repeat(generator.standard_normal(len(lengths)), lengths)[: len(moments.order)]


def _smooth(length_deg: float) -> Draw:
    """A normal process over sensor directions and illumination zenith, of Gaussian covariance.

    By random Fourier features (Rahimi and Recht 2007).
    """

    def draw(moments: Moments, generator: np.random.Generator) -> FloatArray:
        sensor = np.stack([direction(z, a) for z, a in zip(moments.sensor_zenith, moments.sensor_azimuth, strict=True)])
        place = np.column_stack([sensor, np.deg2rad(moments.illumination_zenith)])
        frequency = generator.standard_normal((_FEATURES, 4)) / np.deg2rad(length_deg)
        phase = generator.uniform(0.0, 2.0 * np.pi, _FEATURES)
        weight = generator.standard_normal(_FEATURES)
        waves: FloatArray = np.cos(place @ frequency.T + phase)
        return np.asarray(np.sqrt(2.0 / _FEATURES) * waves @ weight)

    return draw


#: By name; every draw has zero mean and unit variance over seeds, shape (point,).
FAMILIES: Final[dict[str, Draw]] = {
    "none": _none,
    "slice": _slice,
    "gp10": _smooth(10.0),
    "gp25": _smooth(25.0),
    "gp50": _smooth(50.0),
    "block": _block,
    "global": _global,
    "independent": _independent,
}
