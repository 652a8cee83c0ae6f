"""The leading explanations of a run, each as what it says of readings yet to come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import log_sum
from twin.diagnosis.posterior import Hypothesis, Posterior
from twin.diagnosis.problem import Problem
from twin.diagnosis.unknown import UNKNOWN_SIZES

#: Explanations that are told apart: so much of the probability, so many at most, none of less than this.
_COVERED, _MOST, _LEAST = 0.99, 10, 0.005
#: Structures of the errors for each explanation.
_STRUCTURES = 2
UNKNOWN = "unknown"
#: Structure of the errors, and gap of unknown cause: number and size.
Member = tuple[int, tuple[int, float] | None]


@dataclass(frozen=True)
class Explanation:
    """One explanation of the run.

    Attributes
    ----------
    names
        Effects; empty for none, and for a smooth gap of unknown cause.
    probability
        Of it among the explanations that are told apart.
    values, covariance
        Of the parameters of all its effects.
    sizes
        Number of parameters of each effect.
    members
        Structure of the errors and gap of unknown cause (number, size), with their probabilities.
    """

    names: tuple[str, ...]
    smooth: bool
    probability: float
    values: FloatArray
    covariance: FloatArray
    sizes: tuple[int, ...]
    members: tuple[tuple[Member, float], ...]

    @property
    def label(self) -> str:
        """For people and files."""
        return UNKNOWN if self.smooth else " and ".join(self.names) or "none"


def explanations(posterior: Posterior, problem: Problem) -> list[Explanation]:
    """The leading explanations of a run, the most probable first, their probabilities adding up to 1."""
    catalogued = {component.name: component.catalogued for component in problem.components}
    chosen: list[tuple[Hypothesis, float]] = []
    for hypothesis, probability in zip(posterior.hypotheses, posterior.probability, strict=True):
        beside = hypothesis.unknown and any(catalogued[name] for name in hypothesis.names)
        if len(chosen) == _MOST or sum(p for _, p in chosen) > _COVERED or (chosen and probability < _LEAST):
            break
        if not beside:
            chosen.append((hypothesis, float(probability)))
    total = sum(p for _, p in chosen)
    return [_explanation(hypothesis, p / total, problem) for hypothesis, p in chosen]


def _explanation(hypothesis: Hypothesis, probability: float, problem: Problem) -> Explanation:
    fit = hypothesis.fit
    if fit is None:
        nothing = np.zeros(0)
        members = _gap_members(problem)
        return Explanation((), True, probability, nothing, np.zeros((0, 0)), (), members)
    weighted = fit.by_structure + np.array([member.log_weight for member in problem.members])
    best = np.argsort(-weighted)[:_STRUCTURES]
    share = np.exp(weighted[best] - log_sum(weighted[best]))
    members = tuple(((int(k), None), float(s)) for k, s in zip(best, share, strict=True) if s > 0)
    return Explanation(hypothesis.names, False, probability, fit.values, fit.covariance, fit.sizes, members)


def _gap_members(problem: Problem) -> tuple[tuple[Member, float], ...]:
    """Structures and gaps of unknown cause that explain the run best."""
    base = sorted(range(len(problem.members)), key=lambda k: -problem.members[k].log_weight)[:_STRUCTURES]
    keys: list[Member] = []
    values = []
    for k in base:
        for number, (_, shape) in enumerate(problem.gaps):
            for size in UNKNOWN_SIZES:
                spread = size * problem.run.relative_u
                factor = factor_of(problem.members[k].covariance + shape * np.outer(spread, spread))
                white = linalg.solve_triangular(factor, problem.residual, lower=True, check_finite=False)
                keys.append((k, (number, size)))
                values.append(problem.members[k].log_weight - 0.5 * white @ white - np.sum(np.log(np.diag(factor))))
    best = np.argsort(-np.array(values))[:_STRUCTURES]
    share = np.exp(np.array(values)[best] - log_sum(np.array(values)[best]))
    return tuple((keys[n], float(s)) for n, s in zip(best, share, strict=True))


def known_of(leading: Sequence[Explanation], known: Sequence[str]) -> list[Explanation]:
    """Explanations by known effects alone, their probabilities adding up to 1."""
    kept = [one for one in leading if set(one.names) <= set(known)]
    total = sum(one.probability for one in kept)
    return [replace(one, probability=one.probability / total) for one in kept]


def entropy(leading: Sequence[Explanation]) -> float:
    """Of which explanation is right, nats."""
    return float(-sum(one.probability * np.log(one.probability) for one in leading))


def factor_of(covariance: FloatArray) -> FloatArray:
    """Lower triangular factor."""
    return np.asarray(linalg.cholesky(covariance, lower=True, check_finite=False))
