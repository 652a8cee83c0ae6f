"""Repetitions of a prediction whose error is too large: the mean stays unbiased, the stated error is reached."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import polygamma

from twin.pooled_variance import Expected, expected, nothing_expected
from twin.repetitions import Repetitions, no_repetitions, repetitions
from twin.sampling_plan import RATE, Tally
from twin.tracer import RANDOMISATIONS, Part

LINES = 256
RATE2 = np.array([[2 * RATE[part]] for part in Part])


def tally(values: np.ndarray, lines: int | np.ndarray = LINES) -> Tally:
    """Values of every part, point and randomisation as if so many sight lines had been traced."""
    found = Tally(values.shape[1])
    found.done[:] = lines
    found.sums = values * found.done[..., None]
    return found


def gamma(rng: np.random.Generator, shape: float, points: int, length: np.ndarray | float = 1.0) -> np.ndarray:
    """Skewed means of runs of some length: the mean is 1, the variance falls as that of the parts does."""
    lots = np.broadcast_to(np.asarray(length, dtype=float), (len(Part), points)) ** RATE2
    some = shape * np.maximum(lots, 1e-6)[..., None]
    return np.where(lots[..., None] > 0, rng.gamma(some, 1 / some, (*lots.shape, RANDOMISATIONS)), 0.0)


def repeated(main: Tally, plan: Repetitions, rng: np.random.Generator, shape: float) -> tuple[np.ndarray, np.ndarray]:
    """Reading and standard uncertainty after the repetitions."""
    lines = plan.lines()
    again = tally(gamma(rng, shape, lines.shape[1], lines / LINES), lines)
    return plan.result(again)


def test_the_weight_of_a_randomisation_does_not_depend_on_its_own_value() -> None:
    rng = np.random.default_rng(3)
    values = gamma(rng, 0.5, 50)
    before = repetitions(tally(values), nothing_expected(50), 0.2).weight
    values[:, :, 4] = 30.0
    after = repetitions(tally(values), nothing_expected(50), 0.2).weight
    np.testing.assert_array_equal(after[:, :, 4], before[:, :, 4])
    assert np.mean(after[:, :, 5].max(axis=0) > before[:, :, 5].max(axis=0)) > 0.9


def test_a_skewed_distribution_keeps_its_mean() -> None:
    rng = np.random.default_rng(1)
    points, shape = 6000, 0.5
    main = tally(gamma(rng, shape, points))
    plan = repetitions(main, nothing_expected(points), 0.2)
    reading, _ = repeated(main, plan, rng, shape)
    assert np.mean(plan.weight.max(axis=(0, 2)) > 0) > 0.2
    error = reading.std(ddof=1) / np.sqrt(points)
    assert abs(reading.mean() - len(Part)) < 4 * error
    # Decided by all values together, repetitions lower it.
    _, stated = no_repetitions(main, plan.expected).result(Tally(points))
    alike = np.broadcast_to(np.where(stated > 0.2 * len(Part), 8.0, 0.0)[:, None], plan.weight.shape)
    lowered, _ = repeated(main, Repetitions(main, plan.expected, alike, plan.longer), rng, shape)
    assert lowered.mean() - len(Part) < -4 * lowered.std(ddof=1) / np.sqrt(points)


def test_errors_cover_and_the_wanted_error_is_reached() -> None:
    rng = np.random.default_rng(2)
    points, shape, wanted = 3000, 30.0, 0.025
    main = tally(gamma(rng, shape, points))
    plan = repetitions(main, nothing_expected(points), wanted)
    assert np.mean(plan.weight.max(axis=(0, 2)) > 0) > 0.3
    reading, error = repeated(main, plan, rng, shape)
    assert np.max(error / main.means().sum(axis=0)) <= wanted
    z = (reading - len(Part)) / error
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.683, abs=0.04)
    assert np.mean(np.abs(z) < 2) == pytest.approx(0.954, abs=0.02)


def test_a_single_randomisation_far_off_does_not_leave_the_error_too_large() -> None:
    values = 1 + 0.01 * np.random.default_rng(4).standard_normal((len(Part), 5, RANDOMISATIONS))
    values[Part.SCATTERED, 2, 7] = 40.0
    main = tally(values)
    plan = repetitions(main, nothing_expected(5), 0.02)
    error = np.sqrt(plan.variances()[0].sum(axis=0)) / main.means().sum(axis=0)
    assert np.all(error <= 0.02)
    assert np.all(plan.weight[Part.SCATTERED, 2] > 0)
    assert np.all(plan.weight[:, [0, 1, 3, 4]] == 0)


def test_without_repetitions_the_reading_is_the_main_runs() -> None:
    main = tally(gamma(np.random.default_rng(5), 3.0, 4))
    reading, error = no_repetitions(main, nothing_expected(4)).result(Tally(4))
    np.testing.assert_allclose(reading, main.means().sum(axis=0))
    assert np.all(error > np.sqrt(main.variances().sum(axis=0)))  # Student's factor


def runs(rng: np.random.Generator, points: int, scatter: float, off: float) -> tuple[Tally, Tally, np.ndarray]:
    """Pilot and main run of normal values whose variance falls as it should but for a factor and its scatter."""
    main_lines, pilot_lines = 1024, 64
    truth = rng.uniform(0.5, 2.0, (len(Part), points)) * 1e-4
    wrong = off * np.exp(scatter * rng.standard_normal(truth.shape))
    before = truth * wrong * (main_lines / pilot_lines) ** RATE2
    shape = (*truth.shape, RANDOMISATIONS)
    pilot, main = (
        tally(1 + np.sqrt(v * RANDOMISATIONS)[..., None] * rng.standard_normal(shape), lines)
        for v, lines in ((before, pilot_lines), (truth, main_lines))
    )
    return pilot, main, truth


def test_the_pilot_counts_by_what_it_is_worth() -> None:
    rng = np.random.default_rng(7)
    pilot, main, truth = runs(rng, 4000, 0.0, 2.0)
    found = expected(pilot, main)
    assert np.all(found.degrees > 13.5)  # as good as the main run's own 15 or better, though off by a factor of 2
    pooled, degrees = found.pooled(main.variances())
    scatter = np.log(pooled / truth).var(axis=1)
    np.testing.assert_allclose(scatter, polygamma(1, degrees / 2), rtol=0.1)
    # Drawn together, low variances are stated too high and high ones too low, by less than chance.
    assert np.mean(pooled / truth) == pytest.approx(1.0, abs=0.05)
    assert pooled.sum() / truth.sum() == pytest.approx(1.0, abs=0.01)

    pilot, main, truth = runs(rng, 4000, 0.6, 1.0)
    found = expected(pilot, main)
    # Another 0.6 of scatter: worth as many degrees as scatter as much by chance.
    assert np.all(found.degrees < 10)
    scatter = np.log(found.variances / truth).var(axis=1)
    np.testing.assert_allclose(scatter, polygamma(1, found.degrees / 2), rtol=0.15)
    errors = (main.means() - 1) / np.sqrt(found.pooled(main.variances())[0])
    assert np.mean(np.abs(errors) < 1) == pytest.approx(0.672, abs=0.01)  # Student's t of 23 degrees of freedom


def test_few_geometries_do_not_tell_what_the_pilot_is_worth() -> None:
    pilot, main, _ = runs(np.random.default_rng(8), 10, 0.0, 1.0)
    found = expected(pilot, main)
    assert np.all(found.degrees == 0)
    variances, degrees = found.pooled(main.variances())
    np.testing.assert_allclose(variances, main.variances())
    assert np.all(degrees == RANDOMISATIONS - 1)


def test_a_dark_geometry_among_many_expects_nothing() -> None:
    pilot, main, _ = runs(np.random.default_rng(9), 60, 0.0, 1.0)
    pilot.sums[:, 3] = main.sums[:, 3] = 0.0
    found = expected(pilot, main)
    assert np.all(found.variances[:, 3] == 0)
    assert np.all(np.delete(found.variances, 3, axis=1) > 0)
    assert np.all(found.degrees > 0)


def test_pooled_variances_are_weighted_by_degrees_of_freedom() -> None:
    known = Expected(np.full((len(Part), 1), 4.0), np.array([5.0, 15.0, 0.0]))
    variances, degrees = known.pooled(np.full((len(Part), 1), 1.0))
    np.testing.assert_allclose(variances[:, 0], [35 / 20, 75 / 30, 1.0])
    np.testing.assert_allclose(degrees, [20.0, 30.0, 15.0])
