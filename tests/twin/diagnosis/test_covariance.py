"""Structures of the errors: proper covariances, proper weights, and the pattern that each name promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_runs import NOISE, STABILITY, grid, observed

from twin.diagnosis.covariance import (
    BLOCKS,
    LENGTHS,
    OVER_DIRECTIONS,
    SCALES,
    TIMES,
    correlations,
    noise_and_stability,
    over_directions,
    smooth_gap,
    structures,
)
from twin.diagnosis.observation import Observation

SMALL = {0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}


def run(**changes) -> Observation:
    return observed(grid(SMALL, 10.0, **changes))


def named(found: list[tuple[str, float, np.ndarray]], name: str) -> np.ndarray:
    return next(matrix for label, _, matrix in found if label == name)


def least_eigenvalue(matrix: np.ndarray) -> float:
    return float(np.linalg.eigvalsh(matrix)[0])


@pytest.mark.parametrize("serpentine", [False, True])
def test_correlations_are_positive_semidefinite_with_unit_diagonal(serpentine: bool):
    for name, _, matrix in correlations(run(serpentine=serpentine)):
        np.testing.assert_allclose(np.diag(matrix), 1.0, err_msg=name)
        np.testing.assert_array_equal(matrix, matrix.T, err_msg=name)
        assert least_eigenvalue(matrix) > -1e-9, name


@settings(max_examples=15, deadline=None)
@given(st.sets(st.integers(0, 63), min_size=5, max_size=25))
def test_gaps_and_correlations_of_any_part_of_a_plan_are_proper(chosen: set[int]):
    some = run().take(np.array(sorted(chosen)))
    matrices = [(name, matrix) for name, _, matrix in correlations(some)] + smooth_gap(some)
    for name, matrix in matrices:
        np.testing.assert_allclose(np.diag(matrix), 1.0, err_msg=name)
        assert least_eigenvalue(matrix) > -1e-9, name


def test_weights_add_up_to_one():
    assert sum(s.weight for s in structures(run())) == pytest.approx(1.0)
    assert all(s.weight > 0 for s in structures(run()))


def test_every_correlation_comes_in_every_size():
    found, kinds = structures(run()), correlations(run())
    assert len(found) == len(kinds) * len(SCALES) + 1
    assert len({s.name for s in found}) == len(found)


def test_variance_is_noise_and_scaled_stability():
    for structure in structures(run()):
        sizes = [NOISE**2 + (scale * STABILITY) ** 2 for scale in SCALES] + [NOISE**2]
        variance = np.diag(structure.covariance)
        assert np.ptp(variance) < 1e-15
        assert any(variance[0] == pytest.approx(size) for size in sizes), structure.name


def test_run_without_components_shares_its_uncertainty_out():
    noise, stability = noise_and_stability(observed(grid(SMALL, 10.0), components=False))
    u2 = NOISE**2 + STABILITY**2 + 0.005**2
    np.testing.assert_allclose(noise**2, 0.25 * u2)
    np.testing.assert_allclose(stability**2, 0.5 * u2)


def test_run_without_stability_has_independent_errors_alone():
    sound = run()
    still = Observation(
        **{**vars(sound), "components": {"noise": 0.006 * sound.brf, "stability": np.zeros(len(sound))}}
    )
    (only,) = structures(still)
    assert only.weight == 1.0
    np.testing.assert_allclose(only.covariance, np.diag(np.full(len(sound), 0.006**2)))


def test_one_factor_a_slice_joins_points_of_a_plane_and_no_others():
    matrix, plane = named(correlations(run()), "one factor a slice"), run().plane
    np.testing.assert_array_equal(matrix == 1.0, plane[:, None] == plane)
    assert set(np.unique(matrix)) == {0.0, 1.0}


def test_a_factor_of_a_session_is_no_structure_of_the_errors():
    # It is what the scale of a session does: among the errors it would explain that effect away.
    light = run().illumination
    session = (light[:, None] == light).astype(float)
    assert not any(np.array_equal(matrix, session) for _, _, matrix in correlations(run()))


@pytest.mark.parametrize("length", LENGTHS)
def test_wander_falls_by_the_square_of_the_zenith_distance_within_a_slice(length: float):
    sound = run()
    matrix = named(correlations(sound), f"wander over {length:g} degrees")
    zenith, plane = sound.columns["sensor_zenith"], sound.plane
    first, second = 0, 3
    apart = zenith[first] - zenith[second]
    assert matrix[first, second] == pytest.approx(np.exp(-0.5 * (apart / length) ** 2))
    assert np.all(matrix[plane[:, None] != plane] == 0.0)


@pytest.mark.parametrize("length", OVER_DIRECTIONS)
def test_wander_over_directions_joins_the_slices_of_an_illumination_and_falls_with_its_angle(length: float):
    sound = run(shadow=False)
    matrix = named(correlations(sound), f"smooth over directions, {length:g} degrees")
    light, zenith = sound.columns["illumination_zenith"], sound.columns["sensor_zenith"]
    upright, slanted = (np.flatnonzero((zenith == 0) & (light == angle)) for angle in (0.0, 30.0))
    np.testing.assert_allclose(matrix[np.ix_(upright, upright)], 1.0)
    np.testing.assert_allclose(matrix[np.ix_(upright, slanted)], np.exp(-0.5 * (30 / length) ** 2))


@pytest.mark.parametrize("length", BLOCKS)
def test_blocks_are_runs_of_points_in_the_order_of_time(length: int):
    sound = run()
    shuffled = np.random.default_rng(3).permutation(len(sound))
    matrix = named(correlations(sound.take(shuffled)), f"blocks of {length} points")
    moment = shuffled  # points were read in the order of the plan
    np.testing.assert_array_equal(matrix == 1.0, moment[:, None] // length == moment // length)


@pytest.mark.parametrize("share", TIMES)
def test_wander_in_time_falls_exponentially(share: float):
    matrix = named(correlations(run()), f"wander in time, {share:g} of the run")
    count = len(run())
    assert matrix[0, 5] == pytest.approx(np.exp(-5 / (count - 1) / share))


def test_directions_closer_together_are_more_alike_and_equal_ones_are_one():
    sound = run(shadow=False)
    matrix = over_directions(sound, 25.0)
    zenith, azimuth = sound.columns["sensor_zenith"], sound.columns["sensor_azimuth"]
    nadirs = np.flatnonzero((zenith == 0) & (sound.columns["illumination_zenith"] == 0))
    assert len(nadirs) == 2
    assert matrix[nadirs[0], nadirs[1]] == pytest.approx(1.0)
    # On the meridian azimuth 0, chord 2 sin(difference/2) of unit vectors.
    here = np.flatnonzero((azimuth == 0) & (sound.columns["illumination_zenith"] == 0))
    chord = 2 * np.sin(np.deg2rad(zenith[here[0]] - zenith[here[4]]) / 2)
    assert matrix[here[0], here[4]] == pytest.approx(np.exp(-0.5 * (chord / np.deg2rad(25)) ** 2))


def test_steps_in_time_are_a_random_sequence_of_steps():
    steps = dict(smooth_gap(run()))["a sequence of steps in time"]
    count = len(run())
    expected = 1 - np.abs(np.subtract.outer(np.arange(count), np.arange(count))) / (count - 1)
    np.testing.assert_allclose(steps, expected, atol=1e-12)
