"""Instrument: every device with state and last word, the last preflight, and alignment step by step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHBoxLayout,
    QHeaderView,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)

from gui import marks
from gui.child import Child
from gui.guided import Guided, laboratory_arguments
from gui.model import Changes
from gui.pages.base import Desk, Page, RoomyRows, card, fill
from gui.panels.base import quiet
from gui.theme import Theme
from gui.work import Work

_DEVICES = ("Device", "State", "Last word", "Who it says it is")
_CHECKS = ("Check", "State", "Found")


class InstrumentPage(Page):
    """Devices on the left, preflight and alignment on the right."""

    name = "instrument"
    title = "Instrument"
    sign = "arms"
    tip = "Devices, preflight and alignment"
    order = 10

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._child = Child(self)
        self._child.said.connect(self._hear_child)
        self._child.ended.connect(self._child_ended)
        self._rest = ""
        self._work = Work(self)
        self._work.finished.connect(self._show_preflight)
        self.results: list[dict[str, Any]] = []
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        devices, body = card("Devices")
        self.devices = _table(_DEVICES, "Devices: state, last word, identity")
        body.addWidget(self.devices, 1)
        self.say = quiet("Nothing is asked yet. Asking moves nothing.")
        self.say.setWordWrap(True)
        body.addWidget(self.say)
        self.ask = QPushButton("Ask every device")
        self.ask.setProperty("role", "main")
        self.ask.setMinimumHeight(36)
        self.ask.setToolTip("Who are you, how are you? Nothing moves, no light.")
        self.ask.clicked.connect(self.ask_devices)
        body.addWidget(self.ask)
        row.addWidget(devices, 3)
        column = QVBoxLayout()
        column.setSpacing(8)
        preflight, body = card("Last preflight")
        self.when = quiet("Every scan begins with one: limits, cone, devices, dark level, disk, age of the reference.")
        self.when.setWordWrap(True)
        self.checks = _table(_CHECKS, "Checks of the last preflight")
        body.addWidget(self.when)
        body.addWidget(self.checks, 1)
        column.addWidget(preflight, 3)
        self.guided = Guided(desk, "Alignment, step by step")
        self.align = QPushButton("Begin the alignment")
        self.align.setToolTip("Every step is confirmed by a person and recorded")
        self.align.clicked.connect(lambda: self.guided.run("Alignment", ["align", *laboratory_arguments(desk)]))
        self.guided.add_button(self.align)
        column.addWidget(self.guided, 3)
        row.addLayout(column, 3)

    def ask_devices(self) -> None:
        """Ask every device, in a process of its own."""
        setup = self.desk.setup
        if self._child.running or (setup.devices is None and not setup.simulate):
            self.say.setText("Name a laboratory first: goniotwin gui --devices devices.toml, or --simulate.")
            return
        self.results, self._rest = [], ""
        self.devices.setRowCount(0)
        self.say.setText("Asking… (the simulated laboratory is started for it)" if setup.simulate else "Asking…")
        self.ask.setEnabled(False)
        words = ["--simulate", f"{setup.speed:g}"] if setup.simulate else [str(setup.devices)]
        self._child.run("gui.device_check", words)

    def _hear_child(self, text: str) -> None:
        *lines, self._rest = (self._rest + text).split("\n")
        for line in lines:
            try:
                found = json.loads(line)
            except ValueError:
                continue  # a warning of a library
            if "error" in found:
                self.say.setText(f"⚠ {found['error']}")
            else:
                self.results.append(found)
                self._add(found)

    def _add(self, found: dict[str, Any]) -> None:
        good = bool(found.get("ok"))
        last = found.get("problem") or found.get("cause") or found.get("state") or ""
        texts = (found.get("role", ""), "answers" if good else "needs you", last, _words(found.get("identity", "")))
        _append(self, self.devices, texts, good)

    def set_theme(self, theme: Theme) -> None:
        """Signs in other colours."""
        for table in (self.devices, self.checks):
            for row in range(table.rowCount()):
                if (item := table.item(row, 1)) is not None:
                    _sign(item, theme)

    def _child_ended(self, status: int) -> None:
        self._set_enabled()
        good = sum(bool(found.get("ok")) for found in self.results)
        if self.results:
            bad = len(self.results) - good
            self.say.setText(
                f"All {good} devices answer."
                if not bad
                else f"{bad} of {len(self.results)} need you: switch them on, look at the cable, then ask again."
            )
        elif not self.say.text().startswith("⚠"):
            self.say.setText(f"⚠ The question failed (status {status}). Is another program using the instrument?")

    def _set_enabled(self) -> None:
        free = not self.model.busy
        self.ask.setEnabled(free and not self._child.running)
        self.align.setEnabled(free)

    def enter(self) -> None:
        """Show the last preflight."""
        if self.model.run_dir:
            folder = Path(self.model.run_dir)
            self._work.do(lambda: _last_preflight(folder))

    def _show_preflight(self, found: tuple[str, list[dict[str, Any]]]) -> None:
        when, checks = found
        if not checks:
            return
        self.when.setText(f"{when[:19].replace('T', ' ')} UTC, before the run {Path(self.model.run_dir).name}")
        fill(self.checks, lambda: self._put(checks))

    def _put(self, checks: list[dict[str, Any]]) -> None:
        self.checks.setRowCount(0)
        for check in checks:
            good = bool(check.get("passed"))
            _append(self, self.checks, (check["name"], "good" if good else "not good", check.get("found", "")), good)

    def refresh(self, changes: Changes) -> None:
        """Devices can only be asked while no scan has them."""
        if not (changes.state or changes.scan):
            return
        self._set_enabled()
        if self.model.connected and not self._child.running:
            self.say.setText("A scan has the devices; what they say stands in the messages below.")
        if self.isVisible() and self.model.state.value in ("homing", "mounting"):
            self.enter()


def _words(identity: str) -> str:
    """What a device says it is, so that it can be broken into lines: many separate with bare commas."""
    return ", ".join(part.strip() for part in identity.split(","))


def _last_preflight(folder: Path) -> tuple[str, list[dict[str, Any]]]:
    from gui.preflight_records import last_preflight

    return last_preflight(folder)


def _table(heads: tuple[str, ...], name: str) -> QTableWidget:
    table = QTableWidget(0, len(heads))
    table.setHorizontalHeaderLabels(heads)
    table.setAccessibleName(name)
    table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    table.setTabKeyNavigation(False)
    table.setShowGrid(False)
    table.setWordWrap(True)
    table.setItemDelegate(RoomyRows(table))
    table.verticalHeader().hide()
    table.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
    header = table.horizontalHeader()
    header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft)
    header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
    for column in range(2, len(heads)):
        header.setSectionResizeMode(column, QHeaderView.ResizeMode.Stretch)
    return table


def _append(page: Page, table: QTableWidget, texts: tuple[str, ...], good: bool) -> None:
    row = table.rowCount()
    table.insertRow(row)
    for column, text in enumerate(texts):
        item = QTableWidgetItem(text)
        item.setToolTip(text)
        if column == 1:
            item.setData(Qt.ItemDataRole.UserRole, good)
            _sign(item, page.desk.theme)
        table.setItem(row, column, item)


def _sign(item: QTableWidgetItem, theme: Theme) -> None:
    good = item.data(Qt.ItemDataRole.UserRole)
    item.setIcon(marks.icon("check" if good else "warning", theme.good if good else theme.bad))


PAGE = InstrumentPage
