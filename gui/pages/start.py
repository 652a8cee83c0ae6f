"""Start: go on with what was interrupted, or begin something new."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from gui import marks, words
from gui.model import Changes
from gui.pages.base import Desk, Page, card, scrolled
from gui.panels.base import quiet
from gui.past_runs import PastRun, past_runs
from gui.theme import Theme
from gui.work import Work
from instrument.states import FINAL

_LAST = 6  # runs that are listed


class StartPage(Page):
    """The ready plan, interrupted runs, last runs."""

    name = "start"
    title = "Start"
    sign = "house"
    tip = "Begin a scan, or go on with one that was interrupted"
    order = 0

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.resume_buttons: list[QPushButton] = []
        self._work = Work(self)
        self._work.finished.connect(self._show)
        inside = QWidget()
        self._column = QVBoxLayout(inside)
        self._column.setSpacing(8)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.addWidget(self._ready())
        self.interrupted, self._interrupted = card("Interrupted runs")
        self.last, self._last = card("Last runs")
        self._column.addWidget(self.interrupted)
        self._column.addWidget(self.last)
        self._column.addStretch(1)
        self.interrupted.hide()
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(scrolled(inside))
        self._rows: list[QWidget] = []
        self._show_ready()

    def _ready(self) -> QFrame:
        frame, body = card()
        self.heading, self.text = QLabel(), quiet()
        self.heading.setProperty("role", "heading")
        self.heading.setWordWrap(True)
        self.text.setWordWrap(True)
        self.begin = QPushButton("Run this plan  F5")
        self.begin.setProperty("role", "main")
        self.begin.setMinimumHeight(44)
        self.begin.clicked.connect(lambda: self.asked.emit("start"))
        self.change = QPushButton("Look at it or change it")
        self.change.setMinimumHeight(44)
        self.change.clicked.connect(lambda: self.go.emit("setup"))
        row = QHBoxLayout()
        texts = QVBoxLayout()
        texts.addWidget(self.heading)
        texts.addWidget(self.text)
        row.addLayout(texts, 1)
        row.addWidget(self.change)
        row.addWidget(self.begin)
        body.addLayout(row)
        return frame

    def enter(self) -> None:
        """Look for runs."""
        folder = self.desk.setup.runs
        self._work.do(lambda: past_runs(folder))
        self._show_ready()

    def hear(self, what: str) -> None:
        """Another plan is ready."""
        if what == "plan":
            self._show_ready()

    def refresh(self, changes: Changes) -> None:
        """What may be done depends on whether a scan runs."""
        if changes.state or changes.scan:
            self._show_ready()
            for button in self.resume_buttons:
                button.setEnabled(not self.model.busy)
            if self.isVisible() and not self.model.connected and self.model.state in FINAL:
                self.enter()

    def set_theme(self, theme: Theme) -> None:
        """Signs in other colours."""
        self.enter()

    def _show_ready(self) -> None:
        setup, model = self.desk.setup, self.model
        if model.connected:
            self.heading.setText(f"A scan is running: {model.title or 'being set up'}")
            self.text.setText("It has a process of its own: closing this window does not end it.")
        elif setup.plan is not None:
            self.heading.setText(f"Ready: {setup.plan.name}")
            self.text.setText(f"{setup.laboratory[:1].upper()}{setup.laboratory[1:]}. Nothing moves before you start.")
        else:
            self.heading.setText("No plan is chosen yet")
            self.text.setText("Open one (Ctrl+O), or make one on the page Set up.")
        self.begin.setEnabled(setup.plan is not None and not model.busy)

    def _show(self, runs: list[PastRun]) -> None:
        for row in self._rows:
            row.setParent(None)
            row.deleteLater()
        self._rows, self.resume_buttons = [], []
        broken = [run for run in runs if run.resumable]
        self.interrupted.setVisible(bool(broken))
        for run in broken[:_LAST]:
            self._rows.append(self._row(run, resume=True))
            self._interrupted.addWidget(self._rows[-1])
        for run in runs[:_LAST]:
            self._rows.append(self._row(run, resume=False))
            self._last.addWidget(self._rows[-1])
        if not runs:
            self._rows.append(quiet(f"No runs in {words.place(self.desk.setup.runs)} yet."))
            self._last.addWidget(self._rows[-1])

    def _row(self, run: PastRun, *, resume: bool) -> QWidget:
        widget, seen = QWidget(), run.row
        row = QHBoxLayout(widget)
        row.setContentsMargins(0, 0, 0, 0)
        sign = QLabel()
        kind = "pause" if resume else "check" if seen.outcome == "finished" else "ring"
        tone = {"pause": "hold", "check": "good"}.get(kind, "quiet")
        sign.setPixmap(marks.pixmap(kind, self.desk.theme.tone(tone), 18))
        title = run.name
        what = seen.problem or f"{seen.outcome}, {seen.measured} of {seen.planned} points"
        text = QLabel(f"{run.started}   {title}   ({what})")
        text.setToolTip(str(run.folder))
        text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        text.setMinimumWidth(10)
        row.addWidget(sign)
        row.addWidget(text, 1)
        if resume:
            missing = seen.planned - seen.measured - seen.skipped
            button = QPushButton(f"Go on with it: {missing} points are missing")
            button.setEnabled(not self.model.busy)
            button.clicked.connect(lambda: self._resume(run))
            self.resume_buttons.append(button)
        else:
            button = QPushButton("Open")
            button.setEnabled(run.readable)
            button.clicked.connect(lambda: self.told.emit(f"open:{run.folder}"))
        button.setAccessibleName(f"{button.text()}: {title}, {run.started}")
        row.addWidget(button)
        return widget

    def _resume(self, run: PastRun) -> None:
        self.desk.setup.resume = run.folder
        self.asked.emit("start")


PAGE = StartPage
