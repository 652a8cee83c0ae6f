"""Fits effects to a run, and weighs them: evidence by quadrature where the run says little, by Laplace where much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from instrument.angles import FloatArray
from twin.diagnosis.amplitude import AmplitudePrior, Nodes, Signature, log_sum
from twin.diagnosis.likelihood import Compressed, Normal

#: Whitened size of a gap above which the posterior is narrower than the nodes lie apart, by number of parameters.
_NARROW = {1: 8.0}
_NARROW_MANY = 3.5
#: Two gaps whose whitened cosine is larger are one to this run.
_COLLINEAR = 0.9
_STEPS, _ENOUGH = 12, 1e-3
#: Structures whose logarithmic evidence lies this much below the best add nothing.
_NEGLIGIBLE = 9.0


@dataclass(frozen=True)
class Component:
    """One effect in one run, with its prior covered by nodes."""

    signature: Signature
    prior: AmplitudePrior
    nodes: Nodes
    compressed: Compressed

    @classmethod
    def of(cls, signature: Signature, relative_u: FloatArray) -> Component:
        """Prepare an effect."""
        prior = AmplitudePrior(signature, relative_u)
        nodes = prior.nodes()
        return cls(signature, prior, nodes, Compressed.of(nodes.table))

    def at(self, rows: NDArray[np.int64]) -> Component:
        """The same effect and prior, at some points of the run."""
        prior = self.prior.at(rows)
        nodes = replace(self.nodes, table=self.nodes.table[:, rows])
        compressed = replace(self.compressed, basis=self.compressed.basis[:, rows])
        return Component(prior.signature, prior, nodes, compressed)

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.signature.name

    @property
    def catalogued(self) -> bool:
        """Whether the effect may be named; another stands for an unknown cause."""
        return self.signature.catalogued

    @property
    def form_error(self) -> float:
        """Relative error of the response where its law is only one of several; 0 where the usual one holds."""
        return self.signature.form_error

    def row(self, value: FloatArray) -> FloatArray:
        """Logarithmic ratio at one value, shape (point,)."""
        return np.asarray(self.signature.log_ratio(value[None])[0])


@dataclass(frozen=True)
class Fit:
    """Effects fitted together.

    Attributes
    ----------
    names
        Effects; empty for none.
    log_evidence
        Averaged over the structures.
    by_structure
        Logarithmic evidence under each structure, -inf where negligible, shape (structure,).
    values, covariance
        Joint posterior mean of the parameters, in the order of the effects, and covariance.
    table, shape (point,)
        Logarithmic ratio at the posterior mean.
    best
        Number of the structure that explains the run best.
    log_peak
        Logarithmic density of the run at the posterior mean, averaged over the structures that explain it best: how
        well these effects can fit it, whatever they cost in prior; -inf where it was not asked.
    """

    names: tuple[str, ...]
    log_evidence: float
    by_structure: FloatArray
    values: FloatArray
    covariance: FloatArray
    table: FloatArray
    best: int
    sizes: tuple[int, ...] = field(default=())
    log_peak: float = -np.inf
    tables: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))


def fit_none(residual: FloatArray, members: Sequence[Normal]) -> Fit:
    """No effect: the budget explains the residuals."""
    by = np.array([member.log_density(residual) for member in members])
    return _fit((), (), by, members, np.zeros(0), np.zeros((0, 0)), np.zeros((0, len(residual))))


def fit_single(component: Component, residual: FloatArray, members: Sequence[Normal]) -> Fit | None:
    """One effect; None where its cap leaves nothing that could be seen."""
    nodes = component.nodes
    if not len(nodes.values):
        return None
    tables = np.stack([component.compressed.log_density(residual, member) for member in members])
    weights = np.array([member.log_weight for member in members])
    quadrature = np.asarray(log_sum(tables + nodes.log_mass, axis=1))
    by, places, spreads = quadrature.copy(), [], []
    narrow = _NARROW.get(nodes.values.shape[1], _NARROW_MANY)
    best_node = np.max(tables, axis=1)
    relevant = weights + best_node > np.max(weights + best_node) - _NEGLIGIBLE
    for number in range(len(members)):
        shares = np.exp(tables[number] + nodes.log_mass - quadrature[number])
        mean = shares @ nodes.values
        spread = (nodes.values - mean).T @ ((nodes.values - mean) * shares[:, None])
        if relevant[number]:
            start = nodes.values[np.argmax(tables[number])]
            found = refine([component], start, residual, members[number])
            if found is not None and found.size > narrow:
                by[number], mean, spread = found.log_evidence, found.values, found.covariance
        places.append(mean)
        spreads.append(spread)
    by = np.where(relevant, by, -np.inf)
    mean, covariance = _mixture(by + weights, np.array(places), np.array(spreads))
    mean = _inside(mean, [component])
    return _fit((component.name,), (len(mean),), by, members, mean, covariance, component.row(mean)[None])


@dataclass(frozen=True)
class Refined:
    """A local optimum under one structure."""

    values: FloatArray
    covariance: FloatArray
    log_evidence: float
    log_density: float
    size: float


def refine(components: Sequence[Component], start: FloatArray, residual: FloatArray, member: Normal) -> Refined | None:
    """Refit non-linearly from a start (Levenberg and Marquardt) and weigh with Laplace's approximation.

    Parameters
    ----------
    start
        Parameters of all components, one after the other.

    Returns
    -------
    Refined or None
        None where the optimum has no prior mass.
    """
    value, damping = _inside(start, components), 1e-3
    white = member.white(residual)
    table, jacobian = _whitened(components, value, member)
    cost = _squared(white - table)
    for _ in range(_STEPS):
        normal = jacobian @ jacobian.T
        step = _solved(normal + damping * np.diag(np.diag(normal) + 1e-300), jacobian @ (white - table))
        trial = _inside(value + step, components)
        trial_table, trial_jacobian = _whitened(components, trial, member)
        trial_cost = _squared(white - trial_table)
        if trial_cost < cost:
            gain, cost, value, table, jacobian = cost - trial_cost, trial_cost, trial, trial_table, trial_jacobian
            damping *= 0.2
            if gain < _ENOUGH:
                break
        else:
            damping *= 8.0
            if damping > 1e6:
                break
    normal = jacobian @ jacobian.T
    # The slab is about as wide as the amplitude itself: what the run leaves open, the prior bounds.
    bounded = normal + np.diag(_prior_precision(value, components))
    covariance = np.asarray(linalg.inv(bounded), dtype=float)
    log_prior = sum(
        c.prior.log_density(v, c.row(v)) for c, v in zip(components, _split(value, components), strict=True)
    )
    sign, log_det = np.linalg.slogdet(bounded)
    if not np.isfinite(log_prior) or sign <= 0:
        return None
    log_density = member.log_norm - 0.5 * cost
    evidence = log_density + log_prior + 0.5 * len(value) * np.log(2 * np.pi) - 0.5 * log_det
    return Refined(
        np.asarray(value, dtype=float),
        covariance,
        float(evidence),
        float(log_density),
        float(np.sqrt(_squared(table))),
    )


def fit_pair(
    first: Component,
    second: Component,
    start: FloatArray,
    residual: FloatArray,
    members: Sequence[Normal],
    chosen: Sequence[int],
) -> Fit | None:
    """Two effects together, under the chosen structures; None where the run cannot tell the one from the other."""
    pair = [first, second]
    by = np.full(len(members), -np.inf)
    places, spreads, numbers = [], [], []
    for number in chosen:
        found = refine(pair, start, residual, members[number])
        if found is not None:
            by[number] = found.log_evidence
            places.append(found.values)
            spreads.append(found.covariance)
            numbers.append(number)
    if not places:
        return None
    best = numbers[int(np.argmax(by[numbers]))]
    parts = _split(places[numbers.index(best)], pair)
    white = members[best].white(np.stack([first.row(parts[0]), second.row(parts[1])]))
    if _alike(white[0], white[1]) > _COLLINEAR:
        return None
    weights = np.array([members[n].log_weight for n in numbers])
    mean, covariance = _mixture(by[numbers] + weights, np.array(places), np.array(spreads))
    mean = _inside(mean, pair)
    parts = _split(mean, pair)
    tables = np.stack([first.row(parts[0]), second.row(parts[1])])
    sizes = tuple(len(p) for p in parts)
    return _fit((first.name, second.name), sizes, by, members, mean, covariance, tables)


def _fit(
    names: tuple[str, ...],
    sizes: tuple[int, ...],
    by: FloatArray,
    members: Sequence[Normal],
    mean: FloatArray,
    covariance: FloatArray,
    tables: FloatArray,
) -> Fit:
    weighted = by + np.array([member.log_weight for member in members])
    best = int(np.argmax(weighted))
    return Fit(
        names, float(log_sum(weighted)), by, mean, covariance, tables.sum(axis=0), best, sizes=sizes, tables=tables
    )


def _whitened(components: Sequence[Component], value: FloatArray, member: Normal) -> tuple[FloatArray, FloatArray]:
    """Logarithmic ratio and its slope, whitened in one product: shape (point,) and (parameter, point)."""
    table, slope = _linearised(components, value)
    rows = member.white(np.concatenate([table[None], slope]))
    return rows[0], rows[1:]


def _linearised(components: Sequence[Component], value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithmic ratio at a value, shape (point,), and its slope, shape (parameter, point)."""
    total, slopes = 0.0, []
    for component, part in zip(components, _split(value, components), strict=True):
        step = 0.02 * component.prior.scale
        up = np.minimum(part + step, component.prior.high)
        down = np.maximum(part - step, component.prior.low)
        rows = np.repeat(part[None], 2 * len(part) + 1, axis=0)
        for axis in range(len(part)):
            rows[1 + 2 * axis, axis], rows[2 + 2 * axis, axis] = up[axis], down[axis]
        tables = component.signature.log_ratio(rows)
        total = total + tables[0]
        slopes.append((tables[1::2] - tables[2::2]) / np.maximum(up - down, 1e-300)[:, None])
    return np.asarray(total), np.concatenate(slopes)


