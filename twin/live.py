"""The twin that follows a scan: predicts ahead of it in another process and sums up when it is over.

:class:`LiveTwin` is registered as observer ``twin`` in the entry-point group ``goniotwin.observers``. Three threads are
involved: the bus's, on which :meth:`LiveTwin.on_event` only takes notes; one that asks the worker for batch after
batch; and whoever calls :meth:`LiveTwin.finish`. Whatever happens to the worker process, the scan goes on; what it owes
is computed again.

A second process works out, in idle time, what the uncertain inputs add to the uncertainty of every point of the plan,
unless an earlier scan left that in the cache (:mod:`twin.input_uncertainty`). From then on ``u_brf`` holds it; until
then ``u_brf`` is the ray tracer's error alone, and says so.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal, Protocol

from instrument.errors import InputError
from instrument.events import (
    Event,
    Geometry,
    Message,
    PointAnnotated,
    PointMeasured,
    PointSkipped,
    PointStarted,
    ScanEnded,
    ScanStarted,
)
from instrument.observers import Publish
from twin.schedule import Batch, Schedule, Stage
from twin.worker import (
    UNCERTAINTY_FACTORY,
    KnownUncertainty,
    Prediction,
    PredictionWorker,
    Timeouts,
    TwinUnusable,
    Unpredictable,
    WorkerError,
    WorkerUnavailable,
)

SOURCE = "twin"
#: Uncertainties of the inputs are worked out when nobody else wants the processor, however long that takes.
IDLE_NICENESS, IDLE_PATIENCE_S = 19, 6 * 3600.0
#: Sight lines of a first look: an error of 0.2 % at most points of the example, small beside what a measurement and the
#: inputs are uncertain by (benchmarks/bench_live.py).
LOOK = 8192
#: A quick look first, a few whole slices ahead of the scan; then the accuracy that a comparison needs.
STAGES = (Stage(standard_error=0.004, batch=33, sight_lines=LOOK), Stage(standard_error=0.001, batch=11))
#: After so many failures in a row, and none to wait for but them, the rest is reported as missing.
LAST_ATTEMPTS = 8


class Predictor(Protocol):
    """What the live twin needs of :class:`~twin.worker.PredictionWorker`."""

    def predict(
        self,
        indices: tuple[int, ...],
        geometries: list[Geometry],
        standard_error: float,
        sight_lines: int | None = None,
    ) -> Any: ...

    def close(self) -> None: ...


class Assessor(Protocol):
    """Tells what the inputs add to the uncertainty of predictions."""

    def uncertainty(self, geometries: Sequence[Geometry]) -> Any: ...

    def close(self) -> None: ...


PredictorFactory = Callable[[Path, Path, Path], Predictor]
AssessorFactory = Callable[[Path, Path, Path], Assessor]


def idle_assessor(facility: Path, artifact: Path, material: Path) -> Assessor:
    """A process that works at the lowest priority."""
    return PredictionWorker(
        facility,
        artifact,
        material,
        niceness=IDLE_NICENESS,
        timeouts=Timeouts(request_s=IDLE_PATIENCE_S),
        factory=UNCERTAINTY_FACTORY,
    )


class LiveTwin:
    """Predicts the points of one scan while it runs.

    Parameters
    ----------
    publish
        Puts events on the bus; may be called from any thread.
    predictor
        Makes a predictor of (facility, artifact, material).
    assessor
        Makes what tells the uncertainty from the inputs, of the same; None: ``u_brf`` is the ray tracer's error alone.
    stages
        Passes over the points, from coarse to fine.
    """

    def __init__(
        self,
        publish: Publish,
        *,
        predictor: PredictorFactory = PredictionWorker,
        assessor: AssessorFactory | None = idle_assessor,
        stages: tuple[Stage, ...] = STAGES,
    ) -> None:
        self._publish = publish
        self._make_predictor, self._make_assessor = predictor, assessor
        self._stages = stages
        self._change = threading.Condition()
        self._clock = _LaboratoryClock()
        self._predictor: Predictor | None = None
        self._assessor: Assessor | None = None
        self._known: KnownUncertainty | None = None
        self._assessor_failed = False
        self._thread: threading.Thread | None = None
        self._schedule: Schedule | None = None
        self._points: tuple[Geometry, ...] = ()
        self._measured: set[int] = set()
        self._values: dict[int, dict[str, float]] = {}
        self._attributes: dict[str, Any] = {}
        self._run_file: Path | None = None
        self._finishing = self._closed = False
        self._hopeless = ""
        self._refusals: set[str] = set()

    @staticmethod
    def check(facility: Path | None, artifact: Path | None, material: Path | None) -> None:
        """Before a scan begins: read what no one else has read yet, the material.

        Raises
        ------
        InputError
            If the file is wrong.
        """
        if material is not None:
            from twin.material import read_material

            read_material(material)

    def on_event(self, event: Event) -> None:
        """Take note of where the scan is; never waits for a prediction."""
        with self._change:
            self._clock.see(event)
            if isinstance(event, ScanStarted):
                self._start(event)
            elif isinstance(event, PointMeasured):
                self._measured.add(event.index)
                self._move(event.index + 1)
            elif isinstance(event, PointSkipped):
                self._move(event.index + 1)
            elif isinstance(event, PointStarted):
                self._move(event.index)
            elif isinstance(event, ScanEnded) and event.run_file is not None:
                self._run_file = Path(event.run_file)

    def finish(self, run_dir: Path) -> list[Any]:
        """Complete the predictions of all measured points, write ``prediction.nc``, ``comparison.json`` and
        ``figures/`` into the run folder.

        Returns
        -------
        list
            Tables for the terminal; empty where there was nothing to predict.
        """
        if self._thread is None:
            return []
        self._complete()
        from twin.summary import NothingToCompare, summarise

        with self._change:
            values, attributes, run_file = dict(self._values), dict(self._attributes), self._run_file
            waiting = self._assessor is not None and self._known is None and not self._assessor_failed
        if waiting:
            self._say(
                "info",
                "u_brf of the predictions is the ray tracer's error alone: the uncertainty of their inputs was not"
                " ready when the scan ended",
                "goniotwin predict --uncertainty works it out",
            )
        try:
            return summarise(run_file or run_dir / "run.nc", self._points, values, attributes, run_dir)
        except NothingToCompare as reason:
            self._say("warning", f"no comparison: {self._hopeless or reason}")
            return []

    def close(self) -> None:
        """End the worker process and the thread; may be called at any time and repeatedly."""
        with self._change:
            self._closed = True
            self._change.notify_all()
        for worker in (self._predictor, self._assessor):
            if worker is not None:
                worker.close()
        if self._thread is not None:
            self._thread.join()

    def _start(self, event: ScanStarted) -> None:
        self._measured.update(event.done)
        if self._thread is not None or self._closed:
            return
        if event.facility is None or event.artifact is None or event.material is None:
            names = {"facility": event.facility, "artifact": event.artifact, "material": event.material}
            missing = ", ".join(name for name, path in names.items() if path is None)
            self._say("info", f"the twin predicts nothing: the scan names no {missing}")
            return
        self._points = event.points
        self._schedule = Schedule(event.points, self._stages)
        self._schedule.move_to(_first_open(len(event.points), self._measured))
        files = Path(event.facility), Path(event.artifact), Path(event.material)
        self._predictor = self._make_predictor(*files)
        if self._make_assessor is not None:
            self._assessor = self._make_assessor(*files)
            self._assessor.uncertainty(event.points).add_done_callback(self._assess)
        self._thread = threading.Thread(target=self._predict_all, name="live twin", daemon=True)
        self._thread.start()

    def _move(self, position: int) -> None:
        if self._schedule is not None:
            self._schedule.move_to(position)

    def _complete(self) -> None:
        """Wait until every measured point is predicted, or cannot be."""
        assert self._schedule is not None
        assert self._thread is not None
        with self._change:
            self._finishing = True
            self._schedule.restrict(self._measured)
            remaining = self._schedule.remaining
            self._change.notify_all()
        if remaining and not self._hopeless:
            self._say("info", f"the scan is over; the twin still predicts or refines {remaining} points")
        self._thread.join()
        lost = self._schedule.remaining + len(self._schedule.given_up & self._measured)
        if lost and not self._closed and not self._hopeless:
            self._say("warning", f"{lost} points could not be predicted as accurately as wanted, or not at all")

    def _predict_all(self) -> None:
        """The thread that keeps the worker busy."""
        assert self._schedule is not None
        failures = 0
        while (batch := self._next_batch(failures)) is not None:
            try:
                self._take(batch, self._ask(batch))
                failures = 0
            except WorkerUnavailable as pause:
                self._say(
                    "warning", f"the twin pauses: {pause}", "predictions go on by themselves; the scan is not affected"
                )
                self._rest(pause.retry_after_s)
            except Unpredictable as error:
                self._refuse(batch, error)
            except WorkerError as error:
                failures += 1
                if not self._closed:
                    self._lose(batch, error)
            except (InputError, TwinUnusable) as error:
                self._give_up(str(error))
                return

    def _next_batch(self, failures: int) -> Batch | None:
        """Wait for something to do; None at the end."""
        assert self._schedule is not None
        with self._change:
            while not self._closed:
                if self._finishing and failures >= LAST_ATTEMPTS:
                    return None
                batch = self._schedule.next_batch()
                if batch is not None or self._finishing:
                    return batch
                self._change.wait()
        return None

    def _ask(self, batch: Batch) -> Prediction:
        assert self._predictor is not None
        geometries = [self._points[index] for index in batch.indices]
        answer = self._predictor.predict(batch.indices, geometries, batch.standard_error, batch.sight_lines)
        prediction: Prediction = answer.result()
        return prediction

    def _take(self, batch: Batch, prediction: Prediction) -> None:
        assert self._schedule is not None
        columns = zip(prediction.indices, prediction.brf, prediction.u_brf, prediction.u_brf_monte_carlo, strict=True)
        values = {i: {"brf": brf, "u_brf": u, "u_brf_monte_carlo": u_mc} for i, brf, u, u_mc in columns}
        with self._change:
            self._schedule.succeeded(batch)
            self._attributes = dict(prediction.attributes)
            news = self._take_in(values)
        self._annotate(news)

    def _assess(self, answer: Future[KnownUncertainty]) -> None:
        """The uncertainty of the inputs is there, or cannot be told: what was predicted before gets it too."""
        if answer.cancelled():
            return
        error = answer.exception()
        if error is None:
            with self._change:
                self._known = answer.result()
                news = self._take_in(self._values)
            self._annotate(news)
            return
        with self._change:
            self._assessor_failed = True
            closed = self._closed
        if not closed and not self._hopeless:
            text = f"the uncertainty of the twin's inputs cannot be told: {error}"
            self._say("warning", text, "u_brf of the predictions is the ray tracer's error alone")

    def _take_in(self, values: Mapping[int, dict[str, float]]) -> dict[int, dict[str, float]]:
        """Keep predictions, with the uncertainty of the inputs once that is known; returns what is kept."""
        known, told = self._known, {}
        for index, value in values.items():
            told[index] = dict(value)
            if known is not None:
                u = known.u_brf_inputs[index]
                told[index] |= {"u_brf": math.hypot(u, value["u_brf_monte_carlo"]), "u_brf_inputs": u}
        self._values.update(told)
        if known is not None:
            self._attributes |= {"u_brf_contains": known.contains, "u_brf_notes": "; ".join(known.notes)}
        return told

    def _annotate(self, values: Mapping[int, dict[str, float]]) -> None:
        with self._change:
            now = self._clock.now()
        for index, annotation in values.items():
            self._publish(PointAnnotated(time=now, index=index, source=SOURCE, values=annotation))

    def _lose(self, batch: Batch, error: WorkerError) -> None:
        assert self._schedule is not None
        with self._change:
            self._schedule.failed(batch)
        self._say(
            "warning",
            f"a prediction of {len(batch.indices)} points was lost: {error}",
            "they are computed again; the scan is not affected",
        )

    def _refuse(self, batch: Batch, error: Unpredictable) -> None:
        assert self._schedule is not None
        with self._change:
            self._schedule.refused(batch)
        if str(error) not in self._refusals:
            self._refusals.add(str(error))
            self._say("warning", f"the twin cannot predict some points: {error}", "they are measured all the same")

    def _give_up(self, reason: str) -> None:
        self._hopeless = reason
        self._say("error", f"the twin cannot predict: {reason}", "the scan goes on; compare its run afterwards")

    def _rest(self, seconds: float) -> None:
        with self._change:
            self._change.wait_for(lambda: self._closed, timeout=max(seconds, 0.0))

    def _say(self, level: Literal["info", "warning", "error"], text: str, advice: str = "") -> None:
        with self._change:
            now = self._clock.now()
        self._publish(Message(time=now, level=level, text=text, advice=advice))


class _LaboratoryClock:
    """Laboratory time, carried on from the last event with the speed that the scan's clock runs at."""

    def __init__(self) -> None:
        self._time, self._at, self._speed = datetime.now(UTC), time.monotonic(), 1.0

    def see(self, event: Event) -> None:
        if isinstance(event, PointAnnotated | Message):
            return  # these are stamped by listeners, this one among them
        if isinstance(event, ScanStarted):
            self._speed = event.clock_speed
        self._time, self._at = event.time, time.monotonic()

    def now(self) -> datetime:
        return self._time + timedelta(seconds=self._speed * (time.monotonic() - self._at))


def _first_open(count: int, done: set[int]) -> int:
    return next((index for index in range(count) if index not in done), count)
