"""How a window starts and steers a scan. What it sees of the scan comes back as events only.

Every method of a :class:`Controller` returns at once: starting processes, connecting devices and stopping arms happen
on threads of their own.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol

from drivers.errors import ConfigurationError, DeviceError
from gui.notices import ControllerClosed, ControllerFailed, ControllerStarting, Notice, OperatorAnswered, OperatorAsked
from instrument.errors import InputError, SafetyError
from instrument.events import Event, Message
from instrument.operators import Mounted
from instrument.prompts import Prompt

if TYPE_CHECKING:
    from instrument.session import ScanRequest, ScanSession


class Listener(Protocol):
    """Where events and notices go; may be called from any thread."""

    def on_event(self, event: Event | Notice) -> None:
        """Take an event; returns at once."""
        ...


class Controller(Protocol):
    """Steers one scan at a time.

    Attributes
    ----------
    detached
        Whether the scan goes on when this program ends.
    """

    detached: bool

    def start(self) -> None:
        """Set the session up and run the plan."""
        ...

    def pause(self) -> None:
        """Pause after the point in hand."""
        ...

    def pause_now(self) -> None:
        """Pause at once; the point in hand is repeated."""
        ...

    def resume(self) -> None:
        """Go on after a pause."""
        ...

    def abort(self) -> None:
        """End in an orderly way: what is measured is kept."""
        ...

    def halt(self) -> None:
        """Emergency: stop the arms and block the light now."""
        ...

    def answer(self, done: bool, value: float | str | None = None) -> None:
        """Answer the engine's request to the operator; False gives up and ends the scan.

        Parameters
        ----------
        value
            The number or the choice that a prompt asks for.
        """
        ...


class WindowOperator:
    """The operator who sits at the window: waits on the engine's thread until the window brings the answer."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._answered = threading.Event()
        self._done = False
        self._value: float | str | None = None
        self._gone = False

    def mount(self, what: Mounted) -> None:
        """Ask the window and wait; raises KeyboardInterrupt when the person gives up."""
        self._ask(what)

    def reply(self, prompt: Prompt) -> float | str | None:
        """Show a step and wait until it is done; an answer that makes no sense is asked for again.

        Raises
        ------
        KeyboardInterrupt
            When the person gives up.
        """
        while True:
            value = self._ask(prompt)
            if not prompt.objection(value):
                return value

    def _ask(self, what: Mounted | Prompt) -> float | str | None:
        self._answered.clear()
        if self._gone:
            raise KeyboardInterrupt
        self._listener.on_event(OperatorAsked(what))
        self._answered.wait()
        self._listener.on_event(OperatorAnswered())
        if not self._done:
            raise KeyboardInterrupt
        return self._value

    def answer(self, done: bool, value: float | str | None = None) -> None:
        """The person's answer; from any thread."""
        self._done, self._value = done, value
        self._answered.set()

    def leave(self) -> None:
        """Nobody will answer any more: a question that is open, and every later one, counts as given up."""
        self._gone = True
        self.answer(False)


class SessionController:
    """Runs scan sessions of :mod:`instrument.session`, one at a time.

    Parameters
    ----------
    request
        What every start asks for.
    listener
        Receives the engine's events and this controller's notices.
    make_session
        Builds a session; :class:`instrument.session.ScanSession` where it is not given.
    make_operator
        Makes who answers the engine's requests where no simulated laboratory does.
    """

    detached = False

    def __init__(
        self,
        request: ScanRequest,
        listener: Listener,
        make_session: Callable[[ScanRequest, WindowOperator | None], ScanSession] | None = None,
        make_operator: Callable[[Listener], WindowOperator] | None = None,
    ) -> None:
        self.request = request
        self._listener = listener
        self._make_session = make_session or _session
        self._make_operator = make_operator or WindowOperator
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._session: ScanSession | None = None
        self._started = False
        self._given_up = False
        self._operator = self._make_operator(listener)

    def start(self) -> None:
        """Set the session up and run the plan; does nothing while a session is there."""
        with self._lock:
            if self._thread is not None:
                return
            self._started = self._given_up = False
            self._operator = self._make_operator(self._listener)
            self._thread = threading.Thread(target=self._run, name="scan session", daemon=True)
            self._listener.on_event(ControllerStarting())
            self._thread.start()

    def pause(self, *, now: bool = False) -> None:
        """Pause after the point in hand, or at once."""
        self._ask(lambda session: session.pause(now=now))

    def pause_now(self) -> None:
        """Pause at once; the point in hand is repeated."""
        self.pause(now=True)

    def resume(self) -> None:
        """Go on after a pause."""
        self._ask(lambda session: session.resume())

    def abort(self) -> None:
        """End in an orderly way; a session that is still being set up does not start."""
        self._given_up = True
        self._operator.leave()
        self._ask(lambda session: session.abort("asked for in the window"))

    def halt(self) -> None:
        """Stop the arms and block the light now."""
        self._given_up = True
        self._operator.leave()
        self._ask(lambda session: session.halt("asked for in the window"))

    def answer(self, done: bool, value: float | str | None = None) -> None:
        """Answer the engine's request to the operator."""
        self._operator.answer(done, value)

    def join(self, timeout: float | None = None) -> bool:
        """Wait (wall-clock seconds) until everything is released; False where it is not yet."""
        thread = self._thread
        if thread is not None:
            thread.join(timeout)
        return thread is None or not thread.is_alive()

    def _ask(self, command: Callable[[ScanSession], None]) -> None:
        """Give a command on a thread of its own, so that no slow one stands before a halt."""
        threading.Thread(target=self._give, args=(command,), name="scan command", daemon=True).start()

    def _give(self, command: Callable[[ScanSession], None]) -> None:
        with self._lock:
            session = self._session if self._started else None
        if session is None:
            return
        try:
            command(session)
        except Exception as error:  # noqa: BLE001 - whatever went wrong, the person must read it
            text, advice = explain(error)
            self._listener.on_event(Message(time=datetime.now(UTC), level="error", text=text, advice=advice))

    def _run(self) -> None:
        try:
            session = self._make_session(self.request, None if self.request.simulate else self._operator)
            session.subscribe(self._listener.on_event, "window")
            with session:
                with self._lock:
                    self._session = session
                    self._started = not self._given_up
                    if self._started:
                        session.start()
                if self._started:
                    session.wait()
                    session.finish()
        except Exception as error:  # noqa: BLE001 - the thread ends here; the window says what happened
            self._fail(error)
        finally:
            with self._lock:
                self._session, self._thread, self._started = None, None, False
            self._listener.on_event(ControllerClosed())

    def _fail(self, error: Exception) -> None:
        text, advice = explain(error)
        self._listener.on_event(ControllerFailed(datetime.now(UTC), text, advice))


def _session(request: ScanRequest, operator: WindowOperator | None) -> ScanSession:
    from instrument.session import ScanSession

    return ScanSession(request, operator)


def explain(error: Exception) -> tuple[str, str]:
    """What happened and what to do, in words."""
    if isinstance(error, (InputError, ConfigurationError)):
        return str(error), "Correct the file and press Start again; nothing has moved."
    if isinstance(error, DeviceError):
        return f"{error.device}: {error.problem}", error.advice or "Check the device and its cable, then start again."
    if isinstance(error, SafetyError):
        return str(error), "Nothing goes on until the cause is removed."
    return (
        f"{type(error).__name__}: {error}",
        "The program met something it does not know. What is measured is in the run folder; please report this.",
    )
