"""Which explanation of a run is how probable: none, one effect, two, or none that is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import log_sum
from twin.diagnosis.couples import pairs
from twin.diagnosis.fit import Component, Fit, fit_none, fit_single
from twin.diagnosis.likelihood import Normal
from twin.diagnosis.unknown import smooth_evidence, tolerant

#: Prior probabilities: of no gap, of one effect in all, of two in all, of a cause that is not in the library. A
#: diagnosis is asked for where something is suspected, and an effect that the budget hides is there all the same.
PRIOR = {"none": 0.25, "one": 0.53, "two": 0.11, "unknown": 0.11}
#: Shares of the unknown: a smooth gap, the same beside an effect, and causes that are only suspected.
SHARES = {"smooth": 0.77, "beside": 0.01, "suspected": 0.22}
#: Fits of one effect, and of two, that are weighed with the error of the response.
_CHECKED = 8
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
        names = {name for h in self.hypotheses for name in h.names if not h.unknown}
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
    form_errors = {component.name: component.form_error for component in components}

    def checked(fit: Fit) -> Fit:
        return tolerant(fit, residual, members, gaps, max(form_errors[name] for name in fit.names))

    as_rendered = [fit for component, fit in singles if component.catalogued]
    singles = _checked(singles, checked)
    known = {component.name for component in components if component.catalogued}
    hypotheses += [_single(component, fit, known, len(components)) for component, fit in singles]
    tell("two effects", 0.45)
    named = [(component, fit) for component, fit in singles if component.catalogued]
    inside = {component.name: np.log(max(component.nodes.inside, 1e-12)) for component, _ in named}
    couples = sorted(pairs(residual, named, members), key=lambda fit: -fit.log_evidence)
    couples = [checked(fit) for fit in couples[:_CHECKED]] + couples[_CHECKED:]
    each = PRIOR["two"] / max(1.0, len(known) * (len(known) - 1) / 2)
    for fit in couples:
        prior = np.log(each) + sum(inside[name] for name in fit.names)
        hypotheses.append(Hypothesis(fit.names, False, prior, fit.log_evidence, fit))
    tell("an unknown cause", 0.8)
    for beside, evidence in smooth_evidence(residual, as_rendered, members, gaps, relative_u, none):
        share = SHARES["smooth"] if beside is None else SHARES["beside"] / max(1, len(known))
        names = () if beside is None else beside.names
        hypotheses.append(Hypothesis(names, True, np.log(PRIOR["unknown"] * share), evidence, beside))
    return normalised(hypotheses)


def _checked(singles: Sequence[tuple[Component, Fit]], check: Callable[[Fit], Fit]) -> list[tuple[Component, Fit]]:
    """The best fits checked, and the rest as they are."""
    ranked = sorted(singles, key=lambda pair: -pair[1].log_evidence)
    return [(c, check(fit)) for c, fit in ranked[:_CHECKED]] + ranked[_CHECKED:]


def _single(component: Component, fit: Fit, known: set[str], library: int) -> Hypothesis:
    """One effect; one that is only suspected counts as unknown."""
    inside = np.log(max(component.nodes.inside, 1e-12))
    named = component.name in known
    total = PRIOR["one"] / max(1, len(known))
    if not named:
        total = PRIOR["unknown"] * SHARES["suspected"] / max(1, library - len(known))
    return Hypothesis((component.name,), not named, np.log(total) + inside, fit.log_evidence, fit)


def normalised(hypotheses: Sequence[Hypothesis]) -> Posterior:
    """Posterior of weighed hypotheses, the most probable first."""
    log_joint = np.array([h.log_prior + h.log_evidence for h in hypotheses])
    order = np.argsort(-log_joint, kind="stable")
    probability = np.exp(log_joint - log_sum(log_joint))
    return Posterior(tuple(hypotheses[k] for k in order), probability[order])
