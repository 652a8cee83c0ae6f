"""Several runs as one: what is shared, what is each run's own, and what is gained."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_runs import effects, errors, grid, nominal, observed, problem

from instrument.errors import InputError
from twin.diagnosis.covariance import Structure
from twin.diagnosis.fit import fit_none, fit_single
from twin.diagnosis.joint import (
    OF_A_MOUNTING,
    OF_A_RUN,
    JointResponse,
    join,
    joined,
    joined_columns,
    joined_responses,
    joined_structures,
)
from twin.diagnosis.preparation import Prepared
from twin.diagnosis.responses import Responses

PLANES = {0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}
LIBRARY = ("zero", "stray")


def prepared(angle: float, seed: int) -> Prepared:
    """A run whose sensor zenith is off, with noise and an error of scale."""
    columns = grid(PLANES, 10.0)
    known = effects(columns)
    change = known["zero"].log_ratio(np.array([[angle]]))[0] + errors(
        columns, "one factor a slice, 1 times the budget", seed
    )
    run = observed(columns, change)
    found = {name: known[name] for name in LIBRARY}
    count = len(run)
    budget = {
        "scale": np.full(count, 0.005),
        "sample_tilt x_deg": np.full(count, 0.001),
        "holes": np.full(count, 0.002),
    }
    return Prepared(problem(run, list(found.values())), Responses(found, {}), budget)


@pytest.fixture(scope="module")
def two() -> list[Prepared]:
    return [prepared(0.5, 1), prepared(0.5, 2)]


def test_points_follow_each_other_and_rows_go_on_counting(two):
    runs = [p.problem.run for p in two]
    together = joined(runs)
    count = len(runs[0])
    assert len(together) == 2 * count
    assert together.rows[count] == runs[0].rows.max() + 1
    assert np.all(np.diff(together.seconds) > 0)
    assert together.plane.max() == runs[0].plane.max()


def test_one_run_is_no_joint_diagnosis(two):
    with pytest.raises(InputError, match="expected at least two"):
        joined([two[0].problem.run])


def test_what_not_every_run_states_is_left_out_and_said():
    columns = grid(PLANES, 10.0)
    together = joined([observed(columns), observed(columns, components=False, times=False)])
    assert together.components == {}
    assert together.seconds is None
    assert any("not stated by all runs" in note for note in together.notes)


def test_columns_of_a_run_act_in_it_alone_and_those_of_the_twin_in_all():
    parts = [{"scale": np.ones(2), "sample_tilt x_deg": np.ones(2), "holes": np.ones(2)}] * 2
    every = joined_columns(parts, [2, 2], OF_A_RUN + OF_A_MOUNTING)
    assert sorted(every) == [
        "holes",
        "sample_tilt x_deg, run 1",
        "sample_tilt x_deg, run 2",
        "scale, run 1",
        "scale, run 2",
    ]
    np.testing.assert_array_equal(every["holes"], [1, 1, 1, 1])
    np.testing.assert_array_equal(every["scale, run 2"], [0, 0, 1, 1])
    mounted = joined_columns(parts, [2, 2], OF_A_RUN)
    np.testing.assert_array_equal(mounted["sample_tilt x_deg"], [1, 1, 1, 1])


def test_errors_of_different_runs_are_not_correlated():
    one = [Structure("a", 0.5, np.ones((2, 2))), Structure("b", 0.3, np.eye(2)), Structure("c", 0.2, np.eye(2))]
    other = [Structure("a", 0.5, 2 * np.ones((1, 1))), Structure("b", 0.5, np.eye(1))]
    found = joined_structures([one, other])
    assert [s.name for s in found] == ["a", "b"]
    np.testing.assert_allclose([s.weight for s in found], [0.625, 0.375])
    np.testing.assert_array_equal(found[0].covariance, [[1, 1, 0], [1, 1, 0], [0, 0, 2]])
    silent = joined_structures([one, [Structure("none", 1.0, np.eye(1))]])
    assert [s.name for s in silent] == ["a", "b", "c"]


def test_an_effect_that_one_run_does_not_record_is_ruled_out_for_all(two):
    known = two[0].responses.found
    reason = "the run says nothing of gain"
    found, out = joined_responses([Responses(known, {}), Responses({"zero": known["zero"]}, {"stray": reason})])
    assert list(found) == ["zero"]
    assert out == {"stray": f"run 2: {reason}"}


def test_own_parameters_act_in_their_run_alone(two):
    part = two[0].responses.found["zero"]
    own = JointResponse((part, part), own=True)
    assert [p.name for p in own.parameters] == ["run1_angle_deg", "run2_angle_deg"]
    both = own.log_ratio(np.array([[0.5, 0.0]]))[0]
    count = len(both) // 2
    np.testing.assert_allclose(both[:count], part.log_ratio(np.array([[0.5]]))[0])
    np.testing.assert_allclose(both[count:], 0.0, atol=1e-12)
    assert own.derivative().shape == (2, 2 * count)


def test_two_runs_know_the_shared_parameter_better_than_one(two):
    """Own errors alone, and their structure known: the variance of two equal runs is half of one's."""
    nothing = np.zeros((2 * len(two[0].problem.run), 1))
    together = join(two, nothing).problem
    name = "one factor a slice, 1 times the budget"

    def spread(given) -> tuple[float, float]:
        members = [m for m in given.members if m.name == name]
        fit = fit_single(given.component("zero"), given.residual, members)
        return float(fit.values[0]), float(np.sqrt(fit.covariance[0, 0]))

    alone = [spread(join([p, p], nothing).problem.at(np.arange(len(p.problem.run)))) for p in two]
    value, u = spread(together)
    assert u == pytest.approx(alone[0][1] / np.sqrt(2), rel=0.15)
    assert abs(value - 0.5) < 3 * u
    weights = np.array([1 / a[1] ** 2 for a in alone])
    assert value == pytest.approx(float(weights @ [a[0] for a in alone] / weights.sum()), abs=0.5 * u)


def test_runs_that_contradict_each_other_lose_evidence():
    """Opposite errors have no common cause among shared parameters: the joint gain is below that of agreeing runs."""

    def gain(second: float) -> float:
        parts = [prepared(0.8, 3), prepared(second, 4)]
        given = join(parts, np.zeros((2 * len(parts[0].problem.run), 1))).problem
        fit = fit_single(given.component("zero"), given.residual, given.members)
        return fit.log_evidence - fit_none(given.residual, given.members).log_evidence

    agreeing, contradicting = gain(0.8), gain(-0.8)
    assert agreeing > 5.0
    assert contradicting < 0.3 * agreeing


def test_the_nominal_prediction_is_that_of_each_run(two):
    together = join(two, np.zeros((2 * len(two[0].problem.run), 1))).problem
    np.testing.assert_allclose(together.nominal, np.tile(nominal(two[0].problem.run.columns), 2))
