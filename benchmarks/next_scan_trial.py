"""Whether the advised next scan helps: ``python benchmarks/next_scan_trial.py --cases N --seed S``.

A simulated laboratory that shares no physics with the twin measures a short run with one hidden effect. Where the run
leaves two or more explanations, three scans follow in the same laboratory with the same effect: the one that is
advised, one drawn at random from the feasible ones of the same length, and a slice of the run repeated. Each is joined
to the run and diagnosed anew. Counted: how often the true effect comes first. Pairs of effects and unknown causes are
left out of the diagnosis to save time. Results are kept case by case, and a trial goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import binomtest, wilcoxon

from instrument.forms import parse_form, parse_toml
from instrument.plan import PlanForm, make_plan
from sim_fixtures.cases.effects import known_effects
from sim_fixtures.cases.families import FAMILIES
from sim_fixtures.cases.maker import CaseMaker, budget_errors
from sim_fixtures.cases.readings import Laboratory, clean, light, noisy
from sim_fixtures.cases.world import World
from sim_fixtures.examples import example_files
from sim_fixtures.examples.coupon import Points, run_dataset
from sim_fixtures.reality import EXAMPLE_COATING
from twin.content import cache_folder
from twin.diagnosis.effects import effect
from twin.diagnosis.fit import fit_none, fit_single
from twin.diagnosis.followup import Proposal, weighed
from twin.diagnosis.joint import join
from twin.diagnosis.next_explanations import explanations, known_of
from twin.diagnosis.next_information import Outlook
from twin.diagnosis.next_scans import other_geometries, scans
from twin.diagnosis.next_stage import Stage, taken_again, wider
from twin.diagnosis.observation import Observation, observe
from twin.diagnosis.posterior import Hypothesis, Posterior, normalised
from twin.diagnosis.preparation import Bench, Inputs, Prepared
from twin.diagnosis.problem import Problem
from twin.diagnosis.responses import Responses
from twin.diagnosis.trial import interval

#: Effects that the laboratory hides one of, and others that the diagnosis may take them for.
HIDDEN = (
    "sensor_zenith_offset", "backlash", "stale_sample", "dark_offset", "stray_light", "detector_nonlinearity",
    "source_drift", "polarization", "sample_tilt", "sensor_arm_runout", "session_scale", "sample_height",
)  # fmt: skip
LIBRARY = (*HIDDEN, "reference_scale", "illumination_zenith_offset")
SEVERITIES = (1.0, 1.5, 2.0)
PLAN = """version = 1
title = "short run"
[[grid]]
wavelength = [500.0]
illumination_zenith = [0.0, 30.0]
sensor_azimuth = [0.0, 90.0]
sensor_zenith = { start = 60.0, stop = -60.0, step = -10.0 }
"""
#: Structures of the errors that are kept; nats from which a run counts as ambiguous; scans of the same length.
STRUCTURES, AMBIGUOUS, SAME_LENGTH = 4, 0.4, 0.25


class TrialBench(Bench):
    """A bench with the trial's library."""

    def prepare(self, run: Observation, told: Any = None, *, effects: Any = None) -> Prepared:
        return super().prepare(run, told, effects=[effect(name) for name in LIBRARY] if effects is None else effects)


@dataclass(frozen=True)
class Trial:
    """What all cases share."""

    bench: Bench
    stage: Stage
    rays: int

    @classmethod
    def of(cls, cache: Path, rays: int) -> Trial:
        files = example_files()
        bench = TrialBench(Inputs(files.facility, files.artifact, files.material), cache)
        maker = CaseMaker(laboratory(bench, PLAN, rays))
        run = observe(maker.make(seed=0)[0], "run")
        return cls(bench, wider(bench, run, other_geometries(run, bench.facility.arms)), rays)

    def prepared(self, run: Observation, rows: NDArray[np.int64]) -> Prepared:
        """A measured run of some of the stage's points, in their order."""
        stage = self.stage
        taken = replace(
            taken_again(stage, rows), gain=run.gain, reference_gain=run.reference_gain,
            reference_current=None if run.reference_v is None else run.reference_v / run.reference_gain,
        )  # fmt: skip
        found = {name: response.again(taken, rows) for name, response in stage.responses.items()}
        labelled = {label: column[rows] for label, column in stage.labelled.items()}
        budget = np.concatenate([np.stack(list(labelled.values()), axis=1), stage.unlabelled[rows]], axis=1)
        nominal = self.bench.nominal(run)[0]
        problem = Problem.of(run, nominal, stage.u_nominal[rows], budget, list(found.values()))
        return Prepared(problem, Responses(found, {}), labelled, None, self.bench.facility)


