"""A session of a scan that a test watches, on the simulated laboratory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from instrument.events import Event, PointStarted, ScanEnded, StateChanged
from instrument.session import ScanRequest, ScanSession
from instrument.settings import ScanSettings


class Watched:
    """An open session whose events are kept, and that acts when one comes."""

    def __init__(self, request: ScanRequest, settings: ScanSettings | None = None) -> None:
        self.session = ScanSession(request, settings=settings)
        self.events: list[Event] = []
        self._acts: list[tuple[Callable[[Event], bool], Callable[[], Any]]] = []
        self.session.subscribe(self._see, "test")

    def _see(self, event: Event) -> None:
        self.events.append(event)
        for entry in [entry for entry in self._acts if entry[0](event)]:
            self._acts.remove(entry)
            entry[1]()

    def when_point_starts(self, index: int, act: Callable[[], Any]) -> None:
        self._acts.append((lambda e: isinstance(e, PointStarted) and e.index == index, act))

    def when_state(self, state: str, act: Callable[[], Any]) -> None:
        self._acts.append((lambda e: isinstance(e, StateChanged) and e.new == state, act))

    def control(self, action: str, **arguments: Any) -> Any:
        return self.session.laboratory.control(action, **arguments)  # type: ignore[union-attr]

    def run(self) -> ScanEnded:
        self.session.start()
        end = self.session.wait(90.0)
        assert end is not None, f"hangs in state {self.session.state}"
        assert self.session.bus.drain(10.0)
        return end

    def of(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]


def state_is_safe(watch: Watched, *, watchdog_trips: bool = False) -> bool:
    state = watch.control("state")
    still = not any(axis["moving"] for axis in state["axes"].values())
    assert watchdog_trips or state["watchdog_trips"] == 0
    return still and not state["emission"] and not state["shutter_open"]
