"""Stated probabilities beside the share that was right: counted by hand."""

import math

import pytest

from twin.diagnosis.trial_reliability import bins, expected_calibration_error


def test_statements_are_counted_in_the_bin_of_their_probability():
    found = bins([0.92, 0.94, 0.95, 0.97, 0.4], [True, False, True, True, False])
    assert [(b.low, b.high, b.count) for b in found] == [(0.3, 0.5, 1), (0.9, 0.95, 3), (0.95, 1.0, 1)]
    assert found[1].stated == pytest.approx((0.92 + 0.94 + 0.95) / 3)
    assert found[1].right == pytest.approx(2 / 3)


def test_calibration_error_is_the_mean_distance_of_stated_and_true_share():
    # Four statements of 0.6, one of them right: 0.35 apart; one of 1.0 that is right: none apart.
    told = bins([0.6] * 4 + [1.0], [True, False, False, False, True])
    assert expected_calibration_error(told) == pytest.approx(0.35 * 4 / 5)


def test_no_statement_has_no_calibration_error():
    assert math.isnan(expected_calibration_error(bins([], [])))
