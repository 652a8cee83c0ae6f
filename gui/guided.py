"""A command that asks a person things, led from the window: its words, the question, the answer."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtGui import QFontDatabase
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QLineEdit, QPlainTextEdit, QPushButton, QVBoxLayout

from gui.child import Child
from gui.pages.base import Desk

_ASKS = "(q gives up)"
_LINES_KEPT = 2000


class Guided(QFrame):
    """Runs one command of the program at a time.

    Signals
    -------
    ended
        Its exit status.
    """

    ended = Signal(int)

    def __init__(self, desk: Desk, title: str) -> None:
        super().__init__()
        self.desk = desk
        self.setObjectName("card")
        self.child = Child(self)
        self.child.said.connect(self._hear)
        self.child.ended.connect(self._ended)
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
        self.words.setPlaceholderText("What the procedure says, and what it asks, stands here.")
        body.addWidget(self.words, 1)
        self.question = QLabel()
        self.question.setProperty("role", "value")
        self.question.setWordWrap(True)
        body.addWidget(self.question)
        row = QHBoxLayout()
        self.line = QLineEdit()
        self.line.setPlaceholderText("answer, where one is wanted")
        self.line.setAccessibleName("Answer to the procedure")
        self.line.returnPressed.connect(self.answer)
        self.done = QPushButton("Done, go on")
        self.done.clicked.connect(self.answer)
        self.give_up = QPushButton("Give up")
        self.give_up.setToolTip("End the procedure in an orderly way; nothing is stored")
        self.give_up.clicked.connect(self._give_up)
        row.addWidget(self.line, 1)
        row.addWidget(self.done)
        row.addWidget(self.give_up)
        body.addLayout(row)
        self.buttons = QHBoxLayout()
        body.addLayout(self.buttons)
        self._set_enabled()

    @property
    def running(self) -> bool:
        """Whether a command runs."""
        return self.child.running

    def add_button(self, button: QPushButton) -> None:
        """A button below, such as one that begins."""
        self.buttons.addWidget(button)

    def run(self, title: str, arguments: list[str]) -> None:
        """Begin a command."""
        if self.running:
            return
        self.heading.setText(title)
        self.words.clear()
        self.question.setText("Beginning…")
        self.child.run("instrument", arguments)
        self._set_enabled()

    def answer(self) -> None:
        """Answer the question that stands."""
        if self.running and self._asked:
            self._asked = False
            self.child.answer(self.line.text())
            self.line.clear()
            self.question.setText("Going on…")
            self._set_enabled()

    _asked = False

    def _give_up(self) -> None:
        if self._asked:
            self._asked = False
            self.child.answer("q")
        else:
            self.child.stop()
        self.question.setText("Ending in an orderly way…")

    def _hear(self, text: str) -> None:
        for line in text.splitlines():
            if line.strip():
                self.words.appendPlainText(line)
        if _ASKS in text:
            self._asked = True
            blocks = [line.strip() for line in self.words.toPlainText().splitlines()[-3:]]
            self.question.setText(" ".join(blocks).replace(_ASKS, "").strip())
            self.line.setFocus()
        self._set_enabled()

    def _ended(self, status: int) -> None:
        self._asked = False
        text = {
            0: "✓ Done; the result is stored.",
            1: "⚠ Carried out, and not passed: read what it says above.",
            2: "⚠ The input is wrong: read what it says above.",
            3: "⚠ A device failed: read what it says above.",
            130: "Given up; nothing is stored.",
        }.get(status, f"⚠ Ended with status {status}: read what it says above.")
        self.question.setText(text)
        self._set_enabled()
        self.ended.emit(status)

    def _set_enabled(self) -> None:
        self.line.setEnabled(self._asked)
        self.done.setEnabled(self._asked)
        self.give_up.setEnabled(self.running)


def laboratory_arguments(desk: Desk) -> list[str]:
    """Options that name the laboratory and the person."""
    setup = desk.setup
    words = ["--simulate", "--speed", f"{setup.speed:g}", "--seed", str(setup.seed)] if setup.simulate else []
    if setup.devices is not None:
        words += ["--devices", str(setup.devices)]
    if setup.facility is not None:
        words += ["--facility", str(setup.facility)]
    if setup.operator:
        words += ["--who", setup.operator]
    return words
