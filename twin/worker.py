"""Ray tracing in a process of its own, so that nothing that happens there can stop a scan.

A Dr.Jit kernel can abort the process it runs in, hang, or take every core. :class:`PredictionWorker` starts the process
when the first prediction is asked for, gives it a low priority, and starts it again after a crash, but not
more often than :class:`RestartLimit` allows. It never repeats a request by itself: the caller decides that.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from instrument.errors import InputError
from instrument.events import Geometry

Json = dict[str, Any]

#: What the process calls with (facility, artifact, material) to get an object with ``predict``.
TWIN_FACTORY = "twin.scan_twin:scan_twin"
#: And to get one with ``uncertainty``.
UNCERTAINTY_FACTORY = "twin.input_uncertainty:UncertainTwin.from_files"


class WorkerError(RuntimeError):
    """A prediction could not be computed; the next request may well succeed."""


class WorkerCrashed(WorkerError):
    """The process ended, or was ended because it did not answer in time."""


class Unpredictable(WorkerError):
    """The twin refuses a point of the request, and would again: asked for at a wavelength without material, say."""


class TwinUnusable(RuntimeError):
    """The process runs, but no twin can be built in it: a broken installation. Trying again does not help."""


class WorkerUnavailable(WorkerError):
    """The process crashed too often lately; ``retry_after_s`` tells when it may be started again."""

    def __init__(self, text: str, retry_after_s: float) -> None:
        super().__init__(text)
        self.retry_after_s = retry_after_s


@dataclass(frozen=True)
class Prediction:
    """Values for the requested points, in the order of the request; all without unit."""

    indices: tuple[int, ...]
    brf: tuple[float, ...]
    u_brf: tuple[float, ...]
    u_brf_monte_carlo: tuple[float, ...]
    attributes: Json


@dataclass(frozen=True)
class KnownUncertainty:
    """Standard uncertainties (k = 1) of the requested points from the inputs of the twin.

    Attributes
    ----------
    u_brf_inputs
        In the order of the request.
    contains
        What a combined uncertainty that includes them holds, in words.
    notes
        What was assumed, and what is not propagated.
    """

    u_brf_inputs: tuple[float, ...]
    contains: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class RestartLimit:
    """At most ``starts`` starts of the process within ``window_s`` seconds."""

    starts: int = 5
    window_s: float = 60.0


@dataclass(frozen=True)
class Timeouts:
    """Seconds the process may take: to start and read its inputs, and to answer one request."""

    start_s: float = 180.0
    request_s: float = 300.0


@dataclass
class _Request:
    message: Json
    read: Callable[[Json], Any]
    future: Future[Any] = field(default_factory=Future)


class PredictionWorker:
    """Predicts points in another process; requests are answered one after the other, in order.

    Parameters
    ----------
    facility, artifact, material
        Files of the twin.
    seed
        Of every request: whatever crashes in between, the same request has the same answer.
    threads
        Compute threads of the process; by default all cores, on machines with more than two all but one.
    niceness
        Added to the process's nice level.
    """

    def __init__(
        self,
        facility: Path,
        artifact: Path,
        material: Path,
        *,
        seed: int = 1,
        threads: int | None = None,
        niceness: int = 10,
        restarts: RestartLimit | None = None,
        timeouts: Timeouts | None = None,
        factory: str = TWIN_FACTORY,
    ) -> None:
        self._settings = {
            "facility": str(facility),
            "artifact": str(artifact),
            "material": str(material),
            "threads": threads or default_threads(),
            "niceness": niceness,
            "factory": factory,
        }
        self._seed = seed
        self._restarts = restarts or RestartLimit()
        self._timeouts = timeouts or Timeouts()
        self._starts: deque[float] = deque()
        self._numbers = itertools.count(1)
        self._requests: queue.SimpleQueue[_Request | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._process: _Process | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._serve, name="twin worker", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """Of the running process; None where there is none."""
        process = self._process
        return process.pid if process is not None and process.alive else None

    def predict(
        self,
        indices: Sequence[int],
        geometries: Sequence[Geometry],
        standard_error: float,
        sight_lines: int | None = None,
    ) -> Future[Prediction]:
        """Ask for predictions; returns at once.

        Parameters
        ----------
        indices, geometries
            Names of the points, returned with the result, and as many geometries.
        standard_error
            Relative Monte Carlo standard error to reach.
        sight_lines
            Trace so many for every point instead, whatever error they leave.

        Returns
        -------
        Future
            Holds a :class:`Prediction` or raises: :class:`WorkerError` if this attempt failed
            (:class:`Unpredictable` if every other would, too), :class:`~instrument.errors.InputError` if the twin's
            files are wrong, :class:`TwinUnusable` if it cannot be built otherwise. To be cancelled before work begins.
        """
        if len(indices) != len(geometries) or not len(indices):
            raise ValueError(
                f"found {len(indices)} indices and {len(geometries)} geometries; expected as many, and some"
            )
        message = {
            "id": next(self._numbers),
            "geometries": [geometry.model_dump() for geometry in geometries],
            "standard_error": standard_error,
            "samples": sight_lines,
            "seed": self._seed,
        }
        return self._put(message, lambda reply: _prediction(tuple(indices), reply))

    def uncertainty(self, geometries: Sequence[Geometry]) -> Future[KnownUncertainty]:
        """Ask what the inputs add to the uncertainty of these points; returns at once.

        The twin of the process must be able to tell (:class:`twin.input_uncertainty.UncertainTwin`). The result holds a
        :class:`KnownUncertainty` or raises as that of :meth:`predict`.
        """
        message = {"id": next(self._numbers), "uncertainty": [geometry.model_dump() for geometry in geometries]}
        return self._put(message, _known_uncertainty)

    def _put(self, message: Json, read: Callable[[Json], Any]) -> Future[Any]:
        request = _Request(message, read)
        with self._lock:
            if self._closed:
                raise WorkerError("the prediction worker is closed")
            self._requests.put(request)
        return request.future

    def close(self) -> None:
        """End the process; what is under way or waiting fails with :class:`WorkerError`."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            if self._process is not None:
                self._process.kill()
        self._requests.put(None)
        self._thread.join()

    def __enter__(self) -> PredictionWorker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _serve(self) -> None:
        while (request := self._requests.get()) is not None:
            if not request.future.set_running_or_notify_cancel():
                continue
            try:
                answer = self._compute(request)
            except (WorkerError, TwinUnusable, InputError) as error:
                request.future.set_exception(error)
            except BaseException as error:
                request.future.set_exception(error)
                raise
            else:
                request.future.set_result(answer)
        if self._process is not None:
            self._process.kill()
            self._process.bury()

    def _compute(self, request: _Request) -> Any:
        process = self._running_process()
        reply = process.ask(request.message, self._timeouts.request_s)
        if "failed" in reply:
            raise Unpredictable(reply["failed"]) if reply["bad_input"] else WorkerError(reply["failed"])
        return request.read(reply)

    def _running_process(self) -> _Process:
        if self._process is not None and self._process.alive:
            return self._process
        if self._process is not None:
            self._process.bury()
        self._await_permission()
        with self._lock:
            if self._closed:
                raise WorkerCrashed("the prediction worker is closed")
            try:
                self._process = process = _Process()
            except OSError as error:  # no memory, no process, no file descriptor left: perhaps only for now
                raise WorkerCrashed(f"the ray tracing process cannot be started: {error.strerror}") from error
        reply = process.ask({"open": self._settings}, self._timeouts.start_s)
        if "failed" in reply:
            process.kill()
            process.bury()
            raise InputError(reply["failed"]) if reply["bad_input"] else TwinUnusable(reply["failed"])
        return process

    def _await_permission(self) -> None:
        now = time.monotonic()
        while self._starts and now - self._starts[0] > self._restarts.window_s:
            self._starts.popleft()
        if len(self._starts) >= self._restarts.starts:
            wait = self._starts[0] + self._restarts.window_s - now
            text = f"the ray tracing process was started {len(self._starts)} times in {self._restarts.window_s:g} s"
            raise WorkerUnavailable(text, wait)
        self._starts.append(now)


