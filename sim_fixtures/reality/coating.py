"""How the coating reflects: bidirectional reflectance factors in closed form, or a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from instrument.angles import FloatArray

CLOSED_FORM: Final = 0
TABLE: Final = 1


class Reflection(NamedTuple):
    """A coating at one wavelength as compiled code takes it.

    ``table`` holds reflectance factors over (cosine to the sensor, relative azimuth, cosine to the source), the
    cosines evenly from 0 to 1 and the azimuth evenly from 0 over a full turn, which is not repeated.

    ``retro`` is height and angular width parameter of a coherent-backscatter peak, ``glossy`` reflectance and root
    mean square slope of facets, ``grain`` cosine and sine part of a modulation with twice the azimuth, ``diffusion``
    the share of the light that travels inside the coating and its diffusion length in mm; shape (2,) each.
    """

    kind: int
    base: float
    forward: float
    forward_sine_power: float
    forward_azimuth_power: float
    backward: float
    backward_azimuth_power: float
    table: FloatArray
    retro: FloatArray
    glossy: FloatArray
    grain: FloatArray
    diffusion: FloatArray


@dataclass(frozen=True)
class Coating:
    """A reciprocal coating: a Lambertian part, a forward and a backward lobe that grow towards grazing angles.

    With s = sin(illumination zenith) sin(sensor zenith) and phi the azimuth between them, 0 for backscatter,
    BRF = base + forward s^p ((1 - cos phi)/2)^q + backward s ((1 + cos phi)/2)^r at 500 nm.

    ``spectral_slope`` is the relative change a nanometre at 500 nm; it levels off at 10 %.
    """

    base: float
    forward: float = 0.0
    forward_sine_power: float = 3.0
    forward_azimuth_power: float = 2.0
    backward: float = 0.0
    backward_azimuth_power: float = 4.0
    spectral_slope: float = 0.0
    scale: float = 1.0

    def at(self, wavelength: float = 500.0) -> Reflection:
        """The coating at a wavelength in nm."""
        factor = self.scale * float(1.0 + 0.1 * np.tanh(10.0 * self.spectral_slope * (wavelength - 500.0)))
        return Reflection(
            CLOSED_FORM,
            factor * self.base,
            factor * self.forward,
            self.forward_sine_power,
            self.forward_azimuth_power,
            factor * self.backward,
            self.backward_azimuth_power,
            np.zeros((2, 1, 2)),
            *np.zeros((4, 2)),
        )


#: Close to Lambertian near the normal, scattering forward at grazing angles, as the paper's coated metal does.
EXAMPLE_COATING = Coating(
    base=0.585,
    forward=0.30,
    forward_sine_power=2.6,
    forward_azimuth_power=3.0,
    backward=0.045,
    backward_azimuth_power=3.0,
    spectral_slope=0.0013,
)


def lambertian(reflectance: float) -> Reflection:
    """A Lambertian surface."""
    return Coating(base=reflectance).at()


def tabulated(brdf: FloatArray) -> Reflection:
    """A table of the BRDF in 1/sr, shape (cosine to the sensor, azimuth, cosine to the source).

    Linear in the cosines (evenly from 0 to 1) and in the azimuth (evenly from 0 = backscatter, periodic, last
    node not repeated). The table has to be reciprocal and the same on both sides of the plane of incidence.
    """
    table = np.ascontiguousarray(np.pi * brdf)
    return Reflection(TABLE, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, table, *np.zeros((4, 2)))


#: tan(angle/2) over the width parameter where the backscatter peak has fallen to 1/e.
PEAK_AT_1_E: Final = 0.5508


@njit(cache=True, nogil=True)
def backscatter_peak(cos_between: float, width: float) -> float:
    """Coherent backscatter, 1 at exact retro-reflection (Hapke 2002, equation 32); ``width`` as tan(angle/2)."""
    x = np.sqrt(max(1.0 - cos_between, 0.0) / max(1.0 + cos_between, 1e-12)) / width
    if x < 1e-6:
        return 1.0
    return (1.0 + (1.0 - np.exp(-x)) / x) / (2.0 * (1.0 + x) ** 2)


@njit(cache=True, nogil=True)
def facet_lobe(cos_source: float, cos_sensor: float, cos_between: float, slope: float) -> float:
    """BRF of facets of unit reflectance: Beckmann's slopes, V-shaped cavities (Cook and Torrance 1982)."""
    size = np.sqrt(max(2.0 + 2.0 * cos_between, 1e-12))
    half = min(1.0, (cos_source + cos_sensor) / size)
    squared = half * half
    density = np.exp((squared - 1.0) / (squared * slope * slope)) / (np.pi * slope * slope * squared * squared)
    seen = min(1.0, 2.0 * half * min(cos_source, cos_sensor) / (0.5 * size))
    return np.pi * density * seen / (4.0 * cos_source * cos_sensor)


