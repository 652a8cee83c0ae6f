"""What every panel is."""

from __future__ import annotations

from typing import ClassVar, Literal

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QFrame, QLabel, QVBoxLayout, QWidget

from gui.model import Changes, PlaneKey, ScanModel
from gui.theme import Theme

Area = Literal["header", "banner", "left", "centre", "bottom"]
Command = Literal["start", "pause", "resume", "abort", "halt", "mounted"]


class Panel(QFrame):
    """A card of the window that shows a part of the model.

    Signals
    -------
    asked
        The person wants something done (one of ``Command``).
    plane_chosen
        The person points at an azimuth plane (:class:`gui.model.PlaneKey`).
    """

    asked = Signal(str)
    plane_chosen = Signal(object)

    area: ClassVar[Area]
    order: ClassVar[int] = 0
    title: ClassVar[str] = ""
    stretch: ClassVar[int] = 0

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.model, self.theme = model, theme
        self.setObjectName("card")
        self.body = QVBoxLayout(self)
        self.body.setContentsMargins(12, 10, 12, 10)
        self.body.setSpacing(6)
        if self.title:
            title = QLabel(self.title)
            title.setObjectName("cardTitle")
            self.body.addWidget(title)

    def refresh(self, changes: Changes) -> None:
        """Show what has changed; called in the Qt thread at most about 30 times a second."""

    def show_plane(self, plane: PlaneKey | None) -> None:
        """The window now shows this plane."""

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = theme
        self.refresh(Changes(scan=True))


def quiet(text: str = "") -> QLabel:
    """A label for secondary text."""
    label = QLabel(text)
    label.setProperty("role", "quiet")
    return label


def value(text: str = "") -> QLabel:
    """A label for a value."""
    label = QLabel(text)
    label.setProperty("role", "value")
    return label
