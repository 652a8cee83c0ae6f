"""A person at the terminal: answers, keys, Ctrl-C."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from collections.abc import Iterator

import pytest
from rich.console import Console

from instrument.scan_run import Interrupts, Keyboard, TerminalOperator


class Typist:
    """Writes to what the program takes for its standard input."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def type(self, text: str) -> None:
        os.write(self._descriptor, text.encode())

    def hang_up(self) -> None:
        os.close(self._descriptor)
        self._descriptor = -1


@pytest.fixture
def typist(monkeypatch: pytest.MonkeyPatch) -> Iterator[Typist]:
    reading, writing = os.pipe()
    with os.fdopen(reading) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        hand = Typist(writing)
        yield hand
        if hand._descriptor >= 0:
            hand.hang_up()


def test_lines_come_one_by_one_and_nothing_blocks(typist: Typist) -> None:
    keyboard = Keyboard()
    assert keyboard.line(0.0) is None
    typist.type("one\ntwo\nthr")
    assert keyboard.line(1.0) == "one"
    assert keyboard.line(0.0) == "two"
    assert keyboard.line(0.0) is None
    typist.type("ee\n")
    assert keyboard.line(1.0) == "three"
    typist.hang_up()
    with pytest.raises(EOFError):
        keyboard.line(1.0)


def test_enter_says_that_the_sample_is_in_place(typist: Typist) -> None:
    screen = io.StringIO()
    operator = TerminalOperator(Keyboard(), Console(file=screen))
    typist.type("\n")
    operator.mount("reference")
    assert "Put the reference on the stage" in screen.getvalue()
    assert not operator.waiting


@pytest.mark.parametrize("end", ["q", "end of input"])
def test_giving_up_is_an_interruption(typist: Typist, end: str) -> None:
    operator = TerminalOperator(Keyboard(), Console(file=io.StringIO()))
    if end == "q":
        typist.type("q\n")
    else:
        typist.hang_up()
    with pytest.raises(KeyboardInterrupt):
        operator.mount("sample")


def test_a_dismissed_operator_stops_waiting(typist: Typist) -> None:
    operator = TerminalOperator(Keyboard(), Console(file=io.StringIO()))
    asking = threading.Thread(target=lambda: operator.mount("sample"), daemon=True)
    asking.start()
    operator.dismissed = True
    asking.join(5.0)
    assert not asking.is_alive()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupts_are_counted_and_the_old_handlers_come_back(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    interrupts = Interrupts()
    with interrupts.caught():
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
    assert 1 <= interrupts.count <= 2
    assert signal.getsignal(number) is before
