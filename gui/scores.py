"""How far a measured and a simulated value are apart: what :mod:`twin.metrics` says, for one point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Category = Literal["good", "acceptable", "poor"]
CATEGORIES: tuple[Category, ...] = ("good", "acceptable", "poor")


@dataclass(frozen=True)
class Score:
    """Difference of a point: relative (1), in combined standard uncertainties (t'), and the category of t'."""

    relative_difference: float
    t: float
    category: Category


#: ``score(measured, u_measured, simulated, u_simulated)``: BRF and standard uncertainty of each; None where the
#: metrics are not defined.
ScoreFunction = Callable[[float, float, float, float], Score | None]
