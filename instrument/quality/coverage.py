"""From a combined standard uncertainty to an expanded one (JCGM 100:2008, the GUM, Annex G)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from instrument.angles import FloatArray

#: Coverage probability of k = 2 for a normal distribution: erf(sqrt 2) = 0.9545.
PROBABILITY = float(special.erf(np.sqrt(2.0)))


def effective_degrees_of_freedom(
    components: Sequence[ArrayLike], degrees_of_freedom: Sequence[ArrayLike]
) -> FloatArray:
    """Welch-Satterthwaite formula (GUM, equation G.2b): u_c^4 / sum(u_i^4 / nu_i).

    Parameters
    ----------
    components
        Independent standard uncertainties of the result, each of shape (point,).
    degrees_of_freedom
        Of each component, one number or shape (point,); infinite where it is known exactly.

    Returns
    -------
    array, shape (point,)
        Infinite where no component has a finite number.

    Raises
    ------
    ValueError
        If a number of degrees of freedom is not above 0.
    """
    total: FloatArray = np.asarray(sum(np.asarray(u, dtype=float) ** 2 for u in components))
    weighted: FloatArray = np.zeros_like(total)
    for u, dof in zip(components, degrees_of_freedom, strict=True):
        nu = np.asarray(dof, dtype=float)
        if np.any(~(nu > 0)):
            raise ValueError(f"degrees of freedom: found {np.min(nu):g}; expected a number above 0")
        weighted = weighted + np.asarray(u, dtype=float) ** 4 / nu
    with np.errstate(divide="ignore", invalid="ignore"):
        result = total**2 / weighted
    return np.where(weighted > 0, result, np.inf)


def coverage_factor(degrees_of_freedom: ArrayLike, probability: float = PROBABILITY) -> FloatArray:
    """Factor k of Student's distribution for a two-sided interval of this coverage probability (GUM, G.3.2).

    A number of degrees of freedom that is not whole is taken as it is (GUM, G.4.1, note 1).
    """
    nu = np.asarray(degrees_of_freedom, dtype=float)
    upper = (1 + probability) / 2
    finite = np.where(np.isfinite(nu), nu, 1.0)
    return np.asarray(np.where(np.isfinite(nu), special.stdtrit(finite, upper), special.ndtri(upper)))
