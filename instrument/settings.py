"""How a scan is carried out: times, tolerances to failure, number of attempts. Nothing here changes what is measured.

Seconds are laboratory seconds (:mod:`drivers.clock`) except where a name says ``wall``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from instrument.forms import Form

Seconds = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]


class MotionSettings(Form):
    """How a move is watched."""

    poll: Seconds = 0.1
    poll_wall: Seconds = 0.005  # never ask more often than the wire can answer
    start_grace: Seconds = 1.0  # standing still off target for longer: the command had no effect
    deadline_factor: Annotated[float, Field(ge=1)] = 1.5  # of the time that the trapezoidal profile takes
    deadline_extra: Seconds = 2.0
    wire_wall: Seconds = 2.0  # for exchanges with the device, added to every deadline
    homing_deadline: Seconds = 180.0
    homing: Seconds = 10.0  # what an axis is expected to take; for the estimate of the duration only
    stop_deadline: Seconds = 10.0
    stop_again: Seconds = 2.0  # still moving so long after a stop: it is told to stop again


class AcquisitionSettings(Form):
    """How a reading is taken."""

    dark_samples: Count = 9
    settling: Seconds = 0.5  # after the arms have come to rest or the shutter has opened, at least
    ceiling: Annotated[float, Field(gt=0, le=1)] = 0.9  # of full scale: above it the gain goes down
    floor: Annotated[float, Field(ge=0, lt=1)] = 0.05  # below it the gain goes up, where that stays under target
    target: Annotated[float, Field(gt=0, le=1)] = 0.8
    read_attempts: Count = 3  # of a question that changes nothing
    settling_attempts: Count = 4  # bursts, until one shows no trend
    drift: Annotated[float, Field(gt=0)] = 1e-3  # of the reading, during a burst: less is not waited for
    drift_significance: Annotated[float, Field(gt=0)] = 5.4  # Student's t; 1 burst of 1000 of mere noise is beyond
    unstable: Annotated[float, Field(gt=0)] = 0.2  # relative scatter within a burst: the source, not noise
    darkest: Annotated[float, Field(gt=0, le=1)] = 0.05  # of full scale, before a scan, at the lowest gain
    noise_floor: Annotated[float, Field(ge=0)] = 0.01  # of full scale: with less light scatter says nothing


class ScanSettings(Form):
    """The whole.

    Attributes
    ----------
    dwell
        What a point takes once the arms stand, readings included: with 20 s and short moves a real scan keeps the
        pace of about 2.7 points a minute; what the readings leave of it is settling time.
    keep_alive_wall, heartbeat_wall
        Period of feeding the source's watchdog, and how long the engine may be silent until that ends.
    after_failure
        What follows a point that could not be measured: the next one, or an orderly end as faulted.
    failures_in_a_row
        So many and the instrument, not the point, is at fault: the scan ends.
    suspend_limit_wall
        How long to wait when the laboratory cannot measure; then the scan ends as faulted. People and cables take
        their time by the wall clock, however fast a simulated laboratory's clock runs.
    look_wall
        How often a suspended scan looks whether it may go on.
    relight
        Who ends a suspension for lost light. A class-4 source that an interlock has switched off comes back by a
        person's decision (IEC 60825-1, manual reset); ``self`` is for laboratories that have decided otherwise.
    close_limit_wall
        How long the end of the program waits for an orderly end of the scan, then for a halt, before it goes anyway.
    disk_reserve
        MB that have to be free on the disk of the run folder, or the scan rests.
    recovery
        Laboratory seconds to wait before a point is tried again whose light was unstable or saturated the detector.
    reference_age
        Hours after which a resumed run measures the reference anew.
    hands
        What a change on the stage is expected to take; for the estimate of the duration only.
    emission_while_mounting
        Leave the source on (behind a closed shutter) while hands are at the stage.
    """

    dwell: Seconds = 20.0
    warm_up: Seconds = 0.0
    source_power: Annotated[float, Field(gt=0, le=1)] = 1.0
    keep_alive_wall: Annotated[float, Field(gt=0)] = 2.0
    heartbeat_wall: Annotated[float, Field(gt=0)] = 60.0
    after_failure: Literal["continue", "end"] = "continue"
    failures_in_a_row: Count = 3
    suspend_limit_wall: Seconds = 3600.0
    look_wall: Annotated[float, Field(gt=0)] = 1.0
    relight: Literal["person", "self"] = "person"
    close_limit_wall: Annotated[float, Field(gt=0)] = 120.0
    disk_reserve: Annotated[float, Field(ge=0)] = 200.0
    recovery: Seconds = 60.0
    reference_age: Annotated[float, Field(gt=0)] = 12.0
    hands: Seconds = 0.0
    emission_while_mounting: bool = False
    motion: MotionSettings = MotionSettings()
    acquisition: AcquisitionSettings = AcquisitionSettings()
