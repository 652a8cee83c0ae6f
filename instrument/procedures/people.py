"""Who answers the prompts of a procedure: a person at the terminal, or a program that shows them to one.

A program in between sets the variable :data:`VARIABLE` to ``json``. Each prompt is then one line on standard output,
``{"prompt": {...}}`` with the fields of :class:`instrument.prompts.Prompt`, and its answer one line on standard input:
``{"answer": VALUE}`` (null for a confirmation) or ``{"give_up": true}``.
"""

from __future__ import annotations

import json
import os

from rich.console import Console

from instrument.operators import Mounted
from instrument.prompts import Guide, Prompt
from instrument.scan_run import Keyboard, TerminalOperator

VARIABLE = "GONIOTWIN_PROMPTS"
_POLL_WALL = 0.1


class LineOperator:
    """Prompts and answers as lines of JSON."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard
        self.dismissed = False

    def reply(self, prompt: Prompt) -> float | str | None:
        """Send a prompt and wait for its answer; a wrong one is asked for again.

        Raises
        ------
        KeyboardInterrupt
            When the person gives up, nobody can answer any more, or the operator was dismissed.
        """
        while True:
            print(json.dumps({"prompt": prompt.model_dump(mode="json")}), flush=True)
            value = self._answer()
            if prompt.kind == "confirm":
                return None
            if isinstance(value, int) and not isinstance(value, bool):
                value = float(value)
            if not (objection := prompt.objection(value)):
                return value
            print(f"found {value!r}; {objection}", flush=True)

    def _answer(self) -> float | str | None:
        while not self.dismissed:
            try:
                line = self._keyboard.line(_POLL_WALL)
            except EOFError:
                break
            if line is None:
                continue
            try:
                said = json.loads(line)
            except ValueError:
                said = None
            if isinstance(said, dict) and "answer" in said:
                answer: float | str | None = said["answer"]
                return answer
            if isinstance(said, dict) and said.get("give_up"):
                break
            print(f"found {line!r}; expected an answer as a line of JSON", flush=True)
        raise KeyboardInterrupt


class Rehearsal:
    """A person is asked everything; then the hands of the simulated laboratory do it."""

    def __init__(self, person: Guide, hands: object) -> None:
        self._person, self._hands = person, hands

    def mount(self, what: Mounted) -> None:
        """Put the reference or the sample on the stage."""
        self.reply(Prompt(key=f"mount:{what}", title=f"Put the {what} on the stage"))

    def reply(self, prompt: Prompt) -> float | str | None:
        """The person's answer, after the hands have done what the prompt says."""
        value = self._person.reply(prompt)
        if isinstance(self._hands, Guide):
            self._hands.reply(prompt)
        return value


def person_in_charge(console: Console) -> TerminalOperator | LineOperator:
    """Who answers in this process."""
    if os.environ.get(VARIABLE) == "json":
        return LineOperator(Keyboard())
    return TerminalOperator(Keyboard(), console)
