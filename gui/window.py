"""The main window: pages around one model. It holds no science and speaks to no device."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QSettings, QTimer
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QMessageBox

from gui.bridge import INTERVAL_MS
from gui.control import Controller, Listener
from gui.export import export_folder, pictured, write_export
from gui.frame import Frame
from gui.guided import Guided
from gui.model import Changes
from gui.panels.plots import PlotsPanel
from gui.panels.request import RequestPanel
from gui.points import PlaneKey
from gui.questions import ask
from gui.setup import Setup
from instrument.states import FINAL

#: Makes the controller of a window; it is told where events go and which plan to run (None: the laboratory's own).
ControllerFactory = Callable[[Listener, Path | None], Controller]

_LATE = 0.1  # seconds between two pictures of a panel that costs much
_BATCH_MS, _BETWEEN_MS = INTERVAL_MS, INTERVAL_MS // 2


class MainWindow(Frame):
    """One window on one instrument.

    Parameters
    ----------
    make_controller
        Called for every start with the window's listener and the chosen plan.
    settings
        Where layout and last files are remembered.
    plan
        The plan that Start runs; None: the one that comes with the laboratory.
    laboratory
        What is driven, in words, for the title.
    plan_needed
        True where the laboratory brings no plan of its own.
    setup
        What a start asks for; the pages change it.
    """

    def __init__(
        self,
        make_controller: ControllerFactory,
        settings: QSettings,
        plan: Path | None = None,
        laboratory: str = "",
        plan_needed: bool = False,
        setup: Setup | None = None,
    ) -> None:
        super().__init__(settings, setup or Setup(plan=plan), laboratory, plan_needed)
        self._make_controller = make_controller
        self._controller: Controller | None = None
        self._closing = False
        self._question: QMessageBox | None = None
        self._late = QTimer(self)
        self._late.setSingleShot(True)
        self._late.timeout.connect(self._catch_up)
        self._drawn = 0.0
        self._alone = False
        self._connect()
        self.show_page(self.pages[0].name)

    def _connect(self) -> None:
        self.bridge.changed.connect(self._refresh)
        for panel in self.panels:
            panel.asked.connect(self.do)
            panel.plane_chosen.connect(self._plane_chosen)
            panel.fell_behind.connect(self._expect_to_catch_up)
        for page in self.pages:
            page.asked.connect(self.do)
            page.go.connect(self.show_page)
            page.told.connect(self.tell)
            page.said.connect(lambda text: self.statusBar().showMessage(text, 8000))
        request = self.panel("RequestPanel")
        assert isinstance(request, RequestPanel)
        request.answered.connect(self.answer)
        plots = self.panel("PlotsPanel")
        assert isinstance(plots, PlotsPanel)
        self.plots = plots
        plots.follow_changed.connect(lambda on: self._follow() if on else None)

    # What a person asks for

    def do(self, command: str) -> None:
        """Carry out a command of a panel or a page."""
        if command == "start":
            self._start()
        elif command == "export":
            self.export()
        elif command == "abort" and self.model.procedure:
            self._each_guided(lambda guided: guided.give_up())
        elif command == "abort":
            self._ask_to_abort()
        elif command == "halt" and self.model.procedure:
            self._each_guided(lambda guided: guided.halt())
        elif self._controller is not None:
            getattr(self._controller, command)()

    def answer(self, value: float | str | None) -> None:
        """Answer what the procedure or the scan asks; None says "done"."""
        if self.model.procedure:
            self._each_guided(lambda guided: guided.answer(value))
        elif self._controller is not None:
            self._controller.answer(True, value)

    def _each_guided(self, act: Callable[[Guided], None]) -> None:
        for guided in self.desk.guided:
            if guided.running:
                act(guided)

    def export(self) -> Path | None:
        """Write every point and a picture of every plot into a new folder of the run; returns it at once."""
        if not self.model.points:
            self.statusBar().showMessage("There is nothing to export yet", 8000)
            return None
        try:
            folder = export_folder(self.model)
        except OSError as error:
            self.statusBar().showMessage(f"Cannot export: {error}", 8000)
            return None
        pictures = pictured([panel for panel in self.panels if panel.lazy])
        points = list(self.model.points)
        self._export.do(lambda: write_export(folder, points, pictures))
        return folder

    def join(self, controller: Controller) -> None:
        """Watch and steer a scan that runs already."""
        self._controller = controller
        controller.start()
        self.show_page("acquire")

    def _start(self) -> None:
        if self.model.busy or any(guided.running for guided in self.desk.guided):
            return
        if self.setup.unsaved and self.setup.resume is None:
            self.show_page("setup")
            self.statusBar().showMessage("The plan has changed: save it (Ctrl+S), then start", 8000)
            return
        if self.setup.plan is None and self._plan_needed and self.setup.resume is None:
            self._choose_plan()
            if self.setup.plan is None:
                return
        self._controller = self._make_controller(self.bridge, self.setup.plan)
        self.setup.resume = None
        self._controller.start()
        if self.stack.currentWidget() not in (self.page("acquire"), self.page("watch")):
            self.show_page("acquire")

    def _ask_to_abort(self) -> None:
        self._ask(
            "Abort the scan",
            "Abort the scan?",
            "Abort the scan",
            "Go on measuring",
            lambda yes: self._abort() if yes else None,
            "It ends in an orderly way. What is measured is kept, and the run can be resumed later.",
        )

    def _abort(self) -> None:
        if self._controller is not None:
            self._controller.abort()

    def _ask(
        self,
        title: str,
        text: str,
        yes: str,
        no: str,
        answered: Callable[[bool], None],
        detail: str,
        other: tuple[str, Callable[[], None]] | None = None,
    ) -> None:
        if self._question is not None:
            self._question.raise_()
            return

        def done(accepted: bool) -> None:
            self._question = None
            answered(accepted)

        self._question = ask(self, title, text, yes, no, done, detail, other)

    # What the engine says

    def _refresh(self, changes: Changes) -> None:
        for panel in self.panels:
            panel.take(changes)
        for page in self.pages:
            page.refresh(changes)
        if changes.scan or changes.current:
            self._follow()
        if any(panel.behind for panel in self.panels):
            self._expect_to_catch_up()
        if changes.scan or changes.state:
            self._show_title()
            self.open_action.setEnabled(not self.model.connected)
            over = not self.model.busy or (self.model.connected and self.model.state in FINAL)
            if self._question is not None and over:
                self._question.reject()
        if self._closing and not self.model.busy:
            self.close()

    def _expect_to_catch_up(self) -> None:
        """Between two batches of events, so that no pass of the loop has to do both."""
        if not self._late.isActive():
            self._alone = False
            self._late.start(_BETWEEN_MS if time.monotonic() > self._drawn + _LATE else _BATCH_MS + _BETWEEN_MS)

    def _catch_up(self) -> None:
        """Let one of the panels that cost much draw; the next one has to wait for the next pass of the loop."""
        if not self._alone:  # a slow pass may have painted or delivered just before: not in the same one
            self._alone = True
            self._late.start(0)
            return
        behind = [panel for panel in self.panels if panel.behind]
        wait = self._drawn + _LATE / max(len(behind), 1) - time.monotonic()
        if wait > 0:
            self._alone = False
            self._late.start(round(1000 * wait) + 1)
            return
        for panel in behind[:1]:
            panel.catch_up()
        if any(panel.behind for panel in behind[:1]):  # more of the same picture
            self._late.start(_BETWEEN_MS)
            return
        self._drawn = time.monotonic()
        if len(behind) > 1:
            self._late.start(_BETWEEN_MS)

    def settle(self) -> None:
        """Deliver and draw everything that has arrived, now; call in the Qt thread."""
        self.bridge.flush()
        for panel in self.panels:
            while panel.behind:
                panel.catch_up()

    def _follow(self) -> None:
        if not self.plots.follow.isChecked() and self.plots.plane in self.model.planes:
            return
        plane = self.model.current_plane
        if plane is None and self.plots.plane is None:
            plane = next(iter(self.model.planes), None)
        if plane is not None:
            self._show_plane(plane)

    def _plane_chosen(self, plane: PlaneKey) -> None:
        self.plots.follow.setChecked(plane == self.model.current_plane)
        self._show_plane(plane)

    def _show_plane(self, plane: PlaneKey) -> None:
        for panel in self.panels:
            panel.show_plane(plane)

    # Coming and going

    def closeEvent(self, event: QCloseEvent) -> None:
        """Close at once when nothing runs; else ask what is to become of the scan."""
        if not self.model.busy:
            self._remember()
            event.accept()
            return
        event.ignore()
        if self._closing:
            return
        if self.model.procedure:
            self._ask(
                "A procedure is running",
                "Give the procedure up and close the window?",
                "Give it up and close",
                "Keep the window open",
                self._close_answered,
                "It ends in an orderly way: arms at rest, light off. Nothing of it is stored.",
            )
            return
        detached = self._controller is not None and self._controller.detached
        self._ask(
            "A scan is running",
            "Close the window while the scan goes on?" if detached else "End the scan and close the window?",
            "Close the window, go on measuring" if detached else "End the scan and close",
            "Keep the window open",
            self._leave_answered if detached else self._close_answered,
            "The scan has a process of its own and does not need the window. A new window joins it: goniotwin gui."
            if detached
            else "The scan ends in an orderly way: arms at rest, light off. What is measured is kept, and the run can"
            " be resumed later.",
            ("End the scan and close", self.end_and_close) if detached else None,
        )

    @property
    def asking(self) -> bool:
        """True while a question to the person stands."""
        return self._question is not None

    def _close_answered(self, yes: bool) -> None:
        if yes:
            self.end_and_close()

    def _leave_answered(self, yes: bool) -> None:
        if yes:
            self.leave()

    def leave(self) -> None:
        """Close; a scan in a process of its own goes on, any other ends in an orderly way. Asks nobody."""
        if self.model.procedure or self._controller is None or not self._controller.detached:
            self.end_and_close()
            return
        self._remember()
        self._closing = True
        self._controller.leave()  # type: ignore[attr-defined]
        self.model.connected = False
        self.close()

    def end_and_close(self) -> None:
        """End a scan in an orderly way, and close as soon as the instrument is safe; asks nobody."""
        self._closing = True
        self.statusBar().showMessage("Ending; the window closes when the instrument is safe")
        if self.model.procedure:
            self._each_guided(lambda guided: guided.give_up())
        else:
            self._abort()
        if not self.model.busy:
            self.close()
