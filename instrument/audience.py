"""The observers of a scan, found by their entry points; none of them can delay or end it."""

from __future__ import annotations

import logging
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from instrument.bus import EventBus, Subscription
from instrument.events import Message
from instrument.observers import Observer, ObserverFactory

log = logging.getLogger(__name__)
GROUP = "goniotwin.observers"
#: Wall-clock seconds that an observer may lag behind the end of a scan.
_PATIENCE_WALL = 600.0


def check_inputs(facility: Path | None, artifact: Path | None, material: Path | None) -> None:
    """Let every observer that cares read the files it will need, before anything starts.

    Raises
    ------
    InputError
        From an observer that could not use a file.
    """
    for point in _registered():
        try:
            check = getattr(point.load(), "check", None)
        except Exception:
            log.debug("observer %s cannot be loaded", point.name, exc_info=True)
            continue  # said when it takes its seat
        if check is not None:
            check(facility, artifact, material)


def _registered() -> list[EntryPoint]:
    return sorted(entry_points(group=GROUP), key=lambda point: point.name)


class Audience:
    """Loads observers, lets them watch, and lets them finish.

    Parameters
    ----------
    bus
        What they watch.
    points
        Entry points to load; those of the group ``goniotwin.observers`` by default.
    """

    def __init__(self, bus: EventBus, points: list[EntryPoint] | None = None) -> None:
        self._bus = bus
        self._seats: list[tuple[str, Observer, Subscription]] = []
        for point in _registered() if points is None else points:
            self._seat(point)

    @property
    def seated(self) -> int:
        """How many observers watch."""
        return len(self._seats)

    def _seat(self, point: EntryPoint) -> None:
        try:
            factory: ObserverFactory = point.load()
            observer = factory(self._bus.publish)
        except Exception as error:
            log.debug("observer %s cannot watch", point.name, exc_info=True)
            self._complain(f"{point.name} cannot watch this scan: {type(error).__name__}: {error}")
            return
        if observer is not None:
            subscription = self._bus.subscribe(observer.on_event, point.name)
            self._seats.append((point.name, observer, subscription))

    def finish(self, run_dir: Path) -> list[Any]:
        """After the end of the scan: what every observer wants printed. A failed one is reported and left out."""
        printed: list[Any] = []
        for name, observer, subscription in self._seats:
            if not subscription.drain(_PATIENCE_WALL):
                self._complain(f"{name} is still busy {_PATIENCE_WALL:.0f} s after the end and is left out")
                continue
            if subscription.failure is not None:
                continue
            try:
                printed += observer.finish(run_dir)
            except Exception as error:
                log.debug("observer %s cannot finish", name, exc_info=True)
                self._complain(f"{name} could not finish: {type(error).__name__}: {error}")
        return printed

    def close(self) -> None:
        """Let every observer go. May be repeated."""
        while self._seats:
            name, observer, subscription = self._seats.pop()
            # What is queued for it is not waited for: closing is how an observer learns that it is over.
            self._bus.unsubscribe(subscription, timeout=0.0)
            try:
                observer.close()
            except Exception as error:
                log.debug("observer %s cannot close", name, exc_info=True)
                self._complain(f"{name} could not release what it holds: {type(error).__name__}: {error}")

    def _complain(self, text: str) -> None:
        self._bus.publish(
            Message(
                time=self._bus.now(),
                level="error",
                text=text,
                advice="the run is complete without it; what it adds can be computed from the run folder",
            )
        )
