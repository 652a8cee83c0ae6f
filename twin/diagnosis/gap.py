"""How far the gap shrinks: predicted from what was fitted, measured on slices that took no part in choice or fit.

The slices are shared out among three groups. For each, structures of the errors, effects and their parameters are
chosen from the other slices alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from instrument.angles import FloatArray
from twin.diagnosis.couples import pairs
from twin.diagnosis.fit import Component, Fit, fit_none, fit_single
from twin.diagnosis.likelihood import marginal
from twin.diagnosis.posterior import PRIOR, Hypothesis, normalised
from twin.diagnosis.problem import Problem

#: Groups of slices that are held out in turn, and structures kept while choosing without them.
FOLDS, _STRUCTURES = 3, 10
#: Draws of what the held-out slices may read, and explanations that they are drawn from.
_DRAWS, _EXPLANATIONS = 400, 6
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Gap:
    """Root mean square relative differences, and how far they shrink.

    Attributes
    ----------
    before, after
        Over all points; ``after`` with the leading explanation, which was fitted to them.
    heldout_before, heldout_after
        Over slices in turn held out from choice and fit.
    shrink
        On the held-out slices, without what noise and budget alone would leave.
    interval
        Of the shrink, expected before looking at the held-out slices (5 % to 95 %).
    plain_shrink
        1 - heldout_after/heldout_before, noise and budget included.
    removable
        Largest value of the plain shrink that noise and budget leave room for.
    chosen
        What was chosen without each group of slices.
    gain
        Nats by which what was chosen and fitted without a group of slices predicts it better than the nominal twin.
    withheld
        Held-out difference that the correction would leave, where that is larger than without it; the correction is not
        offered then, and the other numbers are those without it.
    """

    before: float
    after: float
    heldout_before: float
    heldout_after: float
    shrink: float
    interval: tuple[float, float]
    plain_shrink: float
    removable: float
    chosen: tuple[tuple[str, ...], ...]
    gain: float = 0.0
    withheld: float | None = None


@dataclass(frozen=True)
class Fold:
    """What the slices outside a group say of it.

    Attributes
    ----------
    rows, seen
        Points of the group, and all others.
    structures
        Numbers of the structures that explain the seen points best.
    explanations
        The most probable ones of the seen points, fitted to them, with their probabilities; the first is the choice.
    table, shape (row,)
        Logarithmic ratio that the choice predicts.
    """

    rows: IntArray
    seen: IntArray
    structures: tuple[int, ...]
    explanations: tuple[tuple[Fit, float], ...]
    table: FloatArray

    @property
    def choice(self) -> Fit:
        """What was chosen without the group."""
        return self.explanations[0][0]


def measure_gap(problem: Problem, leading: Fit, folds: Sequence[Fold], seed: int = 1) -> Gap:
    """Measure how far the gap shrinks.

    A correction that makes the held-out slices differ more is not offered: errors that all points share may outweigh an
    effect that is really there, and what a user sees is the whole.

    Parameters
    ----------
    leading
        The leading explanation, fitted to all points.
    folds
        As :func:`held_out` gives them.
    """
    table = np.zeros(len(problem.run))
    for fold in folds:
        table[fold.rows] = fold.table
    before = _difference(problem, np.zeros(len(problem.run)))
    corrected = _difference(problem, table)
    withheld = corrected if corrected > before else None
    held_after = corrected if withheld is None else before
    variance = left_alone(problem, folds)
    return Gap(
        before,
        before if withheld is not None else _difference(problem, leading.table),
        before,
        held_after,
        shrink_of(before, held_after, variance),
        expected_shrink(problem, folds, variance, seed),
        1.0 - held_after / before if before > 0 else 0.0,
        1.0 - float(np.sqrt(min(1.0, variance / before**2))) if before > 0 else 0.0,
        tuple(fold.choice.names for fold in folds),
        gain_of(problem, folds),
        withheld,
    )


def gain_of(problem: Problem, folds: Sequence[Fold]) -> float:
    """Nats by which choices made without a group predict it better than the nominal twin, all groups."""
    return sum(_gain(problem, fold) for fold in folds)


def shrink_of(before: float, after: float, variance: float) -> float:
    """1 - sqrt(max(0, after^2 - v))/sqrt(max(0, before^2 - v)); 0 where there was nothing to shrink."""
    left, was = max(0.0, after**2 - variance), max(0.0, before**2 - variance)
    return float(1.0 - np.sqrt(left / was)) if was > 0 else 0.0


def _difference(problem: Problem, table: FloatArray) -> float:
    """Root mean square of (prediction - measurement)/measurement with a logarithmic ratio added."""
    return float(np.sqrt(np.mean(np.expm1(table - problem.residual) ** 2)))


def groups(problem: Problem) -> list[IntArray]:
    """Points of slices that are held out together; blocks of neighbouring points where there are few slices."""
    plane = problem.run.plane
    if plane.max() + 1 < FOLDS:
        plane = np.arange(len(plane)) * 2 * FOLDS // len(plane)
    return [np.flatnonzero(plane % FOLDS == fold) for fold in range(FOLDS)]


def held_out(problem: Problem) -> list[Fold]:
    """Choose and fit without each group of slices, and predict it."""
    found = []
    for rows in groups(problem):
        seen = np.setdiff1d(np.arange(len(problem.run)), rows)
        part = problem.at(seen)
        kept = _structures(part)
        best = _choose(replace(part, structures=[part.structures[k] for k in kept]))
        table = _table(problem, best[0][0], best[0][0].values[None], rows)[0]
        found.append(Fold(rows, seen, kept, best, table))
    return found


def _structures(problem: Problem) -> tuple[int, ...]:
    """Numbers of the structures that explain a problem best, alone or beside the effect that looks best at first."""
    members, residual = problem.members, problem.residual
    weights = np.array([m.log_weight for m in members])
    none = np.array([m.log_density(residual) for m in members]) + weights
    best = none
    for base in dict.fromkeys((int(np.argmax(none)), int(np.argmax(weights)))):
        gaps = [_likely(component, residual, problem, base) for component in problem.components if component.catalogued]
        if gaps:
            rest = residual - max(gaps, key=lambda pair: pair[0])[1]
            best = np.maximum(best, np.array([m.log_density(rest) for m in members]) + weights)
    return tuple(int(k) for k in np.argsort(-best, kind="stable")[:_STRUCTURES])


def _likely(component: Component, residual: FloatArray, problem: Problem, base: int) -> tuple[float, FloatArray]:
    """Logarithmic posterior density of an effect's best node under a structure, and its logarithmic ratio."""
    if not len(component.nodes.values):
        return -np.inf, np.zeros(len(residual))
    score = component.compressed.log_density(residual, problem.members[base]) + component.nodes.log_mass
    node = int(np.argmax(score))
    return float(score[node]), component.nodes.table[node]


