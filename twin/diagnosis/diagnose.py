"""The whole diagnosis of a run: is there a gap, where, which effect, how far does it shrink."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.consistency import Consistency, judge
from twin.diagnosis.fit import Fit
from twin.diagnosis.followup import Proposal, proposals
from twin.diagnosis.gap import Gap, gain_of, held_out, measure_gap
from twin.diagnosis.likelihood import Normal
from twin.diagnosis.posterior import Posterior
from twin.diagnosis.preparation import Prepared
from twin.diagnosis.verdict import Decision, confirmed
from twin.diagnosis.where import Region, regions, unknown_gap

Told = Callable[[str, float], None]
_MEMBERS = 6


@dataclass(frozen=True)
class Diagnosis:
    """What was found in a run.

    Attributes
    ----------
    prepared, posterior
        What it rests on.
    consistency, where, decision, gap
        The answers.
    correction, shape (point,)
        Logarithm of the corrected prediction over the nominal one; 0 where the correction is withheld.
    proposals
        Scans that would tell apart what the run cannot.
    """

    prepared: Prepared
    posterior: Posterior
    consistency: Consistency
    where: tuple[Region, ...]
    decision: Decision
    gap: Gap
    correction: FloatArray
    proposals: tuple[Proposal, ...] = ()


def diagnose(prepared: Prepared, told: Told | None = None) -> Diagnosis:
    """Diagnose a prepared run."""
    tell = told or (lambda what, share: None)
    problem = prepared.problem
    posterior = problem.posterior(lambda what, share: tell(what, 0.7 * share))
    none = _fit_of(posterior, ())
    tell("consistency", 0.7)
    shapes = [shape for _, shape in problem.gaps]
    consistency = judge(problem.residual, problem.members, posterior, none, shapes)
    tell("slices held out", 0.72)
    folds = held_out(problem)
    decision = confirmed(posterior, consistency.consistent, gain_of(problem, folds), problem.run.relative_u)
    leading = none if decision.verdict in ("none", "unknown") else decision.leading.fit
    assert leading is not None
    weights = _weights(problem.members, leading)
    tell("where", 0.9)
    where = regions(problem.run, _located(prepared, decision, leading, weights))
    gap = measure_gap(problem, leading, folds)
    correction = leading.table if gap.withheld is None else none.table
    found = Diagnosis(prepared, posterior, consistency, tuple(where), decision, gap, correction)
    if prepared.facility is not None:
        tell("the next scan", 0.95)
        found = replace(found, proposals=tuple(proposals(found, prepared.facility)))
    tell("done", 1.0)
    return found


def _fit_of(posterior: Posterior, names: tuple[str, ...]) -> Fit:
    fit = next(h.fit for h in posterior.hypotheses if h.names == names and not h.unknown)
    assert fit is not None
    return fit


def _weights(members: Sequence[Normal], fit: Fit) -> FloatArray:
    """Posterior weights of the structures under an explanation, shape (structure,)."""
    return np.asarray(np.exp(fit.by_structure + np.array([m.log_weight for m in members]) - fit.log_evidence))


def _located(prepared: Prepared, decision: Decision, leading: Fit, weights: FloatArray) -> FloatArray:
    """The gap that the leading explanation sees, relative, shape (point,)."""
    problem = prepared.problem
    if decision.verdict == "none":
        return np.zeros(len(problem.run))
    if decision.verdict == "unknown":
        best = [problem.members[k] for k in np.argsort(-weights)[:_MEMBERS]]
        return np.expm1(unknown_gap(problem.residual, best, problem.gaps, problem.run.relative_u))
    return np.expm1(leading.table)
