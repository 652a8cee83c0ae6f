"""Reaching targets from one side, so that the play of gears is always taken up the same way.

An axis with an approach goes first beyond a target that it would reach from the wrong side, by its ``backlash``, and
then to it. Where it has just been moved in the right direction its gears are engaged, and it goes on in that direction
without more ado; after a search for the zero, a stop in mid-move or a lost answer they may be loose.
"""

from __future__ import annotations

from typing import NamedTuple

from drivers.interfaces import AxisLimits


class Leg(NamedTuple):
    """One arm moves, the others stand; ``overshoot`` marks a way beyond the target that is meant."""

    axis: str
    start: float
    target: float
    overshoot: bool = False


def one_sided(leg: Leg, limits: AxisLimits | None, *, loose: bool) -> tuple[Leg, ...]:
    """The moves that a move comes down to: one, two where the target is to be reached from the other side, or none.

    Parameters
    ----------
    leg
        From where to where; may lead nowhere.
    limits
        Of the axis; None for one without an approach.
    loose
        Whether its gears may be anywhere within their play.
    """
    if limits is None or not limits.approach:
        return (leg,) if leg.start != leg.target else ()
    way = (leg.target - leg.start) * limits.approach
    if way >= limits.backlash or (way > 0 and not loose):
        return (leg,)
    if way == 0 and not loose:
        return ()
    beyond = beyond_target(leg.target, limits)
    return (Leg(leg.axis, leg.start, beyond, overshoot=True), Leg(leg.axis, beyond, leg.target))


def beyond_target(target: float, limits: AxisLimits) -> float:
    """Where an axis goes first that would reach a target (degree) from the wrong side; the target without approach."""
    return target - limits.approach * limits.backlash
