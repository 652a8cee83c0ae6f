"""What a person is asked: one form for the terminal, the window and the simulated laboratory.

A prompt says what to do and what kind of answer it wants; the answer is recorded with its time and its author. Whoever
asks never blocks the engine: :func:`attend` waits on a thread of its own, and an abort is obeyed meanwhile.
"""

from __future__ import annotations

import getpass
from datetime import UTC, datetime
from typing import Literal, Protocol, runtime_checkable

from instrument.control import Controls
from instrument.forms import Form
from instrument.hands import HandsFailed, while_listening


class Prompt(Form):
    """One step for a person.

    Attributes
    ----------
    key
        What it is about, for programs: ``start-source``, ``mount:reference``, ``align:level``.
    title, text
        A few words, and what to do.
    kind
        ``confirm`` wants a yes; ``number`` a value in ``unit``; ``choice`` one of ``choices``.
    lower, upper
        Between which a number makes sense.
    """

    key: str
    title: str
    text: str = ""
    kind: Literal["confirm", "number", "choice"] = "confirm"
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    choices: tuple[str, ...] = ()

    def objection(self, value: float | str | None) -> str:
        """Why a value is no answer; empty where it is one."""
        if self.kind == "confirm":
            return ""
        if self.kind == "choice":
            return "" if value in self.choices else f"expected one of: {', '.join(self.choices)}"
        if not isinstance(value, float):
            return f"expected a number in {self.unit}" if self.unit else "expected a number"
        if (self.lower is not None and value < self.lower) or (self.upper is not None and value > self.upper):
            low = "-inf" if self.lower is None else f"{self.lower:g}"
            high = "inf" if self.upper is None else f"{self.upper:g}"
            return f"expected {low} to {high} {self.unit}".rstrip()
        return ""


class Answer(Form):
    """What a person said to a prompt; ``who`` the account under which the program runs, or a given name."""

    key: str
    title: str = ""
    time: datetime
    who: str = ""
    value: float | str | None = None
    unit: str = ""
    note: str = ""


@runtime_checkable
class Guide(Protocol):
    """An operator who can answer more than "the sample is on the stage"."""

    def reply(self, prompt: Prompt) -> float | str | None:
        """Answer a prompt; returns when it is done, with the value where one is wanted.

        Raises
        ------
        KeyboardInterrupt
            When the person gives up.
        """
        ...


class PromptFailed(RuntimeError):
    """Nobody could be asked."""


def account() -> str:
    """Name of the account that runs the program; empty where there is none."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ""


def attend(
    operator: object, prompt: Prompt, controls: Controls, *, now: datetime | None = None, who: str | None = None
) -> Answer:
    """Ask an operator and wait; an abort or a halt is obeyed meanwhile.

    Raises
    ------
    PromptFailed
        If this operator answers no prompts, or failed.
    Interruption
        If the work is interrupted meanwhile, or the person gives up.
    """
    if not isinstance(operator, Guide):
        raise PromptFailed(f"{prompt.title}: nobody is there to answer; run it from a terminal")
    guide: Guide = operator
    try:
        value = while_listening(
            lambda: guide.reply(prompt), controls, name=f"prompt {prompt.key}", given_up=f"given up at: {prompt.title}"
        )
    except HandsFailed as failure:
        raise PromptFailed(f"{prompt.title}: {failure}") from failure.__cause__
    if objection := prompt.objection(value):
        raise PromptFailed(f"{prompt.title}: found {value!r}; {objection}")
    return Answer(
        key=prompt.key,
        title=prompt.title,
        time=now or datetime.now(UTC),
        who=account() if who is None else who,
        value=value,
        unit=prompt.unit,
    )


#: What has to be so before a class-4 source emits (IEC 60825-1: the person in charge of the laser area).
START_SOURCE = Prompt(
    key="start-source",
    title="Start the class-4 source",
    text=(
        "The source is about to emit. Make sure that everyone in the room wears eyewear for its wavelengths, that the"
        " doors are closed and the warning light is on, that nothing shiny is in the beam, and that the key is yours."
    ),
)
