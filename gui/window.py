"""The main window: pages around one model. It holds no science and speaks to no device."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PySide6.QtCore import QByteArray, QSettings, QSize, Qt, QTimer
from PySide6.QtGui import QAction, QActionGroup, QCloseEvent, QKeySequence, QShortcut, QShowEvent
from PySide6.QtWidgets import (
    QButtonGroup,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QMainWindow,
    QMessageBox,
    QSplitter,
    QStackedWidget,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from gui import marks, pages, panels, words
from gui import theme as themes
from gui.bridge import INTERVAL_MS, Bridge
from gui.comparison import score
from gui.control import Controller, Listener
from gui.export import export_folder, pictured, write_export
from gui.model import Changes, PlaneKey, ScanModel
from gui.pages.base import Desk, Page
from gui.panels.base import Panel
from gui.panels.plots import PlotsPanel
from gui.questions import ask
from gui.setup import Setup
from gui.work import Work
from instrument.states import FINAL

#: Makes the controller of a window; it is told where events go and which plan to run (None: the laboratory's own).
ControllerFactory = Callable[[Listener, Path | None], Controller]

_LATE = 0.1  # seconds between two pictures of a panel that costs much
_BATCH_MS, _BETWEEN_MS = INTERVAL_MS, INTERVAL_MS // 2
_HELP = "Ctrl+1 … 8 pages   F5 start   F6 pause   F7 resume   F8 abort   F12 HALT"


class MainWindow(QMainWindow):
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
        super().__init__()
        self._make_controller, self._settings = make_controller, settings
        self._controller: Controller | None = None
        self.setup = setup or Setup(plan=plan)
        self._laboratory, self._plan_needed = laboratory or self.setup.laboratory, plan_needed
        self._closing = self._laid_out = False
        self._question: QMessageBox | None = None
        self.model = ScanModel(score)
        self.bridge = Bridge(self.model, self)
        self.bridge.changed.connect(self._refresh)
        self._late = QTimer(self)
        self._late.setSingleShot(True)
        self._drawn = 0.0
        self._late.timeout.connect(self._catch_up)
        self.palette_choice = themes.remembered(settings)
        theme = themes.choose(self.palette_choice)
        self.panels: list[Panel] = [panel(self.model, theme) for panel in panels.discover()]
        self.desk = Desk(self.model, self.setup, settings, theme, self.panels, self.bridge.on_event)
        self.pages: list[Page] = [page(self.desk) for page in pages.discover()]
        self._lay_out()
        self._make_menu()
        self._connect()
        self.statusBar().addPermanentWidget(QLabel(_HELP))
        self._restore_geometry()
        self._show_title()
        self.show_page(self.pages[0].name)

    def panel(self, name: str) -> Panel:
        """The panel whose class has this name."""
        return next(panel for panel in self.panels if type(panel).__name__ == name)

    def page(self, name: str) -> Page:
        """The page of this name."""
        return next(page for page in self.pages if page.name == name)

    @property
    def across(self) -> QSplitter:
        """Between planes and plots."""
        page: Any = self.page("watch")
        splitter: QSplitter = page.across
        return splitter

    # Layout

    def _lay_out(self) -> None:
        centre = QWidget()
        column = QVBoxLayout(centre)
        column.setContentsMargins(10, 10, 10, 4)
        column.setSpacing(8)
        header = QHBoxLayout()
        header.setSpacing(8)
        for panel in self.desk.in_area("header"):
            header.addWidget(panel, panel.stretch)
        column.addLayout(header)
        for panel in self.desk.in_area("banner"):
            column.addWidget(panel)
        self.stack = QStackedWidget()
        for page in self.pages:
            self.stack.addWidget(page)
        self.down = QSplitter(Qt.Orientation.Vertical)
        self.down.addWidget(self.stack)
        for panel in self.desk.in_area("bottom"):
            self.down.addWidget(panel)
        self.down.setSizes([700, 110])
        self.down.setStretchFactor(0, 1)
        self.down.setHandleWidth(8)
        row = QHBoxLayout()
        row.setSpacing(8)
        row.addLayout(self._navigation())
        row.addWidget(self.down, 1)
        column.addLayout(row, 1)
        self.setCentralWidget(centre)
        self.resize(1360, 900)

    def _navigation(self) -> QVBoxLayout:
        column = QVBoxLayout()
        column.setSpacing(4)
        self.navigation: dict[str, QToolButton] = {}
        group = QButtonGroup(self)
        group.setExclusive(True)
        for number, page in enumerate(self.pages, start=1):
            button = QToolButton()
            button.setObjectName("navigation")
            button.setText(page.title)
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextUnderIcon)
            button.setIconSize(QSize(24, 24))
            button.setCheckable(True)
            button.setToolTip(f"{page.tip} (Ctrl+{number})")
            button.setAccessibleName(f"Page {page.title}: {page.tip}")
            key = QShortcut(QKeySequence(f"Ctrl+{number}"), self)
            key.activated.connect(lambda name=page.name: self.show_page(name))
            button.setMinimumWidth(92)
            button.clicked.connect(lambda _=False, name=page.name: self.show_page(name))
            group.addButton(button)
            self.navigation[page.name] = button
            column.addWidget(button)
        column.addStretch(1)
        self._sign_navigation()
        return column

    def _sign_navigation(self) -> None:
        for page in self.pages:
            self.navigation[page.name].setIcon(marks.icon(page.sign, self.desk.theme.text, 24))

    def _make_menu(self) -> None:
        file = self.menuBar().addMenu("&File")
        self.open_action = QAction("&Open plan…", self)
        self.open_action.setShortcut(QKeySequence.StandardKey.Open)
        self.open_action.triggered.connect(self._choose_plan)
        export = QAction("&Export points and pictures", self)
        export.setShortcut(QKeySequence("Ctrl+E"))
        export.triggered.connect(self.export)
        self._export = Work(self)
        self._export.finished.connect(lambda folder: self.statusBar().showMessage(f"Exported: {folder}", 15000))
        self._export.failed.connect(lambda error: self.statusBar().showMessage(f"Cannot export: {error}", 15000))
        leave = QAction("&Close", self)
        leave.setShortcut(QKeySequence("Ctrl+Q"))
        leave.triggered.connect(self.close)
        file.addActions([self.open_action, export, leave])
        view = self.menuBar().addMenu("&View")
        group = QActionGroup(self)
        names: dict[themes.Choice, str] = {"system": "As the &desktop", "light": "&Light", "dark": "Da&rk"}
        for choice, name in names.items():
            action = QAction(name, self, checkable=True, checked=choice == self.palette_choice)
            action.triggered.connect(lambda _=False, choice=choice: self.use_palette(choice))
            group.addAction(action)
            view.addAction(action)

    def _connect(self) -> None:
        for panel in self.panels:
            panel.asked.connect(self.do)
            panel.plane_chosen.connect(self._plane_chosen)
        for page in self.pages:
            page.asked.connect(self.do)
            page.go.connect(self.show_page)
            page.told.connect(self._tell)
            page.said.connect(lambda text: self.statusBar().showMessage(text, 8000))
        plots = self.panel("PlotsPanel")
        assert isinstance(plots, PlotsPanel)
        self.plots = plots
        plots.follow_changed.connect(lambda on: self._follow() if on else None)

    # What a person asks for

    def show_page(self, name: str) -> None:
        """Go to a page."""
        page = self.page(name)
        self.stack.setCurrentWidget(page)
        self.navigation[name].setChecked(True)
        self.navigation[name].setFocus()  # a space bar must not press a button that steers the scan
        page.enter()

    def do(self, command: str) -> None:
        """Carry out a command of a panel or a page."""
        if command == "start":
            self._start()
        elif command == "export":
            self.export()
        elif command == "abort":
            self._ask_to_abort()
        elif self._controller is not None:
            if command == "mounted":
                self._controller.answer(True)
            else:
                getattr(self._controller, command)()

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

    def use_palette(self, choice: themes.Choice) -> None:
        """Change between light and dark."""
        self.palette_choice = choice
        self._settings.setValue("palette", choice)
        self.desk.theme = themes.choose(choice)
        for panel in self.panels:
            panel.set_theme(self.desk.theme)
        for page in self.pages:
            page.set_theme(self.desk.theme)
        self._sign_navigation()

    def set_plan(self, plan: Path) -> None:
        """The plan that the next start runs."""
        self.setup.plan = plan
        self.setup.resume = None
        self._settings.setValue("plan_folder", str(plan.parent))
        self._tell("plan")

    def join(self, controller: Controller) -> None:
        """Watch and steer a scan that runs already."""
        self._controller = controller
        controller.start()
        self.show_page("acquire")

    def _start(self) -> None:
        if self.model.connected:
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

    def _tell(self, what: str) -> None:
        for page in self.pages:
            page.hear(what)
        self._show_title()

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

    def _choose_plan(self) -> None:
        folder = str(self._settings.value("plan_folder", ""))
        name, _ = QFileDialog.getOpenFileName(self, "Open plan", folder, "Plans (*.toml);;All files (*)")
        if name:
            self.set_plan(Path(name))

    # What the engine says

    def _refresh(self, changes: Changes) -> None:
        for panel in self.panels:
            panel.take(changes)
        for page in self.pages:
            page.refresh(changes)
        if changes.scan or changes.current:
            self._follow()
        if not self._late.isActive() and any(panel.behind for panel in self.panels):
            # Between two batches of events, so that no pass of the loop has to do both.
            self._late.start(_BETWEEN_MS if time.monotonic() > self._drawn + _LATE else _BATCH_MS + _BETWEEN_MS)
        if changes.scan or changes.state:
            self._show_title()
            self.open_action.setEnabled(not self.model.connected)
            if self._question is not None and (not self.model.connected or self.model.state in FINAL):
                self._question.reject()
        if self._closing and not self.model.connected:
            self.close()

    def _catch_up(self) -> None:
        """Let one of the panels that cost much draw; the next one has to wait for the next pass of the loop."""
        behind = [panel for panel in self.panels if panel.behind]
        wait = self._drawn + _LATE / max(len(behind), 1) - time.monotonic()
        if wait > 0:
            self._late.start(round(1000 * wait) + 1)
            return
        for panel in behind[:1]:
            panel.catch_up()
        self._drawn = time.monotonic()
        if len(behind) > 1:
            self._late.start(_BETWEEN_MS)

    def settle(self) -> None:
        """Deliver and draw everything that has arrived, now; call in the Qt thread."""
        self.bridge.flush()
        for panel in self.panels:
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

    def _show_title(self) -> None:
        plan = self.setup.plan
        parts = (self.model.title or (plan.name if plan else ""), self._laboratory, "goniotwin")
        self.setWindowTitle(" – ".join(part for part in parts if part))
        where = f"Run folder {words.place(Path(self.model.run_dir))}" if self.model.run_dir else ""
        ready = f"Plan {plan.name}" if plan else "" if self._plan_needed else "The laboratory's own plan"
        self.statusBar().showMessage(where or ready or "Open a plan to begin (Ctrl+O)")

    # Coming and going

    def closeEvent(self, event: QCloseEvent) -> None:
        """Close at once when nothing runs; else ask what is to become of the scan."""
        if not self.model.connected:
            self._remember()
            event.accept()
            return
        event.ignore()
        if self._closing:
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
        if self._controller is None or not self._controller.detached:
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
        self.statusBar().showMessage("Ending the scan; the window closes when the instrument is safe")
        self._abort()
        if not self.model.connected:
            self.close()

    def showEvent(self, event: QShowEvent) -> None:
        """Give the panels the sizes they had last; they have to be laid out for that."""
        super().showEvent(event)
        if not self._laid_out:
            self._laid_out = True
            QTimer.singleShot(0, self, self._restore_splitters)

    def _restore_splitters(self) -> None:
        value = self._settings.value("down")
        if isinstance(value, QByteArray):
            self.down.restoreState(value)
        for page in self.pages:
            page.restore(self._settings)

    def _restore_geometry(self) -> None:
        value = self._settings.value("geometry")
        if isinstance(value, QByteArray):
            self.restoreGeometry(value)

    def _remember(self) -> None:
        self._settings.setValue("geometry", self.saveGeometry())
        self._settings.setValue("down", self.down.saveState())
        for page in self.pages:
            page.remember(self._settings)
