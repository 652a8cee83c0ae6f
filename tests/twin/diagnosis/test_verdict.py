"""What is said of given probabilities: verdicts, classes and their sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.diagnosis.fit import Fit
from twin.diagnosis.posterior import Hypothesis, Posterior, normalised
from twin.diagnosis.verdict import LARGEST_CLASS, TOLD_APART, confirmed, decide

U = np.array([0.01, 0.02])


def fit(*names: str) -> Fit:
    """A fit with one parameter an effect: 1, 2, ... with standard uncertainties of a tenth; a change of two in U."""
    count = len(names)
    values = 1.0 + np.arange(count)
    covariance = np.diag((0.1 * values) ** 2)
    return Fit(names, 0.0, np.zeros(1), values, covariance, np.log1p(2 * U), 0, (1,) * count)


def weighed(*entries: tuple[tuple[str, ...], float], unknown: float = -50.0, none: float = 0.0) -> Posterior:
    """Explanations by names and logarithmic evidence, all of equal prior probability."""
    hypotheses = [Hypothesis((), False, 0.0, none, fit()), Hypothesis((), True, 0.0, unknown, None)]
    hypotheses += [Hypothesis(names, False, 0.0, evidence, fit(*names)) for names, evidence in entries]
    return normalised(hypotheses)


def test_run_within_the_budget_is_none():
    decision = decide(weighed((("tilt",), -3.0), (("drift",), -7.0)))
    assert decision.verdict == "none"
    assert decision.named == ()
    assert [named.effect for named in decision.ranking] == ["tilt", "drift"]


def test_clear_effect_is_named_with_its_parameters():
    decision = decide(weighed((("tilt",), 20.0), (("drift",), 5.0)))
    assert decision.verdict == "effects"
    (named,) = decision.named
    assert (named.effect, named.members) == ("tilt", ("tilt",))
    assert named.probability == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(named.values, [1.0])
    np.testing.assert_allclose(named.u, [0.1])


def test_gap_without_a_name_is_unknown():
    assert decide(weighed((("tilt",), 10.0), unknown=12.0)).verdict == "unknown"


@pytest.mark.parametrize(("behind", "inside"), [(TOLD_APART - 0.1, True), (TOLD_APART + 0.1, False)])
def test_class_holds_what_is_less_than_its_nats_behind(behind: float, inside: bool):
    (named,) = decide(weighed((("stray",), 30.0), (("dark",), 30.0 - behind))).named
    assert ("dark" in named.members) == inside


@pytest.mark.parametrize(("worse", "inside"), [(-2.0, True), (0.9, True), (1.1, False)])
def test_class_holds_what_fits_as_well_and_is_dearer_by_its_prior_alone(worse: float, inside: bool):
    simple, rich = replace(fit("stray"), log_peak=40.0), replace(fit("dark"), log_peak=40.0 - worse)
    none = Hypothesis((), False, 0.0, 0.0, fit())
    posterior = normalised(
        [none, Hypothesis(("stray",), False, 0.0, 30.0, simple), Hypothesis(("dark",), False, 0.0, 22.0, rich)]
    )
    (named,) = decide(posterior).named
    assert named.effect == "stray"
    assert ("dark" in named.members) == inside


def test_effect_whose_fit_was_not_asked_is_judged_by_its_evidence():
    (named,) = decide(weighed((("stray",), 30.0), (("dark",), 22.0))).named
    assert named.members == ("stray",)


@pytest.mark.parametrize(("better", "inside"), [(0.4, False), (0.6, True)])
def test_class_holds_no_effect_that_explains_hardly_more_than_none(better: float, inside: bool):
    posterior = weighed((("stray",), 2.0), (("dark",), better))
    assert (set(decide(posterior).ranking[0].members) == {"stray", "dark"}) == inside


@pytest.mark.parametrize(("better", "inside"), [(0.4, False), (0.6, True)])
def test_class_of_a_second_effect_holds_none_that_explains_hardly_more_than_the_first_alone(
    better: float, inside: bool
):
    decision = decide(weighed((("tilt", "stray"), 30.0), (("tilt", "dark"), 28.0 + better), (("tilt",), 28.0)))
    classes = {named.effect: set(named.members) for named in decision.named}
    assert classes == {"tilt": {"tilt"}, "stray": {"stray", "dark"} if inside else {"stray"}}


def test_probability_of_a_class_is_that_of_its_members_together():
    posterior = weighed((("stray",), 20.0), (("dark",), 19.0), (("tilt",), 19.5 - TOLD_APART))
    (named,) = decide(posterior).named
    assert set(named.members) == {"stray", "dark"}
    assert named.probability == pytest.approx(posterior.of("stray") + posterior.of("dark"))


@pytest.mark.parametrize("count", [LARGEST_CLASS, LARGEST_CLASS + 1])
def test_class_that_is_too_large_names_nothing(count: int):
    decision = decide(weighed(*(((f"effect {k}",), 20.0) for k in range(count))))
    assert decision.verdict == ("effects" if count == LARGEST_CLASS else "undecided")
    assert len(decision.named) == (1 if count == LARGEST_CLASS else 0)
    assert len(decision.ranking[0].members) == count


def test_effect_and_none_and_unknown_alike_is_undecided():
    assert decide(weighed((("tilt",), 0.0), unknown=-0.1, none=-0.1)).verdict == "undecided"


@pytest.mark.parametrize(
    ("consistent", "gain", "verdict"),
    [
        (False, 20.0, "effects"),
        (False, 0.0, "effects"),
        (False, -0.9, "effects"),
        (False, -1.1, "undecided"),
        (True, 20.0, "effects"),
        (True, 0.0, "effects"),
        (True, -0.9, "effects"),
        (True, -1.1, "none"),
    ],
)
def test_an_effect_is_named_unless_the_slices_held_out_speak_against_it(consistent: bool, gain: float, verdict: str):
    said = confirmed(weighed((("tilt",), 20.0)), consistent, gain, U)
    assert said.verdict == verdict
    assert bool(said.named) == (verdict == "effects")


@pytest.mark.parametrize(
    ("probability", "gain", "named"), [(0.69, 0.9, False), (0.69, 1.1, True), (0.71, 0.9, True), (0.71, -1.1, False)]
)
@pytest.mark.parametrize(("consistent", "otherwise"), [(True, "none"), (False, "undecided")])
def test_an_effect_that_is_not_likely_needs_the_slices_held_out(
    probability: float, gain: float, named: bool, consistent: bool, otherwise: str
):
    posterior = weighed((("tilt",), float(np.log(probability / (1 - probability)))))
    assert confirmed(posterior, consistent, gain, U).verdict == ("effects" if named else otherwise)


@pytest.mark.parametrize(("severity", "named"), [(0.32, False), (0.35, True)])
@pytest.mark.parametrize(("consistent", "otherwise"), [(True, "none"), (False, "undecided")])
def test_a_change_below_a_third_of_the_uncertainty_is_not_named(
    severity: float, named: bool, consistent: bool, otherwise: str
):
    said = confirmed(weighed((("tilt",), 20.0)), consistent, 20.0, 2 * U / severity)
    assert said.verdict == ("effects" if named else otherwise)
    assert bool(said.named) == named


@pytest.mark.parametrize(
    ("consistent", "gain", "verdict"),
    [(True, 0.9, "none"), (True, 1.1, "unknown"), (False, 0.0, "unknown"), (False, -5.0, "unknown")],
)
def test_an_unknown_cause_of_a_consistent_run_needs_the_slices_held_out(consistent: bool, gain: float, verdict: str):
    assert confirmed(weighed(unknown=20.0), consistent, gain, U).verdict == verdict


def test_two_effects_are_both_named_each_with_its_class():
    decision = decide(weighed((("stray", "tilt"), 30.0), (("dark", "tilt"), 29.0), (("stray",), 5.0)))
    assert decision.verdict == "effects"
    classes = {named.effect: set(named.members) for named in decision.named}
    assert classes == {"stray": {"stray", "dark"}, "tilt": {"tilt"}}
    values = {named.effect: named.values[0] for named in decision.named}
    assert values == {"stray": 1.0, "tilt": 2.0}


def test_second_effect_that_is_less_probable_than_not_is_left_out():
    decision = decide(weighed((("tilt", "stray"), 30.0), (("tilt", "drift"), 26.5), (("tilt",), 29.9)))
    assert decision.verdict == "effects"
    assert decision.leading.names == ("tilt", "stray")
    assert "tilt" in [named.effect for named in decision.named]
    for named in decision.named:
        assert named.probability >= 0.5


@pytest.mark.parametrize(("ratio", "both"), [(0.37, False), (0.43, True)])
@pytest.mark.parametrize("larger", [0, 1])
def test_second_effect_that_an_error_of_the_first_ones_form_would_make_is_left_out(
    ratio: float, both: bool, larger: int
):
    table = np.log1p(2 * U)
    tables = table * np.where(np.arange(2) == larger, 1.0, ratio)[:, None]
    pair = replace(fit("tilt", "stray"), table=tables.sum(axis=0), tables=tables)
    none = Hypothesis((), False, 0.0, 0.0, fit())
    decision = decide(normalised([none, Hypothesis(pair.names, False, 0.0, 30.0, pair)]))
    assert decision.verdict == "effects"
    assert {named.effect for named in decision.named} == ({"tilt", "stray"} if both else {pair.names[larger]})
    assert {named.effect for named in decision.ranking} == {"tilt", "stray"}  # still listed


def test_ranking_names_every_effect_once_and_falls():
    ranking = decide(weighed((("a",), 5.0), (("b",), 4.9), (("c",), -2.0), (("a", "c"), 1.0))).ranking
    effects = [member for named in ranking for member in named.members]
    assert sorted(effects) == ["a", "b", "c"]
    assert [n.probability for n in ranking] == sorted((n.probability for n in ranking), reverse=True)
