"""What every arm has in common: scale, sign and zero of its stage, its travel, and the check of a target."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from drivers.errors import CommandRefused, CommunicationError
from drivers.forms import Form
from drivers.interfaces import AxisLimits


class ArmForm(Form):
    """Options of an arm in ``devices.toml``: laboratory angle = sign * (stage position / scale) + zero.

    Attributes
    ----------
    sign
        1, or -1 where the stage counts the other way round.
    zero
        Laboratory angle where the stage reads zero, degree.
    lower, upper
        Travel, laboratory degree.
    velocity, acceleration
        Of every move, degree/s and degree/s^2.
    tolerance
        Largest distance from the target that counts as in position, degree.
    approach
        ``rising`` or ``falling``: targets are always reached on rising or on falling angles, whatever the play of the
        gears.
    backlash
        How far beyond its target the arm goes first where it would come from the other side, degree.
    """

    sign: Literal[-1, 1] = 1
    zero: float = 0.0
    lower: float
    upper: float
    velocity: PositiveFloat
    acceleration: PositiveFloat
    tolerance: Annotated[float, Field(gt=0, le=1)] = 0.01
    approach: Literal["either", "rising", "falling"] = "either"
    backlash: Annotated[float, Field(ge=0, le=20)] = 0.0

    @model_validator(mode="after")
    def _travel(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"lower ({self.lower:g}) must be less than upper ({self.upper:g})")
        if (self.approach == "either") != (self.backlash == 0):
            raise ValueError(
                f"approach ({self.approach}) and backlash ({self.backlash:g}) belong together: from which side targets"
                " are reached, and how far beyond them the arm goes first"
            )
        if 0 < self.backlash <= 2 * self.tolerance:
            raise ValueError(
                f"backlash ({self.backlash:g}) must be more than twice the tolerance ({self.tolerance:g}), or the"
                " drive need not move"
            )
        return self

    @property
    def limits(self) -> AxisLimits:
        """Travel and speed as the instrument sees them."""
        side = {"either": 0, "rising": 1, "falling": -1}[self.approach]
        return AxisLimits(self.lower, self.upper, self.velocity, self.acceleration, side, self.backlash)


class ArmScale:
    """Converts between laboratory degrees and the units of a stage.

    Parameters
    ----------
    form
        Options of the arm.
    units_per_degree
        Stage units (degree, step ...) in one degree.
    """

    def __init__(self, form: ArmForm, units_per_degree: float) -> None:
        self._form = form
        self._scale = form.sign * units_per_degree

    def to_stage(self, angle: float) -> float:
        """Stage units of a laboratory angle in degree."""
        return (angle - self._form.zero) * self._scale

    def to_laboratory(self, position: float) -> float:
        """Laboratory angle in degree of a stage position."""
        return position / self._scale + self._form.zero

    def stage_travel(self) -> tuple[float, float]:
        """Lower and upper end of the travel in stage units."""
        ends = sorted((self.to_stage(self._form.lower), self.to_stage(self._form.upper)))
        return ends[0], ends[1]

    def check_target(self, device: str, target: float) -> None:
        """Refuse a target outside the travel, before anything is sent.

        Raises
        ------
        CommandRefused
            If ``target`` is outside, or not a number.
        """
        if not self._form.lower <= target <= self._form.upper:
            raise CommandRefused(
                device,
                f"target {target:g} is outside the travel of {self._form.lower:g} to {self._form.upper:g} degree",
                "nothing was sent",
            )


def stop_surely(stop: Callable[[], None]) -> None:
    """Stop an axis; tried three times before the failure is reported.

    Raises
    ------
    CommunicationError
        If the third try fails too.
    """
    for _ in range(2):
        with contextlib.suppress(CommunicationError):
            stop()
            return
    stop()
