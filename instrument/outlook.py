"""The forecast of a scan: of one that is about to start, and of one on paper."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
from typing import Any

from drivers.clock import Clock
from drivers.configuration import DevicesForm, planned
from drivers.interfaces import ROLES, Laboratory
from instrument.control import ask
from instrument.forecast import Forecast, Pace, forecast
from instrument.job import ScanJob
from instrument.safety import Pose
from instrument.station import Station
from instrument.turning import position_at_start


def outlook(job: ScanJob, station: Station, missing: Sequence[int], start: Pose) -> Forecast:
    """What is ahead of a scan whose devices are connected.

    Parameters
    ----------
    missing
        Indices of the points that are to be measured.
    start
        Where the arms stand once they are homed.

    Raises
    ------
    SafetyError
        If no allowed way leads to a point, or to a repetition of the reference and back.
    """
    laboratory = station.laboratory
    axes = laboratory.axes() | laboratory.stages()
    return forecast(
        [(index, job.plan.points[index]) for index in missing],
        job.missing_references(),
        job.references(),
        station.envelope,
        Pace.of(laboratory, job.settings, job.plan.samples, _exchange(station, len(axes))),
        start=start,
        to_home=sum(not ask(axis.status).homed for axis in axes.values()),
        repeat_minutes=job.facility.reference.repeat_minutes,
        reference_age=job.reference_age() / timedelta(seconds=1),
        turned=position_at_start(job.plan.points),
    )


def _exchange(station: Station, axes: int) -> float:
    """Laboratory seconds of a question on the wire, as the axes answer now."""
    began = station.time()
    for _ in range(3):
        station.mover.readback()
    return (station.time() - began) / (3 * axes)


class _NoLine:
    """Stands in for a wire: a driver attaches to it, and is never heard."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: None


def laboratory_on_paper(devices: DevicesForm) -> Laboratory:
    """The devices of ``devices.toml`` without their wires: what they say of themselves is what is configured.

    Raises
    ------
    ConfigurationError
        If the file is wrong.
    """
    clock, line = Clock(), _NoLine()
    made: dict[str, Any] = {plan.role: plan.driver(plan.role, line, plan.options, clock) for plan in planned(devices)}
    others = {role: device for role, device in made.items() if role not in ROLES}
    return Laboratory(**{role: made[role] for role in ROLES}, others=others)
