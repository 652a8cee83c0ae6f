"""Which explanation of a run is how probable: none, one effect, two, or none that is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import log_sum
from twin.diagnosis.fit import Component, Fit, fit_none, fit_pair, fit_single
from twin.diagnosis.likelihood import Normal, marginal

#: Prior probabilities: of no gap, of one effect in all, of two in all, of a cause that is not in the library.
PRIOR = {"none": 0.5, "one": 0.33, "two": 0.03, "unknown": 0.14}
#: Standard deviation of an unknown gap over the relative uncertainty of the run.
UNKNOWN_SIZES = (1.0, 2.0, 4.0)
#: Pairs are sought around so many single effects, and refitted under so many structures.
_PARTNERS, _STRUCTURES, _REFITTED = 8, 4, 40
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Hypothesis:
    """An explanation of a run.

    Attributes
    ----------
    names
        Effects; empty for none.
    unknown
        Whether a gap of unknown cause is part of it.
    log_prior, log_evidence
    fit
        None for an unknown cause alone.
    """

    names: tuple[str, ...]
    unknown: bool
    log_prior: float
    log_evidence: float
    fit: Fit | None


@dataclass(frozen=True)
class Posterior:
    """Explanations with their probabilities, shape (hypothesis,), the most probable first."""

    hypotheses: tuple[Hypothesis, ...]
    probability: FloatArray

    @property
    def none(self) -> float:
        """Probability that the budget explains the run."""
        return self._total(lambda h: not h.names and not h.unknown)

    @property
    def unknown(self) -> float:
        """Probability of a gap, or a part of one, that no effect explains."""
        return self._total(lambda h: h.unknown)

    def of(self, name: str) -> float:
        """Probability that an effect is there, alone or with another, and nothing unknown."""
        return self._total(lambda h: name in h.names and not h.unknown)

    def ranking(self) -> list[tuple[str, float]]:
        """Effects by probability."""
        names = {name for h in self.hypotheses for name in h.names}
        return sorted(((name, self.of(name)) for name in names), key=lambda pair: -pair[1])

    def _total(self, chosen: Callable[[Hypothesis], bool]) -> float:
        return float(sum(p for h, p in zip(self.hypotheses, self.probability, strict=True) if chosen(h)))


def weigh(
    residual: FloatArray,
    components: Sequence[Component],
    members: Sequence[Normal],
    gaps: Sequence[tuple[str, FloatArray]],
    relative_u: FloatArray,
    progress: Progress | None = None,
) -> Posterior:
    """Weigh every explanation.

    Parameters
    ----------
    residual, shape (point,)
        Logarithm of measurement over prediction.
    components
        The library of effects for this run.
    members
        Structures of the errors.
    gaps
        Correlation matrices of gaps of unknown cause.
    relative_u, shape (point,)
        Relative standard uncertainty of the run.
    """
    tell = progress or (lambda what, share: None)
    tell("no effect", 0.0)
    none = fit_none(residual, members)
    hypotheses = [Hypothesis((), False, np.log(PRIOR["none"]), none.log_evidence, none)]
    singles: list[tuple[Component, Fit]] = []
    for number, component in enumerate(components):
        tell(component.name, 0.05 + 0.35 * number / len(components))
        fit = fit_single(component, residual, members)
        if fit is not None:
            singles.append((component, fit))
    each = np.log(PRIOR["one"] / max(1, len(components)))
    for component, fit in singles:
        inside = np.log(max(component.nodes.inside, 1e-12))
        hypotheses.append(Hypothesis((component.name,), False, each + inside, fit.log_evidence, fit))
    tell("two effects", 0.45)
    couples = len(components) * (len(components) - 1) / 2
    for fit in pairs(residual, singles, members):
        hypotheses.append(Hypothesis(fit.names, False, np.log(PRIOR["two"] / max(1.0, couples)), fit.log_evidence, fit))
    tell("an unknown cause", 0.8)
    hypotheses += unknown(residual, [fit for _, fit in singles], members, gaps, relative_u, none, len(components))
    return normalised(hypotheses)


def normalised(hypotheses: Sequence[Hypothesis]) -> Posterior:
    """Posterior of weighed hypotheses, the most probable first."""
    log_joint = np.array([h.log_prior + h.log_evidence for h in hypotheses])
    order = np.argsort(-log_joint, kind="stable")
    probability = np.exp(log_joint - log_sum(log_joint))
    return Posterior(tuple(hypotheses[k] for k in order), probability[order])


def pairs(
    residual: FloatArray,
    singles: Sequence[tuple[Component, Fit]],
    members: Sequence[Normal],
    *,
    around: int = _PARTNERS,
    refitted: int = _REFITTED,
) -> list[Fit]:
    """Two effects together: around the best single ones, every partner; the most promising are refitted."""
    ranked = sorted(singles, key=lambda pair: -pair[1].log_evidence)
    candidates: dict[tuple[str, str], tuple[float, Component, Component, FloatArray, NDArray[np.int64]]] = {}
    for component, fit in ranked[:around]:
        chosen = _best_structures(fit, members)
        rest = residual - fit.table
        member = members[fit.best]
        for partner, _ in ranked:
            if partner.name == component.name:
                continue
            score = partner.compressed.log_density(rest, member) + partner.nodes.log_mass
            node = int(np.argmax(score))
            key = (min(component.name, partner.name), max(component.name, partner.name))
            start = np.concatenate([fit.values, partner.nodes.values[node]])
            if key not in candidates or candidates[key][0] < score[node]:
                candidates[key] = (float(score[node]), component, partner, start, chosen)
    best = sorted(candidates.values(), key=lambda c: -c[0])[:refitted]
    found = []
    for _, component, partner, start, chosen in best:
        fit_two = fit_pair(component, partner, start, residual, members, [int(n) for n in chosen])
        if fit_two is not None:
            found.append(fit_two)
    return found


def _best_structures(fit: Fit, members: Sequence[Normal]) -> NDArray[np.int64]:
    weighted = fit.by_structure + np.array([m.log_weight for m in members])
    return np.argsort(-weighted)[:_STRUCTURES]


def unknown(
    residual: FloatArray,
    singles: Sequence[Fit],
    members: Sequence[Normal],
    gaps: Sequence[tuple[str, FloatArray]],
    relative_u: FloatArray,
    none: Fit,
    library: int,
) -> list[Hypothesis]:
    """A smooth gap of unknown cause, alone and beside an effect."""
    base = sorted(range(len(members)), key=lambda k: -members[k].log_weight)[:8]
    base = list(dict.fromkeys([*base, *_best_structures(none, members).tolist()]))
    best = sorted(singles, key=lambda fit: -fit.log_evidence)[:3]
    rests = [residual, *(residual - fit.table for fit in best)]
    log_values: list[list[float]] = [[] for _ in rests]
    weights = []
    for k in base:
        for _, shape in gaps:
            for size in UNKNOWN_SIZES:
                spread = size * relative_u
                wide = replace(members[k], covariance=members[k].covariance + shape * np.outer(spread, spread))
                weights.append(members[k].log_weight)
                for values, rest in zip(log_values, rests, strict=True):
                    values.append(wide.log_density(rest))
    weight = np.array(weights) - log_sum(np.array(weights))
    found = [
        Hypothesis((), True, np.log(PRIOR["unknown"] * 0.6), float(log_sum(np.array(log_values[0]) + weight)), None)
    ]
    share = np.log(PRIOR["unknown"] * 0.4 / max(1, library))
    for fit, values in zip(best, log_values[1:], strict=True):
        # What the parameters cost in evidence is nearly what they cost without the unknown part.
        occam = fit.log_evidence - marginal(np.array([m.log_density(residual - fit.table) for m in members]), members)
        evidence = float(log_sum(np.array(values) + weight)) + min(occam, 0.0)
        found.append(Hypothesis(fit.names, True, share, evidence, fit))
    return found
