"""Start, pause, resume, abort, halt. The keys are written on the buttons."""

from __future__ import annotations

from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QGridLayout, QPushButton, QSizePolicy, QWidget

from gui import marks
from gui.looks import Actions, actions
from gui.model import Changes, ScanModel
from gui.panels.base import Panel
from gui.theme import Theme

#: command: (label, key, sign, what it does)
BUTTONS = {
    "start": ("Start", "F5", "play", "Connect the devices and run the plan"),
    "pause": ("Pause after point", "F6", "pause", "Rest after the point in hand, shutter closed"),
    "pause_now": ("Pause now", "Shift+F6", "pause", "Rest at once, shutter closed; the point in hand is repeated"),
    "resume": ("Resume", "F7", "play", "Go on with the scan"),
    "abort": ("Abort", "F8", "square", "End the scan in an orderly way; measured points are kept"),
    "halt": ("HALT", "F12", "cross", "Emergency: stop the arms and block the light now, without a question"),
}
_FILLED = ("start", "halt")  # buttons in a full colour


class ControlsPanel(Panel):
    """The buttons; which of them work is what the engine's own table allows in the state."""

    area = "header"
    order = 1

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        grid = QGridLayout()
        grid.setSpacing(8)
        self._allowed: Actions | None = None
        self.buttons: dict[str, QPushButton] = {}
        self.shortcuts: dict[str, QShortcut] = {}
        for column, (command, (label, key, _, tip)) in enumerate(BUTTONS.items()):
            button = QPushButton(f"{label}\n{key}")
            button.setObjectName(command)
            button.setToolTip(f"{tip} ({key})")
            button.setAccessibleName(f"{label}: {tip}")
            button.setIconSize(QSize(18, 18))
            button.setMinimumHeight(44)
            button.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
            button.clicked.connect(lambda _=False, command=command: self.asked.emit(command))
            shortcut = QShortcut(QKeySequence(key), self)
            if command == "halt":
                shortcut.setContext(Qt.ShortcutContext.ApplicationShortcut)  # also while a question is open
            shortcut.activated.connect(button.click)
            self.buttons[command], self.shortcuts[command] = button, shortcut
            grid.addWidget(button, 0, column)
        self.buttons["halt"].setMinimumWidth(120)
        self.body.addLayout(grid)
        self.refresh(Changes(scan=True))

    def refresh(self, changes: Changes) -> None:
        """Enable what may be asked for now."""
        if not (changes.state or changes.scan):
            return
        allowed = actions(self.model.state, self.model.connected, bool(self.model.procedure))
        if allowed == self._allowed and not changes.scan:
            return
        self._allowed = allowed
        for command, button in self.buttons.items():
            enabled = allowed.pause if command == "pause_now" else getattr(allowed, command)
            if button.hasFocus() and not enabled:
                button.clearFocus()  # else Qt hands the focus to the next button, where a space bar would press it
            button.setEnabled(enabled)
            colour = self.theme.text if enabled else self.theme.quiet_text
            if enabled and command in _FILLED:
                colour = "#ffffff" if command == "halt" else self.theme.on_accent
            button.setIcon(marks.icon(BUTTONS[command][2], colour, 18))


PANEL = ControlsPanel
