"""Two effects together: sought around the best single ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.fit import Component, Fit, fit_pair, refine
from twin.diagnosis.likelihood import Normal

#: Pairs are sought around so many single effects, and refitted under so many structures.
_PARTNERS, _STRUCTURES, _REFITTED = 8, 4, 40
#: Nodes of each effect that are tried with all of the other before both are refitted.
_NODES = 800


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
        begin = _better(component, partner, start, residual, members[int(chosen[0])])
        fit_two = fit_pair(component, partner, begin, residual, members, [int(n) for n in chosen])
        if fit_two is not None:
            found.append(fit_two)
    return found


def _better(first: Component, second: Component, start: FloatArray, residual: FloatArray, member: Normal) -> FloatArray:
    """The better of two starts, refitted: the one given, and the nodes of both effects that are best together.

    What the first effect alone was fitted to holds the second as well: two effects of like form may both lie far from
    where they fit best together.
    """
    found = [
        refine([first, second], begin, residual, member)
        for begin in (start, _together(first, second, residual, member))
    ]
    fits = [fit for fit in found if fit is not None]
    return max(fits, key=lambda fit: fit.log_evidence).values if fits else start


def _together(first: Component, second: Component, residual: FloatArray, member: Normal) -> FloatArray:
    """Of some nodes of both effects those that explain a residual best together, parameters one after the other."""
    scores, rows, values = [], [], []
    for one in (first, second):
        some = slice(None, None, -(-len(one.nodes.values) // _NODES))
        density = one.compressed.log_density(residual, member) + one.nodes.log_mass
        scores.append(density[some])
        rows.append(one.compressed.coefficients[some] @ member.white(one.compressed.basis))
        values.append(one.nodes.values[some])
    # |r - a - b|^2 = |r - a|^2 + |r - b|^2 - |r|^2 + 2 a b
    joint = scores[0][:, None] + scores[1] - rows[0] @ rows[1].T
    k, m = np.unravel_index(int(np.argmax(joint)), joint.shape)
    return np.concatenate([values[0][k], values[1][m]])


def best_structures(fit: Fit, members: Sequence[Normal]) -> NDArray[np.int64]:
    """Numbers of the structures under which a fit is the most probable, the best first."""
    weighted = fit.by_structure + np.array([m.log_weight for m in members])
    return np.asarray(np.argsort(-weighted)[:_STRUCTURES])
