"""The large state indicator: sign, name of the state, what happens and what to do."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from gui import marks, words
from gui.looks import LOOKS, PROCEDURE, Look
from gui.model import Changes, ScanModel
from gui.panels.base import Panel
from gui.theme import Theme
from instrument.states import FINAL


class StatePanel(Panel):
    """Reads from across the room."""

    area = "header"
    order = 0
    stretch = 1

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.sign, self.name, self.text = QLabel(), QLabel(), QLabel()
        font = self.name.font()
        font.setPointSizeF(font.pointSizeF() * 2.0)
        font.setBold(True)
        self.name.setFont(font)
        self.text.setWordWrap(True)
        self.text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        row = QHBoxLayout()
        row.setSpacing(14)
        row.addWidget(self.sign)
        words = QVBoxLayout()
        words.setSpacing(0)
        words.addWidget(self.name)
        words.addWidget(self.text)
        row.addLayout(words, 1)
        self.body.addLayout(row)
        self.refresh(Changes(scan=True))

    def look(self) -> Look:
        """What is shown now."""
        return PROCEDURE if self.model.procedure else LOOKS[self.model.state]

    def refresh(self, changes: Changes) -> None:
        """Show the state."""
        if not (changes.state or changes.scan):
            return
        look, model = self.look(), self.model
        text = look.text
        if model.connected and model.state in FINAL:
            text = "The devices are being released and the results written."
        if model.procedure:
            text = f"{words.sentence(model.procedure)} {text}"
        elif model.state_reason:
            text = f"{words.sentence(model.state_reason)} {text}"
        colour = self.theme.tone(look.tone)
        self.sign.setPixmap(marks.pixmap(look.sign, colour, 48))
        self.name.setText(look.title)
        self.text.setText(text)
        self.setAccessibleName(f"State of the {'instrument' if model.procedure else 'scan'}: {look.title}")
        style = (
            f"QFrame#card {{ background: {self.theme.tone_surface[look.tone]}; border-left: 8px solid {colour};"
            " border-top-left-radius: 0; border-bottom-left-radius: 0; }"
        )
        if style != self.styleSheet():  # Qt lays out anew even where nothing changes
            self.setStyleSheet(style)


PANEL = StatePanel
