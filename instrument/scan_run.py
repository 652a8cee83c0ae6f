"""A scan at a terminal: keys, signals, lines on the screen, exit status."""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from rich.console import Console

from drivers.errors import ConfigurationError
from instrument.errors import EXIT_BAD_INPUT, EXIT_DEVICE, EXIT_DONE, EXIT_INCOMPLETE, EXIT_INTERRUPTED, InputError
from instrument.events import ScanEnded
from instrument.operators import Mounted
from instrument.output import check_json, write_json
from instrument.prompts import Prompt
from instrument.request import ScanRequest
from instrument.scan_display import ScanDisplay
from instrument.session import ScanSession
from instrument.settings import ScanSettings
from instrument.states import State

_POLL_WALL = 0.1
#: Ctrl-C, a request to terminate, and a terminal that went away (a lost connection must not strand the laser).
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Keyboard:
    """Lines typed at the terminal, without ever blocking for one."""

    def __init__(self) -> None:
        self._open = sys.stdin is not None and not sys.stdin.closed
        self._buffer = b""

    @property
    def present(self) -> bool:
        """True where a person can type."""
        return self._open and sys.stdin.isatty()

    def line(self, wait: float) -> str | None:
        """The next line, within so many wall-clock seconds; None where there is none.

        Raises
        ------
        EOFError
            If no more will come.
        """
        if b"\n" not in self._buffer and self._open:
            ready, _, _ = select.select([sys.stdin], [], [], wait)
            if ready:
                piece = os.read(sys.stdin.fileno(), 4096)
                self._open = bool(piece)
                self._buffer += piece
        if b"\n" in self._buffer:
            line, _, self._buffer = self._buffer.partition(b"\n")
            return line.decode(errors="replace").strip()
        if not self._open:
            raise EOFError
        return None


class TerminalOperator:
    """A person at the terminal changes the sample and says so.

    Attributes
    ----------
    waiting
        True while a question stands: the answer belongs to it.
    """

    def __init__(self, keyboard: Keyboard, console: Console) -> None:
        self._keyboard, self._console = keyboard, console
        self.waiting = False
        self.dismissed = False

    def mount(self, what: Mounted) -> None:
        """Ask, and wait for Enter.

        Raises
        ------
        KeyboardInterrupt
            If the answer is ``q``, or nobody can answer.
        """
        self._console.print(f"[bold]Put the {what} on the stage[/], then press Enter (q gives up).")
        self._line("nobody can say that the sample is in place")

    def reply(self, prompt: Prompt) -> float | str | None:
        """Show a prompt and wait for its answer; a wrong one is asked for again.

        Raises
        ------
        KeyboardInterrupt
            If the answer is ``q``, nobody can answer, or the operator was dismissed.
        """
        self._console.print(prompt.title, style="bold", markup=False, soft_wrap=True)
        if prompt.text:
            self._console.print(f"  {prompt.text}", markup=False, soft_wrap=True)
        wanted = {
            "confirm": "Enter when done",
            "number": f"a number in {prompt.unit}, then Enter" if prompt.unit else "a number, then Enter",
            "choice": f"{' or '.join(prompt.choices)}, then Enter",
        }[prompt.kind]
        while True:
            self._console.print(f"  {wanted} (q gives up).", markup=False)
            word = self._line("nobody can answer")
            if word is None:
                raise KeyboardInterrupt
            value: float | str | None = None if prompt.kind == "confirm" else word
            if prompt.kind == "number":
                with suppress(ValueError):
                    value = float(word.replace(",", "."))
            if not (objection := prompt.objection(value)):
                return value
            self._console.print(f"  found {word!r}; {objection}", markup=False)

    def _line(self, otherwise: str) -> str | None:
        """The next line, None once dismissed; KeyboardInterrupt where a person gives up, or nobody can answer."""
        self.waiting = True
        try:
            while not self.dismissed:
                answer = self._keyboard.line(_POLL_WALL)
                if answer == "q":
                    raise KeyboardInterrupt
                if answer is not None:
                    return answer
            return None
        except EOFError:
            self._console.print(f"Standard input has ended: {otherwise}.")
            raise KeyboardInterrupt from None
        finally:
            self.waiting = False


