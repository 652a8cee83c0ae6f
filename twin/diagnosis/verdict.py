"""What is said of a run: which explanation, with which others it may be confused, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.posterior import Hypothesis, Posterior
from twin.diagnosis.unknown import LAW_ERROR

Verdict = Literal["none", "effects", "unknown", "undecided"]
#: Effects whose evidence lies within so many nats of the best cannot be told from it (about 95 to 5).
TOLD_APART = 3.0
#: Nor can those that fit the run within so many nats of it: one that is dearer by its prior alone is not ruled out.
FITS_ALIKE = 1.0
#: An effect that explains the run by less than so many nats more than what is left without it stands in no place of
#: another.
_EXPLAINS = 0.5
#: A class of more effects names nothing.
LARGEST_CLASS = 5
#: Least probability of what is said.
_SURE = 0.5
#: Nats by which held-out slices must speak: for an effect that is less than likely, or a cause that is unknown in a run
#: that looks consistent; or against an effect.
_CONFIRMED = 1.0
#: Probability from which an effect is likely.
_LIKELY = 0.7
#: Least root mean square of an effect over the run's uncertainty at which it is named.
_SMALLEST = 1 / 3
#: Least size of an effect over that of the other at which both are named: less is within two standard errors of the
#: other's form, as another rim or another lobe makes them.
_BESIDE = 2 * LAW_ERROR


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
    leading = _leading(posterior)
    slots = sorted(_named(leading, posterior), key=lambda n: -n.probability)
    best = slots[0].probability if slots else 0.0
    # A second effect is named only where it is more probable than not, and more than an error of the first one's form.
    small = _too_small(leading)
    named = tuple(n for n in slots if n.effect not in small and (n is slots[0] or n.probability >= _SURE))
    verdict: Verdict
    if posterior.none >= max(_SURE, best) or (posterior.none > best and posterior.none > posterior.unknown):
        verdict = "none"
    elif posterior.unknown >= max(_SURE, best):
        verdict = "unknown"
    elif named and best >= _SURE and len(named[0].members) <= LARGEST_CLASS:
        verdict = "effects"
        named = tuple(n for n in named if len(n.members) <= LARGEST_CLASS)
    else:
        verdict = "undecided"
    return Decision(verdict, named if verdict == "effects" else (), ranked(posterior, slots), leading)


def confirmed(posterior: Posterior, consistent: bool, gain: float, relative_u: FloatArray) -> Decision:
    """What is said once the slices held out were asked.

    An effect is not named against them, nor where it is too small to be told from the difference of two models of one
    laboratory. One that is not likely needs them, and so does an unknown cause of a run that agrees with the twin: a
    likely effect has a form that the rest of the run knows, what is unknown has none.

    Parameters
    ----------
    consistent
        Whether the run agrees with the twin within the budget.
    gain
        Nats by which what was chosen without them predicts the held-out slices better than the nominal twin.
    relative_u, shape (point,)
        Relative standard uncertainty of the run. Errors that are smooth let a change be seen far below it.
    """
    decision = decide(posterior)
    if decision.verdict == "effects":
        likely = decision.named[0].probability >= _LIKELY
        small = _severity(decision.leading, relative_u) < _SMALLEST
        if not small and gain >= (-_CONFIRMED if likely else _CONFIRMED):
            return decision
        return replace(decision, verdict="none" if consistent else "undecided", named=())
    if consistent and gain < _CONFIRMED:
        return replace(decision, verdict="none", named=())
    return decision


def ranked(posterior: Posterior, leading: Sequence[Named]) -> tuple[Named, ...]:
    """Classes of the leading explanation, and every other effect alone, the most probable first."""
    found = list(leading)
    seen = {member for named in leading for member in named.members}
    for name, probability in posterior.ranking():
        if name not in seen:
            best = next(h for h in posterior.hypotheses if name in h.names and not h.unknown)
            values, u = _values(best, best.names.index(name))
            found.append(Named(name, (name,), probability, values, u))
    return tuple(sorted(found, key=lambda n: -n.probability))


def _leading(posterior: Posterior) -> Hypothesis:
    """The most probable explanation by named effects."""
    return next((h for h in posterior.hypotheses if h.names and not h.unknown), posterior.hypotheses[0])


def _severity(leading: Hypothesis, relative_u: FloatArray) -> float:
    """Root mean square of an explanation's relative change over the run's relative uncertainty."""
    assert leading.fit is not None
    return float(np.sqrt(np.mean((np.expm1(leading.fit.table) / relative_u) ** 2)))


def _too_small(leading: Hypothesis) -> set[str]:
    """Effects of an explanation that are no more than an error of the other one's form."""
    if leading.fit is None or len(leading.fit.tables) < 2:
        return set()
    size = np.sqrt(np.mean(leading.fit.tables**2, axis=1))
    return {name for name, one in zip(leading.names, size, strict=True) if one < _BESIDE * np.max(size)}


def _named(leading: Hypothesis, posterior: Posterior) -> tuple[Named, ...]:
    return tuple(_slot(leading, slot, posterior) for slot in range(len(leading.names)))


def _slot(leading: Hypothesis, slot: int, posterior: Posterior) -> Named:
    """One effect of an explanation, and those that could stand in its place."""
    others = set(leading.names) - {leading.names[slot]}
    members = [leading.names[slot]]
    without = [h.log_evidence for h in posterior.hypotheses if not h.unknown and set(h.names) == others]
    least = max(without, default=-np.inf) + _EXPLAINS
    for other in posterior.hypotheses:
        if other.unknown or len(other.names) != len(leading.names) or not others <= set(other.names):
            continue
        if other.log_evidence < least:
            continue
        rest = [name for name in other.names if name not in others]
        if _near(leading, other) and len(rest) == 1 and rest[0] not in members:
            members.append(rest[0])
    probability = sum(
        p
        for h, p in zip(posterior.hypotheses, posterior.probability, strict=True)
        if not h.unknown and set(h.names) & set(members)
    )
    values, u = _values(leading, slot)
    return Named(leading.names[slot], tuple(members), float(probability), values, u)


def _near(leading: Hypothesis, other: Hypothesis) -> bool:
    """Whether the run cannot tell the other explanation from the leading one."""
    if other.log_evidence > leading.log_evidence - TOLD_APART:
        return True
    if leading.fit is None or other.fit is None or not np.isfinite(leading.fit.log_peak):
        return False
    return other.fit.log_peak > leading.fit.log_peak - FITS_ALIKE


def _values(hypothesis: Hypothesis, slot: int) -> tuple[FloatArray, FloatArray]:
    """Parameters of one effect of an explanation, and their standard uncertainties."""
    fit = hypothesis.fit
    assert fit is not None
    start = int(np.sum(fit.sizes[:slot]))
    place = slice(start, start + fit.sizes[slot])
    return fit.values[place], np.sqrt(np.maximum(np.diag(fit.covariance)[place], 0.0))
