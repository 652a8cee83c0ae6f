"""Look back: every run with plan, date, state and figures; open, compare, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtCore import QSettings, QSize, Qt, QUrl
from PySide6.QtGui import QDesktopServices, QIcon, QImage, QPixmap
from PySide6.QtWidgets import (
    QAbstractItemView,
    QFileDialog,
    QHBoxLayout,
    QHeaderView,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from gui import marks, words
from gui.child import Child
from gui.compare_window import CompareWindow
from gui.model import Changes
from gui.pages.base import Desk, Page, card, explained
from gui.panels.base import quiet
from gui.past_runs import PastRun, past_runs
from gui.work import Work
from instrument.states import FINAL

_HEADS = ("Started (UTC)", "Title", "Points", "State", "Operator", "Sample", "Figures", "Folder")
REPORT_NAME = "report.html"
_WORDS_KEPT = 1000  # characters of what the report's process says
_PICTURE, _PICTURES = QSize(180, 110), 24  # size and number of the figures that are listed
#: State of a run: sign and tone.
_STATES = {
    "finished": ("check", "good"),
    "aborted": ("square", "quiet"),
    "interrupted": ("pause", "hold"),
    "halted": ("cross", "bad"),
    "faulted": ("warning", "bad"),
}


class RunsPage(Page):
    """Table of runs above, what the chosen one holds below."""

    name = "runs"
    title = "Look back"
    sign = "folder"
    tip = "Earlier runs: open, compare, report"
    order = 70

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.runs: list[PastRun] = []
        self._shown: list[PastRun] = []
        self._list, self._open, self._read = Work(self), Work(self), Work(self)
        self._read.finished.connect(self._show_figures)
        self._child = Child(self)
        self._child.said.connect(self._hear_child)
        self._child.ended.connect(self._report_ended)
        self._reported, self._words = Path(REPORT_NAME), ""
        self._list.finished.connect(self._show)
        self._open.finished.connect(lambda task: task())
        self._open.failed.connect(self._complain)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        frame, body = card()
        body.addLayout(self._head())
        self.table = self._table()
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
        self.search = QLineEdit()
        self.search.setPlaceholderText("find: title, state, operator, sample, date")
        self.search.setAccessibleName("Find runs")
        self.search.setClearButtonEnabled(True)
        self.search.textChanged.connect(lambda _: self._fill())
        for text, tip, slot in (
            ("Folder…", "Another folder with runs", self._choose_folder),
            ("Read again", "Read the folder again", self.read),
        ):
            button = QPushButton(text)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            row.addWidget(button)
        row.addWidget(self.where)
        row.addWidget(self.search, 1)
        return row

    def _table(self) -> QTableWidget:
        table = QTableWidget(0, len(_HEADS))
        table.setHorizontalHeaderLabels(_HEADS)
        table.setAccessibleName("Runs, newest first")
        table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        table.setTabKeyNavigation(False)
        table.setShowGrid(False)
        table.verticalHeader().hide()
        table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        table.horizontalHeader().setSectionResizeMode(1, QHeaderView.ResizeMode.Stretch)
        table.horizontalHeader().setDefaultAlignment(Qt.AlignmentFlag.AlignLeft)
        table.itemSelectionChanged.connect(self._choose)
        table.itemActivated.connect(lambda _: self._open_run())
        return table

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
        self.no_figures = quiet("No figures. They are drawn at the end of a scan that the twin watched.")
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
        """Read the folder again, on a thread."""
        folder = self.desk.setup.runs
        self.where.setText(words.place(folder))
        self._list.do(lambda: past_runs(folder))

    def _choose_folder(self) -> None:
        name = QFileDialog.getExistingDirectory(self, "Folder with runs", str(self.desk.setup.runs))
        if name:
            self.desk.setup.runs = Path(name)
            self.desk.settings.setValue("runs", name)
            self.read()

    def _show(self, runs: list[PastRun]) -> None:
        self.runs = runs
        self._fill()

    def _fill(self) -> None:
        wanted = self.search.text().lower().split()
        self._shown = [run for run in self.runs if all(word in _texts(run).lower() for word in wanted)]
        self.table.setRowCount(len(self._shown))
        for row, run in enumerate(self._shown):
            for column, text in enumerate(_row(run)):
                item = QTableWidgetItem(text)
                item.setToolTip(run.overview.problem or str(run.folder))
                if column == 3:
                    sign, tone = _STATES.get(run.overview.outcome, ("warning", "bad"))
                    item.setIcon(marks.icon(sign, self.desk.theme.tone(tone)))
                self.table.setItem(row, column, item)
        if self._shown:
            self.table.selectRow(0)
        self._choose()

    def chosen(self) -> list[PastRun]:
        """The chosen runs."""
        rows = sorted({index.row() for index in self.table.selectionModel().selectedRows()})
        return [self._shown[row] for row in rows if row < len(self._shown)]

    def _choose(self) -> None:
        chosen = self.chosen()
        one = chosen[0] if len(chosen) == 1 else None
        readable = one is not None and not one.overview.problem and one.overview.measured > 0
        idle = not self.model.connected
        self.buttons["open"].setEnabled(readable and idle)
        self.buttons["compare"].setEnabled(len(chosen) == 2)
        self.buttons["resume"].setEnabled(one is not None and one.resumable and not self.model.busy)
        self.buttons["diagnose"].setEnabled(readable)
        self.buttons["report"].setEnabled(readable and not self._child.running)
        self.buttons["folder"].setEnabled(one is not None)
        self.figures.clear()
        paths = one.figures[:_PICTURES] if one else ()
        self.figures.setVisible(bool(paths))
        self.no_figures.setVisible(not paths)
        self._read.do(lambda: [(path, _small(path)) for path in paths])
        if one is not None and one.overview.problem:
            self._say(one.overview.problem)
        else:
            self._say("")

    def _show_figures(self, pictures: list[tuple[Path, QImage]]) -> None:
        self.figures.clear()
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

    def restore(self, settings: QSettings) -> None:
        """The folder of last time, where none was given."""
        value = settings.value("runs")
        if isinstance(value, str) and Path(value).is_dir() and self.desk.setup.runs == Path("runs"):
            self.desk.setup.runs = Path(value)


def _small(path: Path) -> QImage:
    """A figure as small as it is listed; read on a thread."""
    ways = Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
    return QImage(str(path)).scaled(_PICTURE * 2, *ways)


def _row(run: PastRun) -> tuple[str, ...]:
    row = run.overview
    started = row.created[:16].replace("T", " ")
    points = f"{row.measured} of {row.planned}" if not row.problem else ""
    state = row.outcome or "cannot be read"
    figures = f"{len(run.figures)}" + (" + report" if run.report else "")
    return (started, row.title, points, state, row.operator, row.sample, figures, run.folder.name)


def _texts(run: PastRun) -> str:
    return " ".join(_row(run))


def _name(run: PastRun) -> str:
    return f"{run.overview.title or run.folder.name}, {run.overview.created[:16].replace('T', ' ')}"


PAGE = RunsPage
