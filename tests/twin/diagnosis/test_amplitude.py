"""Priors of amplitudes: they integrate to one, keep the caps, and count sizes as the gaps they make."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from synthetic_runs import Formula, Parameter, effects, grid, linear, observed

from twin.diagnosis.amplitude import HIGHEST, LOWEST, AmplitudePrior, AtRows, log_slab, log_sum

COLUMNS = grid({0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}, 10.0)
COUNT = len(COLUMNS["wavelength"])
RUN = observed(COLUMNS)
U = RUN.relative_u
TAN = np.tan(np.deg2rad(COLUMNS["sensor_zenith"]))


def steps(cap: tuple[float, float]) -> Formula:
    """An effect whose gap of 1 is of severity 100 at every point: severity = amount to first order."""
    return linear("steps", U.mean() * np.ones(COUNT), 1.0, cap)


def two(caps: tuple[float, float] = (-50.0, 50.0)) -> Formula:
    """Two parameters whose gaps are orthogonal and of equal size: the severity is the length of the vector."""
    first = np.where(np.arange(COUNT) % 2 == 0, np.sqrt(2), 0.0) * U
    second = np.where(np.arange(COUNT) % 2 == 1, np.sqrt(2), 0.0) * U
    parameters = (Parameter("x", 1.0, caps), Parameter("y", 1.0, caps))
    return Formula("two", parameters, lambda v: np.log1p(v[:, :1] * first + v[:, 1:] * second))


def with_shape(low: float = 1.0, high: float = 3.0) -> Formula:
    """A size, and a power that says how it looks."""
    parameters = (Parameter("size", 0.01, (-0.5, 0.5)), Parameter("power", 1.0, (low, high), nominal=1.0, shape=True))
    place = np.linspace(0.2, 1.0, COUNT)
    return Formula("bent", parameters, lambda v: np.log1p(v[:, :1] * place ** v[:, 1:]))


def test_slab_integrates_to_one_over_the_logarithm_of_the_severity():
    edges = np.log([1e-6, LOWEST, HIGHEST, 1e6])
    total = sum(
        quad(lambda x: float(np.exp(log_slab(np.array(np.exp(x))))), low, high)[0] for low, high in pairwise(edges)
    )
    assert total == pytest.approx(1.0, abs=1e-8)


def test_slab_is_flat_between_its_ends_and_falls_beyond():
    inside = log_slab(np.geomspace(LOWEST, HIGHEST, 7))
    assert np.ptp(inside) < 1e-12
    # Half of the least and twice the largest severity: a factor of 2^4 less.
    np.testing.assert_allclose(log_slab(np.array([LOWEST / 2, HIGHEST * 2])), inside[0] - 4 * np.log(2))


@pytest.mark.parametrize("effect", [steps((-40.0, 40.0)), two(), *effects(COLUMNS).values(), with_shape()])
def test_masses_of_nodes_add_up_to_one(effect: Formula):
    nodes = AmplitudePrior(effect, U).nodes()
    assert float(np.sum(np.exp(nodes.log_mass))) == pytest.approx(1.0)
    assert 0 < nodes.inside <= 1.0
    assert nodes.table.shape == (len(nodes.values), COUNT)
    np.testing.assert_allclose(nodes.table, effect.log_ratio(nodes.values))


@settings(max_examples=20, deadline=None)
@given(st.floats(0.3, 20.0), st.floats(0.3, 20.0))
def test_no_node_lies_beyond_the_cap(low: float, high: float):
    effect = linear("capped", TAN * np.deg2rad(1), 0.5, (-low, high))
    values = AmplitudePrior(effect, U).nodes().values
    assert np.all((values >= -low - 1e-12) & (values <= high + 1e-12))


def test_cap_takes_the_prior_beyond_it_away():
    free = AmplitudePrior(steps((-50.0, 50.0)), U).nodes().inside
    one_sided = AmplitudePrior(steps((0.0, 50.0)), U).nodes().inside
    assert one_sided == pytest.approx(free / 2, rel=1e-6)
    # Up to severity 1: log(1/LOWEST) of the flat part and the tail below, on either side.
    width = np.log(HIGHEST / LOWEST) + 0.5
    below, tail = np.log(1 / LOWEST) / width, (1 - (0.15 / LOWEST) ** 4) / 4 / width
    bounded = AmplitudePrior(steps((-1.0, 1.0)), U).nodes().inside
    assert bounded == pytest.approx(below + tail, rel=0.02)


def test_effect_that_its_cap_makes_invisible_has_no_nodes():
    nodes = AmplitudePrior(steps((-0.05, 0.05)), U).nodes()
    assert len(nodes.values) == 0
    assert nodes.inside == 0.0


def test_density_of_one_parameter_integrates_to_one_within_the_cap():
    effect = steps((-1.5, 8.0))
    prior = AmplitudePrior(effect, U)
    prior.nodes()

    def density(x: float) -> float:
        return float(np.exp(prior.log_density(np.array([x]), effect.log_ratio(np.array([[x]]))[0])))

    total = quad(density, -1.5, -0.15, limit=200)[0] + quad(density, 0.15, 8.0, points=[0.5, 6.0], limit=200)[0]
    assert total == pytest.approx(1.0, rel=0.02)


def test_density_of_two_parameters_integrates_to_one():
    effect = two()
    prior = AmplitudePrior(effect, U)
    prior.nodes()

    def ring(radius: float) -> float:
        """Mean over some directions times the circumference."""
        ways = 2 * pi * (np.arange(8) + 0.3) / 8
        values = [np.array([radius * cos(a), radius * sin(a)]) for a in ways]
        density = [np.exp(prior.log_density(value, effect.log_ratio(value[None])[0])) for value in values]
        return 2 * pi * radius * float(np.mean(density))

    radii = np.geomspace(0.15, 12.0, 400)
    total = np.trapezoid([ring(r) for r in radii], radii)
    assert total == pytest.approx(1.0, rel=0.02)


def test_density_is_nothing_beyond_the_cap_and_without_size():
    prior = AmplitudePrior(steps((-1.0, 2.0)), U)
    row = steps((-1.0, 2.0)).log_ratio(np.array([[1.0]]))[0]
    assert prior.log_density(np.array([2.1]), row) == -np.inf
    assert prior.log_density(np.array([-1.1]), row) == -np.inf
    assert prior.log_density(np.array([0.0]), 0 * row) == -np.inf
    assert np.isfinite(prior.log_density(np.array([1.0]), row))


def test_parameters_of_shape_are_uniform_within_their_caps():
    nodes = AmplitudePrior(with_shape(1.0, 3.0), U).nodes()
    powers, mass = nodes.values[:, 1], np.exp(nodes.log_mass)
    shares = [mass[np.isclose(powers, power)].sum() for power in np.unique(np.round(powers, 9))]
    np.testing.assert_allclose(shares, 1 / len(shares), rtol=1e-3)
    # Middles of equal parts of the range.
    count = len(shares)
    np.testing.assert_allclose(np.unique(np.round(powers, 9)), 1 + 2 * (np.arange(count) + 0.5) / count)


def test_density_of_a_shape_is_that_of_its_range():
    narrow, wide = (AmplitudePrior(with_shape(1.0, high), U) for high in (2.0, 3.0))
    value = np.array([0.02, 1.5])
    row = with_shape().log_ratio(value[None])[0]
    assert narrow.log_density(value, row) - wide.log_density(value, row) == pytest.approx(np.log(2))


@pytest.mark.parametrize("effect", [*effects(COLUMNS).values()])
def test_nodes_reach_from_hardly_visible_to_gross_unless_capped(effect: Formula):
    prior = AmplitudePrior(effect, U)
    severity = prior.severity(prior.nodes().table)
    assert severity.min() < 0.25
    assert severity.max() > 6.0


def test_severity_is_the_root_mean_square_in_units_of_the_uncertainty():
    prior = AmplitudePrior(steps((-50.0, 50.0)), U)
    row = np.log1p(3 * U * np.where(np.arange(COUNT) < COUNT / 2, 1.0, -1.0))
    assert prior.severity(row) == pytest.approx(3.0)


@settings(max_examples=20, deadline=None)
@given(st.sets(st.integers(0, COUNT - 1), min_size=5, max_size=40))
def test_effect_at_some_points_is_the_effect_there(chosen: set[int]):
    rows = np.array(sorted(chosen))
    effect = effects(COLUMNS)["tilt"]
    some = AtRows(effect, rows)
    values = np.array([[0.3, -0.2], [1.0, 0.0]])
    np.testing.assert_array_equal(some.log_ratio(values), effect.log_ratio(values)[:, rows])
    assert some.name == effect.name
    assert some.parameters is effect.parameters


def test_logarithm_of_a_sum_of_nothing_is_minus_infinity():
    assert log_sum(np.zeros(0)) == -np.inf
    assert log_sum(np.log([1.0, 2.0, 4.0])) == pytest.approx(np.log(7.0))
