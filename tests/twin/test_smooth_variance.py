"""Variances of a plan, smoothed: nearer to the truth where geometries are alike, left alone where they are not."""

from __future__ import annotations

import numpy as np
import pytest

from twin.smooth_variance import ENOUGH, smoothed
from twin.tracer import RANDOMISATIONS

SHARES = np.array([0.85, 0.12, 0.03])


def drawn(points: int, scatter: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Values, shape (part, point, RANDOMISATIONS), and the true variances of their means.

    The variances are products of powers of the parts' means, times what is each geometry's own.
    """
    random = np.random.default_rng(seed)
    means = SHARES[:, None] * random.uniform(0.4, 1.6, (3, points))
    variances = 1e-6 * means**1.5 * means.sum(axis=0) ** 0.5 * np.exp(scatter * random.standard_normal((3, points)))
    noise = random.standard_normal((3, points, RANDOMISATIONS)) * np.sqrt(RANDOMISATIONS * variances)[..., None]
    return means[..., None] + noise, variances


def off(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Scatter of the logarithm of found over true variances, shape (part,)."""
    return np.log(found / true).std(axis=1)


def raw(values: np.ndarray) -> np.ndarray:
    return values.var(axis=-1, ddof=1) / RANDOMISATIONS


def test_alike_geometries_tell_each_others_variance() -> None:
    values, true = drawn(300, scatter=0.1)
    found = smoothed(values)
    assert np.all(off(raw(values), true) > 0.33)
    assert np.all(off(found, true) < 0.2)
    assert np.sum(found, axis=1) / np.sum(true, axis=1) == pytest.approx(1, abs=0.1)


def test_geometries_of_their_own_keep_their_variance() -> None:
    values, true = drawn(300, scatter=1.5)
    assert np.all(off(smoothed(values), true) < 1.05 * off(raw(values), true))


def test_one_value_far_off_no_longer_counts_ten_times() -> None:
    values, _ = drawn(200, scatter=0.1)
    values[2, 7, 3] += 20 * np.sqrt(RANDOMISATIONS * raw(values)[2, 7])
    assert raw(values)[2, 7] > 15 * np.median(raw(values)[2])
    assert smoothed(values)[2, 7] < 4 * np.median(raw(values)[2])


def test_few_geometries_and_parts_that_never_vary_stay_as_they_are() -> None:
    few, _ = drawn(ENOUGH - 1, scatter=0.1)
    np.testing.assert_array_equal(smoothed(few), raw(few))
    values, _ = drawn(100, scatter=0.1)
    values[0] = values[0].mean(axis=-1, keepdims=True)  # light that needs no sampling
    values[1, :50] = 0.0
    found = smoothed(values)
    np.testing.assert_array_equal(found[0], raw(values)[0])
    assert np.all(found[1, :50] == 0)
    assert np.all(np.isfinite(found))
