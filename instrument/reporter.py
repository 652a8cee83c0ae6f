"""The engine's voice: every change of state, note and result goes first to the journal, then to the bus."""

from __future__ import annotations

import logging
from datetime import datetime
from typing import Any, Literal

from drivers.clock import Clock
from instrument.bus import EventBus
from instrument.events import AxesRead, Event, Message, StateChanged
from instrument.journal import Journal
from instrument.states import State, StateMachine

log = logging.getLogger(__name__)


class Reporter:
    """Journal, bus and state of one scan."""

    def __init__(self, clock: Clock, journal: Journal, bus: EventBus) -> None:
        self._clock, self._journal, self._bus = clock, journal, bus
        self._machine = StateMachine(self._journal_state, self._announce_state)

    @property
    def state(self) -> State:
        """What the scan is doing."""
        return self._machine.state

    def now(self) -> datetime:
        """Laboratory time, UTC."""
        return self._clock.now()

    def to(self, state: State, reason: str = "") -> None:
        """Change the state: recorded, then announced, then in force."""
        self._machine.to(state, reason)

    def record(self, kind: str, **payload: Any) -> None:
        """Write to the journal; on the disk when this returns."""
        self._journal.record(kind, **payload)

    def publish(self, event: Event) -> None:
        """Tell every listener."""
        self._bus.publish(event)

    def note(self, text: str) -> None:
        """Something that may be looked up later."""
        self.record("note", text=text)

    def decision(self, text: str) -> None:
        """Something that is recorded, and that a person should see."""
        self.note(text)
        self.tell("warning", text)

    def tell(self, level: Literal["info", "warning", "error"], text: str, advice: str = "") -> None:
        """Something that a person should see."""
        self.publish(Message(time=self.now(), level=level, text=text, advice=advice))

    def stands(self, positions: dict[str, float]) -> None:
        """Where the axes stand, degree; for whoever watches, and not recorded."""
        self.publish(AxesRead(time=self.now(), positions=positions))

    def close(self) -> None:
        """The journal is complete."""
        self._journal.close()

    def _journal_state(self, old: State, new: State, reason: str) -> None:
        log.info("%s -> %s %s", old, new, reason)
        self.record("state", time=self.now(), old=str(old), new=str(new), reason=reason)

    def _announce_state(self, old: State, new: State, reason: str) -> None:
        self.publish(StateChanged(time=self.now(), old=str(old), new=str(new), reason=reason))