class Interrupts:
    """Counts Ctrl-C; a request to terminate and the end of the terminal count as one."""

    def __init__(self) -> None:
        self.count = 0

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Count instead of raising ``KeyboardInterrupt``."""
        before = {number: signal.signal(number, self._count) for number in _INTERRUPTS}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def ending(self) -> Iterator[None]:
        """Let a request to terminate end the program by way of its clean-up: nothing temporary stays behind."""
        numbers = (signal.SIGTERM, signal.SIGHUP)
        before = {number: signal.signal(number, self._end) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _count(self, number: int, frame: FrameType | None) -> None:
        self.count += 1

    def _end(self, number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)


def run_scan(request: ScanRequest, report: Path | None = None, settings: ScanSettings | None = None) -> int:
    """Run a scan at the terminal and return the exit status.

    Parameters
    ----------
    request
        What is asked for.
    report
        Where to write how it ended, as JSON.
    settings
        How it is carried out.

    Raises
    ------
    InputError, ConfigurationError, InstrumentBusy
        Before anything moves.
    """
    check_json(report)
    console = Console(highlight=False)
    keyboard, interrupts = Keyboard(), Interrupts()
    by_hand = TerminalOperator(keyboard, console)
    simulated = request.simulate or (request.resume is not None and request.devices is None)
    session = ScanSession(request, operator=None if simulated else by_hand, settings=settings)
    with interrupts.ending(), ScanDisplay(console) as display:
        session.subscribe(display.show, "the terminal")
        with session:
            display.predicted = session.observed
            with interrupts.caught():
                session.start()
                end = _attend(session, by_hand, keyboard, interrupts, console)
            session.bus.drain()
            display.close()
            for printable in session.finish():
                console.print(printable)
            session.bus.drain()
            status = _status(session, end, interrupts.count > 0)
            if report is not None:
                content = end.model_dump(mode="json", exclude={"kind"})
                write_json(report, content | {"run_dir": str(session.run_dir), "exit_status": status})
            _conclude(console, session, end, status)
    return status


def _attend(
    session: ScanSession, operator: TerminalOperator, keyboard: Keyboard, interrupts: Interrupts, console: Console
) -> ScanEnded:
    """Wait for the end, and pass on what the person wants."""
    heard = 0
    try:
        while (end := session.wait(_POLL_WALL)) is None:
            if interrupts.count > heard:
                heard = interrupts.count
                if heard == 1:
                    console.print("Ending in an orderly way; Ctrl-C again stops everything at once.")
                    session.abort("interrupted at the terminal")
                else:
                    session.halt("interrupted twice at the terminal")
            if keyboard.present and not operator.waiting:
                _obey(session, keyboard, console)
        return end
    finally:
        operator.dismissed = True


def _obey(session: ScanSession, keyboard: Keyboard, console: Console) -> None:
    try:
        word = keyboard.line(0.0)
    except EOFError:
        return
    if word is None:
        return
    if session.state in (State.PAUSED, State.SUSPENDED):
        session.resume()
    elif word == "p":
        console.print("Resting after this point; Enter goes on.")
        session.pause()


def _status(session: ScanSession, end: ScanEnded, interrupted: bool) -> int:
    if end.outcome in ("aborted", "halted") or (interrupted and end.outcome != "finished"):
        return EXIT_INTERRUPTED
    if end.outcome == "faulted":
        bad_input = isinstance(session.error, InputError | ConfigurationError)
        return EXIT_BAD_INPUT if bad_input else EXIT_DEVICE
    return EXIT_DONE if end.done == end.total and end.run_file is not None else EXIT_INCOMPLETE


def _conclude(console: Console, session: ScanSession, end: ScanEnded, status: int) -> None:
    console.print(f"{end.done} of {end.total} points measured: {end.outcome}.")
    console.print(f"Run folder: {session.run_dir}", soft_wrap=True)
    if end.done < end.total and status != EXIT_BAD_INPUT:
        console.print(f"To go on with it: goniotwin scan --resume {session.run_dir}", soft_wrap=True)
    if status != EXIT_DONE and end.reason:
        print(f"goniotwin: {end.reason}", file=sys.stderr)
