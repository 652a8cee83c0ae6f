"""The Jacobian of a plan, as the diagnosis uses it."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from test_propagation import NARROW, ZENITHS
from test_state_vector import RANDOM, SYSTEMATIC, coupon, uncertain
from traced_samples import columns, flat

from instrument.errors import InputError
from twin.coupon import from_coupon
from twin.propagation import by_sensitivities
from twin.propagation_render import PlanRenderer
from twin.sensitivities import Sensitivities, of_propagation
from twin.state_vector import StateVector, state_vector


@pytest.fixture(scope="module")
def state() -> StateVector:
    run = coupon(noise=(0.01, RANDOM), reference=(0.005, SYSTEMATIC))
    known = uncertain(NARROW, arms={"u_sensor_zenith": 0.2})
    return state_vector(known, flat(), from_coupon(run, "coupon"), run)


@pytest.fixture(scope="module")
def found(state: StateVector) -> Sensitivities:
    renderer = PlanRenderer(state, columns(0.0, ZENITHS, 45.0), seed=3)
    return of_propagation(state, by_sensitivities(renderer, tolerance=0.02))


def test_columns_are_relative_and_named(found: Sensitivities) -> None:
    assert found.names[:2] == ("sensor zenith", "material reference")
    assert found.units[:2] == ("degree", "1")
    assert found.all_sources == ("sensor zenith", "material reference", "material noise")
    expected = np.deg2rad(1.0) * (-np.tan(np.deg2rad(ZENITHS)) + np.tan(np.deg2rad(15.0)))
    np.testing.assert_allclose(found.jacobian[:, 0], expected, rtol=0.02, atol=2e-4)
    np.testing.assert_allclose(found.factor()[:, 1], 0.005, rtol=0.03)
    assert np.all(found.error[:, 0] < 0.02 * np.abs(expected).max())
    assert list(found.reduced[:2]) == [False, False]
    assert np.all(found.reduced[2:])


def test_the_covariance_is_that_of_the_propagation(state: StateVector, found: Sensitivities) -> None:
    renderer = PlanRenderer(state, columns(0.0, ZENITHS, 45.0), seed=3)
    result = by_sensitivities(renderer, tolerance=0.02)
    expected = result.covariance() / result.brf / result.brf[:, None]
    np.testing.assert_allclose(found.covariance(), expected, rtol=1e-6, atol=1e-9)


def test_rows_of_the_budget_can_be_left_out(found: Sensitivities) -> None:
    assert found.without(["material noise", "no such"]).names == ("sensor zenith", "material reference")
    only = found.only(["material reference"])
    np.testing.assert_allclose(only.covariance(), 0.005**2, rtol=0.1)
    with pytest.raises(InputError, match="source: found nothing such; expected some of sensor zenith"):
        found.only(["nothing such"])


def test_noise_in_the_columns_does_not_count_as_uncertainty() -> None:
    generator = np.random.default_rng(4)
    true = generator.normal(size=(40, 1))
    error = np.full((40, 30), 0.5)
    noisy = np.concatenate([true, np.zeros((40, 29))], axis=1) + error * generator.normal(size=error.shape)
    names = tuple(map(str, range(30)))
    found = Sensitivities(np.ones(40), names, names, names, np.ones(30), noisy, error, np.zeros(30, dtype=bool))
    plain = np.trace(noisy @ noisy.T)
    assert plain == pytest.approx(np.sum(true**2) + 300, rel=0.15)
    clean = found.covariance()
    assert np.trace(clean) < plain - 150
    assert np.linalg.eigvalsh(clean)[0] > -1e-9


def test_a_state_vector_survives_the_way_to_another_process(state: StateVector) -> None:
    again = pickle.loads(pickle.dumps(state))  # noqa: S301 - our own bytes
    value = state.nominal + state.standard_uncertainty
    assert again.inputs(value).setup == state.inputs(value).setup
    np.testing.assert_array_equal(again.inputs(value).coupon_error, state.inputs(value).coupon_error)
    points = columns(0.0, [30.0], 45.0)
    one, other = (PlanRenderer(s, points, seed=1).render([value], 64) for s in (state, again))
    np.testing.assert_allclose(one, other, rtol=1e-6)
