"""The instrument in three dimensions: arms, beam, sample and detector, moving as the axes do."""

from __future__ import annotations

import os
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication, QKeySequence, QShortcut, QShowEvent
from PySide6.QtWidgets import QHBoxLayout, QPushButton, QStackedWidget, QWidget

from gui.model import Changes, ScanModel
from gui.panels.base import Panel, quiet
from gui.solid import VARIABLE
from gui.solid.apart import Apart
from gui.solid.geometry import Camera, Stance, commanded, from_direction, reported
from gui.solid.lines import ArmsView, Sample, sample_of
from gui.solid.renderer import Renderer
from gui.solid.view import SolidView
from gui.theme import Theme
from gui.work import Work

_WITHOUT_SCREEN = ("offscreen", "minimal", "minimalegl", "vnc", "linuxfb")
_REST = Stance(0.0, 0.0, 45.0)  # of a plan of which nothing has moved yet
_VIEWS = (
    ("Side", "S", "The whole instrument, from the side"),
    ("Lamp", "L", "From the lamp, wherever its arm goes"),
    ("Detector", "D", "From the detector, wherever its arm goes"),
    ("Above", "A", "From above: azimuth 0 to the right, 90 upwards"),
)
_HINT = "Drag or arrow keys turn, wheel or + and − zoom."


def wanted() -> bool:
    """Whether a rendered picture is to be tried here."""
    said = os.environ.get(VARIABLE, "")
    if said in ("solid", "lines"):
        return said == "solid"
    return QGuiApplication.platformName() not in _WITHOUT_SCREEN


def _why_not() -> str:
    return f"{VARIABLE} asks for them" if os.environ.get(VARIABLE) == "lines" else "there is no screen to render for"


class ArmsPanel(Panel):
    """A rendered picture; lines until there is one, or where there cannot be one."""

    area = "acquire-right"
    title = "Instrument"
    lazy = True

    def __init__(
        self, model: ScanModel, theme: Theme, parent: QWidget | None = None, renderer: Renderer | None = None
    ) -> None:
        super().__init__(model, theme, parent)
        self.lines = ArmsView(theme)
        self.solid = SolidView(theme, renderer)
        self.stack = QStackedWidget()
        self.stack.addWidget(self.lines)
        self.stack.addWidget(self.solid)
        self.body.addLayout(self._buttons())
        self.body.addWidget(self.stack, 1)
        self.text = quiet()
        self.text.setWordWrap(True)
        self.body.addWidget(self.text)
        self._lines = "lines until a picture is rendered" if wanted() else f"lines: {_why_not()}"
        self._works = Work(self)
        self._works.finished.connect(self._show_sample)
        self.solid.drawn.connect(self._show_solid)
        self.solid.failed.connect(self._stay_with_lines)
        self.apart = Apart(self)
        self.apart.ended.connect(self._apart_ended)
        self._trouble = ""
        self.refresh(Changes(scan=True))

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.buttons: dict[str, QPushButton] = {}
        for text, key, tip in _VIEWS:
            button = QPushButton(f"{text}  {key}")
            button.setToolTip(tip)
            button.setAccessibleName(f"Look from {text.lower()}: {tip}")
            button.clicked.connect(lambda _=False, text=text: self.look(text))
            shortcut = QShortcut(QKeySequence(key), self)
            shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
            shortcut.activated.connect(lambda text=text: self.look(text))
            self.buttons[text] = button
            row.addWidget(button)
        row.addStretch(1)
        own = QPushButton("Own window  W")
        own.setToolTip("The instrument in a window of its own, which the mouse turns freely")
        own.setAccessibleName(f"Own window: {own.toolTip()}")
        own.clicked.connect(self.open_apart)
        QShortcut(QKeySequence("W"), self, self.open_apart, context=Qt.ShortcutContext.WidgetWithChildrenShortcut)
        own.setEnabled(QGuiApplication.platformName() not in _WITHOUT_SCREEN)
        self.buttons["Own window"] = own
        row.addWidget(own)
        return row

    def look(self, text: str) -> None:
        """Look from where a button says."""
        stance = self.solid.target or _REST
        if text == "Lamp":
            camera, seen = Camera("lamp"), from_direction(stance.illumination_zenith, 0.0)
        elif text == "Detector":
            camera, seen = Camera("detector"), from_direction(stance.sensor_zenith, stance.sensor_azimuth)
        elif text == "Above":
            camera, seen = Camera(azimuth=-90.0, height=90.0), (-90.0, 90.0)
        else:
            camera, seen = Camera(), (Camera().azimuth, Camera().height)
        self.solid.look(camera)
        self.lines.look_from(*seen)
        self._tell_apart()

    def open_apart(self) -> None:
        """Show the instrument in a window of its own as well."""
        if self.buttons["Own window"].isEnabled():
            self._trouble = ""
            self.apart.start()
            self._tell_apart()

    def _tell_apart(self) -> None:
        request = self.solid.request(self.solid.target or _REST)
        if self.apart.open and request is not None:
            self.apart.tell(request)

    def _apart_ended(self, trouble: str) -> None:
        self._trouble = f"the window of its own has ended: {trouble}" if trouble else ""
        self._say()

    # What the view says of itself

    def _show_solid(self) -> None:
        self._lines = ""
        self.stack.setCurrentWidget(self.solid)
        self._say()

    def _stay_with_lines(self, reason: str) -> None:
        self._lines = f"lines: nothing can be rendered here ({reason})"
        self.stack.setCurrentWidget(self.lines)
        self._say()

    def _say(self) -> None:
        parts = [self._whence(), self._lines or "the sample is drawn larger than the arms"]
        if self.solid.problem:
            parts.append(f"a plain sample: {self.solid.problem}")
        if self._trouble:
            parts.append(self._trouble)
        self.text.setText(f"{'; '.join(parts)}. {_HINT}")

    def _whence(self) -> str:
        """Where the positions come from."""
        model = self.model
        if model.positions:
            now = "say that the axes are" if model.connected else "last said that the axes were"
            return f"Where the drives {now}"
        return "No axis has moved yet" if model.current is None else "Where the axes are sent"

    # Following the scan

    def showEvent(self, event: QShowEvent) -> None:
        """Begin to render."""
        super().showEvent(event)
        if wanted():
            self.solid.begin()

    def _show_sample(self, sample: Sample) -> None:
        self.lines.sample = sample
        self.lines.update()

    def refresh(self, changes: Changes) -> None:
        """Follow the scan."""
        if not (changes.scan or changes.current or changes.state or changes.moved):
            return
        model = self.model
        self.lines.light = model.state.value == "measuring"
        self.solid.set_light(self.lines.light)
        if changes.scan and model.run_dir:
            folder = Path(model.run_dir)
            self._works.do(lambda: sample_of(folder))
            self.solid.set_folder(folder)
        self._go(self._stance(), at_once=changes.scan)
        self._say()
        self.lines.update()

    def _stance(self) -> Stance | None:
        model = self.model
        if not model.points:
            return None
        index = model.current
        sent = _REST if index is None else commanded(model.points[index].geometry)
        if index is None and self.solid.target is not None:
            sent = self.solid.target  # where the last point was
        if not model.positions:
            return sent
        return reported(model.positions, sent, model.points[index or 0].geometry.illumination_azimuth)

    def _go(self, stance: Stance | None, *, at_once: bool) -> None:
        self.lines.go_to(stance)
        self.solid.go_to(stance, at_once=at_once)
        self._tell_apart()

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.theme = self.lines.theme = theme
        self.lines.update()
        self.solid.set_theme(theme)
        self._tell_apart()


PANEL = ArmsPanel
