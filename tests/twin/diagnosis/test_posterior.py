"""Sound runs, single effects, pairs and gaps of no known cause, drawn from every structure of the errors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import binom
from synthetic_runs import (
    SCALE,
    at_severity,
    effects,
    errors,
    grid,
    linear,
    observed,
    problem,
    severity,
    with_change,
)

from twin.diagnosis.covariance import correlations
from twin.diagnosis.fit import Fit, fit_none, fit_single
from twin.diagnosis.likelihood import Normal
from twin.diagnosis.posterior import PRIOR, Hypothesis, normalised, weigh
from twin.diagnosis.problem import Problem
from twin.diagnosis.unknown import smooth_evidence, tolerant, without_scale
from twin.diagnosis.verdict import decide

COLUMNS = grid({0.0: (0.0, 90.0), 15.0: (50.0, 130.0), 30.0: (0.0, 60.0)}, 10.0)
RUN = observed(COLUMNS)
EFFECTS = effects(COLUMNS)
WAYS = {"tilt": (1.0, 0.5), "zero": (-1.0,), "stray": (1.0,), "drift": (1.0,), "polarised": (-1.0,)}
KINDS = [f"{name}, 1 times the budget" for name, _, _ in correlations(RUN)]


@cache
def known() -> Problem:
    """The problem, prepared once: other readings leave library and structures as they are."""
    return problem(RUN, list(EFFECTS.values()))


def verdict(change: np.ndarray, given: Problem | None = None) -> tuple[str, list[str]]:
    decision = decide(with_change(given or known(), change).posterior())
    return decision.verdict, [named.effect for named in decision.named]


def change_by(name: str, wanted: float) -> np.ndarray:
    effect = EFFECTS[name]
    return effect.log_ratio(at_severity(effect, wanted, RUN, WAYS[name])[None])[0]


def bump(width_deg: float = 25.0) -> np.ndarray:
    """A gap that no effect makes: light beside the mirror direction of one illumination, on one side of the plane."""
    zenith, azimuth = COLUMNS["sensor_zenith"], COLUMNS["sensor_azimuth"]
    here = (COLUMNS["illumination_zenith"] == 15.0) & (azimuth == 130.0)
    return 0.12 * np.exp(-0.5 * ((zenith - 35.0) / width_deg) ** 2) * here


def test_priors_are_probabilities():
    assert sum(PRIOR.values()) == pytest.approx(1.0)
    assert PRIOR["none"] == pytest.approx(0.25)


def test_probabilities_follow_from_prior_and_evidence():
    hypotheses = [Hypothesis((), False, np.log(0.5), 10.0, None), Hypothesis(("a",), False, np.log(0.2), 12.0, None)]
    found = normalised(hypotheses)
    odds = 0.2 / 0.5 * np.exp(2.0)
    assert found.hypotheses[0].names == ("a",)
    np.testing.assert_allclose(found.probability, [odds / (1 + odds), 1 / (1 + odds)])


def test_enormous_evidences_do_not_overflow():
    found = normalised([Hypothesis((), False, 0.0, 5e4, None), Hypothesis(("a",), False, 0.0, -5e4, None)])
    np.testing.assert_array_equal(found.probability, [1.0, 0.0])


def test_probabilities_add_up_and_are_sorted():
    found = with_change(known(), errors(COLUMNS, KINDS[2], 3) + change_by("drift", 1.0)).posterior()
    assert found.probability.sum() == pytest.approx(1.0)
    assert np.all(np.diff(found.probability) <= 0)
    named = sum(p for h, p in zip(found.hypotheses, found.probability, strict=True) if h.names and not h.unknown)
    assert found.none + found.unknown + named == pytest.approx(1.0)
    for name in EFFECTS:
        assert 0 <= found.of(name) <= named + 1e-12
    assert [p for _, p in found.ranking()] == sorted((p for _, p in found.ranking()), reverse=True)


def test_prior_alone_decides_where_all_evidences_are_equal():
    # Without a prior mass inside their caps lost, one effect of five has a fifth of the mass of "one".
    found = with_change(known(), errors(COLUMNS, KINDS[0], 1)).posterior()
    for hypothesis in found.hypotheses:
        if len(hypothesis.names) == 1 and not hypothesis.unknown:
            component = known().component(hypothesis.names[0])
            expected = np.log(PRIOR["one"] / len(EFFECTS) * component.nodes.inside)
            assert hypothesis.log_prior == pytest.approx(expected)


@pytest.mark.slow
def test_sound_runs_of_every_structure_are_called_none():
    columns = grid({0.0: (0.0, 90.0), 30.0: (60.0, 120.0)}, 20.0)
    run, library = observed(columns), effects(columns)
    given = problem(run, [library[name] for name in ("tilt", "stray", "drift")])
    draws = [(kind, seed) for kind in KINDS for seed in (1, 2)]
    alarms = [draw for draw in draws if verdict(errors(columns, *draw), given)[0] != "none"]
    # At a share of false alarms of 5 % as many or more would be seen once in 200 times.
    assert len(alarms) <= binom.ppf(0.995, len(draws), 0.05), alarms


def test_uncorrelated_errors_alone_would_call_correlated_ones_an_effect():
    independent = [s for s in known().structures if s.name.startswith("independent, 1 ")]
    narrow = Problem(**{**vars_of(known()), "structures": independent})
    kind = next(k for k in KINDS if k.startswith("one factor a slice"))
    changes = [errors(COLUMNS, kind, seed) for seed in (1, 2)]
    assert [verdict(change)[0] for change in changes] == ["none"] * 2
    assert [verdict(change, narrow)[0] for change in changes] != ["none"] * 2


def vars_of(given: Problem) -> dict:
    names = ("run", "nominal", "u_nominal", "budget", "structures", "gaps", "components")
    return {name: getattr(given, name) for name in names}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("tilt", "one factor a slice"),
        ("zero", "wander over 25 degrees"),
        ("stray", "independent"),
        ("drift", "wander over 10 degrees"),
        ("polarised", "one factor"),
    ],
)
def test_single_effect_is_named(name: str, kind: str):
    change = errors(COLUMNS, f"{kind}, 1 times the budget", seed=21) + change_by(name, 2.5)
    assert verdict(change) == ("effects", [name])


@pytest.mark.parametrize(("first", "second"), [("tilt", "polarised"), ("zero", "drift"), ("stray", "tilt")])
def test_two_effects_together_are_both_named(first: str, second: str):
    change = errors(COLUMNS, KINDS[0], seed=22) + change_by(first, 3.0) + change_by(second, 2.5)
    said, names = verdict(change)
    assert said == "effects"
    assert set(names) == {first, second}


def test_effect_keeps_its_name_when_a_slice_is_read_backwards():
    columns = grid({0.0: (0.0, 90.0), 15.0: (50.0, 130.0), 30.0: (0.0, 60.0)}, 10.0, serpentine=True)
    run, library = observed(columns), effects(columns)
    tilt = library["tilt"]
    change = tilt.log_ratio(at_severity(tilt, 2.5, run, (0.3, 1.0))[None])[0]
    given = problem(run, list(library.values()))
    assert verdict(change + errors(columns, KINDS[2], seed=23), given) == ("effects", ["tilt"])


@pytest.mark.parametrize("rows", [slice(0, None, 2), slice(0, 60), slice(30, None)])
def test_effect_keeps_its_name_in_parts_of_a_plan(rows: slice):
    chosen = np.arange(len(RUN))[rows]
    change = errors(COLUMNS, KINDS[0], seed=24) + change_by("zero", 3.0)
    assert verdict_of_part(change, chosen) == ("effects", ["zero"])


def verdict_of_part(change: np.ndarray, chosen: np.ndarray) -> tuple[str, list[str]]:
    decision = decide(with_change(known(), change).at(chosen).posterior())
    return decision.verdict, [named.effect for named in decision.named]


def test_gap_of_no_known_cause_is_called_unknown():
    change = errors(COLUMNS, KINDS[0], seed=25) + bump()
    assert severity(bump(), RUN) > 2
    assert verdict(change)[0] == "unknown"


def test_effect_is_unknown_to_a_library_without_it():
    rest = problem(RUN, [effect for name, effect in EFFECTS.items() if name not in ("stray",)])
    change = errors(COLUMNS, KINDS[0], seed=26) + change_by("stray", 3.0)
    said, names = verdict(change, rest)
    assert said == "unknown", names


def test_error_of_scale_within_the_budget_is_no_effect():
    change = errors(COLUMNS, KINDS[0], seed=27) + 1.5 * SCALE
    assert verdict(change)[0] == "none"


def test_a_factor_for_all_points_is_no_sign_of_an_unknown_cause():
    given = with_change(known(), np.log1p(4 * RUN.relative_u))
    independent = given.members[:1]
    none = fit_none(given.residual, independent)
    ((beside, evidence),) = smooth_evidence(given.residual, [], independent, given.gaps, RUN.relative_u, none)
    assert beside is None
    assert evidence < none.log_evidence


def test_an_unknown_gap_has_no_mean_over_the_run():
    generator = np.random.default_rng(5)
    factor = generator.standard_normal((6, 4))
    draws = generator.standard_normal((200_000, 4)) @ factor.T
    less = draws - draws.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(without_scale(factor @ factor.T), less.T @ less / len(less), atol=0.05)


def test_evidence_of_two_names_for_one_thing_is_shared():
    twin_of_zero = linear("drift again", np.linspace(0, 1, len(RUN)), 0.02, (-0.3, 0.3))
    given = problem(
        RUN, [EFFECTS["tilt"], linear("drift", np.linspace(0, 1, len(RUN)), 0.02, (-0.3, 0.3)), twin_of_zero]
    )
    found = with_change(given, errors(COLUMNS, KINDS[0], seed=28) + change_by("drift", 3.0)).posterior()
    assert found.of("drift") == pytest.approx(found.of("drift again"), rel=1e-6)
    decision = decide(found)
    assert decision.verdict == "effects"
    assert set(decision.named[0].members) == {"drift", "drift again"}
    assert decision.named[0].probability > 0.9


def test_progress_grows_to_the_end():
    told: list[float] = []
    given = known()
    weigh(
        errors(COLUMNS, KINDS[0], 1),
        given.components[:2],
        given.members[:2],
        given.gaps[:1],
        RUN.relative_u,
        lambda what, share: told.append(share),
    )
    assert told == sorted(told)
    assert told[0] == 0.0
    assert 0.5 < told[-1] <= 1.0


def fitted_under_one_structure(change: np.ndarray) -> tuple[Problem, list[Normal], Fit]:
    """Stray light fitted where the errors are known to be independent."""
    here = with_change(known(), change)
    one = [member for member in here.members if member.name == KINDS[0]]
    assert len(one) == 1
    fit = fit_single(here.component("stray"), here.residual, one)
    assert fit is not None
    return here, one, fit


def test_a_structure_that_has_its_optimum_elsewhere_gains_nothing_from_a_tolerance():
    """A mean over structures that fits none of them is no evidence for wider errors."""
    here, one, fit = fitted_under_one_structure(errors(COLUMNS, KINDS[0], seed=11) + change_by("stray", 4.0))
    off = replace(fit, table=fit.table + 0.5 * (COLUMNS["sensor_zenith"] > 0))
    assert one[0].log_density(here.residual - off.table) < fit.by_structure[0] - 1000
    assert tolerant(off, here.residual, one, here.gaps).log_evidence <= fit.log_evidence + 1e-6


def test_an_effect_that_also_acts_a_little_elsewhere_wins_back_much_of_its_evidence():
    """Of its size 15 % lie where the library has less of it: far less likely, were the library exact."""
    change = errors(COLUMNS, KINDS[0], seed=11) + change_by("stray", 4.0)
    wave = np.sin(np.deg2rad(4 * COLUMNS["sensor_zenith"]))
    size = np.sqrt(np.mean(change_by("stray", 4.0) ** 2) / np.mean(wave**2))
    _, _, exact = fitted_under_one_structure(change)
    here, one, fit = fitted_under_one_structure(change + 0.15 * size * wave)
    found = tolerant(fit, here.residual, one, here.gaps).log_evidence
    assert fit.log_evidence < exact.log_evidence - 10
    assert found > fit.log_evidence + 4


def test_a_law_that_is_one_of_several_is_tolerated_more():
    change = errors(COLUMNS, KINDS[0], seed=11) + 0.7 * change_by("stray", 4.0) * (COLUMNS["sensor_azimuth"] > 20)
    here, one, fit = fitted_under_one_structure(change + 0.3 * change_by("stray", 4.0))
    usual, law = (tolerant(fit, here.residual, one, here.gaps, error).log_evidence for error in (0.0, 0.3))
    assert law > usual + 3
