"""Fields to search the catalogue of runs with; wrong input is marked where it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QTimer, Signal
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QLineEdit, QSizePolicy, QWidget

from instrument.errors import InputError

if TYPE_CHECKING:
    from instrument.catalogue.search import Query

_TYPED_MS = 300  # without another key, before a search begins
_STATES = ("finished", "aborted", "halted", "faulted", "interrupted", "running", "damaged")
_FIGURES = {
    "": "any figures",
    "relative_rmse": "relative RMSE",
    "mean_absolute_relative_difference": "mean |relative difference|",
    "rms_t": "RMS of t′",
    "level_of_agreement": "level of agreement",
    "median_relative_u": "median uncertainty",
    "largest_relative_u": "largest uncertainty",
    "completeness": "completeness",
    "probability": "probability of the diagnosis",
}
_TEXTS = {
    "plan": ("Title", "part of the plan's title"),
    "sample": ("Sample", "part of the sample's name"),
    "operator": ("Operator", "part of the name"),
    "verdict": ("Diagnosis", "part of verdict or effect"),
    "since": ("From", "2026-03-02"),
    "until": ("To", "2026-03-31"),
}


class SearchFields(QWidget):
    """What a run must be to be listed.

    Signals
    -------
    changed
        A person has changed what to look for, and it makes sense.
    wrong
        What is wrong with it, in words; empty when nothing is.
    """

    changed = Signal()
    wrong = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.fields: dict[str, QLineEdit] = {}
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(4)
        for number, (name, (text, hint)) in enumerate(_TEXTS.items()):
            self.fields[name] = self._field(text, hint)
            self._stand(grid, number, text, self.fields[name])
        self.state = self._choice("State", {"": "any state"} | {state: state for state in _STATES})
        self._stand(grid, 6, "State", self.state)
        self.figure = self._choice("Figure of merit", _FIGURES)
        self.comparison = self._choice("Comparison", {sign: sign for sign in ("<", "<=", ">=", ">", "=")})
        self.fields["bound"] = self._field("Bound of the figure of merit", "0.03")
        for column, widget in (
            (0, QLabel("Figure")),
            (1, self.figure),
            (2, self.comparison),
            (3, self.fields["bound"]),
        ):
            grid.addWidget(widget, 2, column)
        for column in (1, 3, 5):
            grid.setColumnStretch(column, 1)
        self._typed = QTimer(self)
        self._typed.setSingleShot(True)
        self._typed.setInterval(_TYPED_MS)
        self._typed.timeout.connect(self._check)

    def _stand(self, grid: QGridLayout, number: int, text: str, widget: QWidget) -> None:
        """Three fields a row; the eighth and later cells belong to the figure of merit."""
        row, column = (divmod(number, 3)) if number < 6 else (2, 2)
        label = QLabel(text)
        label.setBuddy(widget)
        grid.addWidget(label, row, 2 * column)
        grid.addWidget(widget, row, 2 * column + 1)

    def _field(self, text: str, hint: str) -> QLineEdit:
        field = QLineEdit()
        field.setPlaceholderText(hint)
        field.setAccessibleName(f"Find runs: {text}")
        field.setClearButtonEnabled(True)
        field.textChanged.connect(lambda _: self._typed.start())
        return field

    def _choice(self, text: str, choices: dict[str, str]) -> QComboBox:
        box = QComboBox()
        box.setAccessibleName(f"Find runs: {text}")
        box.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        for key, shown in choices.items():
            box.addItem(shown, key)
        box.currentIndexChanged.connect(lambda _: self._typed.start())
        return box

    def query(self) -> Callable[[], Query]:
        """Makes the query of what stands in the fields now; call it on the thread, since its modules load slowly.

        It raises :class:`WrongField` where a field makes no sense.
        """
        texts = {name: field.text().strip() for name, field in self.fields.items()}
        state, figure = str(self.state.currentData()), str(self.figure.currentData())
        comparison = str(self.comparison.currentData())
        return lambda: _query(texts, state, figure, comparison)

    def mark(self, field: str, text: str) -> None:
        """Mark a field as wrong, and none else; an empty name marks none."""
        for name, widget in self.fields.items():
            wrong = name == field
            if widget.property("wrong") != wrong:
                widget.setProperty("wrong", wrong)
                widget.style().unpolish(widget)
                widget.style().polish(widget)
            widget.setToolTip(text if wrong else "")
        self.wrong.emit(text)

    def _check(self) -> None:
        self.changed.emit()


class WrongField(InputError):
    """What stands in a field makes no sense.

    Attributes
    ----------
    field
        Its name.
    """

    def __init__(self, field: str, text: str) -> None:
        self.field = field
        super().__init__(text)


def _query(texts: dict[str, str], state: str, figure: str, comparison: str) -> Query:
    from instrument.catalogue.search import Query, condition, moment

    def read(field: str, reader: Callable[..., Any], *given: Any, **more: Any) -> Any:
        try:
            return reader(*given, **more)
        except InputError as error:
            raise WrongField(field, str(error)) from None

    bound = texts["bound"]
    if bound and not figure:
        raise WrongField("bound", f"a figure of merit: none is chosen; found {bound!r} as its bound")
    where = [f"{figure}{comparison}{bound}"] if figure and bound else []
    since, until = texts["since"], texts["until"]
    return Query(
        plan=texts["plan"],
        sample=texts["sample"],
        operator=texts["operator"],
        verdict=texts["verdict"],
        state=state,
        since=read("since", moment, since, "From") if since else None,
        until=read("until", moment, until, "To", end=True) if until else None,
        conditions=[read("bound", condition, text) for text in where],
    )
