"""What a scan or a procedure asks: shown on every page as long as it is open, with a field for the answer."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QLineEdit, QPushButton, QVBoxLayout, QWidget

from gui import marks
from gui.model import Changes, ScanModel
from gui.panels.base import Panel
from gui.theme import Theme
from gui.words import MINUS
from instrument.operators import Mounted
from instrument.prompts import Prompt

_WORDS: dict[Mounted, tuple[str, str]] = {
    "reference": (
        "Put the reference sample on the stage",
        "Level it and bring its surface to the height of the optical centre.",
    ),
    "sample": (
        "Put the sample on the stage",
        "Level it, turn it to its mark and bring its surface to the height of the optical centre.",
    ),
}

_MOUNTED = "It lies on the stage: go on  F9"
_CLEAR = "Stand clear before you go on: the arms will move."


class AnswerField(QWidget):
    """What an answer is given with: a number with its limits, or one button a choice.

    Signals
    -------
    changed
        The answer is another one; whether it makes sense tells :attr:`problem`.
    entered
        The person pressed Enter.
    """

    changed = Signal()
    entered = Signal()

    def __init__(self) -> None:
        super().__init__()
        self._prompt: Prompt | None = None
        self.buttons: list[QPushButton] = []
        self._row = QHBoxLayout(self)
        self._row.setContentsMargins(0, 0, 0, 0)
        self.line, self.unit = QLineEdit(), QLabel()
        self.line.setMinimumWidth(110)
        self.line.textEdited.connect(lambda _: self._told())
        self.line.returnPressed.connect(self.entered)
        self._row.addWidget(self.line)
        self._row.addWidget(self.unit)

    def show_prompt(self, prompt: Prompt | None) -> None:
        """Ask for the answer of another prompt."""
        self._prompt = prompt
        for button in self.buttons:
            button.setParent(None)
        self.buttons = []
        number = prompt is not None and prompt.kind == "number"
        self.line.clear()
        self.line.setVisible(number)
        self.unit.setVisible(number)
        if prompt is not None and number:
            limits = "" if prompt.lower is None or prompt.upper is None else f"{prompt.lower:g} to {prompt.upper:g}"
            self.line.setPlaceholderText(limits.replace("-", MINUS))
            self.line.setAccessibleName(f"{prompt.title} {limits} {prompt.unit}")
            self.unit.setText(prompt.unit)
        for choice in prompt.choices if prompt is not None and prompt.kind == "choice" else ():
            button = QPushButton(f"&{choice}")
            button.setCheckable(True)
            button.setAutoExclusive(True)
            button.toggled.connect(lambda _: self._told())
            self._row.addWidget(button)
            self.buttons.append(button)
        self._told()

    @property
    def value(self) -> float | str | None:
        """The answer as it stands."""
        if self._prompt is None or self._prompt.kind == "confirm":
            return None
        if self._prompt.kind == "choice":
            return next((b.text().removeprefix("&") for b in self.buttons if b.isChecked()), None)
        try:
            return float(self.line.text().replace(",", ".").replace(MINUS, "-"))
        except ValueError:
            return self.line.text() or None

    @property
    def problem(self) -> str:
        """Why the answer does not make sense; empty where it does."""
        return self._prompt.objection(self.value) if self._prompt is not None else ""

    def _told(self) -> None:
        wrong = bool(self.line.text()) and bool(self.problem)
        if bool(self.line.property("wrong")) != wrong:
            self.line.setProperty("wrong", wrong)
            self.line.style().unpolish(self.line)
            self.line.style().polish(self.line)
        self.changed.emit()


class RequestPanel(Panel):
    """A banner with the question, a field for what it wants, and the way out.

    Signals
    -------
    answered
        The answer: a number, a choice, or None for "done".
    """

    area = "banner"
    answered = Signal(object)

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.sign, self.what, self.how = QLabel(), QLabel(), QLabel()
        font = self.what.font()
        font.setPointSizeF(font.pointSizeF() * 1.3)
        font.setBold(True)
        self.what.setFont(font)
        self.what.setWordWrap(True)
        self.how.setWordWrap(True)
        self.field = AnswerField()
        self.field.changed.connect(self._check)
        self.field.entered.connect(self._answer)
        self.problem = QLabel()
        self.problem.setProperty("role", "wrong")
        self.done = QPushButton(_MOUNTED)
        self.done.clicked.connect(self._answer)
        self.give_up = QPushButton("End the scan…")
        self.give_up.clicked.connect(lambda: self.asked.emit("abort"))
        row = QHBoxLayout()
        row.setSpacing(14)
        row.addWidget(self.sign)
        words = QVBoxLayout()
        words.addWidget(self.what)
        words.addWidget(self.how)
        words.addWidget(self.problem)
        row.addLayout(words, 1)
        row.addWidget(self.field)
        row.addWidget(self.done)
        row.addWidget(self.give_up)
        self.body.addLayout(row)
        self.refresh(Changes(scan=True))

    def refresh(self, changes: Changes) -> None:
        """Show or hide the request."""
        if not (changes.request or changes.scan):
            return
        request = self.model.request
        self.setVisible(request is not None)
        if request is None:
            return
        prompt = request if isinstance(request, Prompt) else None
        title, text = (prompt.title, prompt.text) if prompt else _WORDS[request]  # type: ignore[index]
        self.what.setText(title)
        confirm = prompt is None or prompt.kind == "confirm"
        self.how.setText(f"{text} {_CLEAR}".strip() if confirm else text)
        self.how.setVisible(bool(self.how.text()))
        self.field.setVisible(not confirm)
        self.field.show_prompt(prompt)
        self.done.setText(_MOUNTED if prompt is None else "Done: go on  F9" if confirm else "Answer  F9")
        self.done.setShortcut("F9")  # a new text takes the old shortcut away
        self.give_up.setText("Give the procedure up" if self.model.procedure else "End the scan…")
        self.setAccessibleName(title)
        self.sign.setPixmap(marks.pixmap("hand", self.theme.hold, 40))
        self.setStyleSheet(
            f"QFrame#card {{ background: {self.theme.tone_surface['hold']}; border: 2px solid {self.theme.hold}; }}"
        )
        if not confirm and self.isVisible():
            first: QWidget = self.field.buttons[0] if self.field.buttons else self.field.line
            first.setFocus()

    def _check(self) -> None:
        problem = self.field.problem
        self.done.setEnabled(not problem)
        shown = problem if self.field.value is not None else ""
        self.problem.setText(f"⚠ {shown}" if shown else "")
        self.problem.setVisible(bool(shown))

    def _answer(self) -> None:
        if self.model.request is not None and not self.field.problem:
            self.answered.emit(self.field.value)


PANEL = RequestPanel
