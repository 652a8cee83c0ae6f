"""Is there a gap? A two-sided test of measurement against prediction that knows how little is known of correlations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import log_sum
from twin.diagnosis.fit import Fit
from twin.diagnosis.likelihood import Normal
from twin.diagnosis.posterior import PRIOR, Posterior
from twin.diagnosis.where import dark_uncertainty

#: A smaller probability is no longer called consistent.
LEVEL = 0.05
_DARK_MEMBERS = 4


@dataclass(frozen=True)
class Consistency:
    """Whether a run agrees with its prediction.

    Attributes
    ----------
    consistent
    p_value
        Bound on the probability that a sound run looks so.
    dark_uncertainty
        Relative standard uncertainty that the budget lacks; 0 where it lacks nothing.
    chi_square
        Of the residuals with their full covariance, over the number of points, averaged over the structures.
    """

    consistent: bool
    p_value: float
    dark_uncertainty: float
    chi_square: float


def judge(
    residual: FloatArray, members: Sequence[Normal], posterior: Posterior, none: Fit, shapes: Sequence[FloatArray]
) -> Consistency:
    """Test the residuals.

    The evidence of all explanations with a gap over that of none is, for a sound run, rarely large: its inverse bounds
    the probability to see as much (Ville's inequality for the mean over the prior). It finds gaps with a pattern; an
    ordinary two-sided chi-square test finds residuals that scatter too much, or too little.
    """
    odds = (1 - posterior.none) / max(posterior.none, 1e-300) * PRIOR["none"] / (1 - PRIOR["none"])
    weights = np.exp(none.by_structure + np.array([m.log_weight for m in members]) - none.log_evidence)
    chi_square, p_scatter = _scatter(residual, members, weights)
    p_value = float(min(1.0, 2 * min(1 / max(odds, 1e-300), p_scatter)))
    best = [members[k] for k in np.argsort(-weights)[:_DARK_MEMBERS]]
    dark = dark_uncertainty(residual, best, [np.eye(len(residual)), *shapes])
    return Consistency(p_value >= LEVEL, p_value, dark, chi_square)


def _scatter(residual: FloatArray, members: Sequence[Normal], weights: FloatArray) -> tuple[float, float]:
    """Chi-square over points, and its two-sided probability, averaged over the structures."""
    from scipy.stats import chi2

    count = len(residual)
    relevant = [int(k) for k in np.flatnonzero(weights > 1e-3 * np.max(weights))]
    share = weights[relevant] / np.sum(weights[relevant])
    values = np.array([float(np.sum(members[k].white(residual) ** 2)) for k in relevant])
    tail = 2 * np.minimum(chi2.sf(values, count), chi2.cdf(values, count))
    return float(share @ values / count), float(min(1.0, share @ tail))


def evidence_ratio(posterior: Posterior) -> float:
    """Logarithm of the evidence of a gap over that of none, in nats."""
    joint = np.array([h.log_prior + h.log_evidence for h in posterior.hypotheses])
    gap = np.array([bool(h.names) or h.unknown for h in posterior.hypotheses])
    prior = np.log(PRIOR["none"] / (1 - PRIOR["none"]))
    return float(log_sum(joint[gap]) - log_sum(joint[~gap]) + prior)
