"""Fits and evidences against integrals done by brute force, and against generalised least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest, multivariate_normal
from synthetic_runs import (
    SCALE,
    Formula,
    Parameter,
    at_severity,
    effects,
    errors,
    grid,
    linear,
    observed,
    structure,
)

from twin.diagnosis.covariance import Structure
from twin.diagnosis.fit import Component, fit_none, fit_pair, fit_single, refine
from twin.diagnosis.likelihood import Normal, marginal, normals

COLUMNS = grid({0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}, 10.0)
COUNT = len(COLUMNS["wavelength"])
RUN = observed(COLUMNS)
U = RUN.relative_u
KINDS = (
    "independent, 1 times the budget",
    "one factor a slice, 1 times the budget",
    "wander over 16 degrees, 1.5 times the budget",
)
TAN = np.tan(np.deg2rad(COLUMNS["sensor_zenith"]))


def members(*kinds: str) -> list[Normal]:
    chosen = [structure(COLUMNS, kind) for kind in kinds or KINDS]
    total = sum(s.weight for s in chosen)
    rescaled = [Structure(s.name, s.weight / total, s.covariance) for s in chosen]
    return normals(rescaled, np.full((COUNT, 1), SCALE), np.full(COUNT, 0.001))


def slope(typical: float = 0.5) -> Formula:
    return linear("slope", np.deg2rad(TAN), typical, (-20.0, 20.0))


def severities(tables: np.ndarray) -> np.ndarray:
    """Of rows of logarithmic ratios, shape (row,)."""
    return np.sqrt(np.mean((np.expm1(tables) / U) ** 2, axis=1))


def slab(size: np.ndarray) -> np.ndarray:
    """Density over the logarithm of the severity: flat from 0.5 to 6, falling with the fourth power beyond."""
    flat = 1 / (np.log(12.0) + 2 / 4.0)
    return flat * np.minimum(1.0, np.minimum((size / 0.5) ** 4, (6.0 / size) ** 4))


def evidence_by_brute_force(effect: Formula, residual: np.ndarray, member: Normal) -> float:
    """Integral of the density over one parameter, half of the prior on each side, by 4000 trapezia."""
    density = multivariate_normal(np.zeros(COUNT), member.covariance)
    amounts = np.geomspace(1e-3, 15.0, 4000)
    sides = [effect.log_ratio(sign * amounts[:, None]) for sign in (1.0, -1.0)]
    values = [density.logpdf(residual - tables) for tables in sides]
    best, total, mass = np.max(values), 0.0, 0.0
    for tables, value in zip(sides, values, strict=True):
        size = severities(tables)
        prior = 0.5 * slab(size) * ((size > 0.15) & (size < 12.0))
        total += np.trapezoid(prior * np.exp(value - best), np.log(size))
        mass += np.trapezoid(prior, np.log(size))
    return float(np.log(total / mass) + best)


@pytest.mark.parametrize("wanted", [0.0, 0.4, 1.0, 2.5])
@pytest.mark.parametrize("kind", KINDS)
def test_evidence_of_one_parameter_is_the_integral(kind: str, wanted: float):
    effect = slope()
    change = errors(COLUMNS, kind, seed=5)
    if wanted:
        change = change + effect.log_ratio(at_severity(effect, wanted, RUN)[None])[0]
    (member,) = members(kind)
    fit = fit_single(Component.of(effect, U), change, [member])
    assert fit is not None
    expected = evidence_by_brute_force(effect, change, member)
    assert fit.log_evidence == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("kind", KINDS)
def test_laplace_of_a_clear_effect_is_the_integral(kind: str):
    effect = slope()
    change = errors(COLUMNS, kind, seed=6) + effect.log_ratio(at_severity(effect, 2.0, RUN)[None])[0]
    (member,) = members(kind)
    found = refine([Component.of(effect, U)], np.array([0.5]), change, member)
    assert found is not None
    assert found.log_evidence == pytest.approx(evidence_by_brute_force(effect, change, member), abs=0.05)


@pytest.mark.parametrize("wanted", [0.5, 3.0])
def test_evidence_of_a_vector_is_the_integral_over_the_plane(wanted: float):
    effect, kind = effects(COLUMNS)["tilt"], KINDS[1]
    change = errors(COLUMNS, kind, seed=7)
    change = change + effect.log_ratio(at_severity(effect, wanted, RUN, (1.0, 0.5))[None])[0]
    (member,) = members(kind)
    fit = fit_single(Component.of(effect, U), change, [member])
    assert fit is not None
    # Polar coordinates in the typical amplitudes, which are the same for both axes.
    lengths, log_values, weights = np.geomspace(0.02, 8.0, 300), [], []
    for way in 2 * np.pi * np.arange(360) / 360:
        tables = effect.log_ratio(0.5 * lengths[:, None] * np.array([np.cos(way), np.sin(way)]))
        size = severities(tables)
        weights.append(np.gradient(np.log(size)) * slab(size) * ((size > 0.15) & (size < 12.0)))
        log_values.append(member.log_norm - 0.5 * np.sum(member.white(change - tables) ** 2, axis=1))
    values, prior = np.array(log_values), np.array(weights)
    expected = np.log(np.sum(prior * np.exp(values - values.max())) / np.sum(prior)) + values.max()
    assert fit.log_evidence == pytest.approx(expected, abs=0.3)


def test_evidence_over_structures_is_the_weighted_mean():
    effect, change = slope(), errors(COLUMNS, KINDS[0], seed=8)
    change = change + effect.log_ratio(np.array([[1.0]]))[0]
    found = members()
    fit = fit_single(Component.of(effect, U), change, found)
    alone = [fit_single(Component.of(effect, U), change, [Normal(m.name, 0.0, m.covariance)]) for m in found]
    assert fit is not None
    expected = marginal([f.log_evidence for f in alone if f is not None], found)
    assert fit.log_evidence == pytest.approx(expected, abs=1e-3)


def test_no_effect_is_as_probable_as_the_residuals():
    change, found = errors(COLUMNS, KINDS[0], seed=9), members()
    fit = fit_none(change, found)
    densities = [multivariate_normal(np.zeros(COUNT), m.covariance).logpdf(change) for m in found]
    assert fit.log_evidence == pytest.approx(marginal(densities, found))
    assert fit.names == ()
    assert fit.best == int(np.argmax(np.array(densities) + [m.log_weight for m in found]))


@pytest.mark.parametrize("kind", KINDS)
def test_clear_effect_is_fitted_as_by_generalised_least_squares(kind: str):
    effect, (member,) = slope(), members(kind)
    column = np.deg2rad(TAN)
    change = errors(COLUMNS, kind, seed=10) + 1.5 * column
    fit = fit_single(Component.of(effect, U), change, [member])
    inverse = np.linalg.inv(member.covariance)
    information = column @ inverse @ column
    assert fit is not None
    assert fit.values[0] == pytest.approx(column @ inverse @ change / information, abs=0.1 / np.sqrt(information))
    assert np.sqrt(fit.covariance[0, 0]) == pytest.approx(1 / np.sqrt(information), rel=0.05)


def test_fitted_vector_lies_within_its_uncertainty():
    effect, kind = effects(COLUMNS)["tilt"], KINDS[1]
    true = np.array([0.6, -0.9])
    change = errors(COLUMNS, kind, seed=11) + effect.log_ratio(true[None])[0]
    fit = fit_single(Component.of(effect, U), change, members())
    assert fit is not None
    apart = fit.values - true
    assert apart @ np.linalg.solve(fit.covariance, apart) < 13.8  # 0.999 of chi-square with 2 degrees of freedom
    assert np.all(np.sqrt(np.diag(fit.covariance)) < 0.2)


def test_uncertainties_cover_what_was_put_in():
    effect, kind = slope(), KINDS[1]
    component, found = Component.of(effect, U), members(kind)
    true = at_severity(effect, 1.5, RUN)
    scores = []
    for seed in range(60):
        fit = fit_single(component, errors(COLUMNS, kind, seed) + effect.log_ratio(true[None])[0], found)
        assert fit is not None
        scores.append((fit.values[0] - true[0]) / np.sqrt(fit.covariance[0, 0]))
    assert kstest(scores, "norm").pvalue > 1e-3
    assert 0.75 < np.std(scores) < 1.3


def test_fit_stays_within_the_cap():
    stray = effects(COLUMNS)["stray"]
    change = errors(COLUMNS, KINDS[0], seed=12) + np.log1p(-0.002 / np.cos(np.deg2rad(COLUMNS["sensor_zenith"])))
    fit = fit_single(Component.of(stray, U), change, members())
    assert fit is not None
    assert fit.values[0] >= 0.0
    assert fit.log_evidence < fit_none(change, members()).log_evidence


def test_effect_that_cannot_be_seen_has_no_fit():
    tiny = linear("tiny", np.deg2rad(TAN), 0.5, (-1e-3, 1e-3))
    assert fit_single(Component.of(tiny, U), errors(COLUMNS, KINDS[0], 1), members()) is None


def test_shape_of_an_effect_is_found_where_the_run_shows_it():
    place = np.linspace(0.05, 1.0, COUNT)
    parameters = (Parameter("size", 0.03, (-0.5, 0.5)), Parameter("power", 1.0, (0.5, 4.0), nominal=1.0, shape=True))
    bent = Formula("bent", parameters, lambda v: np.log1p(v[:, :1] * place ** v[:, 1:]))
    change = errors(COLUMNS, KINDS[0], seed=13) + bent.log_ratio(np.array([[0.12, 3.0]]))[0]
    fit = fit_single(Component.of(bent, U), change, members(KINDS[0]))
    assert fit is not None
    assert abs(fit.values[1] - 3.0) < 3 * np.sqrt(fit.covariance[1, 1])
    assert 0.05 < np.sqrt(fit.covariance[1, 1]) < 0.8


def two(first: np.ndarray, second: np.ndarray) -> tuple[Component, Component]:
    return (
        Component.of(linear("first", first, 0.01, (-1.0, 1.0)), U),
        Component.of(linear("second", second, 0.01, (-1.0, 1.0)), U),
    )


def test_pair_is_fitted_as_by_generalised_least_squares():
    kind = KINDS[0]
    (member,) = members(kind)
    columns = np.stack([np.sin(np.deg2rad(COLUMNS["sensor_zenith"])), np.linspace(-1, 1, COUNT) ** 2])
    first, second = two(*columns)
    change = errors(COLUMNS, kind, seed=14) + np.array([0.03, -0.04]) @ columns
    fit = fit_pair(first, second, np.array([0.01, -0.01]), change, [member], [0])
    inverse = np.linalg.inv(member.covariance)
    information = columns @ inverse @ columns.T
    expected = np.linalg.solve(information, columns @ inverse @ change)
    assert fit is not None
    assert fit.sizes == (1, 1)
    np.testing.assert_allclose(fit.values, expected, atol=0.1 * np.sqrt(np.linalg.inv(information).max()))
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(information), rtol=0.05, atol=1e-8)


def test_evidence_of_a_pair_is_the_integral_over_both():
    kind = KINDS[0]
    (member,) = members(kind)
    columns = np.stack([np.sin(np.deg2rad(COLUMNS["sensor_zenith"])), np.linspace(-1, 1, COUNT) ** 2])
    change = errors(COLUMNS, kind, seed=15) + np.array([0.03, -0.04]) @ columns
    fit = fit_pair(*two(*columns), np.array([0.03, -0.04]), change, [member], [0])
    assert fit is not None
    axes = [np.linspace(0.01, 0.05, 120), np.linspace(-0.06, -0.02, 120)]
    sizes = [severities(axis[:, None] * column) for axis, column in zip(axes, columns, strict=True)]
    priors = [
        slab(size) * 0.5 * np.abs(np.gradient(np.log(size), axis)) for size, axis in zip(sizes, axes, strict=True)
    ]
    rows = axes[0][:, None, None] * columns[0] + axes[1][None, :, None] * columns[1]
    values = member.log_norm - 0.5 * np.sum(member.white(change - rows) ** 2, axis=-1)
    best = values.max()
    weighed = np.exp(values - best) * priors[0][:, None] * priors[1]
    expected = best + np.log(np.trapezoid(np.trapezoid(weighed, axes[1], axis=1), axes[0]))
    assert fit.log_evidence == pytest.approx(expected, abs=0.1)


def test_effects_that_look_alike_are_no_pair():
    column = np.deg2rad(TAN)
    first, second = two(column, column * (1 + 0.02 * np.linspace(-1, 1, COUNT)))
    change = errors(COLUMNS, KINDS[0], seed=16) + column
    assert fit_pair(first, second, np.array([0.5, 0.5]), change, members(), [0, 1]) is None


def test_effect_at_some_points_keeps_its_prior():
    component = Component.of(slope(), U)
    rows = np.arange(0, COUNT, 2)
    some = component.at(rows)
    np.testing.assert_array_equal(some.nodes.log_mass, component.nodes.log_mass)
    np.testing.assert_array_equal(some.nodes.table, component.nodes.table[:, rows])
    value = np.array([0.7])
    np.testing.assert_array_equal(some.row(value), component.row(value)[rows])
