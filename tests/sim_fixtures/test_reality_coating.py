"""The coating of the simulated sample: reciprocal, never brighter than the light on it, and equal to its table."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_fixtures.reality.coating import EXAMPLE_COATING, Coating, reflectance_factor, tabulated

# At the normal itself the azimuth has no meaning.
COSINE = st.floats(0.01, 0.999)
AZIMUTH = st.floats(0.0, np.pi)


def factor(coating: Coating, mi: float, mo: float, azimuth_rad: float, wavelength: float = 500.0) -> float:
    between = mi * mo + np.sqrt((1 - mi**2) * (1 - mo**2)) * np.cos(azimuth_rad)
    return float(reflectance_factor(coating.at(wavelength), mi, mo, between))


@settings(deadline=None)  # the first call compiles
@given(COSINE, COSINE, AZIMUTH)
def test_the_example_is_reciprocal(mi: float, mo: float, azimuth_rad: float) -> None:
    assert factor(EXAMPLE_COATING, mi, mo, azimuth_rad) == pytest.approx(factor(EXAMPLE_COATING, mo, mi, azimuth_rad))


@pytest.mark.parametrize("wavelength", [400.0, 500.0, 900.0])
@pytest.mark.parametrize("cosine", [0.02, 0.3, 0.7, 1.0])
def test_the_example_returns_less_than_it_gets(cosine: float, wavelength: float) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(16)
    turns = (np.arange(32) + 0.5) * np.pi / 32
    returned = sum(
        factor(EXAMPLE_COATING, cosine, float(mo), float(turn), wavelength) * 2 * mo * w / 2 / len(turns)
        for mo, w in zip(0.5 * (1 + nodes), weights, strict=True)
        for turn in turns
    )
    assert 0.5 < returned < 0.95


def test_the_example_scatters_forward_at_grazing_angles_and_is_nearly_lambertian_at_the_normal() -> None:
    assert factor(EXAMPLE_COATING, 0.3, 0.3, np.pi) > 1.2 * factor(EXAMPLE_COATING, 0.3, 0.3, np.pi / 2)
    near_normal = [factor(EXAMPLE_COATING, 1.0, mo, 0.3) for mo in (0.2, 0.5, 1.0)]
    assert near_normal == pytest.approx([EXAMPLE_COATING.base] * 3)


def test_azimuth_zero_is_backscatter() -> None:
    backward = Coating(base=0.1, backward=0.5)
    assert factor(backward, 0.6, 0.6, 0.0) > factor(backward, 0.6, 0.6, np.pi) == pytest.approx(0.1)


@settings(deadline=None)  # the first call compiles
@given(COSINE, COSINE, AZIMUTH)
def test_a_table_is_linear_between_its_nodes(mi: float, mo: float, azimuth_rad: float) -> None:
    cosines, azimuths = np.linspace(0, 1, 5), np.arange(8) * 2 * np.pi / 8
    tent = np.minimum(azimuths, 2 * np.pi - azimuths)
    table = (1 + 2 * cosines[:, None, None]) * (3 + tent[None, :, None]) * (1 + 2 * cosines[None, None, :]) / np.pi
    between = mi * mo + np.sqrt((1 - mi**2) * (1 - mo**2)) * np.cos(azimuth_rad)
    expected = (1 + 2 * mi) * (1 + 2 * mo) * (3 + azimuth_rad)
    # The azimuth comes back from a cosine, which costs digits near 0 and 180 degrees.
    assert reflectance_factor(tabulated(table), mi, mo, between) == pytest.approx(expected, rel=1e-5)


def test_the_slope_of_the_spectrum_levels_off() -> None:
    at = [factor(EXAMPLE_COATING, 1.0, 0.5, 0.0, wavelength) for wavelength in (300.0, 499.0, 500.0, 501.0, 2000.0)]
    assert at[3] / at[2] - 1 == pytest.approx(EXAMPLE_COATING.spectral_slope, rel=0.01)
    assert 0.9 * at[2] <= at[0] < at[1] < at[2] < at[4] <= 1.1 * at[2]
