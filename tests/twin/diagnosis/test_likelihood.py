"""Densities against SciPy, and tables weighed in compressed form against weighing row by row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal
from synthetic_runs import SCALE, effects, grid, observed

from twin.diagnosis.covariance import structures
from twin.diagnosis.likelihood import Compressed, Normal, marginal, normals

COLUMNS = grid({0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}, 20.0)
COUNT = len(COLUMNS["wavelength"])


def members() -> list[Normal]:
    return normals(structures(observed(COLUMNS)), np.full((COUNT, 1), SCALE), np.full(COUNT, 0.002))


def residual(seed: int = 1) -> np.ndarray:
    return 0.01 * np.random.default_rng(seed).standard_normal(COUNT)


def test_density_is_that_of_scipy_under_every_structure():
    for member in members():
        expected = multivariate_normal(np.zeros(COUNT), member.covariance).logpdf(residual())
        assert member.log_density(residual()) == pytest.approx(expected, rel=1e-9), member.name


def test_shared_errors_are_added_to_every_structure():
    plain = structures(observed(COLUMNS))
    for structure, member in zip(plain, members(), strict=True):
        added = member.covariance - structure.covariance
        np.testing.assert_allclose(added, SCALE**2 + 0.002**2 * np.eye(COUNT), atol=1e-15)
        assert np.exp(member.log_weight) == pytest.approx(structure.weight)


def test_whitened_errors_are_independent_with_unit_variance():
    for member in members()[::7]:
        w = member.whitener
        np.testing.assert_allclose(w @ member.covariance @ w.T, np.eye(COUNT), atol=1e-8)
        np.testing.assert_allclose(member.white(residual()), w @ residual())
        np.testing.assert_allclose(member.white(np.stack([residual(1), residual(2)]))[1], w @ residual(2))


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-0.05, 0.05), min_size=2, max_size=8), st.integers(0, 2**16))
def test_compressed_rows_weigh_what_the_rows_do(amounts: list[float], seed: int):
    tables = [e.log_ratio(np.array([[a] * len(e.parameters) for a in amounts])) for e in effects(COLUMNS).values()]
    table = np.concatenate(tables)
    member = members()[seed % 60]
    here = residual(seed)
    expected = [member.log_density(here - row) for row in table]
    # Per point 1e-5 is left out, a thousandth of a standard deviation: far less than a nat where a row is plausible.
    np.testing.assert_allclose(Compressed.of(table).log_density(here, member), expected, rtol=1e-4, atol=0.02)


def test_what_compression_leaves_out_is_below_its_tolerance():
    table = np.concatenate([0.1 * np.random.default_rng(4).standard_normal((3, COUNT)), np.full((2, COUNT), 1e-7)])
    for tolerance in (1e-5, 1e-2):
        found = Compressed.of(table, tolerance)
        assert np.max(np.abs(found.coefficients @ found.basis - table)) <= tolerance


def test_table_without_rows_weighs_nothing():
    assert Compressed.of(np.zeros((0, COUNT))).log_density(residual(), members()[0]).shape == (0,)


def test_mean_over_structures_of_equal_densities_is_that_density():
    found = members()
    assert marginal(np.full(len(found), -3.0), found) == pytest.approx(-3.0)


def test_mean_over_structures_is_weighted_by_their_probability():
    found = members()
    values = np.array([member.log_density(residual()) for member in found])
    weights = np.array([s.weight for s in structures(observed(COLUMNS))])
    expected = np.log(np.sum(weights * np.exp(values - values.max()))) + values.max()
    assert marginal(values, found) == pytest.approx(expected)
