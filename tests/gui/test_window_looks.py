"""Palettes, layout and names in the window."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from PySide6.QtWidgets import QApplication, QLabel
from pytestqt.qtbot import QtBot
from window_stage import Stage, running


@pytest.mark.parametrize("choice", ["light", "dark"])
def test_text_is_legible_in_both_palettes(stage: Stage, choice: Any) -> None:
    stage.window.use_palette(choice)
    running(stage, 6)
    theme = stage.window.plots.theme
    assert QApplication.palette().window().color().name() == theme.window
    assert theme.dark == (choice == "dark")
    inks = ("text", "quiet_text", "measured", "simulated", "good", "acceptable", "poor")
    for ink in inks:
        assert contrast(getattr(theme, ink), theme.surface) >= 4.5, ink
    for tone, ground in theme.tone_surface.items():
        assert contrast(theme.text, ground) >= 7, tone
        assert contrast(theme.tone(tone), ground) >= 3, tone
    assert contrast("#ffffff", theme.halt) >= 4.5


def contrast(a: str, b: str) -> float:
    """Contrast ratio of WCAG 2.2, section 1.4.3."""
    from PySide6.QtGui import QColor

    def luminance(colour: str) -> float:
        parts = (QColor(colour).redF(), QColor(colour).greenF(), QColor(colour).blueF())
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_layout_and_palette_are_remembered(make_stage: Callable[..., Stage]) -> None:
    first = make_stage()
    first.window.use_palette("dark")
    first.window.across.setSizes([450, 700])
    QApplication.processEvents()
    sizes = first.window.across.sizes()
    first.window.close()
    second = make_stage()
    QApplication.processEvents()
    assert second.window.palette_choice == "dark"
    assert second.window.across.sizes() == sizes


def test_every_button_has_a_name_that_can_be_read_out(stage: Stage) -> None:
    for button in stage.window.panel("ControlsPanel").buttons.values():  # type: ignore[attr-defined]
        assert len(button.accessibleName()) > len("Start: ")


def test_no_label_is_cut_off(stage: Stage, qtbot: QtBot) -> None:
    running(stage, 12)
    QApplication.processEvents()
    for label in stage.window.findChildren(QLabel):
        if label.isVisible() and label.text() and not label.wordWrap():
            assert label.width() >= label.minimumSizeHint().width(), label.text()