_LABORATORIES: dict[str, Laboratory] = {}


def laboratory(bench: Bench, text: str, rays: int) -> Laboratory:
    """The simulated laboratory with a plan; what it knows of its geometries is worked out once."""
    if text not in _LABORATORIES:
        _LABORATORIES[text] = _laboratory(bench, text, rays)
    return _LABORATORIES[text]


def _laboratory(bench: Bench, text: str, rays: int) -> Laboratory:
    plan = make_plan(parse_form(parse_toml(text, "plan"), PlanForm, "plan"), bench.facility, "plan")
    return Laboratory(bench.facility, bench.artifact, EXAMPLE_COATING, plan, rays)


def diagnosed(problem: Problem) -> tuple[Problem, Posterior]:
    """None and every single effect of the library, under the structures that explain the run best."""
    none = fit_none(problem.residual, problem.members)
    weights = none.by_structure + np.array([m.log_weight for m in problem.members])
    kept = [int(k) for k in np.argsort(-weights)[:STRUCTURES]]
    problem = problem.at(np.arange(len(problem.run)), kept)
    hypotheses = [Hypothesis((), False, math.log(0.5), fit_none(problem.residual, problem.members).log_evidence, None)]
    hypotheses[0] = replace(hypotheses[0], fit=fit_none(problem.residual, problem.members))
    for component in problem.components:
        fit = fit_single(component, problem.residual, problem.members)
        if fit is not None:
            prior = math.log(0.5 / len(problem.components)) + math.log(max(component.nodes.inside, 1e-12))
            hypotheses.append(Hypothesis((component.name,), False, prior, fit.log_evidence, fit))
    return problem, normalised(hypotheses)


def followed(trial: Trial, proposal: Proposal, case: Case, seed: int) -> xr.Dataset:
    """The proposed scan in the laboratory of the case, with the same effect."""
    lab = laboratory(trial.bench, proposal.plan, trial.rays)
    world = World(budget_errors(lab.facility, case.seed))
    for name, parameters in case.truth.items():
        world = known_effects()[name].apply(world, parameters)
    share = proposal.scan.light
    if share < 1:
        world = world.with_law(lambda _, flux: share * flux)
        world = world.with_electronics(dead_time=share * world.electronics.dead_time)
    true = clean(lab, world, light(lab, world, seed))
    stability = lab.facility.budget.instrument_stability
    size = max(stability) if isinstance(stability, tuple) else stability
    drift = size * FAMILIES[case.family](lab.moments, np.random.default_rng((seed, 12)))
    readings, reference, brf = noisy(lab, true, drift, np.random.default_rng((seed, 13)))
    return run_dataset(lab.facility, lab.plan, Points.of(lab.plan), readings, reference, brf)


@dataclass(frozen=True)
class Case:
    """A hidden effect."""

    seed: int
    effect: str
    severity: float
    family: str
    truth: dict[str, dict[str, float]]


