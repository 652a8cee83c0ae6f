"""How far a simulated reflectance is from a measured one: the metrics of Leroy et al. (2025), section II-I.

Everything here is a pure function of arrays that broadcast against each other. ``simulated`` and ``measured`` are
reflectance factors, ``u_simulated`` and ``u_measured`` their standard uncertainties (k = 1), all without unit.
Equation and table numbers are those of the paper, DOI 10.1109/TGRS.2025.3547305.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Coverage factor of the level of agreement: alpha = 2 in equation (8).
COVERAGE = 2.0

#: Table V: up to which |dR*| and |t'| a point is good and acceptable, and from which n' on.
RELATIVE_DIFFERENCE_LIMITS = (0.02, 0.04)
T_LIMITS = (1.0, 2.0)
LEVEL_OF_AGREEMENT_LIMITS = (0.95, 0.50)

#: Share of the simulation in the combined uncertainty below which n' is a step; the division would overflow.
_STEP_BELOW = 1e-12


class Category(IntEnum):
    """The three categories of Table V."""

    GOOD = 0
    ACCEPTABLE = 1
    POOR = 2


def relative_difference(simulated: ArrayLike, measured: ArrayLike) -> FloatArray:
    """Relative difference dR* = (R_sim - R_mes)/R_mes, equation (2).

    Raises
    ------
    ValueError
        Where a measured value is zero: then the relative difference has no meaning.
    """
    simulated, measured = _floats(simulated), _floats(measured)
    if np.any(measured == 0):
        raise ValueError("the relative difference to a measured value of zero is undefined")
    with np.errstate(over="ignore"):  # beyond the largest number a difference is infinite
        return (simulated - measured) / measured


def combined_uncertainty(u_simulated: ArrayLike, u_measured: ArrayLike) -> FloatArray:
    """Combined standard uncertainty sigma_c, equation (6).

    Raises
    ------
    ValueError
        Where an uncertainty is negative.
    """
    u_simulated, u_measured = _floats(u_simulated), _floats(u_measured)
    if np.any(u_simulated < 0) or np.any(u_measured < 0):
        raise ValueError("a standard uncertainty is negative")
    return np.hypot(u_simulated, u_measured)


def t_score(simulated: ArrayLike, measured: ArrayLike, u_simulated: ArrayLike, u_measured: ArrayLike) -> FloatArray:
    """The t-score t' = (R_sim - R_mes)/sigma_c, equation (3).

    Raises
    ------
    ValueError
        Where both uncertainties are zero: nothing can be said about agreement.
    """
    sigma = combined_uncertainty(u_simulated, u_measured)
    if np.any(sigma == 0):
        raise ValueError("both standard uncertainties are zero, the t-score is undefined")
    with np.errstate(over="ignore"):  # beyond the largest number a score is infinite
        return (_floats(simulated) - _floats(measured)) / sigma


def level_of_agreement(t: ArrayLike, u_simulated: ArrayLike, u_measured: ArrayLike) -> FloatArray:
    r"""Level of agreement n' of normally distributed variables, in closed form.

    The paper defines n' as the fraction of samples of the simulation that lie within 2 sigma_c of the measured
    value, and tabulates it by drawing samples. A sample of the simulation lies t' sigma_c + u_sim z from the
    measured value, z standard normal; so with k = u_sim/sigma_c

        n' = Phi((2 - t')/k) - Phi((-2 - t')/k),

    which becomes a step at \|t'\| = 2 when k goes to zero (one half at the step itself).

    Parameters
    ----------
    t
        t-score of every point.
    u_simulated, u_measured
        Standard uncertainties; only their ratio matters.

    Returns
    -------
    array of the broadcast shape, between 0 and 1
    """
    sigma = combined_uncertainty(u_simulated, u_measured)
    if np.any(sigma == 0):
        raise ValueError("both standard uncertainties are zero, the level of agreement is undefined")
    t, k = np.broadcast_arrays(np.abs(_floats(t)), _floats(u_simulated) / sigma)
    step = np.heaviside(COVERAGE - t, 0.5)
    width = np.where(k > _STEP_BELOW, k, 1.0)
    overlap = ndtr((COVERAGE - t) / width) - ndtr((-COVERAGE - t) / width)
    return np.where(k > _STEP_BELOW, overlap, step)


def relative_rmse(difference: ArrayLike) -> float:
    """Relative root-mean-square error of relative differences, equation (9); not a number for no points."""
    return root_mean_square(difference)


def root_mean_square(values: ArrayLike) -> float:
    """Root of the mean square; not a number for no points."""
    values = _floats(values)
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


def mean_absolute(values: ArrayLike) -> float:
    """Mean of the magnitudes; not a number for no points."""
    values = _floats(values)
    return float(np.mean(np.abs(values))) if values.size else float("nan")


def categorise_relative_difference(difference: ArrayLike) -> IntArray:
    """:class:`Category` of relative differences (as fractions, not per cent), Table V."""
    return _categorise_magnitude(difference, RELATIVE_DIFFERENCE_LIMITS)


def categorise_t(t: ArrayLike) -> IntArray:
    """:class:`Category` of t-scores, Table V."""
    return _categorise_magnitude(t, T_LIMITS)


def categorise_level_of_agreement(n: ArrayLike) -> IntArray:
    """:class:`Category` of levels of agreement (as fractions, not per cent), Table V."""
    good, acceptable = LEVEL_OF_AGREEMENT_LIMITS
    n = _floats(n)
    return np.where(n >= good, Category.GOOD, np.where(n >= acceptable, Category.ACCEPTABLE, Category.POOR))


def _categorise_magnitude(values: ArrayLike, limits: tuple[float, float]) -> IntArray:
    """The criterion of equation (4) is strict for "good"; the text calls a point poor only beyond the outer limit."""
    good, acceptable = limits
    size = np.abs(_floats(values))
    return np.where(size < good, Category.GOOD, np.where(size <= acceptable, Category.ACCEPTABLE, Category.POOR))


def _floats(values: ArrayLike) -> FloatArray:
    return np.asarray(values, dtype=np.float64)
