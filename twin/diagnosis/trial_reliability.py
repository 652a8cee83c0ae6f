"""How far stated probabilities can be trusted: beside the share that was right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

#: Edges of the bins of stated probability.
EDGES = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)


@dataclass(frozen=True)
class Bin:
    """Statements whose probability lies in one bin.

    Attributes
    ----------
    low, high
        Of the bin; ``high`` belongs to it.
    count
        Statements.
    stated
        Mean of their probabilities.
    right
        Share that was right.
    """

    low: float
    high: float
    count: int
    stated: float
    right: float


def bins(probability: Sequence[float], right: Sequence[bool]) -> list[Bin]:
    """Statements by their probability; empty bins are left out."""
    p, hit = np.asarray(probability, float), np.asarray(right, bool)
    found = []
    for low, high in pairwise(EDGES):
        inside = (p > low) & (p <= high) if low else p <= high
        if inside.any():
            found.append(Bin(low, high, int(inside.sum()), float(p[inside].mean()), float(hit[inside].mean())))
    return found


def expected_calibration_error(table: Sequence[Bin]) -> float:
    """Mean difference of stated and true share, weighed by the statements; NaN of none."""
    total = sum(b.count for b in table)
    return sum(b.count * abs(b.stated - b.right) for b in table) / total if total else float("nan")