@njit(cache=True, nogil=True)
def grain_factor(reflection: Reflection, wx: float, wy: float, ox: float, oy: float) -> float:
    """Modulation of a horizontal face with twice the azimuth of both directions; reciprocal."""
    even = wx * wx - wy * wy + ox * ox - oy * oy
    odd = 2.0 * (wx * wy + ox * oy)
    return 1.0 + reflection.grain[0] * even + reflection.grain[1] * odd


@njit(cache=True, nogil=True)
def reflectance_factor(reflection: Reflection, cos_source: float, cos_sensor: float, cos_between: float) -> float:
    """BRF from the two cosines to the normal and the cosine of the angle between the two directions."""
    extra = 0.0
    if reflection.retro[0] != 0.0:
        extra += reflection.retro[0] * backscatter_peak(cos_between, reflection.retro[1])
    if reflection.glossy[0] != 0.0 and cos_source > 0.0 and cos_sensor > 0.0:
        extra += reflection.glossy[0] * facet_lobe(cos_source, cos_sensor, cos_between, reflection.glossy[1])
    squared_sines = (1.0 - cos_source * cos_source) * (1.0 - cos_sensor * cos_sensor)
    s = np.sqrt(max(squared_sines, 0.0))
    cos_azimuth = 1.0
    if s > 1e-12:
        cos_azimuth = min(1.0, max(-1.0, (cos_between - cos_source * cos_sensor) / s))
    if reflection.kind == CLOSED_FORM:
        value = reflection.base
        if reflection.forward != 0.0:
            value += (
                reflection.forward
                * _power(s, reflection.forward_sine_power)
                * _power(0.5 * (1.0 - cos_azimuth), reflection.forward_azimuth_power)
            )
        if reflection.backward != 0.0:
            value += reflection.backward * s * _power(0.5 * (1.0 + cos_azimuth), reflection.backward_azimuth_power)
        return value + extra
    return _interpolate(reflection.table, cos_sensor, np.arccos(cos_azimuth), cos_source) + extra


@njit(cache=True, nogil=True)
def _power(base: float, exponent: float) -> float:
    """A power; the cube, which most coatings here have, without the cost of a general one."""
    return base * base * base if exponent == 3.0 else base**exponent


@njit(cache=True, nogil=True)
def _interpolate(table: FloatArray, cos_sensor: float, azimuth_rad: float, cos_source: float) -> float:
    i, u = _node(cos_sensor, table.shape[0])
    k, w = _node(cos_source, table.shape[2])
    turn = azimuth_rad / (2.0 * np.pi) * table.shape[1]
    j = int(turn)
    v = turn - j
    j %= table.shape[1]
    after = (j + 1) % table.shape[1]
    near = (1 - w) * table[i, j, k] + w * table[i, j, k + 1]
    near = (1 - u) * near + u * ((1 - w) * table[i + 1, j, k] + w * table[i + 1, j, k + 1])
    far = (1 - w) * table[i, after, k] + w * table[i, after, k + 1]
    far = (1 - u) * far + u * ((1 - w) * table[i + 1, after, k] + w * table[i + 1, after, k + 1])
    return (1 - v) * near + v * far


@njit(cache=True, nogil=True)
def _node(cosine: float, count: int) -> tuple[int, float]:
    place = min(max(cosine, 0.0), 1.0) * (count - 1)
    node = min(int(place), count - 2)
    return node, place - node
