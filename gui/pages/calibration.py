"""Calibration: dark level, reference and the other procedures, each with its last result, led step by step."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHBoxLayout,
    QHeaderView,
    QLineEdit,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)

from gui import marks, words
from gui.guided import Guided, laboratory_arguments
from gui.model import Changes
from gui.pages.base import Desk, Page, RoomyRows, card, fill
from gui.panels.base import quiet
from gui.procedures import Procedure, procedures
from gui.theme import Theme
from gui.work import Work

_HEADS = ("Procedure", "Last result", "When", "What it found")
_SIGNS = {"passed": ("check", "good"), "failed": ("warning", "bad"), "recorded": ("disc", "quiet")}


class CalibrationPage(Page):
    """Procedures on the left, the one that runs on the right; the reference of the scan below."""

    name = "calibration"
    title = "Calibrate"
    sign = "balance"
    tip = "Dark level, reference, gains, linearity, wavelength"
    order = 30

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.procedures: list[Procedure] = []
        self._listed: tuple[list[Procedure], Theme] = ([], desk.theme)
        self._work = Work(self)
        self._work.finished.connect(self._show)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        column = QVBoxLayout()
        column.setSpacing(8)
        frame, body = card("Procedures")
        self.table = QTableWidget(0, len(_HEADS))
        self.table.setHorizontalHeaderLabels(_HEADS)
        self.table.setAccessibleName("Procedures and their last results")
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setTabKeyNavigation(False)
        self.table.setShowGrid(False)
        self.table.setWordWrap(True)
        self.table.setItemDelegate(RoomyRows(self.table))
        self.table.verticalHeader().hide()
        self.table.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header = self.table.horizontalHeader()
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft)
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(3, QHeaderView.ResizeMode.Stretch)
        self.table.itemSelectionChanged.connect(self._choose)
        self.table.itemActivated.connect(lambda _: self.run())
        body.addWidget(self.table, 1)
        self.about = quiet()
        self.about.setWordWrap(True)
        body.addWidget(self.about)
        self.subject = QLineEdit()
        self.subject.setPlaceholderText("name of the control sample")
        self.subject.setAccessibleName("Name of the control sample")
        self.subject.textChanged.connect(lambda _: self._choose())
        body.addWidget(self.subject)
        self.begin = QPushButton("Carry it out")
        self.begin.setProperty("role", "main")
        self.begin.setMinimumHeight(36)
        self.begin.clicked.connect(self.run)
        body.addWidget(self.begin)
        column.addWidget(frame, 3)
        reference, body = card("Reference of the scan")
        self.reference = quiet()
        self.reference.setWordWrap(True)
        body.addWidget(self.reference)
        column.addWidget(reference)
        row.addLayout(column, 1)
        self.guided = Guided(desk, "What runs")
        self.guided.ended.connect(lambda _: self.enter())
        row.addWidget(self.guided, 1)
        self._show_reference()
        self._choose()

    def enter(self) -> None:
        """Read the last results."""
        folder = self.desk.setup.calibrations
        self._work.do(lambda: procedures(folder))

    def _show(self, found: list[Procedure]) -> None:
        self.procedures = found
        row = max(self.table.currentRow(), 0)
        if (found, self.desk.theme) != self._listed:
            self._listed = list(found), self.desk.theme
            fill(self.table, lambda: self._put(found))
        if found:
            self.table.selectRow(min(row, len(found) - 1))
        self._choose()

    def _put(self, found: list[Procedure]) -> None:
        self.table.setRowCount(len(found))
        for index, each in enumerate(found):
            texts = (each.command.replace("-", " "), each.verdict or "never", each.age, each.summary or each.text)
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                item.setToolTip(each.text)
                if column == 1:
                    sign, tone = _SIGNS.get(each.verdict, ("ring", "quiet"))
                    item.setIcon(marks.icon(sign, self.desk.theme.tone(tone)))
                self.table.setItem(index, column, item)

    def chosen(self) -> Procedure | None:
        """The chosen procedure."""
        row = self.table.currentRow()
        return self.procedures[row] if 0 <= row < len(self.procedures) else None

    def _choose(self) -> None:
        one = self.chosen()
        setup = self.desk.setup
        why = ""
        named = one is not None and one.needed == ("sample",)
        self.subject.setVisible(named)
        if named and not self.subject.text().strip():
            why = " It needs the name of the control sample."
        elif one is not None and one.needed and not named:
            why = f" It needs {', '.join(one.needed)}: goniotwin calibrate {one.command} --help."
        elif setup.devices is None and not setup.simulate:
            why = " It needs a laboratory: goniotwin gui --devices, or --simulate."
        elif self.model.busy:
            why = " The instrument is taken; wait until the scan or the procedure is over."
        self.about.setText((one.text if one else "Choose a procedure.") + why)
        self.begin.setEnabled(one is not None and not why)

    def run(self) -> None:
        """Carry the chosen procedure out."""
        one = self.chosen()
        if one is None or not self.begin.isEnabled():
            return
        subject = [self.subject.text().strip()] if one.needed else []
        words_ = ["calibrate", one.command, *laboratory_arguments(self.desk), *(["--", *subject] if subject else [])]
        self.guided.run(one.command.replace("-", " ").capitalize(), words_)
        self._choose()

    def set_theme(self, theme: Theme) -> None:
        """Signs in other colours."""
        self._show(self.procedures)

    def refresh(self, changes: Changes) -> None:
        """Show the reference of the scan; procedures have to wait for it."""
        if changes.state or changes.scan:
            self._choose()
        if changes.current or changes.scan:
            self._show_reference()

    def _show_reference(self) -> None:
        readings = self.model.references
        if not readings:
            self.reference.setText(
                "Every scan measures the reference first, at each azimuth, and the dark level with every reading."
                " Its readings stand here, and over time on the page Watch."
            )
            return
        lines = [
            f"{words.clock_time(r.time)} UTC   azimuth {words.angle(r.sensor_azimuth)}   {words.current(r.current)}"
            f" ± {100 * r.relative_standard_error:.2g} %"
            for r in readings[-8:]
        ]
        first: dict[float, float] = {}
        for r in readings:
            first.setdefault(r.sensor_azimuth, r.current)
        last = {r.sensor_azimuth: r.current for r in readings}
        if len(readings) > len(first):
            drift = max(abs(last[a] / first[a] - 1) for a in first if first[a])
            lines.append(f"Largest drift from the first to the last reading: {100 * drift:.2g} %")
        self.reference.setText("\n".join(lines))


PAGE = CalibrationPage
