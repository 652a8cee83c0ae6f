"""Two effects together: sought around the best single ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.fit import Component, Fit, fit_pair
from twin.diagnosis.likelihood import Normal

#: Pairs are sought around so many single effects, and refitted under so many structures.
_PARTNERS, _STRUCTURES, _REFITTED = 8, 4, 40


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
        chosen = best_structures(fit, members)
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


def best_structures(fit: Fit, members: Sequence[Normal]) -> NDArray[np.int64]:
    """Numbers of the structures under which a fit is the most probable, the best first."""
    weighted = fit.by_structure + np.array([m.log_weight for m in members])
    return np.asarray(np.argsort(-weighted)[:_STRUCTURES])
