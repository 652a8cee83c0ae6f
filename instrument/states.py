"""The states of a scan and the only ways between them, as one table.

Every change is recorded (durably, in the journal) before it is announced, and announced before anything that
belongs to the new state happens. A change that the table does not name is a fault of the program and raises.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from enum import StrEnum


class State(StrEnum):
    """What a scan is doing."""

    IDLE = "idle"
    CONNECTING = "connecting"  # opening the wires, asking every device who it is
    PREFLIGHT = "preflight"  # the whole plan against limits and cone; interlocks; nothing has moved
    HOMING = "homing"
    MOUNTING = "mounting"  # hands at the stage: emission off, shutter closed, arms at rest
    REFERENCING = "referencing"
    MOVING = "moving"
    MEASURING = "measuring"
    PAUSING = "pausing"  # coming to rest because a person asked
    PAUSED = "paused"
    SUSPENDED = "suspended"  # at rest because the laboratory cannot measure now (interlock open, cable out ...)
    FINISHING = "finishing"
    FINISHED = "finished"
    ABORTING = "aborting"  # an orderly end before the last point
    ABORTED = "aborted"
    HALTED = "halted"  # stopped at once, nothing tidied beyond the safe state
    FAULTING = "faulting"  # bringing the laboratory into its safe state after a fault
    FAULTED = "faulted"


S = State
#: From which state to which. Working states can also end early: see :data:`EARLY_ENDS`.
_WORK: dict[State, set[State]] = {
    S.IDLE: {S.CONNECTING, S.FINISHING},  # to finishing: a resumed run that lacks nothing
    S.CONNECTING: {S.PREFLIGHT},
    S.PREFLIGHT: {S.HOMING},
    S.HOMING: {S.MOUNTING, S.PAUSING, S.SUSPENDED},
    S.MOUNTING: {S.MOUNTING, S.REFERENCING, S.MOVING, S.PAUSING, S.SUSPENDED},
    S.REFERENCING: {S.REFERENCING, S.MOUNTING, S.PAUSING, S.SUSPENDED, S.FINISHING},
    # To mounting: the reference is repeated on schedule, or hands turn the sample.
    S.MOVING: {S.MEASURING, S.MOVING, S.MOUNTING, S.PAUSING, S.SUSPENDED, S.FINISHING},
    S.MEASURING: {S.MOVING, S.MOUNTING, S.PAUSING, S.SUSPENDED, S.FINISHING},
    S.PAUSING: {S.PAUSED, S.SUSPENDED},
    S.PAUSED: {S.HOMING, S.MOUNTING, S.REFERENCING, S.MOVING, S.SUSPENDED},
    S.SUSPENDED: {S.HOMING, S.MOUNTING, S.REFERENCING, S.MOVING, S.PAUSING, S.SUSPENDED},
    S.FINISHING: {S.FINISHED},
    S.ABORTING: {S.ABORTED},
    S.FAULTING: {S.FAULTED},
    S.FINISHED: set(),
    S.ABORTED: set(),
    S.HALTED: set(),
    S.FAULTED: set(),
}
#: Where a scan can rest for good.
FINAL = frozenset({S.FINISHED, S.ABORTED, S.HALTED, S.FAULTED})
#: Ways out of every state that is not final: an orderly end, a stop at once, a fault.
EARLY_ENDS = frozenset({S.ABORTING, S.HALTED, S.FAULTING})
_ENDING = frozenset({S.ABORTING, S.FAULTING})
#: The whole table: legal successors of every state.
TRANSITIONS: dict[State, frozenset[State]] = {
    state: frozenset(
        targets
        if state in FINAL
        else targets | {S.HALTED, S.FAULTING} - {state}
        if state in _ENDING
        else targets | EARLY_ENDS
    )
    for state, targets in _WORK.items()
}


class IllegalTransition(RuntimeError):
    """A change of state that the table does not allow."""

    def __init__(self, old: State, new: State) -> None:
        self.old, self.new = old, new
        allowed = ", ".join(sorted(TRANSITIONS[old])) or "nothing: it is final"
        super().__init__(f"no way from state {old} to {new}; allowed: {allowed}")


Watcher = Callable[[State, State, str], None]


class StateMachine:
    """Holds the state of one scan.

    Parameters
    ----------
    *watchers
        Called in order with (old, new, reason) for every change, before it takes effect: the journal first.
        When one raises, the state stays as it was.
    """

    def __init__(self, *watchers: Watcher) -> None:
        self._watchers = watchers
        self._state = S.IDLE
        self._lock = threading.RLock()

    @property
    def state(self) -> State:
        """The state now."""
        return self._state

    @property
    def ended(self) -> bool:
        """True in a final state."""
        return self._state in FINAL

    def to(self, new: State, reason: str = "") -> None:
        """Go to a state.

        Raises
        ------
        IllegalTransition
            If the table has no such way; nothing is recorded then.
        """
        with self._lock:
            old = self._state
            if new not in TRANSITIONS[old]:
                raise IllegalTransition(old, new)
            for watcher in self._watchers:
                watcher(old, new, reason)
            self._state = new
