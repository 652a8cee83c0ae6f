"""The two-sided test of a run against its prediction."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_runs import SCALE, errors, grid, structure

from twin.diagnosis.consistency import LEVEL, evidence_ratio, judge
from twin.diagnosis.fit import fit_none
from twin.diagnosis.likelihood import Normal, normals
from twin.diagnosis.posterior import PRIOR, Hypothesis, Posterior, normalised

COLUMNS = grid({0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}, 10.0)
COUNT = len(COLUMNS["wavelength"])
KIND = "one factor a slice, 1 times the budget"


def members() -> list[Normal]:
    found = normals([structure(COLUMNS, KIND)], np.full((COUNT, 1), SCALE), np.full(COUNT, 0.001))
    return [Normal(m.name, 0.0, m.covariance) for m in found]


def posterior(log_ratio: float) -> Posterior:
    """Gap and none with the given logarithm of the ratio of their evidences."""
    gap = np.log(1 - PRIOR["none"])
    return normalised(
        [Hypothesis((), False, np.log(PRIOR["none"]), 0.0, None), Hypothesis((), True, gap, log_ratio, None)]
    )


def judged(residual: np.ndarray, log_ratio: float = -2.0):
    here = members()
    return judge(residual, here, posterior(log_ratio), fit_none(residual, here), [])


@pytest.mark.parametrize("log_ratio", [-5.0, 0.0, 3.0, 20.0])
def test_ratio_of_evidences_is_found_again(log_ratio: float):
    assert evidence_ratio(posterior(log_ratio)) == pytest.approx(log_ratio)


@pytest.mark.parametrize("log_ratio", [4.0, 8.0, 30.0])
def test_p_value_is_bounded_by_the_inverse_ratio_of_evidences(log_ratio: float):
    # Two tests are made, so the smaller probability counts twice.
    assert judged(errors(COLUMNS, KIND, seed=1), log_ratio).p_value == pytest.approx(2 * np.exp(-log_ratio), rel=1e-6)


def test_p_value_of_overwhelming_evidence_is_finite():
    assert 0.0 <= judged(errors(COLUMNS, KIND, seed=1), 2000.0).p_value < 1e-200


def test_sound_run_is_consistent():
    found = judged(errors(COLUMNS, KIND, seed=2))
    assert found.consistent
    assert found.p_value > LEVEL
    assert 0.5 < found.chi_square < 1.6


def test_chi_square_is_per_point_with_the_full_covariance():
    residual = errors(COLUMNS, KIND, seed=3)
    expected = residual @ np.linalg.solve(members()[0].covariance, residual) / COUNT
    assert judged(residual).chi_square == pytest.approx(expected)


@pytest.mark.parametrize("factor", [1.7, 0.4])
def test_too_much_scatter_and_too_little_are_both_inconsistent(factor: float):
    found = judged(factor * errors(COLUMNS, KIND, seed=4))
    assert not found.consistent
    assert found.p_value < 0.01


def test_alarms_of_the_scatter_test_are_as_rare_as_its_level():
    alarms = sum(not judged(errors(COLUMNS, KIND, seed)).consistent for seed in range(100, 140))
    assert alarms <= 6  # at 5 % more would be seen less than once in 200 times


def test_missing_uncertainty_is_stated():
    extra = 0.02 * np.random.default_rng(50).standard_normal(COUNT)
    assert 0.013 < judged(errors(COLUMNS, KIND, seed=5) + extra).dark_uncertainty < 0.03
