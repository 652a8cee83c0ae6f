"""How far a measured and a simulated value are apart: what :mod:`twin.metrics` says, for one point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Category = Literal["good", "acceptable", "poor"]
CATEGORIES: tuple[Category, ...] = ("good", "acceptable", "poor")


@dataclass(frozen=True)
class Score:
    """Difference of a point: relative (1), in combined standard uncertainties (t'), level of agreement; categories."""

    relative_difference: float
    t: float
    category: Category
    level: float = float("nan")  # of agreement, n'
    difference_category: Category = "good"
    level_category: Category = "good"


#: ``score(measured, u_measured, simulated, u_simulated)``: BRF and standard uncertainty of each; None where the
#: metrics are not defined.
ScoreFunction = Callable[[float, float, float, float], Score | None]
