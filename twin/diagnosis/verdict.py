"""What is said of a run: which explanation, with which others it may be confused, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.posterior import Hypothesis, Posterior

Verdict = Literal["none", "effects", "unknown", "undecided"]
#: Effects whose evidence lies within so many nats of the best cannot be told from it (about 95 to 5).
TOLD_APART = 3.0
#: A class of more effects names nothing.
LARGEST_CLASS = 5
#: Least probability of what is said.
_SURE = 0.5


@dataclass(frozen=True)
class Named:
    """An effect that is named, with those that this run cannot tell from it.

    Attributes
    ----------
    effect, members
        The most probable, and all of the class, the most probable first.
    probability
        That the cause is one of the class.
    values, u
        Parameters of the effect and their standard uncertainties, shape (parameter,).
    """

    effect: str
    members: tuple[str, ...]
    probability: float
    values: FloatArray
    u: FloatArray


@dataclass(frozen=True)
class Decision:
    """What is said."""

    verdict: Verdict
    named: tuple[Named, ...]
    ranking: tuple[Named, ...]
    leading: Hypothesis


def decide(posterior: Posterior) -> Decision:
    """Fold the explanations into classes and say what can be said."""
    ranking = ranked(posterior)
    leading = _leading(posterior)
    named = _named(leading, posterior)
    best = named[0].probability if named else 0.0
    verdict: Verdict
    if posterior.none >= max(_SURE, best) or (posterior.none > best and posterior.none > posterior.unknown):
        verdict, named = "none", ()
    elif posterior.unknown >= max(_SURE, best):
        verdict, named = "unknown", ()
    elif named and best >= _SURE and all(len(n.members) <= LARGEST_CLASS for n in named):
        verdict = "effects"
    else:
        verdict = "undecided"
    return Decision(verdict, named, ranking, leading)


def ranked(posterior: Posterior) -> tuple[Named, ...]:
    """Every effect with its class, the most probable first; of effects in one class the first stands for all."""
    found: list[Named] = []
    seen: set[str] = set()
    for name, _ in posterior.ranking():
        if name in seen:
            continue
        best = next(h for h in posterior.hypotheses if name in h.names and not h.unknown)
        slot = best.names.index(name)
        entry = _slot(best, slot, posterior)
        if entry.effect not in seen:
            found.append(entry)
        seen |= set(entry.members)
    return tuple(sorted(found, key=lambda n: -n.probability))


def _leading(posterior: Posterior) -> Hypothesis:
    """The most probable explanation by named effects."""
    return next((h for h in posterior.hypotheses if h.names and not h.unknown), posterior.hypotheses[0])


def _named(leading: Hypothesis, posterior: Posterior) -> tuple[Named, ...]:
    return tuple(_slot(leading, slot, posterior) for slot in range(len(leading.names)))


def _slot(leading: Hypothesis, slot: int, posterior: Posterior) -> Named:
    """One effect of an explanation, and those that could stand in its place."""
    others = set(leading.names) - {leading.names[slot]}
    members = [leading.names[slot]]
    for other in posterior.hypotheses:
        if other.unknown or len(other.names) != len(leading.names) or not others <= set(other.names):
            continue
        rest = [name for name in other.names if name not in others]
        near = other.log_evidence > leading.log_evidence - TOLD_APART
        if near and len(rest) == 1 and rest[0] not in members:
            members.append(rest[0])
    probability = sum(
        p
        for h, p in zip(posterior.hypotheses, posterior.probability, strict=True)
        if not h.unknown and set(h.names) & set(members)
    )
    fit = leading.fit
    assert fit is not None
    start = int(np.sum(fit.sizes[:slot]))
    place = slice(start, start + fit.sizes[slot])
    u = np.sqrt(np.maximum(np.diag(fit.covariance)[place], 0.0))
    return Named(leading.names[slot], tuple(members), float(probability), fit.values[place], u)
