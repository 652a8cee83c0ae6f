"""What no effect of the catalogue explains: smooth gaps, causes that are only suspected, and what an effect leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import log_sum
from twin.diagnosis.couples import best_structures
from twin.diagnosis.fit import Fit
from twin.diagnosis.likelihood import Normal, marginal

#: Standard deviation of an unknown gap over the relative uncertainty of the run.
UNKNOWN_SIZES = (1.5, 3.0)
#: The twin's gap of an effect is as good as this, relative: other rims, other lobes, other time constants.
RESPONSE_ERROR = 0.12
#: An effect may follow another law than the library's, near at every point to that of its neighbours.
LAW_ERROR = 0.2
#: What an effect does besides: somewhere else than the twin says, in one of the forms of an unknown gap.
ELSEWHERE_ERROR = 0.2
#: Shares of the gap as the twin renders it, with the response's error, after another law, and with more elsewhere.
_TOLERANCES = (0.35, 0.35, 0.15, 0.15)
#: Structures of the largest prior weight under which an unknown gap is weighed.
_BASE, _BESIDE = 8, 3


def smooth_evidence(
    residual: FloatArray,
    singles: Sequence[Fit],
    members: Sequence[Normal],
    gaps: Sequence[tuple[str, FloatArray]],
    relative_u: FloatArray,
    none: Fit,
) -> list[tuple[Fit | None, float]]:
    """Logarithmic evidence of a smooth gap of unknown cause, alone (None) and beside the best single effects."""
    base = sorted(range(len(members)), key=lambda k: -members[k].log_weight)[:_BASE]
    base = list(dict.fromkeys([*base, *best_structures(none, members).tolist()]))
    best = sorted(singles, key=lambda fit: -fit.log_evidence)[:_BESIDE]
    rests = [residual, *(residual - fit.table for fit in best)]
    log_values: list[list[float]] = [[] for _ in rests]
    weights = []
    for k in base:
        for _, shape in gaps:
            for size in UNKNOWN_SIZES:
                spread = size * relative_u
                gap = without_scale(shape * np.outer(spread, spread))
                wide = replace(members[k], covariance=members[k].covariance + gap)
                weights.append(members[k].log_weight)
                for values, rest in zip(log_values, rests, strict=True):
                    values.append(wide.log_density(rest))
    weight = np.array(weights) - log_sum(np.array(weights))
    found: list[tuple[Fit | None, float]] = [(None, float(log_sum(np.array(log_values[0]) + weight)))]
    for fit, values in zip(best, log_values[1:], strict=True):
        # What the parameters cost in evidence is nearly what they cost without the unknown part.
        occam = fit.log_evidence - marginal([m.log_density(residual - fit.table) for m in members], members)
        found.append((fit, float(log_sum(np.array(values) + weight)) + min(occam, 0.0)))
    return found


def without_scale(covariance: FloatArray) -> FloatArray:
    """Covariance of a relative gap less its mean over the run: a factor for all points is known, as a scale.

    A wander that is slow enough is nearly a scale, and would otherwise take the place of one.
    """
    mean = covariance.mean(axis=1)
    return np.asarray(covariance - mean[:, None] - mean + mean.mean())


def tolerant(
    fit: Fit,
    residual: FloatArray,
    members: Sequence[Normal],
    gaps: Sequence[tuple[str, FloatArray]],
    form_error: float = 0.0,
) -> Fit:
    """The fit, weighed with the gap as the twin renders it, with the response's own error, and after another law.

    Parameters
    ----------
    gaps
        Correlation matrices of gaps of unknown cause, shape (point, point). The first is that of another law's
        departure, and of half of the response's error; the other half is independent.
    form_error
        Relative error of the response where that of the effect's law is larger than the usual one.
    """
    square, smooth = np.outer(fit.table, fit.table), gaps[0][1]
    response, law = max(RESPONSE_ERROR, form_error), max(LAW_ERROR, form_error)
    elsewhere = ELSEWHERE_ERROR**2 * np.mean(fit.table**2)
    errors = [
        (_TOLERANCES[1], response**2 * square * 0.5 * (smooth + np.eye(len(square)))),
        (_TOLERANCES[2], law**2 * square * smooth),
        *((_TOLERANCES[3] / len(gaps), elsewhere * shape) for _, shape in gaps),
    ]
    rest = residual - fit.table
    by, peaks = fit.by_structure.copy(), [-np.inf]
    for k in best_structures(fit, members).tolist():
        if np.isfinite(by[k]):
            exact = members[k].log_density(rest)
            peaks.append(exact + members[k].log_weight)
            # Under a structure that has its optimum elsewhere, its evidence is less than the density there.
            highest = max(exact, float(by[k]))
            weighed = [np.log(_TOLERANCES[0])]
            for share, error in errors:
                wider = replace(members[k], covariance=members[k].covariance + error)
                weighed.append(np.log(share) + wider.log_density(rest) - highest)
            by[k] += float(log_sum(np.array(weighed)))
    weighted = by + np.array([member.log_weight for member in members])
    return replace(
        fit,
        by_structure=by,
        log_evidence=float(log_sum(weighted)),
        best=int(np.argmax(weighted)),
        log_peak=float(log_sum(np.array(peaks))),
    )
