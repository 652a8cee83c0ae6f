"""The variance between results, against closed forms and a published example."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from instrument.quality.random_effects import dersimonian_laird, mandel_paule


@given(st.lists(st.floats(0, 1000), min_size=3, max_size=8, unique=True), st.floats(1e-3, 1.0))
def test_equal_uncertainties_have_a_closed_form(results: list[float], u: float) -> None:
    """With one u for all both methods give tau^2 = s^2 - u^2, and the plain mean with s^2/n."""
    x = np.array(results)
    s2, n = x.var(ddof=1), len(x)
    for method in (mandel_paule, dersimonian_laird):
        found = method(x, np.full(n, u))
        assert found.tau**2 == pytest.approx(max(0.0, s2 - u**2), rel=1e-6, abs=1e-9 * u**2)
        assert found.mean[0] == pytest.approx(x.mean())
        assert found.u[0] ** 2 == pytest.approx(max(s2, u**2) / n, rel=1e-6)


def test_two_results_by_hand() -> None:
    """Results 10 and 14 with u 1 and 2: the weights for t^2 between are 1/(1 + t^2), 1/(4 + t^2).

    Mandel-Paule: 16/(5 + 2 t^2) = 1, so t^2 = 5.5; DerSimonian-Laird: Q = 16/5, c = 1.25 - 1.0625/1.25 = 0.4, so
    t^2 = 2.2/0.4 = 5.5 as well, as always with two. Mean (10/6.5 + 14/9.5)/(1/6.5 + 1/9.5) = 11.625.
    """
    for method in (mandel_paule, dersimonian_laird):
        found = method([10.0, 14.0], [1.0, 2.0])
        assert found.tau**2 == pytest.approx(5.5)
        assert found.mean[0] == pytest.approx(11.625)
        assert found.u[0] == pytest.approx(1 / np.sqrt(1 / 6.5 + 1 / 9.5))
        assert (found.q, found.expected) == (pytest.approx(3.2), 1)


def test_dersimonian_laird_by_hand_with_three() -> None:
    """x = 0, 1, 5 with u^2 = 1, 1/2, 1/4: w = 1, 2, 4; mean 22/7; Q = 102 - 484/7 = 230/7; c = 7 - 21/7 = 4."""
    found = dersimonian_laird([0.0, 1.0, 5.0], np.sqrt([1.0, 0.5, 0.25]))
    assert found.q == pytest.approx(230 / 7)
    assert found.tau**2 == pytest.approx((230 / 7 - 2) / 4)


def test_mandel_paule_solves_its_equation() -> None:
    x, u = np.array([0.0, 1.0, 5.0, 2.5]), np.array([1.0, 0.7, 0.5, 0.3])
    found = mandel_paule(x, u)
    weights = 1 / (u**2 + found.tau**2)
    mean = np.sum(weights * x) / np.sum(weights)
    assert np.sum(weights * (x - mean) ** 2) == pytest.approx(3.0)
    assert found.weights[:, 0] == pytest.approx(weights / weights.sum())


def test_results_that_agree_have_nothing_between_them() -> None:
    found = mandel_paule([1.00, 1.01, 0.99], [0.1, 0.2, 0.1])
    assert found.tau == 0.0
    assert found.u[0] == pytest.approx(1 / np.sqrt(225))
    assert found.mean[0] == pytest.approx((100 + 25.25 + 99) / 225)


def test_one_variance_between_is_shared_by_many_quantities() -> None:
    """By hand: two quantities twice, differences 2 and 4, u = 1: (4 + 16)/(2 (1 + t^2)) = 2, so t^2 = 4."""
    found = mandel_paule([[0.0, 10.0], [2.0, 14.0]], np.ones((2, 2)))
    assert found.tau == pytest.approx(2.0)
    assert found.mean.tolist() == pytest.approx([1.0, 12.0])
    assert found.u.tolist() == pytest.approx([np.sqrt(2.5)] * 2)


def test_a_quantity_with_one_result_keeps_it_and_is_as_uncertain_as_one() -> None:
    found = mandel_paule([[0.0, 7.0], [4.0, np.nan]], np.ones((2, 2)))
    assert found.tau**2 == pytest.approx(7.0)
    assert found.mean[1] == pytest.approx(7.0)
    assert found.u[1] == pytest.approx(np.sqrt(8.0))
    assert found.weights[:, 1].tolist() == [1.0, 0.0]


def test_the_variance_between_comes_back_from_many_points() -> None:
    rng = np.random.default_rng(3)
    u = rng.uniform(0.3, 1.0, (4, 3000))
    x = rng.normal(50.0, 5.0, 3000) + rng.normal(0.0, 2.0, (4, 3000)) + u * rng.standard_normal((4, 3000))
    # Relative standard error of tau^2: about sqrt(2/9000).
    assert mandel_paule(x, u).tau == pytest.approx(2.0, rel=0.03)
    assert dersimonian_laird(x, u).tau == pytest.approx(2.0, rel=0.04)


@pytest.mark.parametrize(
    ("results", "u", "message"),
    [
        ([1.0, 2.0], [0.0, 1.0], "above 0"),
        ([1.0], [1.0], "no quantity has two"),
        ([[1.0, np.nan], [2.0, np.nan]], [[1.0, 1.0]] * 2, "a quantity has no result"),
    ],
)
def test_what_tells_nothing_is_refused(results: list[float], u: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        mandel_paule(results, u)