def _choose(problem: Problem) -> tuple[tuple[Fit, float], ...]:
    """The most probable of none, one and two effects, and the next ones, with their probabilities."""
    members, residual = problem.members, problem.residual
    none = fit_none(residual, members)
    hypotheses = [Hypothesis((), False, np.log(PRIOR["none"]), none.log_evidence, none)]
    library = sum(component.catalogued for component in problem.components)
    singles = [
        (c, fit) for c in problem.components if c.catalogued and (fit := fit_single(c, residual, members)) is not None
    ]
    for component, fit in singles:
        prior = np.log(PRIOR["one"] / library) + np.log(max(component.nodes.inside, 1e-12))
        hypotheses.append(Hypothesis(fit.names, False, prior, fit.log_evidence, fit))
    inside = {component.name: component.nodes.inside for component, _ in singles}
    couples = max(1.0, library * (library - 1) / 2)
    for fit in pairs(residual, singles, members, around=3, refitted=12):
        prior = np.log(PRIOR["two"] / couples) + sum(np.log(max(inside[name], 1e-12)) for name in fit.names)
        hypotheses.append(Hypothesis(fit.names, False, prior, fit.log_evidence, fit))
    posterior = normalised(hypotheses)
    weighed = zip(posterior.hypotheses, posterior.probability, strict=True)
    return tuple((h.fit, float(p)) for h, p in weighed if h.fit is not None)[:_EXPLANATIONS]


def _table(problem: Problem, fit: Fit, values: FloatArray, rows: IntArray) -> FloatArray:
    """Logarithmic ratio of an explanation at some points, shape (value, row), for values of shape (value, p)."""
    result, start = np.zeros((len(values), len(rows))), 0
    for name, size in zip(fit.names, fit.sizes, strict=True):
        component = problem.component(name)
        result += component.signature.log_ratio(values[:, start : start + size])[:, rows]
        start += size
    return result


def _shares(problem: Problem, fold: Fold, fit: Fit) -> FloatArray:
    """Posterior weights of a fold's structures under a fit to the seen points; they add up to 1."""
    log_weight = np.array([problem.members[k].log_weight for k in fold.structures])
    return np.asarray(np.exp(fit.by_structure + log_weight - fit.log_evidence))


