"""Effective degrees of freedom and coverage factors, against the worked examples and tables of the GUM."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from instrument.quality.coverage import PROBABILITY, coverage_factor, effective_degrees_of_freedom


def test_end_gauge_of_gum_h1() -> None:
    """JCGM 100:2008, H.1.6: 16.7 degrees of freedom, k = 2.92 with 16 of them at 99 %, U = 93 nm."""
    # The comparator's difference, H.1.3.2: pooled observations, random and systematic error of the comparator.
    difference = effective_degrees_of_freedom([[5.8], [3.9], [6.7]], [24, 5, 8])
    assert difference[0] == pytest.approx(25.6, abs=0.2)  # the GUM rounds the sum to 9.7 before
    parts = [[25.0], [9.7], [2.9], [16.6]]
    freedom = effective_degrees_of_freedom(parts, [18, 25.6, 50, 2])
    u = float(np.sqrt(sum(part[0] ** 2 for part in parts)))
    assert round(u) == 32
    assert freedom[0] == pytest.approx(16.7, abs=0.1)
    assert float(coverage_factor(16, 0.99)) == pytest.approx(2.92, abs=0.005)
    assert 32 * float(coverage_factor(16, 0.99)) == pytest.approx(93, abs=0.5)


def test_gum_g4_2_example() -> None:
    """JCGM 100:2008, G.4.2: relative u 0.25, 0.57, 0.82 % with n = 10, 5, 15 give u_c = 1.03 % and 19.0."""
    freedom = effective_degrees_of_freedom([[0.25], [0.57], [0.82]], [9, 4, 14])
    assert freedom[0] == pytest.approx(19.0, abs=0.05)
    assert float(coverage_factor(19, 0.95)) == pytest.approx(2.09, abs=0.005)
    assert 1.03 * float(coverage_factor(19, 0.95)) == pytest.approx(2.2, abs=0.05)


@pytest.mark.parametrize(
    ("freedom", "k95", "k95_45", "k99"),
    # JCGM 100:2008, Table G.2.
    [
        (1, 12.71, 13.97, 63.66),
        (2, 4.30, 4.53, 9.92),
        (5, 2.57, 2.65, 4.03),
        (8, 2.31, 2.37, 3.36),
        (20, 2.09, 2.13, 2.85),
        (100, 1.984, 2.025, 2.626),
        (np.inf, 1.960, 2.000, 2.576),
    ],
)
def test_coverage_factors_of_table_g2(freedom: float, k95: float, k95_45: float, k99: float) -> None:
    for probability, expected in ((0.95, k95), (PROBABILITY, k95_45), (0.99, k99)):
        assert float(coverage_factor(freedom, probability)) == pytest.approx(expected, rel=2.5e-3)


def test_what_is_known_exactly_has_no_bound() -> None:
    assert effective_degrees_of_freedom([[1.0, 2.0], [3.0, 0.0]], [np.inf, np.inf]).tolist() == [np.inf, np.inf]
    # Only a component that contributes counts.
    assert effective_degrees_of_freedom([[1.0, 2.0], [3.0, 0.0]], [np.inf, 8]).tolist() == [100 / 81 * 8, np.inf]
    assert float(coverage_factor(np.inf)) == pytest.approx(2.0)


@given(st.lists(st.tuples(st.floats(0.01, 10), st.floats(1, 100)), min_size=1, max_size=6))
def test_between_the_smallest_number_and_the_sum_of_all(parts: list[tuple[float, float]]) -> None:
    """GUM, G.4.1, note 2."""
    freedom = float(effective_degrees_of_freedom([[u] for u, _ in parts], [nu for _, nu in parts])[0])
    assert min(nu for _, nu in parts) * (1 - 1e-9) <= freedom <= sum(nu for _, nu in parts) * (1 + 1e-9)


def test_no_degrees_of_freedom_are_refused() -> None:
    with pytest.raises(ValueError, match="found 0; expected a number above 0"):
        effective_degrees_of_freedom([[1.0]], [0])