def _prior_precision(value: FloatArray, components: Sequence[Component]) -> FloatArray:
    """Inverse variance that the prior gives each parameter about a value, shape (parameter,)."""
    found = []
    for component, part in zip(components, _split(value, components), strict=True):
        prior = component.prior
        width = np.maximum(np.abs(part - prior.nominal), 0.5 * prior.scale)
        found.append(np.where(prior.sized, 1 / width**2, 12 / (prior.high - prior.low) ** 2))
    return np.concatenate(found)


def _split(value: FloatArray, components: Sequence[Component]) -> list[FloatArray]:
    ends = np.cumsum([len(c.prior.nominal) for c in components])[:-1]
    return [np.asarray(part) for part in np.split(value, ends)]


def _inside(value: FloatArray, components: Sequence[Component]) -> FloatArray:
    low = np.concatenate([c.prior.low for c in components])
    high = np.concatenate([c.prior.high for c in components])
    return np.asarray(np.clip(value, low, high))


def _alike(first: FloatArray, second: FloatArray) -> float:
    """Absolute cosine of the angle between two whitened gaps."""
    return float(abs(first @ second) / max(float(np.linalg.norm(first) * np.linalg.norm(second)), 1e-300))


def _squared(white: FloatArray) -> float:
    return float(white @ white)


def _solved(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray(linalg.lstsq(matrix, vector, check_finite=False)[0])


def _mixture(log_weight: FloatArray, means: FloatArray, spreads: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of a mixture; -inf weights are left out."""
    share = np.exp(log_weight - log_sum(log_weight))
    mean = share @ means
    apart = means - mean
    return mean, np.asarray(np.einsum("h,hij->ij", share, spreads) + (apart * share[:, None]).T @ apart)
