"""The twin's metrics in the form the window's model asks for."""

from __future__ import annotations

from gui.scores import CATEGORIES, Score
from twin.metrics import (
    T_LIMITS,
    categorise_level_of_agreement,
    categorise_relative_difference,
    categorise_t,
    level_of_agreement,
    relative_difference,
    t_score,
)

#: |t'| at which the bands of good and of acceptable agreement end.
T_BANDS: tuple[float, float] = T_LIMITS


def score(measured: float, u_measured: float, simulated: float, u_simulated: float) -> Score | None:
    """Score of one point; None where the metrics are not defined (a measured zero, no uncertainty at all)."""
    if measured == 0 or (u_measured == 0 and u_simulated == 0):
        return None
    t = float(t_score(simulated, measured, u_simulated, u_measured))
    difference, level = relative_difference(simulated, measured), level_of_agreement(t, u_simulated, u_measured)
    return Score(
        float(difference),
        t,
        CATEGORIES[int(categorise_t(t))],
        float(level),
        CATEGORIES[int(categorise_relative_difference(difference))],
        CATEGORIES[int(categorise_level_of_agreement(level))],
    )
