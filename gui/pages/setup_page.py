"""Set-up: the plan, what it means for the arms, and what is kept with the run."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import (
    QComboBox,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from gui import marks, words
from gui.model import Changes
from gui.pages.base import Desk, SplitPage, card, explained, scrolled
from gui.pages.plan_points import PlanPoints
from gui.pages.plan_table import PlanTableView
from gui.pages.run_form import RunForm
from gui.panels.base import quiet
from gui.plan_cells import PlanDraft
from gui.plan_check import Checked, Wrong, check_draft, limits_of
from gui.theme import Theme
from gui.work import Work
from instrument.errors import InputError

_WAIT_MS = 250  # after the last key, before the whole plan is checked


class SetupPage(SplitPage):
    """Plan table and run form on the left, the points on the right."""

    name = "setup"
    title = "Set up"
    sign = "table"
    tip = "The plan, sample, operator and output of the next run"
    order = 20

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.draft = PlanDraft()
        self.checked: Checked | None = None
        self._work = Work(self)
        self._work.finished.connect(self._show_check)
        self._work.failed.connect(lambda error: self._show_check(Wrong(explained(error))))
        self._soon = QTimer(self)
        self._soon.setSingleShot(True)
        self._soon.setInterval(_WAIT_MS)
        self._soon.timeout.connect(self.check)
        self.points = PlanPoints(self.desk.theme)
        self.points.start.clicked.connect(lambda: self.asked.emit("start"))
        self.facts, self.map = self.points.facts, self.points.map
        self.readout, self.start = self.points.readout, self.points.start
        self.stand(scrolled(self._left()), self.points, sizes=(700, 520))
        self.hear("plan")

    # Layout

    def _left(self) -> QWidget:
        left = QWidget()
        column = QVBoxLayout(left)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        plan, body = card("Plan")
        files = QHBoxLayout()
        self.where = quiet()
        self.where.setWordWrap(True)
        for text, tip, slot in (
            ("New", "A small plan to begin with", self._new),
            ("Open…", "Open a plan (Ctrl+O)", self._open),
            ("Save", "Save the plan (Ctrl+S)", self._save),
            ("Save as…", "Save under another name (Ctrl+Shift+S)", self._save_as),
        ):
            button = QPushButton(text)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            if "(Ctrl+S)" in tip:
                button.setShortcut("Ctrl+S")
            if "Shift" in tip:
                button.setShortcut("Ctrl+Shift+S")
            files.addWidget(button)
        files.addWidget(self.where, 1)
        body.addLayout(files)
        heads = QHBoxLayout()
        self.title_line = QLineEdit()
        self.title_line.setPlaceholderText("title of the plan")
        self.title_line.setAccessibleName("Title of the plan")
        self.title_line.textEdited.connect(lambda text: self._set("title", text))
        self.samples = QSpinBox()
        self.samples.setRange(1, 10_000)
        self.samples.setAccessibleName("Samples of a reading")
        self.samples.valueChanged.connect(lambda number: self._set("samples", number))
        self.direction = QComboBox()
        self.direction.addItems(["unidirectional", "serpentine"])
        self.direction.setAccessibleName("Direction of the zenith sweeps")
        self.direction.currentTextChanged.connect(lambda text: self._set("direction", text))
        for label, widget, stretch in (
            ("Title", self.title_line, 1),
            ("Samples", self.samples, 0),
            ("Sweeps", self.direction, 0),
        ):
            heads.addWidget(QLabel(label))
            heads.addWidget(widget, stretch)
        body.addLayout(heads)
        self.table = PlanTableView(self.desk.theme)
        self.table.edited.connect(self._edited)
        self.table.complained.connect(self._complain)
        body.addWidget(self.table, 1)
        rows = QHBoxLayout()
        for text, slot in (("Add a row", self._add), ("Remove the row", self._remove)):
            button = QPushButton(text)
            button.clicked.connect(slot)
            rows.addWidget(button)
        rows.addWidget(quiet("Values with commas, or start : stop : step"), 1)
        body.addLayout(rows)
        self.mark, self.problem = QLabel(), QLabel()
        self.problem.setWordWrap(True)
        self.problem.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        complaint = QHBoxLayout()
        complaint.addWidget(self.mark, 0, Qt.AlignmentFlag.AlignTop)
        complaint.addWidget(self.problem, 1)
        body.addLayout(complaint)
        column.addWidget(plan, 1)
        self.form = RunForm(self.desk)
        self.form.changed.connect(lambda: self.told.emit("setup"))
        column.addWidget(self.form)
        return left

    # Files

    def hear(self, what: str) -> None:
        """Another page, or the menu, has chosen a plan or a facility."""
        if what == "plan" and self.desk.setup.plan is not None and self.desk.setup.plan != self.draft.path:
            self._load(self.desk.setup.plan)
        elif what == "plan" and self.draft.path is None:
            self._show_draft()
        if what == "setup":
            self.form.show_setup()

    def _load(self, path: Path) -> None:
        try:
            if path.suffix.lower() == ".csv":
                content = {"version": 1, "title": path.stem, "part": [{"table": path.name}]}
                self.draft = PlanDraft(content, path)
            else:
                self.draft = PlanDraft.read(path)
        except InputError as error:
            self._show_check(Wrong(str(error)))
            return
        self._show_draft()

    def _new(self) -> None:
        self.draft = PlanDraft()
        self._show_draft()

    def _open(self) -> None:
        name, _ = QFileDialog.getOpenFileName(
            self, "Open plan", self.desk.folder("plan"), "Plans (*.toml *.csv);;All files (*)"
        )
        if name:
            self.desk.remember_folder("plan", Path(name))
            self.desk.setup.plan = Path(name)
            self._load(Path(name))
            self.told.emit("plan")

    def _save(self) -> None:
        if self.draft.path is None or self.draft.path.suffix.lower() == ".csv" or self._is_example():
            self._save_as()
        else:
            self._write(self.draft.path)

    def _is_example(self) -> bool:
        return self.draft.path is not None and self.draft.path == self.desk.setup.example_plan

    def _save_as(self) -> None:
        folder = self.desk.folder("plan")
        name, _ = QFileDialog.getSaveFileName(self, "Save plan", f"{folder}/plan.toml", "Plans (*.toml)")
        if name:
            self._write(Path(name).with_suffix(".toml"))

    def _write(self, path: Path) -> None:
        try:
            self.draft.save(path)
        except InputError as error:
            self._complain(str(error))
            return
        self.desk.remember_folder("plan", path)
        self.desk.setup.plan = path
        self._dirty = False
        self._show_where()
        self.start.setEnabled(self._can_start())
        self.told.emit("plan")
        self.said.emit(f"Saved: {path}")

    # Editing

    _dirty = False

    def _show_draft(self) -> None:
        self._dirty = False
        content = self.draft.content
        for widget in (self.samples, self.direction):
            widget.blockSignals(True)
        self.title_line.setText(str(content.get("title", "")))
        samples = content.get("samples", 9)
        self.samples.setValue(samples if isinstance(samples, int) else 9)
        self.direction.setCurrentText(str(content.get("direction", "unidirectional")))
        for widget in (self.samples, self.direction):
            widget.blockSignals(False)
        try:
            limits = limits_of(self.desk.setup.known_facility)
        except InputError as error:
            limits = limits_of(None)
            self._complain(str(error))
        self.table.show_draft(self.draft, limits)
        self._show_where()
        self.check()

    def _show_where(self) -> None:
        path = self.draft.path
        home = (
            "the simulated laboratory's own" if self._is_example() else f"in {words.place(path.parent)}" if path else ""
        )
        name = f"{path.name}, {home}" if path else "not saved yet"
        self.where.setText(name + (" (changed)" if self._dirty else ""))
        self.desk.setup.unsaved = self._dirty

    def _set(self, key: str, new: Any) -> None:
        self.draft.content[key] = new
        self._edited()

    def _edited(self) -> None:
        self._dirty = True
        self._show_where()
        self._soon.start()

    def _add(self) -> None:
        self.draft.add()
        self.table.fill()
        self._edited()

    def _remove(self) -> None:
        row = self.table.currentRow()
        if 0 <= row < len(self.draft.parts) and len(self.draft.parts) > 1:
            del self.draft.parts[row]
            self.table.fill()
            self._edited()

    def _complain(self, text: str) -> None:
        theme = self.desk.theme
        self.problem.setText(text)
        self.mark.setPixmap(marks.pixmap("warning" if text else "check", theme.bad if text else theme.good, 18))
        self.start.setEnabled(not text and self._can_start())

    # What it means

    def check(self) -> None:
        """Check the plan as it stands, on a thread."""
        draft = PlanDraft(copy.deepcopy(self.draft.content), self.draft.path)
        facility, devices = self.desk.setup.known_facility, self.desk.setup.devices
        self.problem.setText("Checking…")
        self._work.do(lambda: check_draft(draft, facility, devices))

    def _show_check(self, result: Checked | Wrong) -> None:
        if isinstance(result, Wrong):
            self.checked = None
            self.table.mark(result.row, result.key)
            self._complain(result.text)
            for fact in self.facts.values():
                fact.setText("–")
            return
        self.checked = result
        if self.table.wrong:
            self.table.mark(-1, "")
        summary, plan = result.summary, result.plan
        self._complain("")
        self.problem.setText(
            "Every point and every way between points can be taken."
            + (" Save the plan before it can run." if self._dirty or self.draft.path is None else "")
        )
        reasons = sorted({blocked.reason for blocked in plan.blocked})
        blocked = f"{len(plan.blocked)}: {'; '.join(reasons)}" if plan.blocked else "none"
        self.facts["Points"].setText(
            f"{len(plan.points)}, and {summary['reference_readings']} readings of the reference"
        )
        self.facts["Blocked"].setText(blocked)
        self.facts["Takes about"].setText(f"{words.duration(summary['duration_s'])} of laboratory time")
        detours = f", {summary['detours']} ways around the shadow cone" if summary["detours"] else ""
        self.facts["Arms move"].setText(f"{words.duration(summary['moving_time_s'])}{detours}")
        self.start.setEnabled(self._can_start())
        self.points.show_plan(plan)

    def _can_start(self) -> bool:
        saved = self.draft.path is not None and not self._dirty
        return saved and self.checked is not None and not self.model.busy

    # As every page

    def refresh(self, changes: Changes) -> None:
        """A start is possible while nothing runs."""
        if changes.state or changes.scan:
            self.start.setEnabled(self._can_start())

    def set_theme(self, theme: Theme) -> None:
        """Use other colours."""
        self.table.theme = theme
        self.table.fill()
        self.map.set_theme(theme)


PAGE = SetupPage
