"""Outliers and trends of a burst, against the handbook's worked example and against what chance does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from instrument.quality.bursts import critical_values, outliers, trend

#: NIST/SEMATECH e-Handbook, section 1.3.5.17.3 (data of Rosner 1983).
ROSNER = np.array(
    [
        -0.25, 0.68, 0.94, 1.15, 1.20, 1.26, 1.26, 1.34, 1.38, 1.43, 1.49, 1.49, 1.55, 1.56, 1.58, 1.65, 1.69, 1.70,
        1.76, 1.77, 1.81, 1.91, 1.94, 1.96, 1.99, 2.06, 2.09, 2.10, 2.14, 2.15, 2.23, 2.24, 2.26, 2.35, 2.37, 2.40,
        2.47, 2.54, 2.62, 2.64, 2.90, 2.92, 2.92, 2.93, 3.21, 3.26, 3.30, 3.59, 3.68, 4.30, 4.64, 5.34, 5.42, 6.01,
    ]
)  # fmt: skip


def test_rosners_example_has_the_three_outliers_of_the_handbook() -> None:
    """One at a time none stands out: the first is only found because the third is."""
    found = outliers(ROSNER, most=10, significance=0.05)
    assert ROSNER[found].tolist() == [5.34, 5.42, 6.01]
    assert not outliers(ROSNER, most=1, significance=0.05).any()


def test_critical_values_are_those_of_the_handbook() -> None:
    """Which are cut off after three decimals."""
    expected = [3.158, 3.151, 3.143, 3.136, 3.128, 3.120, 3.111, 3.103, 3.094, 3.085]
    assert critical_values(54, 10, 0.05) == pytest.approx(expected, abs=1e-3)


def test_the_first_critical_value_of_nine_is_that_of_grubbs() -> None:
    """Grubbs and Beck 1972: 2.215 at two-sided 5 %, 2.387 at 1 %."""
    assert critical_values(9, 1, 0.05)[0] == pytest.approx(2.215, abs=5e-4)
    assert critical_values(9, 1, 0.01)[0] == pytest.approx(2.387, abs=5e-4)


def test_mere_noise_is_accused_as_rarely_as_said() -> None:
    bursts = np.random.default_rng(7).standard_normal((40_000, 9))
    assert outliers(bursts).any(axis=-1).mean() == pytest.approx(0.0142, abs=0.002)
    assert outliers(bursts, most=1).any(axis=-1).mean() == pytest.approx(0.01, abs=0.0017)


def test_two_disturbed_samples_do_not_hide_each_other() -> None:
    bursts = np.random.default_rng(8).standard_normal((4_000, 9))
    bursts[:, [2, 6]] += 12.0
    found = outliers(bursts)
    assert np.all(found[:, [2, 6]], axis=-1).mean() > 0.97
    assert outliers(bursts, most=1).any(axis=-1).mean() < 0.01


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=3), st.floats(0.1, 5))
def test_equal_or_few_samples_have_no_outlier(few: list[float], level: float) -> None:
    assert not outliers(few).any()
    assert not outliers([level] * 9).any()


@given(st.integers(0, 10**6), st.floats(0.01, 100), st.floats(-100, 100))
def test_neither_scale_nor_offset_nor_order_matters(seed: int, scale: float, offset: float) -> None:
    burst = np.random.default_rng(seed).standard_normal(9)
    burst[4] += 9.0
    found = outliers(burst)
    assert (outliers(scale * burst + offset) == found).all()
    assert (outliers(burst[::-1])[::-1] == found).all()


def test_a_trend_is_that_of_the_regression_line() -> None:
    """By hand: x = -1.5 ... 1.5, y = 1, 3, 2, 4: slope 0.8, residuals -0.3, 0.9, -0.9, 0.3, error sqrt(0.9/5)."""
    change, significance = trend([1.0, 3.0, 2.0, 4.0])
    assert change == pytest.approx(2.4)
    assert significance == pytest.approx(0.8 / np.sqrt(0.18))
    assert trend([1.0, 2.0, 3.0]) == (0.0, 0.0)
    assert trend([2.0] * 9) == (0.0, 0.0)
