"""How far the gap shrinks: predicted from what was fitted, measured on slices that took no part in choice or fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.couples import pairs
from twin.diagnosis.fit import Fit, fit_none, fit_single
from twin.diagnosis.likelihood import marginal
from twin.diagnosis.posterior import PRIOR, Hypothesis, normalised
from twin.diagnosis.problem import Problem

#: Groups of slices that are held out in turn, and structures kept while choosing without them.
FOLDS, _STRUCTURES = 3, 10
_DRAWS = 400


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
    removable
        Share of the held-out difference that is not noise and budget.
    chosen
        What was chosen without each group of slices.
    gain
        Nats by which what was chosen and fitted without a group of slices predicts it better than the nominal twin.
    """

    before: float
    after: float
    heldout_before: float
    heldout_after: float
    shrink: float
    interval: tuple[float, float]
    removable: float
    chosen: tuple[tuple[str, ...], ...]
    gain: float = 0.0


def measure_gap(problem: Problem, leading: Fit, weights: FloatArray, seed: int = 1) -> Gap:
    """Measure how far the gap shrinks.

    Parameters
    ----------
    leading
        The leading explanation, fitted to all points.
    weights, shape (structure,)
        Posterior weights of the structures.
    """
    before = _difference(problem, np.zeros(len(problem.run)))
    after = _difference(problem, leading.table)
    table, chosen, gain = held_out(problem, weights)
    variance = float(np.mean(problem.noise_variance(weights)))
    held_before, held_after = before, _difference(problem, table)
    interval = expected_shrink(problem, leading, weights, seed)
    removable = 1.0 - np.sqrt(min(1.0, variance / held_before**2)) if held_before > 0 else 0.0
    return Gap(
        before,
        after,
        held_before,
        held_after,
        shrink_of(held_before, held_after, variance),
        interval,
        float(removable),
        tuple(chosen),
        gain,
    )


def shrink_of(before: float, after: float, variance: float) -> float:
    """1 - sqrt(max(0, after^2 - v))/sqrt(max(0, before^2 - v)); 0 where there was nothing to shrink."""
    left, was = max(0.0, after**2 - variance), max(0.0, before**2 - variance)
    return float(1.0 - np.sqrt(left / was)) if was > 0 else 0.0


def _difference(problem: Problem, table: FloatArray) -> float:
    """Root mean square of (prediction - measurement)/measurement with a logarithmic ratio added."""
    return float(np.sqrt(np.mean(np.expm1(table - problem.residual) ** 2)))


def groups(problem: Problem) -> list[NDArray[np.int64]]:
    """Points of slices that are held out together; blocks of neighbouring points where there are few slices."""
    plane = problem.run.plane
    if plane.max() + 1 < FOLDS:
        plane = np.arange(len(plane)) * 2 * FOLDS // len(plane)
    return [np.flatnonzero(plane % FOLDS == fold) for fold in range(FOLDS)]


def held_out(problem: Problem, weights: FloatArray) -> tuple[FloatArray, list[tuple[str, ...]], float]:
    """Logarithmic ratio at every point from a choice and a fit that did not see its slice; the choices; nats gained."""
    table = np.zeros(len(problem.run))
    chosen, gain = [], 0.0
    kept = [int(k) for k in np.argsort(-weights)[:_STRUCTURES]]
    for rows in groups(problem):
        seen = np.setdiff1d(np.arange(len(problem.run)), rows)
        names, values = _choose(problem.at(seen, kept))
        chosen.append(names)
        start = 0
        for name in names:
            component = problem.component(name)
            count = len(component.prior.nominal)
            table[rows] += component.row(values[start : start + count])[rows]
            start += count
        seen_not = problem.at(rows, kept)
        gain += marginal([m.log_density(seen_not.residual - table[rows]) for m in seen_not.members], seen_not.members)
        gain -= marginal([m.log_density(seen_not.residual) for m in seen_not.members], seen_not.members)
    return table, chosen, gain


def _choose(problem: Problem) -> tuple[tuple[str, ...], FloatArray]:
    """The most probable of none, one and two effects."""
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
    best = normalised(hypotheses).hypotheses[0]
    assert best.fit is not None
    return best.names, best.fit.values


def expected_shrink(problem: Problem, leading: Fit, weights: FloatArray, seed: int) -> tuple[float, float]:
    """Interval (5 % to 95 %) of the shrink that a fit without a group of slices should reach on it.

    The parameters are drawn as uncertain as a fit to the other slices leaves them, the errors from the structures.
    """
    if not leading.names:
        return (0.0, 0.0)
    generator = np.random.default_rng(seed)
    variance = float(np.mean(problem.noise_variance(weights)))
    components = [problem.component(name) for name in leading.names]
    ends = np.cumsum(leading.sizes)[:-1]
    spread = leading.covariance * FOLDS / (FOLDS - 1)
    low = np.concatenate([c.prior.low for c in components])
    high = np.concatenate([c.prior.high for c in components])
    draws = np.clip(generator.multivariate_normal(leading.values, spread, _DRAWS, method="svd"), low, high)
    tables = sum(c.signature.log_ratio(part) for c, part in zip(components, np.split(draws, ends, axis=1), strict=True))
    share = weights / np.sum(weights)
    picks = generator.choice(len(share), _DRAWS, p=share)
    found = []
    for draw, pick in enumerate(picks):
        noise = np.linalg.solve(problem.members[pick].whitener, generator.standard_normal(len(problem.run)))
        before = np.sqrt(np.mean(np.expm1(-leading.table - noise) ** 2))
        after = np.sqrt(np.mean(np.expm1(np.asarray(tables)[draw] - leading.table - noise) ** 2))
        found.append(shrink_of(float(before), float(after), variance))
    low_end, high_end = np.quantile(found, [0.05, 0.95])
    return float(low_end), float(high_end)
