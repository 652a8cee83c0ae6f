"""One scan from request to result: what the command line, the window and the tests all use.

A session starts the simulated laboratory where one is asked for, makes the run folder, takes the lock on the
instrument, brings in the observers and builds the engine. It drives nothing itself: the engine does.
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from drivers.clock import Clock
from drivers.configuration import DevicesForm, connect, endpoints, read_devices
from drivers.lock import InstrumentLock
from instrument.audience import Audience, check_inputs
from instrument.bus import EventBus, Handler, Subscription
from instrument.dataset import run_of_journal, write_run
from instrument.engine import ScanEngine
from instrument.errors import InputError
from instrument.events import Message, ScanEnded
from instrument.job import ScanFiles, ScanJob
from instrument.journal import Journal, JournalContent, read_journal
from instrument.laboratories import StartedLaboratory, laboratory_factory
from instrument.operators import Operator
from instrument.plan import Plan
from instrument.procedures.standing import with_facility
from instrument.reference_check import checked_reference
from instrument.reference_standard import ACCEPTED
from instrument.request import ScanInputs, ScanRequest, complete, header_of, inputs_of
from instrument.run_folder import RUN_NAME, check_free, keep_inputs, make_run_folder
from instrument.settings import ScanSettings
from instrument.states import State

__all__ = ["ScanRequest", "ScanSession", "derive_run"]


class ScanSession:
    """One scan. Use it as a context manager, or call :meth:`open` and :meth:`close`.

    ``open`` may take seconds (it starts the simulated laboratory): a window calls it on a thread. Everything
    else but ``wait``, ``finish`` and ``close`` returns at once.

    Parameters
    ----------
    request
        What is asked for.
    operator
        Who changes the sample; the simulated laboratory brings its own, which is used where this is None.
    settings
        How the scan is carried out.

    Attributes
    ----------
    bus
        Every event of the scan; usable (:meth:`subscribe`) before ``open``.
    run_dir, plan
        Known after ``open``.
    laboratory
        The laboratory that was started for this scan; None for real devices.
    """

    run_dir: Path
    plan: Plan
    laboratory: StartedLaboratory | None = None

    def __init__(
        self, request: ScanRequest, operator: Operator | None = None, settings: ScanSettings | None = None
    ) -> None:
        self.request = request
        self.bus = EventBus(self._now)
        self._operator, self._settings = operator, settings or ScanSettings()
        self._clock = Clock()
        self._stack = ExitStack()
        self._engine: ScanEngine | None = None
        self._audience: Audience | None = None
        self._started = False
        self._objections: list[str] = []

    def subscribe(self, handler: Handler, name: str = "listener") -> Subscription:
        """Call ``handler`` with every event from the first on, on a thread of its own."""
        return self.bus.subscribe(handler, name)

    def open(self) -> None:
        """Read and check every file, start the laboratory, make the run folder, take the lock; nothing moves.

        Raises
        ------
        InputError, ConfigurationError
            If a file or the request is wrong.
        InstrumentBusy
            If another program drives this instrument.
        """
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        given = inputs_of(self.request)
        if self.request.twin:
            check_inputs(given.facility, given.artifact, given.material)
        if self.request.out is not None:
            check_free(self.request.out)
        if given.simulate is not None:
            folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="goniotwin-")))
            started = laboratory_factory()(
                folder,
                speed=given.simulate.speed,
                seed=given.simulate.seed,
                artifact=given.artifact,
                facility=given.facility,
            )
            self.laboratory = self._stack.enter_context(started)
            given = given.filled(self.laboratory.inputs)
            self._operator = self._operator or self.laboratory.operator
        inputs = complete(given)
        self._objections = checked_reference(inputs, self.request.accept_reference, datetime.now(UTC).date())
        if self._operator is None:
            raise InputError("nobody is there to change the sample; run the scan from a terminal or the window")
        devices = read_devices(inputs.devices)
        self._clock = _clock(devices.clock.speed, inputs.resumed)
        self._stack.enter_context(InstrumentLock(endpoints(devices)))
        self.plan = inputs.plan
        job = self._job(inputs, devices, self._operator)
        self._stack.callback(job.journal.close)
        self._engine = ScanEngine(job, self.bus)
        if self.request.twin:
            self._audience = Audience(self.bus)
            self._stack.callback(self._audience.close)

    def _job(self, inputs: ScanInputs, devices: DevicesForm, operator: Operator) -> ScanJob:
        if inputs.resumed is None:
            self.run_dir = make_run_folder(self.request.out, inputs.plan_path)
            inputs = keep_inputs(inputs, self.run_dir)
            journal = Journal.create(self.run_dir, self._header(inputs))
        else:
            self.run_dir = inputs.resumed.path.parent.resolve()
            journal = Journal.reopen(self.run_dir)
            if journal.done != inputs.resumed.points.keys():
                journal.close()
                raise InputError(f"{journal.path}: another program went on with this run meanwhile; resume it again")
        return ScanJob(
            plan=inputs.plan,
            facility=inputs.facility,
            connect=partial(connect, devices, self._clock),
            clock=self._clock,
            journal=journal,
            operator=operator,
            files=ScanFiles(self.run_dir, inputs.facility_path, inputs.artifact, inputs.material),
            previous=inputs.resumed,
            derive=partial(derive_run, self.run_dir),
            settings=with_facility(self._settings, inputs.facility),
        )

    def _header(self, inputs: ScanInputs) -> dict[str, Any]:
        header = header_of(inputs, self._clock.now())
        return header | ({ACCEPTED: self._objections} if self._objections else {})

    @property
    def observed(self) -> bool:
        """Whether any observer, such as the twin, watches."""
        return self._audience is not None and self._audience.seated > 0

    @property
    def state(self) -> State:
        """What the scan is doing."""
        return self._engine.state if self._engine else State.IDLE

    @property
    def error(self) -> Exception | None:
        """What ended the scan early, if anything but a person did."""
        return self._engine.error if self._engine else None

    def start(self) -> None:
        """Begin: the engine connects, checks, and scans on a thread of its own."""
        self._the_engine.start()
        self._started = True

    def pause(self, *, now: bool = False) -> None:
        """Rest after the point at hand, or at once (the point is then repeated)."""
        self._the_engine.pause(now=now)

    def resume(self) -> None:
        """Go on after a pause or a suspension."""
        self._the_engine.resume()

    def abort(self, reason: str = "asked by a person") -> None:
        """End in an orderly way; what is measured is kept and the run can be resumed."""
        self._the_engine.abort(reason)

    def halt(self, reason: str = "asked by a person") -> None:
        """Stop everything at once."""
        self._the_engine.halt(reason)

    def wait(self, timeout: float | None = None) -> ScanEnded | None:
        """Wait (wall-clock seconds) for the end; None where it has not come."""
        return self._the_engine.wait(timeout)

    def finish(self) -> list[Any]:
        """After the end: let every observer finish; returns what they want printed (rich renderables)."""
        return self._audience.finish(self.run_dir) if self._audience else []

    def close(self) -> None:
        """Abort if still running, then release devices, lock, observers and laboratory. May be repeated.

        An engine that hangs in a device that never returns is waited for only so long: it no longer shows signs of
        life, so the watchdog of the source is not fed any more, and the emission ends by itself.
        """
        if self._engine is not None and self._started:
            self._end_engine(self._engine)
        self._stack.close()
        self.bus.close()

    def _end_engine(self, engine: ScanEngine) -> None:
        patience = self._settings.close_limit_wall
        engine.abort("the program ends")
        if engine.wait(patience) is not None:
            return
        engine.halt("the program ends, and an orderly end takes too long")
        if engine.wait(patience) is None:
            self.bus.publish(
                Message(
                    time=self._now(),
                    level="error",
                    text=f"the scan did not end within {2 * patience:g} s: it hangs in state {engine.state}",
                    advice="look at the instrument: switch the source off and see that the arms stand still",
                )
            )

    def __enter__(self) -> ScanSession:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _the_engine(self) -> ScanEngine:
        if self._engine is None:
            raise RuntimeError("the session is not open")
        return self._engine

    def _now(self) -> datetime:
        return self._clock.now()


def _clock(speed: float, resumed: JournalContent | None) -> Clock:
    """Laboratory time that never runs back: an accelerated clock was ahead of the wall clock when a run stopped."""
    now = datetime.now(UTC)
    return Clock(speed, start=now if resumed is None else max(now, resumed.latest))


def derive_run(run_dir: Path) -> Path | None:
    """Make ``run.nc`` of a run folder from its journal; None where no point was measured."""
    content = read_journal(run_dir)
    if not content.points:
        return None
    write_run(run_of_journal(content), run_dir / RUN_NAME)
    return run_dir / RUN_NAME
