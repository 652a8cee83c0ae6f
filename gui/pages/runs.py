"""Look back: the catalogue of runs, searched by plan, sample, date, state, figure of merit; open, compare, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtCore import QSettings, QSize, Qt, QUrl
from PySide6.QtGui import QDesktopServices, QIcon, QImage, QPixmap
from PySide6.QtWidgets import (
    QFileDialog,
    QHBoxLayout,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from gui import words
from gui.child import Child
from gui.compare_window import CompareWindow
from gui.model import Changes
from gui.pages.base import Desk, Page, card, explained
from gui.panels.base import quiet
from gui.past_runs import PastRun, figures_of, past_runs
from gui.run_search import SearchFields, WrongField
from gui.run_table import RunTable
from gui.theme import Theme
from gui.work import Work
from instrument.states import FINAL

REPORT_NAME = "report.html"
_NO_FIGURES = "No figures. They are drawn at the end of a scan that the twin watched."
_WORDS_KEPT = 1000  # characters of what the report's process says
_PICTURE, _PICTURES = QSize(180, 110), 24  # size and number of the figures that are listed


class RunsPage(Page):
    """Table of runs above, what the chosen one holds below."""

    name = "runs"
    title = "Look back"
    sign = "folder"
    tip = "Earlier runs: open, compare, report"
    order = 70

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._list, self._open, self._read = Work(self), Work(self), Work(self)
        self._read.finished.connect(self._show_figures)
        self._child = Child(self)
        self._child.said.connect(self._hear_child)
        self._child.ended.connect(self._report_ended)
        self._reported, self._words = Path(REPORT_NAME), ""
        self._list.finished.connect(self._show)
        self._list.failed.connect(self._not_found)
        self._open.finished.connect(lambda task: task())
        self._open.failed.connect(self._complain)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        frame, body = card()
        body.addLayout(self._head())
        self.search = SearchFields()
        self.search.changed.connect(self.read)
        self.search.wrong.connect(self._say)
        body.addWidget(self.search)
        self.table = RunTable(lambda: self.desk.theme)
        self.table.chosen.connect(self._choose)
        self.table.opened.connect(self._open_run)
        body.addWidget(self.table, 1)
        body.addLayout(self._buttons())
        self.problem = quiet()
        self.problem.setProperty("role", "wrong")
        self.problem.setWordWrap(True)
        self.problem.hide()
        body.addWidget(self.problem)
        column.addWidget(frame, 3)
        column.addWidget(self._figures(), 1)
        self._choose()

    # Layout

    def _head(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.where = quiet()
        for text, tip, slot in (
            ("Folder…", "Another folder with runs", self._choose_folder),
            ("Read again", "Read the folder again", self.read),
        ):
            button = QPushButton(text)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            row.addWidget(button)
        row.addWidget(self.where)
        row.addStretch(1)
        return row

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.buttons: dict[str, QPushButton] = {}
        for name, text, tip, slot in (
            ("open", "Open", "Show the run on the page Watch (Enter)", self._open_run),
            ("compare", "Compare", "Two chosen runs side by side (Ctrl+click chooses the second)", self._compare),
            ("resume", "Go on with it", "Measure the points that are missing", self._resume),
            ("diagnose", "Diagnose", "Say where, why and how far the run differs from its simulation", self._diagnose),
            ("report", "Report", "Write the run up as one page (report.html) and open it", self._report),
            ("folder", "Folder", "Open the run folder", self._folder),
        ):
            button = QPushButton(text)
            button.setToolTip(tip)
            button.setAccessibleName(f"{text}: {tip}")
            button.clicked.connect(slot)
            self.buttons[name] = button
            row.addWidget(button)
        row.addStretch(1)
        return row

    def _figures(self) -> QWidget:
        frame, body = card("Figures of the run")
        self.figures = QListWidget()
        self.figures.setAccessibleName("Figures of the run; Enter opens one")
        self.figures.setViewMode(QListWidget.ViewMode.IconMode)
        self.figures.setFlow(QListWidget.Flow.LeftToRight)
        self.figures.setWrapping(False)
        self.figures.setIconSize(_PICTURE)
        self.figures.setMinimumHeight(150)
        self.figures.itemActivated.connect(
            lambda item: QDesktopServices.openUrl(QUrl.fromLocalFile(item.data(Qt.ItemDataRole.UserRole)))
        )
        self.no_figures = quiet(_NO_FIGURES)
        body.addWidget(self.figures)
        body.addWidget(self.no_figures)
        return frame

    # Reading

    def enter(self) -> None:
        """Read the folder."""
        self.read()

    def hear(self, what: str) -> None:
        """Open a run that another page names."""
        if what.startswith("open:"):
            self.open_folder(Path(what.removeprefix("open:")))

    def read(self) -> None:
        """Search the catalogue, on a thread; it reads what has changed in the folders first."""
        folder, query = self.desk.setup.runs, self.search.query()
        self.where.setText(f"{words.place(folder)}: looking…")
        self._list.do(lambda: past_runs(folder, query()))

    def _choose_folder(self) -> None:
        name = QFileDialog.getExistingDirectory(self, "Folder with runs", str(self.desk.setup.runs))
        if name:
            self.desk.setup.runs = Path(name)
            self.desk.settings.setValue("runs", name)
            self.read()

    def _show(self, runs: list[PastRun]) -> None:
        self.search.mark("", "")
        count = "no runs" if not runs else "1 run" if len(runs) == 1 else f"{len(runs)} runs"
        self.where.setText(f"{words.place(self.desk.setup.runs)}: {count}")
        self.table.put(runs)

    def _not_found(self, error: Exception) -> None:
        self.where.setText(words.place(self.desk.setup.runs))
        if isinstance(error, WrongField):
            self.search.mark(error.field, str(error))
        else:
            self._complain(error)

    def chosen(self) -> list[PastRun]:
        """The chosen runs."""
        return self.table.selected()

    def _choose(self) -> None:
        chosen = self.chosen()
        one = chosen[0] if len(chosen) == 1 else None
        readable = one is not None and one.readable
        idle = not self.model.connected
        self.buttons["open"].setEnabled(readable and idle)
        self.buttons["compare"].setEnabled(len(chosen) == 2)
        self.buttons["resume"].setEnabled(one is not None and one.resumable and not self.model.busy)
        self.buttons["diagnose"].setEnabled(readable)
        self.buttons["report"].setEnabled(readable and not self._child.running)
        self.buttons["folder"].setEnabled(one is not None)
        self.figures.clear()
        self.no_figures.setText("Looking for figures…")
        self._read.do(lambda: [(path, _small(path)) for path in figures_of(one.folder)[:_PICTURES]] if one else [])
        self._say(one.row.problem if one is not None else "")

    def _show_figures(self, pictures: list[tuple[Path, QImage]]) -> None:
        self.figures.setVisible(bool(pictures))
        self.no_figures.setText(_NO_FIGURES)
        self.no_figures.setVisible(not pictures)
        for path, picture in pictures:
            item = QListWidgetItem(QIcon(QPixmap.fromImage(picture)), path.stem)
            item.setData(Qt.ItemDataRole.UserRole, str(path))
            item.setToolTip(str(path))
            self.figures.addItem(item)

    # Doing

    def _say(self, text: str) -> None:
        self.problem.setText(text)
        self.problem.setVisible(bool(text))

    def _complain(self, error: Exception) -> None:
        self._say(explained(error))

    def open_folder(self, folder: Path) -> None:
        """Show a run on the page Watch."""
        if self.model.connected:
            self._say("A scan is running; a run can be opened when it is over.")
            return

        def task() -> Any:
            from gui.replay import events_of

            events = events_of(folder)
            return lambda: self._replay(events)

        self._open.do(task)

    def _replay(self, events: list[Any]) -> None:
        if self.model.connected:
            return
        for event in events:
            self.desk.feed(event)
        self.go.emit("watch")

    def _open_run(self) -> None:
        chosen = self.chosen()
        if len(chosen) == 1:
            self.open_folder(chosen[0].folder)

    def _compare(self) -> None:
        chosen = self.chosen()
        if len(chosen) != 2:
            return
        later, earlier = chosen

        def task() -> Any:
            from gui.replay import compared_events

            events = compared_events(earlier.folder, later.folder)
            return lambda: self._show_comparison(events, earlier, later)

        self._open.do(task)

    def _show_comparison(self, events: list[Any], one: PastRun, other: PastRun) -> None:
        self.comparison = CompareWindow(self.desk, events, _name(one), _name(other), self)
        self.comparison.show()

    def _resume(self) -> None:
        for run in self.chosen():
            self.desk.setup.resume = run.folder
            self.asked.emit("start")

    def _diagnose(self) -> None:
        for run in self.chosen()[:1]:
            self.told.emit(f"run:{run.folder}")
            self.go.emit("understand")

    def _report(self) -> None:
        """Write the report, in a process of its own; it is opened when it is there."""
        for run in self.chosen()[:1]:
            self._reported, self._words = run.folder / REPORT_NAME, ""
            self._child.run("instrument", ["report", str(run.folder), "--force"])
            self.said.emit(f"Writing {words.place(self._reported)}…")
            self._choose()

    def _report_ended(self, status: int) -> None:
        if status == 0:
            self.said.emit(f"Written: {words.place(self._reported)}")
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(self._reported.resolve())))
        self._choose()
        if status != 0:
            self._say(f"⚠ No report: {' '.join(self._words.split()) or f'status {status}'}")

    def _hear_child(self, text: str) -> None:
        self._words = (self._words + text)[-_WORDS_KEPT:]

    def _folder(self) -> None:
        for run in self.chosen():
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(run.folder.resolve())))

    def refresh(self, changes: Changes) -> None:
        """What may be done depends on whether a scan runs."""
        if changes.state or changes.scan:
            idle = not self.model.connected
            if self.isVisible() and idle and self.model.state in FINAL:
                self.read()
            elif self.isVisible():
                self._choose()

    def set_theme(self, theme: Theme) -> None:
        """Signs in other colours."""
        self.table.viewport().update()

    def restore(self, settings: QSettings) -> None:
        """The folder of last time, where none was given."""
        value = settings.value("runs")
        if isinstance(value, str) and Path(value).is_dir() and self.desk.setup.runs == Path("runs"):
            self.desk.setup.runs = Path(value)


def _small(path: Path) -> QImage:
    """A figure as small as it is listed; read on a thread."""
    ways = Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
    return QImage(str(path)).scaled(_PICTURE * 2, *ways)


def _name(run: PastRun) -> str:
    return f"{run.name}, {run.started}"


PAGE = RunsPage
