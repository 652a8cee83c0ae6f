"""Questions to the person at the window. None of them blocks it: the scan, and the halt key, go on underneath."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QMessageBox, QWidget


def ask(
    parent: QWidget,
    title: str,
    text: str,
    yes: str,
    no: str,
    answered: Callable[[bool], None],
    detail: str = "",
    other: tuple[str, Callable[[], None]] | None = None,
) -> QMessageBox:
    """Ask a question with two answers; ``answered`` is told True for ``yes``. Escape and closing mean ``no``.

    Parameters
    ----------
    other
        A third answer, and what follows from it; ``answered`` is then told False.
    """
    box = QMessageBox(parent)
    box.setWindowModality(Qt.WindowModality.NonModal)
    box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    box.setIcon(QMessageBox.Icon.Question)
    box.setWindowTitle(title)
    box.setText(text)
    box.setInformativeText(detail)
    accept = box.addButton(yes, QMessageBox.ButtonRole.AcceptRole)
    third = box.addButton(other[0], QMessageBox.ButtonRole.ActionRole) if other else None
    reject = box.addButton(no, QMessageBox.ButtonRole.RejectRole)
    box.setDefaultButton(reject)
    box.setEscapeButton(reject)

    def finished(_: int) -> None:
        answered(box.clickedButton() is accept)
        if other is not None and box.clickedButton() is third:
            other[1]()

    box.finished.connect(finished)
    box.show()
    return box
