"""What keeps a scan from measuring for a while: it rests in a safe state, and goes on once the cause is gone.

A hindrance costs time, not data: the piece of work that it interrupted is done anew. Whatever does not pass is
bounded: in time (``suspend_limit_wall``), and in how often one piece of work may meet it (:attr:`Hindrance.tries`).
"""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import ClassVar

from drivers.errors import CommunicationError, DeviceError


class Hindrance(DeviceError):
    """The laboratory cannot measure now.

    Attributes
    ----------
    tries
        How often one piece of work may meet it before the work is given up; None: any number of times.
    in_vain
        True when the scan has waited for its end until the limit.
    """

    tries: ClassVar[int | None] = None
    in_vain = False


class LightLost(Hindrance):
    """The source does not emit though it should: an interlock is open, its watchdog has tripped ..."""


class ContactLost(Hindrance, CommunicationError):
    """A device does not answer: a cable is unplugged, a power supply is off ..."""

    tries = 3


class LightUnstable(Hindrance):
    """The readings of one burst scatter more than any noise explains."""

    tries = 3


class DetectorSaturated(Hindrance):
    """There is more light than the lowest gain can take; it may pass (a lamp was switched on, a door opened)."""

    tries = 1


class DiskNearlyFull(Hindrance):
    """The disk of the run folder has less room left than the scan keeps in reserve."""


def require_room(folder: Path, reserve: float) -> None:
    """Make sure that the journal can grow.

    Parameters
    ----------
    folder
        Run folder.
    reserve
        MB (1e6 bytes) that have to be free; 0 asks for nothing.

    Raises
    ------
    DiskNearlyFull
        If less is free, or nobody can tell.
    """
    if reserve <= 0:
        return
    try:
        free = shutil.disk_usage(folder).free / 1e6
    except OSError as error:
        raise DiskNearlyFull("disk", f"{folder}: {error.strerror}", "bring the disk back") from None
    if free < reserve:
        raise DiskNearlyFull(
            "disk", f"{folder}: {free:.0f} MB are free; expected at least {reserve:g} MB", "make room on this disk"
        )


def scatter(samples: tuple[float, ...], dark: float) -> float:
    """Standard deviation of the samples over the light in them; 0 where there is nothing to tell from."""
    if len(samples) < 3:
        return 0.0
    mean = sum(samples) / len(samples)
    light = abs(mean - dark)
    deviation = math.sqrt(sum((sample - mean) ** 2 for sample in samples) / (len(samples) - 1))
    return deviation / light if light > 0 else 0.0
