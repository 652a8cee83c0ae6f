"""What every panel is."""

from __future__ import annotations

from typing import ClassVar, Literal

from PySide6.QtCore import QSize, Signal
from PySide6.QtGui import QColor, QImage, QShowEvent
from PySide6.QtWidgets import QFrame, QLabel, QVBoxLayout, QWidget

from gui.model import Changes, ScanModel
from gui.points import PlaneKey
from gui.theme import Theme

Area = Literal["header", "banner", "acquire", "acquire-right", "left", "centre", "bottom"]
Command = Literal["start", "pause", "pause_now", "resume", "abort", "halt", "mounted"]
_LEAST_PICTURE = QSize(900, 640)


class Panel(QFrame):
    """A card of the window that shows a part of the model.

    Signals
    -------
    asked
        The person wants something done (one of ``Command``).
    plane_chosen
        The person points at an azimuth plane (:class:`gui.points.PlaneKey`).
    fell_behind
        What is seen is not what is known: :meth:`catch_up` is wanted.
    """

    asked = Signal(str)
    plane_chosen = Signal(object)
    fell_behind = Signal()

    area: ClassVar[Area]
    order: ClassVar[int] = 0
    title: ClassVar[str] = ""
    stretch: ClassVar[int] = 0
    lazy: ClassVar[bool] = False  # costs too much to be drawn while nobody sees it

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.model, self.theme = model, theme
        self._pending = Changes()
        self.setObjectName("card")
        self.body = QVBoxLayout(self)
        self.body.setContentsMargins(12, 10, 12, 10)
        self.body.setSpacing(6)
        if self.title and self.area != "centre":  # there it stands on the tab
            title = QLabel(self.title)
            title.setObjectName("cardTitle")
            self.body.addWidget(title)

    def take(self, changes: Changes) -> None:
        """Show what has changed; a panel that costs much does so when it is told to :meth:`catch_up`."""
        if self.lazy:
            self._pending = self._pending.joined(changes)
        else:
            self.refresh(changes)

    @property
    def owing(self) -> bool:
        """Whether there is something left to show."""
        return self._pending != Changes()

    @property
    def behind(self) -> bool:
        """Whether a panel that can be seen has something to catch up with."""
        return self.owing and self.isVisible()

    def catch_up(self) -> None:
        """Show what has changed, or as much of it as one pass of the event loop bears."""
        pending, self._pending = self._pending, Changes()
        if pending != Changes():
            self.refresh(pending)

    def picture(self) -> QImage:
        """The panel as it is, seen or not, twice as fine as on the screen."""
        if not self.isVisible():
            self.resize(self.size().expandedTo(_LEAST_PICTURE))
        while self.owing:
            self.catch_up()
        image = QImage(self.size() * 2, QImage.Format.Format_RGB32)
        image.setDevicePixelRatio(2.0)
        image.fill(QColor(self.theme.window))
        self.render(image)
        return image

    def showEvent(self, event: QShowEvent) -> None:
        """Ask to catch up: pages change at once, and what costs much follows in the next passes."""
        super().showEvent(event)
        if self.owing:
            self.fell_behind.emit()

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
