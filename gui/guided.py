"""A procedure led from the window: what it says stands on its page, what it asks in the banner on every page."""

from __future__ import annotations

import json

from PySide6.QtCore import Signal
from PySide6.QtGui import QFontDatabase
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPlainTextEdit, QPushButton, QVBoxLayout

from gui.child import Child
from gui.notices import OperatorAnswered, OperatorAsked, ProcedureEnded, ProcedureStarted
from gui.pages.base import Desk
from instrument.prompts import Prompt

_LINES_KEPT = 2000
_PROMPT = '{"prompt"'
#: What an exit status means for a person.
_ENDS = {
    0: "✓ Done; the result is stored.",
    1: "⚠ Carried out, and not passed: read what it says above.",
    2: "⚠ The input is wrong: read what it says above.",
    3: "⚠ A device failed: read what it says above.",
    130: "Ended before its end; nothing is stored, the light is off and the arms are at rest.",
}


class Guided(QFrame):
    """Runs one command of the program at a time, which has the instrument meanwhile.

    Signals
    -------
    ended
        Its exit status.
    """

    ended = Signal(int)

    def __init__(self, desk: Desk, title: str) -> None:
        super().__init__()
        self.desk = desk
        desk.guided.append(self)
        self.setObjectName("card")
        self.child = Child(self)
        self.child.said.connect(self._hear)
        self.child.ended.connect(self._ended)
        self._asked = False
        self._rest = ""
        body = QVBoxLayout(self)
        body.setContentsMargins(12, 10, 12, 10)
        self.heading = QLabel(title)
        self.heading.setObjectName("cardTitle")
        body.addWidget(self.heading)
        self.words = QPlainTextEdit()
        self.words.setReadOnly(True)
        self.words.setMaximumBlockCount(_LINES_KEPT)
        self.words.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.words.setAccessibleName("What the procedure says")
        self.words.setTabChangesFocus(True)
        self.words.setPlaceholderText("What the procedure says stands here; what it asks, above the pages.")
        body.addWidget(self.words, 1)
        self.state = QLabel()
        self.state.setProperty("role", "value")
        self.state.setWordWrap(True)
        body.addWidget(self.state)
        self.buttons = QHBoxLayout()
        self.give_up_button = QPushButton("Give up")
        self.give_up_button.setToolTip("End the procedure in an orderly way; nothing is stored")
        self.give_up_button.clicked.connect(self.give_up)
        self.buttons.addWidget(self.give_up_button)
        body.addLayout(self.buttons)
        self.give_up_button.setEnabled(False)

    @property
    def running(self) -> bool:
        """Whether a command runs."""
        return self.child.running

    def add_button(self, button: QPushButton) -> None:
        """A button below, such as one that begins."""
        self.buttons.insertWidget(0, button)

    def run(self, title: str, arguments: list[str]) -> None:
        """Begin a command; does nothing while the instrument is taken."""
        if self.desk.model.busy:
            return
        self.heading.setText(title)
        self.words.clear()
        self._rest = ""
        self.state.setText("Beginning…")
        self.desk.feed(ProcedureStarted(title))
        self.child.run("instrument", arguments)
        self.give_up_button.setEnabled(True)

    def answer(self, value: float | str | None) -> None:
        """Answer the question that stands."""
        if self._asked:
            self._asked = False
            self.words.appendPlainText(f"  answered: {'done' if value is None else value}")
            self.child.answer(json.dumps({"answer": value}))
            self.desk.feed(OperatorAnswered())
            self.state.setText("Going on…")

    def give_up(self) -> None:
        """End in an orderly way."""
        if not self.running:
            return
        self._asked = False
        self.child.stop()
        self.desk.feed(OperatorAnswered())
        self.state.setText("Ending in an orderly way…")

    def halt(self) -> None:
        """Stop everything at once."""
        if self.running:
            self._asked = False
            self.child.halt()
            self.state.setText("Stopping everything…")

    def _hear(self, text: str) -> None:
        *lines, self._rest = (self._rest + text).split("\n")
        for line in lines:
            if line.startswith(_PROMPT):
                self._ask(Prompt.model_validate(json.loads(line)["prompt"]))
            elif line.strip():
                self.words.appendPlainText(line)

    def _ask(self, prompt: Prompt) -> None:
        self._asked = True
        self.words.appendPlainText(prompt.title)
        self.state.setText("Waiting for you: the question stands above.")
        self.desk.feed(OperatorAsked(prompt))

    def _ended(self, status: int) -> None:
        self._asked = False
        self.state.setText(_ENDS.get(status, f"⚠ Ended with status {status}: read what it says above."))
        self.give_up_button.setEnabled(False)
        self.desk.feed(ProcedureEnded())
        self.ended.emit(status)


def laboratory_arguments(desk: Desk) -> list[str]:
    """Options that name the laboratory, the person and the folder of the results."""
    setup = desk.setup
    words = ["--simulate", "--speed", f"{setup.speed:g}", "--seed", str(setup.seed)] if setup.simulate else []
    if setup.devices is not None:
        words += ["--devices", str(setup.devices)]
    if setup.facility is not None:
        words += ["--facility", str(setup.facility)]
    if setup.operator:
        words += ["--who", setup.operator]
    return [*words, "--results", str(setup.calibrations)]
