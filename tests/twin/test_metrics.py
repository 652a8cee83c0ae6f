"""Metrics of the paper's section II-I against definitions, drawn samples and the numbers printed in the text."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from twin import metrics
from twin.metrics import Category


def agreement_by_sampling(t: float, ratio: float, population: int, seed: int) -> float:
    """The paper's construction (Figs. 8 and 9): draw the reference (index 1) and the test variable (index 2)
    and count the test samples within 2 sigma_c of the reference's mean, everything taken from the samples."""
    rng = np.random.default_rng(seed)
    sigma_1, sigma_2 = 1.0, ratio
    sigma_c = np.sqrt(sigma_1**2 + sigma_2**2)
    reference = rng.normal(10.0, sigma_1, population)
    test = rng.normal(10.0 + t * sigma_c, sigma_2, population)
    tolerance = 2 * np.sqrt(np.var(reference) + np.var(test))
    return float(np.mean(np.abs(test - np.mean(reference)) < tolerance))


@pytest.mark.parametrize("ratio", [0.1, 0.48, 1.0, 2.1, 10.0])
@pytest.mark.parametrize("t", [0.0, 0.5, 1.0, 1.7, 2.0, 2.5, 3.5, -1.3])
def test_closed_form_agrees_with_drawn_samples_of_both_variables(t, ratio):
    population = 200_000
    sampled = agreement_by_sampling(t, ratio, population, seed=20250303)
    closed = float(metrics.level_of_agreement(t, ratio, 1.0))
    # Binomial error, plus what the sampled mean and widths move the edges of the interval.
    k = ratio / np.hypot(1.0, ratio)
    slope = (norm.pdf((2 - abs(t)) / k) + norm.pdf((2 + abs(t)) / k)) / k
    error = np.sqrt((closed * (1 - closed) + slope**2 * 3.0) / population)
    assert sampled == pytest.approx(closed, abs=4.5 * error + 1e-6)


def test_sampling_the_reference_too_would_lose_the_dependence_on_the_ratio():
    """Guards the reading of the construction: with pairwise differences n' would not depend on the ratio, while
    Fig. 9 says that it does."""
    by_ratio = metrics.level_of_agreement(1.0, [0.1, 1.0, 10.0], 1.0)
    pairwise = norm.cdf(2 - 1) - norm.cdf(-2 - 1)
    assert np.ptp(by_ratio) > 0.1
    assert np.all(np.abs(by_ratio[:2] - pairwise) > 0.05)


@given(st.floats(0.05, 4.0), st.floats(0.02, 20.0))
def test_closed_form_is_the_integral_of_the_test_density(t, ratio):
    sigma_c = np.hypot(1.0, ratio)
    expected, _ = quad(
        norm(t * sigma_c, ratio).pdf, -2 * sigma_c, 2 * sigma_c, points=[min(t, 2.0) * sigma_c], limit=400
    )
    assert metrics.level_of_agreement(t, ratio, 1.0) == pytest.approx(expected, abs=2e-6)


def test_t_of_two_is_a_level_of_fifty_per_cent():
    """Section III-B: the threshold 2 of t' corresponds to 50 % of n'. Exact but for the far tail of a wide test
    variable: Phi(-4/k) <= 3.2e-5."""
    assert metrics.level_of_agreement(2.0, [0.0, 0.01, 0.5, 1.0, 50.0], 1.0) == pytest.approx(0.5, abs=3.2e-5)


def test_a_visible_disagreement_escapes_the_level_of_agreement_as_the_paper_says():
    """Section II-I on Fig. 8: at (dR/sigma_c, sigma_2/sigma_1) = (1, 0.48) n' fails to report it."""
    assert float(metrics.level_of_agreement(1.0, 0.48, 1.0)) > 0.98


def test_without_simulation_uncertainty_the_level_is_a_step():
    t = [-3.0, -2.0, -1.999999, 0.0, 1.999999, 2.0, 2.000001]
    assert metrics.level_of_agreement(t, 0.0, 0.01).tolist() == [0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0]


@pytest.mark.parametrize("u", [1e-3, 1e-8, 1e-160, 5e-324])
def test_the_step_is_the_limit_of_a_vanishing_uncertainty(u):
    assert metrics.level_of_agreement([-2.1, -1.9, 0.0, 1.9, 2.1], u, 1.0) == pytest.approx([0, 1, 1, 1, 0], abs=1e-12)


@given(st.floats(-50, 50), st.floats(0, 100), st.floats(0, 100))
def test_level_is_a_probability_and_even_in_t(t, u_simulated, u_measured):
    if u_simulated == 0 and u_measured == 0:
        return
    level = float(metrics.level_of_agreement(t, u_simulated, u_measured))
    assert 0 <= level <= 1
    assert level == float(metrics.level_of_agreement(-t, u_simulated, u_measured))


def test_difference_and_score_by_hand():
    assert metrics.relative_difference([0.51, 0.49], 0.5) == pytest.approx([0.02, -0.02])
    assert metrics.t_score(0.51, 0.5, 0.003, 0.004) == pytest.approx(2.0)
    assert metrics.combined_uncertainty(0.003, 0.004) == pytest.approx(0.005)
    assert metrics.relative_rmse([0.03, -0.04]) == pytest.approx(np.sqrt(0.00125))
    assert metrics.mean_absolute([0.03, -0.04]) == pytest.approx(0.035)


def test_averages_of_nothing_are_not_numbers():
    assert np.isnan(metrics.relative_rmse([]))
    assert np.isnan(metrics.mean_absolute([]))


def test_undefined_ratios_are_errors():
    with pytest.raises(ValueError, match="measured value of zero"):
        metrics.relative_difference([0.1, 0.2], [0.1, 0.0])
    with pytest.raises(ValueError, match="both standard uncertainties are zero"):
        metrics.t_score(1.0, 1.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="both standard uncertainties are zero"):
        metrics.level_of_agreement(1.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="negative"):
        metrics.combined_uncertainty(-0.1, 0.1)


def test_categories_of_table_v_and_their_edges():
    good, acceptable, poor = Category
    assert metrics.categorise_relative_difference([0.0, -0.0199, 0.02, -0.04, 0.0401]).tolist() == [
        good, good, acceptable, acceptable, poor,
    ]  # fmt: skip
    assert metrics.categorise_t([0.0, -0.99, 1.0, -2.0, 2.01]).tolist() == [good, good, acceptable, acceptable, poor]
    assert metrics.categorise_level_of_agreement([1.0, 0.95, 0.949, 0.5, 0.49, 0.0]).tolist() == [
        good, good, acceptable, acceptable, poor, poor,
    ]  # fmt: skip


def test_a_measured_value_next_to_nothing_makes_the_difference_infinite_not_an_error():
    assert metrics.relative_difference(1.0, 5e-324) == np.inf
    assert metrics.t_score(1.0, 0.0, 5e-324, 0.0) == np.inf
    assert metrics.level_of_agreement(np.inf, 0.1, 0.1) == 0.0
