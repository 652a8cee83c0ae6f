"""Variances that few randomisations have found, smoothed over the geometries of a plan.

A variance of 16 randomisations is uncertain by a third, and by more where single values are far off: planned after it,
one geometry in some hundred gets ten times the sight lines that it needs, and many too few. But alike geometries have
like variances: over a plan the relative variance of a part follows from the shares that the parts have of the reading,
as a product of powers. How far each geometry's own variance counts beside that is read off the plan: from the scatter
about the product, and from what of it is chance, which two halves of the randomisations tell (empirical Bayes on the
logarithms; Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004, with measured instead of chi-square noise).
"""

from __future__ import annotations

import numpy as np

from instrument.angles import FloatArray

#: Geometries from which on a plan tells.
ENOUGH = 40
#: A part counts where it makes more than this of a geometry's variance; least share of the reading that is told apart.
_MATTERS, _LEAST_SHARE = 1e-3, 1e-6


def smoothed(values: FloatArray) -> FloatArray:
    """Variances of the parts' means, smoothed where the geometries are enough.

    Parameters
    ----------
    values, shape (part, point, randomisation)
        Of independent randomisations.

    Returns
    -------
    array, shape (part, point)
    """
    variances = values.var(axis=-1, ddof=1) / values.shape[-1]
    halves = np.stack([values[..., first::2].var(axis=-1, ddof=1) for first in (0, 1)])
    means = values.mean(axis=-1)
    total, whole = means.sum(axis=0), variances.sum(axis=0)
    told = (total > 0) & np.all(halves > 0, axis=0) & (variances > _MATTERS * whole)
    found = np.array(variances)
    for part, some in enumerate(told):
        if some.sum() < ENOUGH:
            continue
        shares = np.log(np.maximum(means[:, some] / total[some], _LEAST_SHARE))
        own = np.log(variances[part, some] / total[some] ** 2)
        noise = float(np.var(np.diff(np.log(halves[:, part, some]), axis=0))) / 4
        drawn = np.exp(_drawn_together(own, shares, noise))
        drawn *= np.sum(np.exp(own)) / np.sum(drawn)  # a mean of logarithms is too low
        found[part, some] = total[some] ** 2 * drawn
    return found


def _drawn_together(own: FloatArray, shares: FloatArray, noise: float) -> FloatArray:
    """Logarithms of variances, drawn to their regression on those of the shares as far as their scatter is noise."""
    columns = np.stack([np.ones(len(own)), *shares], axis=1)
    fit = columns @ np.linalg.lstsq(columns, own, rcond=None)[0]
    scatter = float(np.sum((own - fit) ** 2)) / (len(own) - columns.shape[1])
    weight = max(0.0, 1.0 - noise / scatter) if scatter > 0 else 1.0
    return np.asarray(fit + weight * (own - fit))
