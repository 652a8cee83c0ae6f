"""Values with their uncertainties, and probabilities, as they are told."""

from __future__ import annotations

import numpy as np


def with_u(value: float, u: float) -> tuple[str, str]:
    """A value and its standard uncertainty, both to the second digit of the uncertainty (GUM 7.2.6)."""
    if not (np.isfinite(u) and u > 0):
        return f"{value:.4g}", f"{u:.2g}"
    decimals = 1 - int(np.floor(np.log10(float(f"{u:.1e}"))))
    told = (f"{round(v, decimals):.{max(0, decimals)}f}" for v in (value, u))
    return next(told), next(told)


def chance_of(probability: float) -> str:
    """A probability to three decimals, without a claim of certainty."""
    if probability < 0.0005:
        return "< 0.001"
    return f"{probability:.3f}" if probability < 0.9995 else "> 0.999"
