"""How events travel from the engine to whoever listens, without the engine ever waiting.

Every listener has a thread and a queue of its own: a slow one lags, a failing one is detached and reported,
and the scan notices neither. The history is kept, so that a listener that comes late sees everything from
the beginning; of a very long scan it sees the beginning and the last part, and is told so.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from typing import TypeVar

from instrument.events import AxesRead, Event, Message, ScanStarted

log = logging.getLogger(__name__)
Handler = Callable[[Event], None]
E = TypeVar("E")
#: Events kept for listeners that come late, some 2 kB each: a night's scan is whole, and memory bounded.
KEPT = 20_000


class Subscription:
    """One listener: its thread, its queue, and how it is doing.

    Attributes
    ----------
    name
        Names the listener in messages.
    failure
        What its handler raised; None while all is well. A failed listener receives nothing more.
    """

    def __init__(self, name: str, handler: Handler, failed: Callable[[Subscription], None]) -> None:
        self.name = name
        self.failure: Exception | None = None
        self._handler, self._failed = handler, failed
        self._queue: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._given = self._taken = 0
        self._progress = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"listener {name}", daemon=True)
        self._thread.start()

    def put(self, event: Event) -> None:
        """Hand over an event; returns at once."""
        with self._progress:
            if self._closed or self.failure is not None:
                return
            self._given += 1
        self._queue.put(event)

    def drain(self, timeout: float) -> bool:
        """Wait (wall-clock seconds) until all events given so far are handled; False where that took too long."""
        with self._progress:
            goal = self._given
            return self._progress.wait_for(lambda: self._taken >= goal or self.failure is not None, timeout)

    def close(self, timeout: float = 10.0) -> bool:
        """Handle what is queued, then end the thread; False where the handler did not return in time."""
        with self._progress:
            self._closed = True
        self._queue.put(None)
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (event := self._queue.get()) is not None:
            try:
                self._handler(event)
            except Exception as error:
                with self._progress:
                    self.failure = error
                    self._progress.notify_all()
                log.exception("listener %s failed at %s", self.name, event.kind)
                self._failed(self)
                return
            with self._progress:
                self._taken += 1
                self._progress.notify_all()


class EventBus:
    """Publishes events to every listener, in one order that all of them see.

    Parameters
    ----------
    now
        Time (UTC) for messages that are not the engine's.
    kept
        How many events the history holds, beside the last start of a scan.
    """

    def __init__(self, now: Callable[[], datetime] = lambda: datetime.now(UTC), kept: int = KEPT) -> None:
        self.now = now
        self._lock = threading.RLock()
        self._history: deque[Event] = deque(maxlen=kept)
        self._published = 0
        self._started: ScanStarted | None = None
        self._subscriptions: list[Subscription] = []

    def publish(self, event: Event) -> None:
        """Hand an event to every listener; from any thread, returns at once."""
        with self._lock:
            if not isinstance(event, AxesRead):  # tomorrow nobody asks on what way an arm came
                self._history.append(event)
                self._published += 1
            if isinstance(event, ScanStarted):
                self._started = event
            for subscription in self._subscriptions:
                subscription.put(event)

    def subscribe(self, handler: Handler, name: str = "listener", *, replay: bool = True) -> Subscription:
        """Call ``handler`` with every event, on a thread of its own.

        Parameters
        ----------
        handler
            What it raises detaches it and becomes an ``error`` message on the bus.
        name
            Names the listener in that message.
        replay
            Whether it first receives everything published so far.
        """
        subscription = Subscription(name, handler, self._detach)
        with self._lock:
            if replay:
                for event in self._replay():
                    subscription.put(event)
            self._subscriptions.append(subscription)
        return subscription

    def unsubscribe(self, subscription: Subscription, timeout: float = 10.0) -> bool:
        """Stop a listener after what is queued for it; False where it did not end in time."""
        with self._lock:
            if subscription in self._subscriptions:
                self._subscriptions.remove(subscription)
        return subscription.close(timeout)

    @property
    def history(self) -> tuple[Event, ...]:
        """What was published so far, oldest first, as far as it is kept."""
        with self._lock:
            return tuple(self._history)

    def _replay(self) -> list[Event]:
        """What a listener that comes late is given."""
        lost = self._published - len(self._history)
        if not lost:
            return list(self._history)
        left_out = Message(
            time=self.now(),
            level="info",
            text=f"{lost} earlier events are left out here",
            advice="the journal of the run holds every reading",
        )
        beginning = [self._started] if self._started is not None and self._started not in self._history else []
        return [*beginning, left_out, *self._history]

    def latest(self, kind: type[E]) -> E | None:
        """The last event of a class, or None."""
        with self._lock:
            found = next((event for event in reversed(self._history) if isinstance(event, kind)), None)
            return self._started if found is None and isinstance(self._started, kind) else found

    def drain(self, timeout: float = 10.0) -> bool:
        """Wait (wall-clock seconds) until all listeners have handled all events; False where one is behind."""
        deadline = time.monotonic() + timeout
        while True:
            with self._lock:
                count, subscriptions = self._published, tuple(self._subscriptions)
            for subscription in subscriptions:
                if not subscription.drain(max(deadline - time.monotonic(), 0.0)):
                    return False
            with self._lock:
                if self._published == count:
                    return True

    def close(self, timeout: float = 10.0) -> tuple[str, ...]:
        """End every listener; names those whose handler did not return in time."""
        with self._lock:
            subscriptions, self._subscriptions = tuple(self._subscriptions), []
        deadline = time.monotonic() + timeout
        return tuple(s.name for s in subscriptions if not s.close(max(deadline - time.monotonic(), 0.0)))

    def _detach(self, subscription: Subscription) -> None:
        with self._lock:
            if subscription in self._subscriptions:
                self._subscriptions.remove(subscription)
        self.publish(
            Message(
                time=self.now(),
                level="error",
                text=f"{subscription.name} failed and no longer follows the scan:"
                f" {type(subscription.failure).__name__}: {subscription.failure}",
                advice="the scan goes on without it; what it adds can be computed from the run folder afterwards",
            )
        )