def one_case(trial: Trial, seed: int) -> dict[str, Any]:
    """A case from its making to the diagnoses after each follow-up scan."""
    random = np.random.default_rng((seed, 31))
    name, severity = str(random.choice(HIDDEN)), float(random.choice(SEVERITIES))
    family = str(random.choice([f for f in FAMILIES if f != "none"]))
    dataset, truth = CaseMaker(laboratory(trial.bench, PLAN, trial.rays)).make(
        [name], severity, seed=seed, noise_family=family
    )
    case = Case(seed, name, severity, family, truth.effects)
    first = trial.prepared(observe(dataset, "run"), np.arange(trial.stage.of_run))
    problem, posterior = diagnosed(first.problem)
    result: dict[str, Any] = {"seed": seed, "effect": name, "severity": severity, "family": family}
    result |= {"before": told(posterior, name), "entropy": entropy(posterior)}
    if result["entropy"] < AMBIGUOUS:
        return result
    outlook = Outlook(problem, [trial.stage], known_of(explanations(posterior, problem), list(trial.stage.responses)))
    found = sorted(weighed(outlook, trial.bench.facility, scans([trial.stage])), key=lambda p: -p.rate)
    if not found:
        return result
    best = found[0]
    others = sorted(found[1:], key=lambda p: abs(p.duration_s - best.duration_s))
    like = [p for p in others if abs(p.duration_s / best.duration_s - 1) < SAME_LENGTH] or others[:4]
    # Of a scan back and forth no repeat is as long; the one nearest in length stands for it.
    again = [p for p in others if p.scan.kind == "as it was"]
    same = {id(p) for p in like}
    again = [p for p in again if id(p) in same] or again[:1]
    if not again:
        return result
    chosen = {"advised": best, "random": like[random.integers(len(like))], "repeat": again[random.integers(len(again))]}
    for number, (label, proposal) in enumerate(chosen.items(), start=1):
        second = trial.prepared(
            observe(followed(trial, proposal, case, 1000 * seed + number), label, 5), proposal.scan.rows
        )
        rows = np.concatenate([np.arange(trial.stage.of_run), proposal.scan.rows])
        both = join([first, second], trial.stage.unlabelled[rows])
        after = told(diagnosed(both.problem)[1], name)
        result[label] = after | {
            "scan": proposal.scan.description, "nats": proposal.information_nats, "duration_s": proposal.duration_s,
            "expected": proposal.right,
        }  # fmt: skip
    return result


def entropy(posterior: Posterior) -> float:
    p = posterior.probability[posterior.probability > 0]
    return float(-np.sum(p * np.log(p)))


def told(posterior: Posterior, true: str) -> dict[str, Any]:
    """What comes first, and the probability of the truth."""
    first = posterior.hypotheses[0].names
    return {"first": first[0] if first else "none", "right": first == (true,), "p_true": posterior.of(true)}


def report(results: list[dict[str, Any]]) -> None:
    """The table of ``docs/diagnosis.md``."""
    cases = [r for r in results if "advised" in r]
    print(f"{len(results)} runs, {len(cases)} of them ambiguous (entropy at least {AMBIGUOUS:g} nats)")
    for label in ("before", "repeat", "random", "advised"):
        right = sum(r[label]["right"] for r in cases)
        low, high = interval(right, len(cases))
        mean = float(np.mean([r[label]["p_true"] for r in cases]))
        share = f"right {right} of {len(cases)} [{low:.2f}, {high:.2f}]"
        print(f"{label:8} {share}, mean probability of the truth {mean:.2f}")
    for other in ("random", "repeat"):
        gained = sum(r["advised"]["right"] and not r[other]["right"] for r in cases)
        lost = sum(r[other]["right"] and not r["advised"]["right"] for r in cases)
        p = binomtest(gained, gained + lost).pvalue if gained + lost else 1.0
        higher = [r["advised"]["p_true"] - r[other]["p_true"] for r in cases]
        rank = wilcoxon(higher).pvalue if np.any(higher) else 1.0
        print(
            f"advised against {other}: right where the other is wrong {gained}, the reverse {lost}"
            f" (McNemar, exact: p = {p:.2g}); probability of the truth, Wilcoxon: p = {rank:.2g}"
        )
    for label in ("advised", "random", "repeat"):
        print(f"{label}: {np.mean([r[label]['duration_s'] for r in cases]) / 60:.1f} min a scan")


def main() -> None:
    """Run the trial."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--rays", type=int, default=4096)
    parser.add_argument("--cache", type=Path, default=cache_folder())
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("next_scan.json"))
    asked = parser.parse_args()
    kept = json.loads(asked.out.read_text()) if asked.out.exists() else {"results": []}
    done = {r["seed"] for r in kept["results"]}
    todo = [s for s in range(1000 * asked.seed, 1000 * asked.seed + asked.cases) if s not in done]
    if todo:
        trial = Trial.of(asked.cache, asked.rays)
    for seed in todo:
        began = time.process_time()
        result = one_case(trial, seed)
        kept["results"].append(result | {"cpu_s": time.process_time() - began})
        asked.out.write_text(json.dumps(kept, indent=1))
        after = {label: result[label]["right"] for label in ("advised", "random", "repeat") if label in result}
        print(seed, result["effect"], result["before"]["first"], f"{result['entropy']:.2f}", after, flush=True)
    report(kept["results"])


if __name__ == "__main__":
    main()
