"""One scan from request to result: what the command line, the window and the tests all use.

A session starts the simulated laboratory where one is asked for, makes the run folder, takes the lock on the
instrument, brings in the observers and builds the engine. It drives nothing itself: the engine does.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from instrument.bus import EventBus, Subscription
from instrument.events import Event, ScanEnded
from instrument.operators import Operator
from instrument.plan import Plan
from instrument.settings import ScanSettings
from instrument.states import State


class ScanRequest(BaseModel):
    """What a person asks for.

    Attributes
    ----------
    plan, facility, artifact, material
        Files; with ``simulate`` the laboratory's own examples stand in for what is not given. Without it plan and
        facility are needed; artifact and material serve the twin.
    simulate, speed, seed
        Start the simulated laboratory, with a clock so many times faster, and its seed.
    devices
        ``devices.toml`` of a laboratory; excludes ``simulate``.
    out
        The run folder; ``runs/<UTC time>-<plan>`` by default. Must not hold a run already.
    twin
        False leaves out every observer.
    resume
        Run folder of an interrupted scan: go on with it. Excludes plan, facility, artifact, material and out.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    plan: Path | None = None
    simulate: bool = False
    speed: float = Field(default=1.0, gt=0)
    seed: int = 1
    devices: Path | None = None
    facility: Path | None = None
    artifact: Path | None = None
    material: Path | None = None
    out: Path | None = None
    twin: bool = True
    resume: Path | None = None


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
    """

    bus: EventBus
    run_dir: Path
    plan: Plan

    def __init__(
        self, request: ScanRequest, operator: Operator | None = None, settings: ScanSettings | None = None
    ) -> None:
        raise NotImplementedError

    def subscribe(self, handler: Callable[[Event], None], name: str = "listener") -> Subscription:
        """Call ``handler`` with every event from the first on, on a thread of its own."""
        raise NotImplementedError

    def open(self) -> None:
        """Read and check every file, start the laboratory, make the run folder, take the lock; nothing moves.

        Raises
        ------
        InputError, ConfigurationError
            If a file or the request is wrong.
        InstrumentBusy
            If another program drives this instrument.
        """
        raise NotImplementedError

    @property
    def state(self) -> State:
        """What the scan is doing."""
        raise NotImplementedError

    def start(self) -> None:
        """Begin: the engine connects, checks, and scans on a thread of its own."""
        raise NotImplementedError

    def pause(self, *, now: bool = False) -> None:
        """Rest after the point at hand, or at once (the point is then repeated)."""
        raise NotImplementedError

    def resume(self) -> None:
        """Go on after a pause or a suspension."""
        raise NotImplementedError

    def abort(self, reason: str = "asked by a person") -> None:
        """End in an orderly way; what is measured is kept and the run can be resumed."""
        raise NotImplementedError

    def halt(self, reason: str = "asked by a person") -> None:
        """Stop everything at once."""
        raise NotImplementedError

    def wait(self, timeout: float | None = None) -> ScanEnded | None:
        """Wait (wall-clock seconds) for the end; None where it has not come."""
        raise NotImplementedError

    @property
    def error(self) -> BaseException | None:
        """What ended the scan early, if anything did."""
        raise NotImplementedError

    def finish(self) -> list[Any]:
        """After the end: let every observer finish; returns what they want printed (rich renderables)."""
        raise NotImplementedError

    def close(self) -> None:
        """Abort if still running, then release devices, lock, observers and laboratory. May be repeated."""
        raise NotImplementedError

    def __enter__(self) -> ScanSession:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
