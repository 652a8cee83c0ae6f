"""A run of another sample, or in another unit, is refused with a word on what it looks like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_runs import errors, grid, nominal, observed

from instrument.errors import InputError
from twin.diagnosis.plausible import check_plausible, flat_reflectance
from twin.material import lambertian

COLUMNS = grid({0.0: (0.0, 90.0), 30.0: (60.0,)}, 10.0)
PREDICTED = nominal(COLUMNS)


def test_a_run_with_a_large_effect_passes():
    run = observed(COLUMNS, np.log(1.25) + errors(COLUMNS, "independent, 1 times the budget", 1))
    check_plausible(run, PREDICTED, np.full(len(run), 0.9))


def test_the_coupon_taken_for_the_artifact_is_recognised():
    run = observed(COLUMNS)
    flat = np.full(len(run), 0.72)
    coupon = replace(run, brf=flat * np.exp(errors(COLUMNS, "independent, 1 times the budget", 2)))
    with pytest.raises(InputError, match="looks like the material's coupon"):
        check_plausible(coupon, PREDICTED, flat)


def test_a_brdf_in_place_of_a_reflectance_factor_is_recognised():
    run = observed(COLUMNS, -np.log(np.pi))
    with pytest.raises(InputError, match=r"found 0\.318 times the prediction.*1/sr"):
        check_plausible(run, PREDICTED, None)


def test_another_sample_is_refused():
    with pytest.raises(InputError, match="found 2 times the prediction"):
        check_plausible(observed(COLUMNS, np.log(2.0)), PREDICTED, None)


def test_a_flat_lambertian_sample_reflects_alike_everywhere():
    np.testing.assert_allclose(flat_reflectance(lambertian(0.6), observed(COLUMNS)), 0.6, rtol=1e-6)
