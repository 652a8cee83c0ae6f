"""The scan: one thread that ties plan, safety, motion, light, readings and journal, and says what it does.

Whatever happens, a scan ends in an orderly way: arms at rest, shutter closed, emission off, journal complete,
and every point either measured or marked with the reason why not.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

from drivers.errors import CommandRefused, CommunicationError, DeviceError
from drivers.interfaces import Laboratory
from instrument.acquisition import NoReading
from instrument.attendance import Attendance
from instrument.bus import EventBus
from instrument.control import AbortAsked, Controls, HaltAsked
from instrument.evaluation import Evaluator
from instrument.events import (
    Geometry,
    PointMeasured,
    PointSkipped,
    PointStarted,
    ReferenceMeasured,
    ScanEnded,
    ScanStarted,
)
from instrument.hindrances import Hindrance, LightUnstable
from instrument.job import ScanJob
from instrument.motion import MotionFailed
from instrument.operators import Mounted
from instrument.outlook import outlook
from instrument.preflight import preflight, require
from instrument.progress import Progress
from instrument.reporter import Reporter
from instrument.run_schema import REPEATED
from instrument.safety import Pose, check_plan
from instrument.states import State
from instrument.station import Station, each
from instrument.steps import Steps
from instrument.turning import position_at_start, turn_prompt

log = logging.getLogger(__name__)
S = State
References = list[tuple[int, Geometry]]
Outcome = Literal["finished", "aborted", "halted", "faulted"]
#: Through which state a scan goes to its final one, and the outcome's name.
_ENDS: dict[Outcome, tuple[State | None, State]] = {
    "finished": (S.FINISHING, S.FINISHED),
    "aborted": (S.ABORTING, S.ABORTED),
    "halted": (None, S.HALTED),
    "faulted": (S.FAULTING, S.FAULTED),
}


class InstrumentFaulty(DeviceError):
    """Points failed in a way that makes going on pointless."""


class ScanEngine:
    """Runs one scan on a thread of its own.

    Attributes
    ----------
    error
        What ended the scan early, if anything but a person did.
    """

    def __init__(self, job: ScanJob, bus: EventBus) -> None:
        self._job = job
        self._controls = Controls(job.clock)
        self._report = Reporter(job.clock, job.journal, bus)
        self._steps = Steps(job.operator, self._controls, self._report, job.clock)
        self._evaluator = Evaluator(job.facility, job.plan.points)
        self._progress = Progress(len(job.plan), job.previous.points if job.previous else ())
        self._begun: set[int] = set()
        self._failures = 0
        self._calibrated = job.clock.now()
        self._turned = position_at_start(job.plan.points)
        self._laboratory: Laboratory | None = None
        self._station: Station | None = None
        self._ended = threading.Event()
        self._end: ScanEnded | None = None
        self._thread = threading.Thread(target=self._run, name="scan engine", daemon=True)
        self.error: Exception | None = None

    @property
    def state(self) -> State:
        """What the scan is doing."""
        return self._report.state

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def pause(self, *, now: bool = False, reason: str = "asked by a person") -> None:
        """Rest after the point at hand, or at once (the point is then repeated)."""
        self._controls.pause(now=now, reason=reason)

    def resume(self) -> None:
        """Go on after a pause or a suspension."""
        self._controls.resume()

    def abort(self, reason: str = "asked by a person") -> None:
        """End in an orderly way."""
        self._controls.abort(reason)

    def halt(self, reason: str = "asked by a person") -> None:
        """Stop everything at once."""
        self._controls.halt(reason)

    def wait(self, timeout: float | None = None) -> ScanEnded | None:
        """Wait (wall-clock seconds) for the end; None where it has not come."""
        return self._end if self._ended.wait(timeout) else None

    def _run(self) -> None:
        outcome: Outcome = "finished"
        try:
            self._scan()
            reason = self._progress.summary()
        except HaltAsked as request:
            outcome, reason = "halted", request.reason
        except AbortAsked as request:
            outcome, reason = "aborted", request.reason
        except Exception as error:
            # Whatever went wrong, the laboratory has to be made safe and the run closed honestly.
            log.debug("scan failed", exc_info=True)
            self.error = error
            outcome, reason = "faulted", str(error) or type(error).__name__
        try:
            self._finish(outcome, reason)
        except Exception as error:
            log.debug("the end of the scan failed", exc_info=True)
            self.error = self.error or error
            self._announce_end("faulted", "; then: ".join(filter(None, (reason, str(error)))), None)

    def _scan(self) -> None:
        for record in self._job.previous.references if self._job.previous else ():
            self._evaluator.add_reference(record["index"], Geometry.model_validate(record["geometry"]), record)
        if not self._progress.missing():
            self._announce_start(0.0)
            return
        self._report.to(S.CONNECTING)
        self._laboratory = self._job.connect()
        station = self._station = Station(
            self._laboratory,
            self._job.facility.arms,
            self._job.clock,
            self._controls,
            self._job.settings,
            self._report.decision,
            self._report.note,
            self._report.stands,
        )
        self._controls.checkpoint()
        self._report.to(S.PREFLIGHT)
        self._preflight(station)
        attendance = Attendance(station, self._report, self._controls, self._job.settings, self._job.files.run_dir)
        self._report.to(S.HOMING)
        for axis in (*station.laboratory.axes(), *station.laboratory.stages()):
            attendance.attended(S.HOMING, partial(station.mover.home, axis))
        self._calibrate(station, attendance, self._job.missing_references())
        for index in self._progress.missing():
            if self._job.reference_due(self._calibrated):
                self._calibrate(station, attendance, self._job.references(), repeated=True)
            self._turn(station, attendance, self._job.plan.points[index].illumination_azimuth)
            self._attempt_point(station, attendance, index)
        if self._job.facility.reference.repeat_minutes > 0:
            self._read_references(station, attendance, self._job.references(), repeated=True)

    def _preflight(self, station: Station) -> None:
        """Everything that can be known to be wrong is found here, before anything moves.

        Raises
        ------
        InputError, SafetyError
            If the plan leads where an arm must not go.
        DeviceFault, DiskNearlyFull
            If a check of the preflight has not passed; all of them are in the journal.
        """
        job = self._job
        checks = preflight(station, job.files.run_dir, job.settings, job.reference_age(), job.facility, job.clock.now())
        for check in checks:
            if check.passed and check.found.startswith("not in order"):
                self._report.tell("warning", f"{check.name}: {check.found}")
        self._report.record("preflight", time=self._report.now(), checks=checks)
        require(checks)
        statuses = {name: axis.status() for name, axis in station.laboratory.axes().items()}
        # An arm that is not homed will stand at its zero once it is.
        start = station.pose() if all(s.homed for s in statuses.values()) else Pose(0.0, 0.0, 0.0)
        total = len(self._job.plan)
        stops = [(f"reference {i + 1}", geometry) for i, geometry in self._job.missing_references()]
        stops += [(f"point {i + 1} of {total}", self._job.plan.points[i]) for i in self._progress.missing()]
        checked = check_plan(stops, start, station.envelope)
        station.stages.check(geometry for _, geometry in stops)
        station.light.check_range(stop.wavelength for _, stop in stops)
        self._announce_start(outlook(self._job, station, self._progress.missing(), start).duration)
        if checked.detours:
            self._report.note(f"{checked.detours} moves lead around the shadow cone")

    def _calibrate(
        self, station: Station, attendance: Attendance, to_read: References, *, repeated: bool = False
    ) -> None:
        """Read the reference, then have the sample put on the stage."""
        self._read_references(station, attendance, to_read, repeated=repeated)
        self._mount("sample", station, attendance)

    def _read_references(
        self, station: Station, attendance: Attendance, to_read: References, *, repeated: bool
    ) -> None:
        """Have the reference put on the stage and read it; nothing where nothing is to be read."""
        self._calibrated = self._report.now()
        if not to_read:
            self._calibrated -= self._job.reference_age()
            return
        self._mount("reference", station, attendance)
        self._report.to(S.REFERENCING, "repeated on schedule" if repeated else "")
        for index, geometry in to_read:
            attendance.attended(S.REFERENCING, partial(self._read_reference, station, index, geometry, repeated))

    def _mount(self, what: Mounted, station: Station, attendance: Attendance) -> None:
        """Let hands at the stage: arms at rest, shutter closed, source off unless told otherwise."""
        self._by_hand(f"{what} to be put on the stage", partial(self._steps.mount, what), station, attendance)

    def _turn(self, station: Station, attendance: Attendance, azimuth: float) -> None:
        """Have the sample turned where a point wants another illumination azimuth."""
        if azimuth != self._turned:
            step = partial(self._steps.confirm, turn_prompt(azimuth), needed=True)
            self._by_hand(f"illumination azimuth {azimuth:g} to be set", step, station, attendance)
            self._turned = azimuth

    def _by_hand(self, reason: str, step: Callable[[], None], station: Station, attendance: Attendance) -> None:
        def work() -> None:
            station.rest()
            if not self._job.settings.emission_while_mounting:
                station.light.off()
                station.zero_monitor()
            step()

        self._report.to(S.MOUNTING, reason)
        attendance.attended(S.MOUNTING, work)
        attendance.attended(S.MOUNTING, self._steps.confirm_source)
        attendance.attended(S.MOUNTING, attendance.light_up)

    def _read_reference(self, station: Station, index: int, geometry: Geometry, repeated: bool) -> None:
        station.go(geometry)
        burst, record = station.read(self._job.plan.samples)
        if repeated:
            record["repeated"] = True
        self._report.record("reference", index=index, geometry=geometry, **record)
        self._evaluator.add_reference(index, geometry, record)
        self._report.publish(
            ReferenceMeasured(
                time=self._report.now(),
                index=index,
                sensor_azimuth=geometry.sensor_azimuth,
                current=burst.current,
                relative_standard_error=burst.relative_standard_error,
            )
        )

    def _attempt_point(self, station: Station, attendance: Attendance, index: int) -> None:
        """Measure a point, or mark it and say why not."""
        try:
            attendance.attended(S.MOVING, partial(self._measure_point, station, index))
        except MotionFailed as error:
            if not error.at_rest:
                raise
            self._skip(station, index, error)
        except (CommunicationError, CommandRefused, NoReading, LightUnstable) as error:
            if isinstance(error, Hindrance) and error.in_vain:
                raise
            self._skip(station, index, error)
        else:
            self._failures = 0

    def _measure_point(self, station: Station, index: int) -> None:
        plan, progress = self._job.plan, self._progress
        geometry = plan.points[index]
        self._report.to(S.MOVING, f"point {index + 1} of {progress.total}")
        self._report.publish(PointStarted(time=self._report.now(), index=index, geometry=geometry))
        progress.begin()
        station.go(geometry)
        self._report.to(S.MEASURING)
        repeated = REPEATED if index in self._begun else 0
        self._begun.add(index)
        burst, record = station.read(plan.samples)
        record["quality_flag"] |= repeated
        brf, u_brf = self._evaluator.brf(geometry, record)
        self._report.record("point", index=index, geometry=geometry, **record)
        progress.done(index)
        self._begun.discard(index)
        self._report.publish(
            PointMeasured(
                time=self._report.now(),
                index=index,
                geometry=geometry,
                brf=brf,
                u_brf=u_brf,
                signal=burst.samples,
                dark=burst.dark,
                gain=burst.gain,
                quality_flag=record["quality_flag"],
                done=len(progress.measured),
                total=progress.total,
                time_left_s=progress.time_left(),
            )
        )

    def _skip(self, station: Station, index: int, error: DeviceError) -> None:
        """Bring the instrument to rest, mark the point, and decide whether to go on."""
        settings = self._job.settings
        station.rest()
        geometry, now = self._job.plan.points[index], self._report.now()
        self._report.record("skipped", index=index, geometry=geometry, time=now, reason=str(error))
        self._progress.skipped.add(index)
        self._failures += 1
        self._report.publish(PointSkipped(time=now, index=index, geometry=geometry, reason=str(error)))
        if settings.after_failure == "end" or self._failures >= settings.failures_in_a_row:
            raise InstrumentFaulty(
                error.device, f"{error.problem}; failed at {self._failures} point(s) in a row", error.advice
            )

    def _finish(self, outcome: Outcome, reason: str) -> None:
        """Safe state first, then the records."""
        problems = self._make_safe()
        if problems and outcome == "finished":
            self.error = problems[0]
            outcome, reason = "faulted", f"all measured, but not brought into the safe state: {problems[0]}"
        before, final = _ENDS[outcome]
        if before is not None:
            self._report.to(before, reason)
        progress = self._progress
        self._report.record(
            "ended",
            time=self._report.now(),
            outcome=outcome,
            reason=reason,
            measured=len(progress.measured),
            skipped=sorted(progress.skipped),
            not_reached=progress.missing(),
        )
        self._report.to(final, reason)
        self._report.close()
        self._announce_end(outcome, reason, self._derive())

    def _derive(self) -> Path | None:
        """Make the run file; the journal stands whatever happens here."""
        try:
            return self._job.derive()
        except Exception as error:
            log.debug("no run file", exc_info=True)
            self.error = self.error or error
            self._report.tell("error", f"the run file could not be made: {error}", "the journal holds every reading")
            return None

    def _make_safe(self) -> list[Exception]:
        problems: list[Exception] = []
        if self._station is not None:
            problems += self._station.make_safe()
        if self._laboratory is not None:
            problems += each(device.close for device in self._laboratory.devices().values())
        for problem in problems:
            self._report.tell("error", f"not brought into its safe state: {problem}", "look at the instrument")
        return problems

    def _announce_start(self, duration: float) -> None:
        job, files = self._job, self._job.files
        self._progress.expect(duration / job.clock.speed)
        self._report.publish(
            ScanStarted(
                time=self._report.now(),
                run_dir=str(files.run_dir),
                title=job.plan.title,
                points=job.plan.points,
                done=tuple(sorted(self._progress.measured)),
                duration_s=duration,
                clock_speed=job.clock.speed,
                facility=str(files.facility) if files.facility else None,
                artifact=str(files.artifact) if files.artifact else None,
                material=str(files.material) if files.material else None,
            )
        )

    def _announce_end(self, outcome: Outcome, reason: str, run_file: Path | None) -> None:
        self._end = ScanEnded(
            time=self._report.now(),
            outcome=outcome,
            done=len(self._progress.measured),
            total=self._progress.total,
            reason=reason,
            run_file=str(run_file) if run_file else None,
        )
        self._report.publish(self._end)
        self._ended.set()