def left_alone(problem: Problem, folds: Sequence[Fold]) -> float:
    """Mean square that noise and budget alone leave on the groups, by structures weighed without them."""
    total = 0.0
    for fold in folds:
        for share, k in zip(_shares(problem, fold, fold.choice), fold.structures, strict=True):
            total += share * float(np.sum(np.diag(problem.members[k].covariance)[fold.rows]))
    return total / len(problem.run)


def _gain(problem: Problem, fold: Fold) -> float:
    """Nats by which a choice predicts its group better than the nominal twin."""
    block, residual = np.ix_(fold.rows, fold.rows), problem.residual[fold.rows]
    members = [replace(problem.members[k], covariance=problem.members[k].covariance[block]) for k in fold.structures]
    with_it, without = (
        marginal([m.log_density(residual - table) for m in members], members)
        for table in (fold.table, np.zeros(len(fold.rows)))
    )
    return with_it - without


def expected_shrink(problem: Problem, folds: Sequence[Fold], variance: float, seed: int = 1) -> tuple[float, float]:
    """Interval (5 % to 95 %) of the shrink on held-out slices, from the others alone.

    The groups are drawn from the posterior predictive distribution of the seen points: explanation, structure and
    parameters from their posterior, the errors as far as those at the seen points leave them open. Where the correction
    would make a draw differ more, it would not be offered.
    """
    generator = np.random.default_rng(seed)
    before, after = np.zeros(_DRAWS), np.zeros(_DRAWS)
    for fold in folds:
        reading = _predictive(problem, fold, generator)
        before += np.sum(np.expm1(-reading) ** 2, axis=1)
        after += np.sum(np.expm1(fold.table - reading) ** 2, axis=1)
    count = len(problem.run)
    pairs_of = zip(np.sqrt(before / count), np.sqrt(after / count), strict=True)
    low, high = np.quantile([shrink_of(float(b), min(float(a), float(b)), variance) for b, a in pairs_of], [0.05, 0.95])
    return float(low), float(high)


def _predictive(problem: Problem, fold: Fold, generator: np.random.Generator) -> FloatArray:
    """Residuals that the seen points let expect of a group, shape (draw, row)."""
    probability = np.array([p for _, p in fold.explanations])
    explained = generator.choice(len(probability), _DRAWS, p=probability / probability.sum())
    result = np.empty((_DRAWS, len(fold.rows)))
    structure = np.empty(_DRAWS, dtype=np.int64)
    seen = np.empty((_DRAWS, len(fold.seen)))
    for number, (fit, _) in enumerate(fold.explanations):
        draws = np.flatnonzero(explained == number)
        if not len(draws):
            continue
        values = _drawn(problem, fit, len(draws), generator)
        result[draws] = _table(problem, fit, values, fold.rows)
        seen[draws] = problem.residual[fold.seen] - _table(problem, fit, values, fold.seen)
        shares = _shares(problem, fold, fit)
        structure[draws] = generator.choice(len(shares), len(draws), p=shares / shares.sum())
    for number, k in enumerate(fold.structures):
        draws = np.flatnonzero(structure == number)
        if len(draws):
            forward, factor = _conditional(problem.members[k].covariance, fold)
            result[draws] += seen[draws] @ forward.T
            result[draws] += generator.standard_normal((len(draws), len(fold.rows))) @ factor.T
    return result


def _drawn(problem: Problem, fit: Fit, count: int, generator: np.random.Generator) -> FloatArray:
    """Parameters of an explanation from their posterior, within the caps, shape (draw, p)."""
    if not fit.names:
        return np.zeros((count, 0))
    priors = [problem.component(name).prior for name in fit.names]
    low, high = (np.concatenate([getattr(p, end) for p in priors]) for end in ("low", "high"))
    draws = generator.multivariate_normal(fit.values, fit.covariance, count, method="svd")
    return np.asarray(np.clip(draws, low, high))


def _conditional(covariance: FloatArray, fold: Fold) -> tuple[FloatArray, FloatArray]:
    """Mean of a group's errors for errors at the seen points, shape (row, seen), and a factor of their covariance."""
    cross = covariance[np.ix_(fold.rows, fold.seen)]
    factor = linalg.cho_factor(covariance[np.ix_(fold.seen, fold.seen)], lower=True, check_finite=False)
    forward = np.asarray(linalg.cho_solve(factor, cross.T, check_finite=False).T)
    open_part = covariance[np.ix_(fold.rows, fold.rows)] - forward @ cross.T
    return forward, np.asarray(linalg.cholesky(0.5 * (open_part + open_part.T), lower=True, check_finite=False))
