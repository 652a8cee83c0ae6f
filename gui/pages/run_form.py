"""What is kept with a run and what it works from: operator, sample, output, files of the twin."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QFileDialog,
    QFormLayout,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QWidget,
)

from gui.pages.base import Desk
from gui.panels.base import quiet

_FILES = {
    "facility": ("Facility", "What is known of the instrument (facility.toml)", "*.toml"),
    "artifact": ("Artifact", "What lies on the stage, for the twin (artifact.toml)", "*.toml"),
    "material": ("Material", "The coating: a run of the coupon, or a table", "*.nc *.csv *.toml *.bsdf"),
    "corrections": ("Corrections", "Effects from a diagnosis that the twin includes", "*.toml"),
}


class RunForm(QFrame):
    """The form; everything in it is part of the next start.

    Signals
    -------
    changed
        Something is set differently.
    """

    changed = Signal()

    def __init__(self, desk: Desk) -> None:
        super().__init__()
        self.desk = desk
        self.setObjectName("card")
        form = QFormLayout(self)
        form.setContentsMargins(12, 10, 12, 10)
        self.lines: dict[str, QLineEdit] = {}
        for keys in (("operator", "sample"), ("project", "remarks")):
            pair = QHBoxLayout()
            for key in keys:
                line = QLineEdit()
                line.setMaxLength(1000)
                line.setPlaceholderText("kept with the run")
                line.setAccessibleName(key.capitalize())
                line.textEdited.connect(lambda text, key=key: self._write(key, text))
                self.lines[key] = line
                if key == keys[1]:
                    pair.addWidget(QLabel(key.capitalize()))
                pair.addWidget(line, 1)
            form.addRow(keys[0].capitalize(), pair)
        self.desk.setup.operator = self.desk.setup.operator or str(desk.settings.value("operator", ""))
        self.lines["out"] = QLineEdit()
        self.lines["out"].setPlaceholderText(f"a new folder in {desk.setup.runs}/")
        self.lines["out"].setAccessibleName("Run folder")
        self.lines["out"].textEdited.connect(lambda text: self._path("out", text))
        form.addRow("Run folder", self._with_button(self.lines["out"], self._choose_out, "Choose the run folder"))
        for key, (label, tip, _) in _FILES.items():
            line = QLineEdit()
            line.setToolTip(tip)
            line.setAccessibleName(f"{label}: {tip}")
            line.setPlaceholderText("the simulated laboratory's own" if desk.setup.simulate else "none")
            if key == "corrections":
                line.setPlaceholderText("none")
            line.textEdited.connect(lambda text, key=key: self._path(key, text))
            self.lines[key] = line
            choose = self._with_button(line, lambda _=False, key=key: self._choose(key), f"Choose: {tip}")
            form.addRow(label, choose)
        self.twin = QCheckBox("The twin predicts every reading while the scan runs")
        self.twin.toggled.connect(self._set_twin)
        form.addRow("", self.twin)
        self.problem = quiet()
        self.problem.setProperty("role", "wrong")
        self.problem.setWordWrap(True)
        self.problem.hide()
        form.addRow(self.problem)
        self.show_setup()

    def show_setup(self) -> None:
        """Show what is set up."""
        setup = self.desk.setup
        for key, line in self.lines.items():
            found = getattr(setup, key)
            line.setText(str(found) if found else "")
        self.twin.setChecked(setup.twin)
        self._check()

    def _with_button(self, line: QLineEdit, slot: object, tip: str) -> QWidget:
        widget = QWidget()
        row = QHBoxLayout(widget)
        row.setContentsMargins(0, 0, 0, 0)
        button = QPushButton("…")
        button.setToolTip(tip)
        button.setAccessibleName(tip)
        button.setMaximumWidth(40)
        button.clicked.connect(slot)
        row.addWidget(line, 1)
        row.addWidget(button)
        return widget

    def _write(self, key: str, text: str) -> None:
        setattr(self.desk.setup, key, text.strip())
        if key == "operator":
            self.desk.settings.setValue("operator", text.strip())
        self.changed.emit()

    def _path(self, key: str, text: str) -> None:
        setattr(self.desk.setup, key, Path(text.strip()) if text.strip() else None)
        self._check()
        self.changed.emit()

    def _set_twin(self, on: bool) -> None:
        self.desk.setup.twin = on

    def _check(self) -> None:
        """Mark names of files that are not there, and an output folder that holds something."""
        problems = []
        for key, line in self.lines.items():
            path = getattr(self.desk.setup, key)
            wrong = ""
            if isinstance(path, Path) and key in _FILES and not path.is_file():
                wrong = f"{_FILES[key][0]}: {path}: no such file"
            elif isinstance(path, Path) and key == "out" and path.exists() and (path.is_file() or any(path.iterdir())):
                wrong = f"Run folder: {path} is not empty; a run has a folder of its own"
            if bool(line.property("wrong")) != bool(wrong):
                line.setProperty("wrong", bool(wrong))
                line.style().unpolish(line)
                line.style().polish(line)
            if wrong:
                problems.append(wrong)
        self.problem.setText("⚠ " + "\n⚠ ".join(problems) if problems else "")
        self.problem.setVisible(bool(problems))

    def _choose(self, key: str) -> None:
        label, _, pattern = _FILES[key]
        name, _ = QFileDialog.getOpenFileName(self, label, self.desk.folder(key), f"{label} ({pattern});;All files (*)")
        if name:
            self.desk.remember_folder(key, Path(name))
            self.lines[key].setText(name)
            self._path(key, name)

    def _choose_out(self) -> None:
        name = QFileDialog.getExistingDirectory(self, "Run folder", self.desk.folder("out"))
        if name:
            self.desk.remember_folder("out", Path(name))
            self.lines["out"].setText(name)
            self._path("out", name)
