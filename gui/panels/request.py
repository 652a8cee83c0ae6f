"""The engine's request to the operator: shown as long as it is open, so that it cannot be lost behind a window."""

from __future__ import annotations

from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from gui import marks
from gui.model import Changes, ScanModel
from gui.panels.base import Panel
from gui.theme import Theme
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


class RequestPanel(Panel):
    """A banner with the two answers."""

    area = "banner"

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.sign, self.what, self.how = QLabel(), QLabel(), QLabel()
        font = self.what.font()
        font.setPointSizeF(font.pointSizeF() * 1.3)
        font.setBold(True)
        self.what.setFont(font)
        self.how.setWordWrap(True)
        self.done = QPushButton(_MOUNTED)
        self.done.setShortcut("F9")
        self.done.clicked.connect(lambda: self.asked.emit("mounted"))
        self.give_up = QPushButton("End the scan…")
        self.give_up.clicked.connect(lambda: self.asked.emit("abort"))
        row = QHBoxLayout()
        row.setSpacing(14)
        row.addWidget(self.sign)
        words = QVBoxLayout()
        words.addWidget(self.what)
        words.addWidget(self.how)
        row.addLayout(words, 1)
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
        title, text = (request.title, request.text) if isinstance(request, Prompt) else _WORDS[request]
        self.what.setText(title)
        self.how.setText(f"{text} {_CLEAR}")
        self.done.setText("Done: go on  F9" if isinstance(request, Prompt) else _MOUNTED)
        self.done.setShortcut("F9")  # a new text takes the old shortcut away
        self.setAccessibleName(title)
        self.sign.setPixmap(marks.pixmap("hand", self.theme.hold, 40))
        self.setStyleSheet(
            f"QFrame#card {{ background: {self.theme.tone_surface['hold']}; border: 2px solid {self.theme.hold}; }}"
        )


PANEL = RequestPanel
