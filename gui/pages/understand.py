"""Understand: the diagnosis of a run, in a process of its own: where, which, how far, what next."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt, QTimer, QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import (
    QAbstractItemView,
    QFileDialog,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from gui import marks, words
from gui.child import Child
from gui.diagnosis_words import how_far_of, next_of, next_plan_of, verdict_of, where_of, which_of
from gui.model import Changes
from gui.pages.base import Desk, Page, card, explained, scrolled
from gui.panels.base import quiet
from gui.past_runs import DIAGNOSIS_NAME, REPORT_NAME, TWIN_NAME
from gui.theme import Theme
from gui.work import Work
from instrument.request import ARTIFACT_NAME, FACILITY_NAME, PLAN_NAME, material_of

_EFFECTS = ("Effect", "Probability", "How large", "Cannot be told from")
_LAST_WORDS = 6


class UnderstandPage(Page):
    """What to diagnose above, the answers below."""

    name = "understand"
    title = "Understand"
    sign = "lens"
    tip = "Why measurement and simulation differ"
    order = 60

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.found: dict[str, Any] = {}
        self.folder: Path | None = None
        self._said: list[str] = []
        self._child = Child(self)
        self._child.said.connect(self._hear_child)
        self._child.ended.connect(self._ended)
        self._prepare = Work(self)
        self._prepare.finished.connect(self._begin)
        self._prepare.failed.connect(self._complain)
        self._snapshot: tempfile.TemporaryDirectory[str] | None = None  # of a run that is not finished
        self._stopped = False
        self._began = 0.0
        self._second = QTimer(self)
        self._second.setInterval(1000)
        self._second.timeout.connect(self._show_time)
        inside = QWidget()
        column = QVBoxLayout(inside)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        column.addWidget(self._what())
        column.addWidget(self._headline())
        row = QHBoxLayout()
        row.setSpacing(8)
        self.where = self._answers(row, "Where")
        self.far = self._answers(row, "How far")
        column.addLayout(row)
        column.addWidget(self._which(), 1)
        column.addWidget(self._next())
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(scrolled(inside))
        self._show()

    # Layout

    def _what(self) -> QWidget:
        frame, body = card("Run")
        row = QHBoxLayout()
        self.line = QLineEdit()
        self.line.setPlaceholderText("run folder")
        self.line.setAccessibleName("Run folder to diagnose")
        self.line.editingFinished.connect(lambda: self._take(Path(self.line.text())) if self.line.text() else None)
        browse = QPushButton("…")
        browse.setAccessibleName("Choose a run folder")
        browse.clicked.connect(self._browse)
        self.this_scan = QPushButton("The scan on the screen")
        self.this_scan.setToolTip("Also while it runs: what is measured so far is diagnosed")
        self.this_scan.clicked.connect(lambda: self._take(Path(self.model.run_dir)))
        self.begin = QPushButton("Diagnose  Ctrl+D")
        self.begin.setShortcut("Ctrl+D")
        self.begin.setProperty("role", "main")
        self.begin.clicked.connect(self.diagnose)
        self.stop = QPushButton("Stop")
        self.stop.setToolTip("End the diagnosis; the run stays as it is")
        self.stop.clicked.connect(self._stop)
        row.addWidget(self.line, 1)
        for button in (browse, self.this_scan, self.begin, self.stop):
            row.addWidget(button)
        body.addLayout(row)
        self.bar = QProgressBar()
        self.bar.setRange(0, 0)
        self.bar.setTextVisible(False)
        self.bar.setAccessibleName("The diagnosis is being worked out")
        self.bar.hide()
        self.state = quiet("Choose a run. The diagnosis has a process of its own; the scan and the window go on.")
        self.state.setWordWrap(True)
        body.addWidget(self.bar)
        body.addWidget(self.state)
        return frame

    def _headline(self) -> QWidget:
        self.headline, body = card()
        row = QHBoxLayout()
        self.verdict_sign, self.verdict, self.verdict_text = QLabel(), QLabel(), quiet()
        self.verdict.setProperty("role", "heading")
        self.verdict.setWordWrap(True)
        self.verdict_text.setWordWrap(True)
        texts = QVBoxLayout()
        texts.addWidget(self.verdict)
        texts.addWidget(self.verdict_text)
        row.addWidget(self.verdict_sign)
        row.addLayout(texts, 1)
        self.report = QPushButton("Open the report")
        self.report.clicked.connect(self._open_report)
        self.apply = QPushButton("Use the corrected twin")
        self.apply.setToolTip("From the next start on the named effects, as found, are part of the prediction")
        self.apply.clicked.connect(self._apply)
        self.load = QPushButton("Load the next plan")
        self.load.setToolTip("The scan that is proposed below, on the page Set up")
        self.load.clicked.connect(self._load_plan)
        for button in (self.report, self.apply, self.load):
            row.addWidget(button)
        body.addLayout(row)
        return self.headline

    def _answers(self, row: QHBoxLayout, title: str) -> QLabel:
        frame, body = card(title)
        label = QLabel("–")
        label.setWordWrap(True)
        label.setAlignment(Qt.AlignmentFlag.AlignTop)
        label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        body.addWidget(label, 1)
        row.addWidget(frame, 1)
        return label

    def _which(self) -> QWidget:
        frame, body = card("Which")
        self.effects = QTableWidget(0, len(_EFFECTS))
        self.effects.setHorizontalHeaderLabels(_EFFECTS)
        self.effects.setAccessibleName("Effects by their probability")
        self.effects.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.effects.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.effects.setTabKeyNavigation(False)
        self.effects.setShowGrid(False)
        self.effects.verticalHeader().hide()
        self.effects.setMinimumHeight(118)
        self.effects.verticalHeader().setDefaultSectionSize(22)
        header = self.effects.horizontalHeader()
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft)
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(3, QHeaderView.ResizeMode.Stretch)
        body.addWidget(self.effects, 1)
        return frame

    def _next(self) -> QWidget:
        frame, body = card("What next")
        self.next = QLabel("–")
        self.next.setWordWrap(True)
        self.next.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        body.addWidget(self.next)
        return frame

    # What is diagnosed

    def hear(self, what: str) -> None:
        """Another page names a run."""
        if what.startswith("run:"):
            self._take(Path(what.removeprefix("run:")))

    def enter(self) -> None:
        """Offer the scan on the screen where nothing is chosen."""
        if self.folder is None and self.model.run_dir and Path(self.model.run_dir).is_dir():
            self._take(Path(self.model.run_dir))

    def _browse(self) -> None:
        name = QFileDialog.getExistingDirectory(self, "Run folder", str(self.desk.setup.runs))
        if name:
            self._take(Path(name))

    def _take(self, folder: Path) -> None:
        """Choose a run, and show its diagnosis where it has one."""
        if self._child.running:
            return
        self.folder, self.found = folder, {}
        self.line.setText(str(folder))
        self.state.setText("Not diagnosed yet.")
        try:
            self.found = json.loads((folder / DIAGNOSIS_NAME).read_text(encoding="utf-8"))
            self.state.setText(f"Diagnosed before: {folder / DIAGNOSIS_NAME}")
        except FileNotFoundError:
            self.found = {}
        except (OSError, ValueError) as error:
            self.state.setText(f"⚠ {folder / DIAGNOSIS_NAME}: {error}")
        self._show()

    # Diagnosing

    def diagnose(self) -> None:
        """Diagnose the chosen run; one that is not finished as far as it is measured."""
        if self.folder is None or self._child.running or self._prepare.busy:
            return
        folder = self.folder
        self._stopped = False
        self._said.clear()
        self.state.setText("Reading the run…")
        self._snapshot = tempfile.TemporaryDirectory(prefix="goniotwin-snapshot-")
        so_far = Path(self._snapshot.name) / "so-far.nc"
        self._prepare.do(lambda: _arguments(folder, so_far))

    def _begin(self, arguments: list[str]) -> None:
        self._began = time.monotonic()
        self._child.run("instrument", arguments)
        self._second.start()
        self._show_time()
        self._show()

    def _stop(self) -> None:
        self._stopped = True
        self._child.stop()

    def _hear_child(self, text: str) -> None:
        self._said += [line.strip() for line in text.splitlines() if line.strip()]
        del self._said[:-_LAST_WORDS]

    def _show_time(self) -> None:
        doing = self._said[-1] if self._said else "preparing"
        self.state.setText(f"Working for {words.duration(time.monotonic() - self._began)}: {doing}")

    def _ended(self, status: int) -> None:
        self._second.stop()
        self._drop_snapshot()
        took = words.duration(time.monotonic() - self._began)
        assert self.folder is not None
        folder = self.folder
        if self._stopped:
            self.state.setText("Stopped; the run stays as it is.")
        elif status != 0:
            reason = " ".join(self._said) or f"status {status}"
            self.state.setText(f"⚠ No diagnosis: {reason}")
        else:
            self._take(folder)
            self.state.setText(f"Done in {took}: {folder / DIAGNOSIS_NAME}")
        self._show()

    def _drop_snapshot(self) -> None:
        if self._snapshot is not None:
            self._snapshot.cleanup()
            self._snapshot = None

    def _complain(self, error: Exception) -> None:
        self._drop_snapshot()
        self.state.setText(f"⚠ {explained(error)}")
        self._show()

    # What was found

    def _show(self) -> None:
        running, found, folder = self._child.running, self.found, self.folder
        self.bar.setVisible(running)
        self.begin.setEnabled(folder is not None and not running)
        self.stop.setEnabled(running)
        self.this_scan.setEnabled(bool(self.model.run_dir) and not running)
        self.headline.setVisible(bool(found))
        self.report.setEnabled(folder is not None and (folder / REPORT_NAME).is_file())
        twin = folder is not None and (folder / TWIN_NAME).is_file() and bool(found.get("effects"))
        self.apply.setEnabled(twin)
        proposed = bool(next_plan_of(found))
        planned = folder is not None and (folder / PLAN_NAME).is_file()
        self.load.setEnabled(bool(found) and (proposed or planned))
        self.load.setText("Load the next plan" if proposed else "Make the next plan of this one")
        if found:
            verdict, theme = verdict_of(found), self.desk.theme
            self.verdict_sign.setPixmap(marks.pixmap(verdict.sign, theme.tone(verdict.tone), 40))
            self.verdict.setText(verdict.title)
            self.verdict_text.setText(verdict.text)
        self.where.setText("\n".join(f"• {line}" for line in where_of(found)) if found else "–")
        self.far.setText("\n".join(f"• {line}" for line in how_far_of(found)) if found else "–")
        self.next.setText("\n".join(f"• {line}" for line in next_of(found)) if found else "–")
        rows = which_of(found)
        self.effects.setRowCount(len(rows))
        for row, texts in enumerate(rows):
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                self.effects.setItem(row, column, item)

    def _open_report(self) -> None:
        if self.folder is not None:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str((self.folder / REPORT_NAME).resolve())))

    def _apply(self) -> None:
        if self.folder is not None:
            self.desk.setup.corrections = (self.folder / TWIN_NAME).resolve()
            self.told.emit("setup")
            self.said.emit("The next start predicts with the corrected twin (page Set up, Corrections)")

    def _load_plan(self) -> None:
        if self.folder is None:
            return
        text = next_plan_of(self.found)
        path = (self.folder / PLAN_NAME).resolve()
        if text:
            path = self.folder.resolve() / "next-plan.toml"
            path.write_text(text, encoding="utf-8")
        self.desk.setup.plan = path
        self.told.emit("plan")
        self.go.emit("setup")
        if not text:
            self.said.emit(f"Change this plan and save it under another name. {self.next.text().splitlines()[0]}")

    def set_theme(self, theme: Theme) -> None:
        """Sign of the verdict in other colours."""
        self._show()

    def refresh(self, changes: Changes) -> None:
        """The scan on the screen may be another one."""
        if changes.scan:
            self.this_scan.setEnabled(bool(self.model.run_dir) and not self._child.running)


def _arguments(folder: Path, so_far: Path) -> list[str]:
    """The command line of a diagnosis; an unfinished run is written to the file ``so_far`` first.

    Raises
    ------
    InputError
        If the folder holds no run.
    """
    from instrument.run_build import rebuild_run
    from instrument.run_folder import RUN_NAME
    from instrument.run_write import write_run

    words_ = ["diagnose"]
    if (folder / RUN_NAME).is_file():
        words_.append(str(folder))
    else:
        write_run(rebuild_run(folder), so_far)
        words_.append(str(so_far))
        named = {"--facility": folder / FACILITY_NAME, "--artifact": folder / ARTIFACT_NAME}
        for option, path in named.items():
            words_ += [option, str(path)]
        words_ += ["--material", str(material_of(folder))]
    words_ += ["--json", str(folder / DIAGNOSIS_NAME), "--report", str(folder / REPORT_NAME)]
    # Diagnosing a run again is asked for: the earlier answer stands on the page.
    return [*words_, "--save-twin", str(folder / TWIN_NAME), "--force"]


PAGE = UnderstandPage
