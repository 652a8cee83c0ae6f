"""The frame of the main window: header, pages, navigation, menus, and what of them is remembered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtCore import QByteArray, QSettings, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAction, QActionGroup, QKeySequence, QShortcut, QShowEvent
from PySide6.QtWidgets import (
    QButtonGroup,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QSplitter,
    QStackedWidget,
    QTabWidget,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from gui import marks, pages, panels, words
from gui import theme as themes
from gui.bridge import Bridge
from gui.comparison import score
from gui.model import ScanModel
from gui.paced import PacedWindow
from gui.pages.base import Desk, Page
from gui.panels.base import Panel
from gui.setup import Setup
from gui.work import Work

_HELP = "Ctrl+1 … 8 pages   F5 start   F6 pause   F7 resume   F8 abort   F12 HALT"
_PREPARED_MS = 400


class Frame(PacedWindow):
    """Panels and pages around one model, laid out; what they ask for is carried out by :class:`gui.window.MainWindow`.

    Parameters
    ----------
    settings
        Where layout and last files are remembered.
    setup
        What a start asks for; the pages change it.
    laboratory
        What is driven, in words, for the title.
    plan_needed
        True where the laboratory brings no plan of its own.

    Signals
    -------
    laid_out
        Every page has been laid out once (:meth:`prepare`), and what they read at first has come.
    """

    laid_out = Signal()

    def __init__(self, settings: QSettings, setup: Setup, laboratory: str, plan_needed: bool) -> None:
        super().__init__()
        self.setup, self._settings = setup, settings
        self._laboratory, self._plan_needed = laboratory or setup.laboratory, plan_needed
        self._laid_out = False
        self._unseen: list[tuple[QWidget, QWidget]] = []  # each with one that has its size
        self.model = ScanModel(score)
        self.bridge = Bridge(self.model, self)
        self.palette_choice = themes.remembered(settings)
        theme = themes.choose(self.palette_choice)
        self.panels: list[Panel] = [panel(self.model, theme) for panel in panels.discover()]
        self.desk = Desk(self.model, self.setup, settings, theme, self.panels, self.bridge.on_event)
        self.pages: list[Page] = [page(self.desk) for page in pages.discover()]
        self._lay_out()
        self._make_menu()
        self.statusBar().addPermanentWidget(QLabel(_HELP))
        self._restore_geometry()
        self._show_title()

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
        splitter: QSplitter = page.split
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
        export.triggered.connect(lambda: self.do("export"))
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

    def show_page(self, name: str) -> None:
        """Go to a page."""
        page = self.page(name)
        self.stack.setCurrentWidget(page)
        self.navigation[name].setChecked(True)
        self.navigation[name].setFocus()  # a space bar must not press a button that steers the scan
        page.enter()

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

    def do(self, command: str) -> None:
        """Carry out a command of a panel or a page."""
        raise NotImplementedError

    def set_plan(self, plan: Path) -> None:
        """The plan that the next start runs."""
        self.setup.plan = plan
        self.setup.resume = None
        self._settings.setValue("plan_folder", str(plan.parent))
        self.tell("plan")

    def tell(self, what: str) -> None:
        """Let every page hear what one of them, or the menu, has changed."""
        for page in self.pages:
            page.hear(what)
        self._show_title()

    def _choose_plan(self) -> None:
        folder = str(self._settings.value("plan_folder", ""))
        name, _ = QFileDialog.getOpenFileName(self, "Open plan", folder, "Plans (*.toml);;All files (*)")
        if name:
            self.set_plan(Path(name))

    def _show_title(self) -> None:
        plan = self.setup.plan
        parts = (self.model.title or (plan.name if plan else ""), self._laboratory, "goniotwin")
        self.setWindowTitle(" – ".join(part for part in parts if part))
        where = f"Run folder {words.place(Path(self.model.run_dir))}" if self.model.run_dir else ""
        ready = f"Plan {plan.name}" if plan else "" if self._plan_needed else "The laboratory's own plan"
        self.statusBar().showMessage(where or ready or "Open a plan to begin (Ctrl+O)")

    def showEvent(self, event: QShowEvent) -> None:
        """Give the panels the sizes they had last; they have to be laid out for that."""
        super().showEvent(event)
        if not self._laid_out:
            self._laid_out = True
            QTimer.singleShot(0, self, self._restore_splitters)

    def prepare(self) -> None:
        """Lay what nobody has seen yet out, one page or tab in a pass of the loop: showing it then holds nothing up."""
        seen = self.stack.currentWidget()
        self._unseen = [(page, self.stack) for page in self.pages if page is not seen]
        for tabs in self.findChildren(QTabWidget):
            shown = tabs.currentWidget()
            later = [tab for number in range(tabs.count()) if (tab := tabs.widget(number)) and tab is not shown]
            self._unseen += [(tab, shown) for tab in later]
        QTimer.singleShot(_PREPARED_MS, self, self._prepare_one)

    def _prepare_one(self) -> None:
        if self._unseen:
            widget, model = self._unseen.pop(0)
            widget.resize(model.size())
            widget.grab()
            QTimer.singleShot(0, self, self._prepare_one)
        elif any(work.busy for work in self.findChildren(Work)):
            QTimer.singleShot(_PREPARED_MS, self, self._prepare_one)
        else:
            self.laid_out.emit()

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