def _prediction(indices: tuple[int, ...], reply: Json) -> Prediction:
    brf, u_brf, u_monte_carlo = (tuple(reply[name]) for name in ("brf", "u_brf", "u_brf_monte_carlo"))
    return Prediction(indices, brf, u_brf, u_monte_carlo, reply["attributes"])


def _known_uncertainty(reply: Json) -> KnownUncertainty:
    return KnownUncertainty(tuple(reply["u_brf_inputs"]), reply["contains"], tuple(reply["notes"]))


class _Process:
    """One life of the process."""

    def __init__(self) -> None:
        self._popen = subprocess.Popen(
            [sys.executable, "-P", "-m", "twin.worker_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Ctrl-C in the terminal must not reach it. A new session would keep that away too, but Linux gives each
            # session an equal share of the processor and so would undo the nice level.
            process_group=0,
        )
        self._last_words: deque[str] = deque(maxlen=20)
        self._listener = threading.Thread(target=self._listen, name="twin worker's errors", daemon=True)
        self._listener.start()

    @property
    def pid(self) -> int:
        return self._popen.pid

    @property
    def alive(self) -> bool:
        return self._popen.poll() is None

    def ask(self, message: Json, timeout_s: float) -> Json:
        """Send a message and wait for its reply; a process that does not answer in time is killed."""
        assert self._popen.stdin is not None
        assert self._popen.stdout is not None
        with self._deadline(timeout_s) as expired:
            line = b""
            # A broken pipe is a crash like a missing reply: both are told below, with the process's last words.
            with contextlib.suppress(BrokenPipeError):
                self._popen.stdin.write(json.dumps(message).encode() + b"\n")
                self._popen.stdin.flush()
                line = self._popen.stdout.readline()
        if expired.is_set():
            self._popen.wait()
            raise WorkerCrashed(f"the ray tracing process did not answer within {timeout_s:g} s and was ended")
        if not line.endswith(b"\n"):
            raise WorkerCrashed(self._obituary())
        reply: Json = json.loads(line)
        if reply.get("id") != message.get("id"):
            self.kill()
            self._popen.wait()
            raise WorkerCrashed(f"the ray tracing process answered request {reply.get('id')}, not {message.get('id')}")
        return reply

    def kill(self) -> None:
        self._popen.kill()

    def bury(self) -> None:
        """Wait for the end of a killed or crashed process and close its pipes."""
        self._popen.wait()
        self._listener.join()
        for pipe in (self._popen.stdin, self._popen.stdout, self._popen.stderr):
            if pipe is not None:
                # What was not yet written when the process ended can no longer be delivered.
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()

    def _obituary(self) -> str:
        self._popen.kill()
        status = self._popen.wait()
        self._listener.join(timeout=5.0)
        how = f"by signal {-status}" if status < 0 else f"with status {status}"
        words = next((line for line in reversed(self._last_words) if line.strip()), "")
        return f"the ray tracing process ended {how}" + (f": {words.strip()}" if words else "")

    def _listen(self) -> None:
        assert self._popen.stderr is not None
        for line in self._popen.stderr:
            self._last_words.append(line.decode(errors="replace"))

    @contextlib.contextmanager
    def _deadline(self, seconds: float) -> Iterator[threading.Event]:
        expired = threading.Event()

        def end() -> None:
            expired.set()
            self._popen.kill()

        timer = threading.Timer(seconds, end)
        timer.daemon = True
        timer.start()
        try:
            yield expired
        finally:
            timer.cancel()


def default_threads() -> int:
    """All cores of this process; where there are more than two, one is left to the scan."""
    from twin.llvm import usable_cores

    cores = usable_cores()
    return cores - 1 if cores > 2 else cores
