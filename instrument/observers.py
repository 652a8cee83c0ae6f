"""Who watches a scan. Observers are found through the entry-point group ``goniotwin.observers``.

An observer runs on a thread of its own, fed through a queue: however slow it is or however it fails, the scan
goes on. A failure is published as a :class:`~instrument.events.Message`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from instrument.events import Event

Publish = Callable[[Event], None]


class Observer(Protocol):
    """Sees every event of a scan, in order."""

    def on_event(self, event: Event) -> None:
        """Called on the observer's own thread for each event, its own annotations included."""
        ...

    def finish(self, run_dir: Path) -> list[Any]:
        """Called once after ``ScanEnded`` and after ``run.nc`` stands; may write files into the run folder.

        Returns
        -------
        list
            Things that rich can print: the observer's summary for the terminal.
        """
        ...

    def close(self) -> None:
        """Release processes and files; called in every case, also after a failure."""
        ...


class ObserverFactory(Protocol):
    """What an entry point of the group names: makes an observer for one scan, or None where it has nothing to do.

    It may have an attribute ``check``, a function of the files (facility, artifact, material) that are given, each a
    path or None. It is called before anything starts and raises :class:`~instrument.errors.InputError` for a file that
    this observer could not use.
    """

    def __call__(self, publish: Publish) -> Observer | None:
        """``publish`` puts an event (an annotation, a message) on the bus; it may be called from any thread."""
        ...
