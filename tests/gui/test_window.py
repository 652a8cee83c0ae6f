"""The real window, drawn into memory and driven by the events an engine would send."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QMessageBox
from pytestqt.qtbot import QtBot
from scan_script import changed, ending
from window_stage import POINTS, Stage, running

from gui.notices import ControllerClosed, OperatorAnswered, OperatorAsked
from gui.panels import discover
from gui.run import obey_signals

F5, F6, F7, F8, F9, F12 = (getattr(Qt.Key, f"Key_F{n}") for n in (5, 6, 7, 8, 9, 12))


def question(stage: Stage) -> QMessageBox:
    boxes = [box for box in stage.window.findChildren(QMessageBox) if box.isVisible()]
    assert len(boxes) == 1
    return boxes[0]


def answer(stage: Stage, qtbot: QtBot, text: str) -> None:
    button = next(button for button in question(stage).buttons() if button.text() == text)
    qtbot.mouseClick(button, Qt.MouseButton.LeftButton)


def buttons(stage: Stage) -> dict[str, bool]:
    return {name: button.isEnabled() for name, button in stage.window.panel("ControlsPanel").buttons.items()}  # type: ignore[attr-defined]


def test_every_panel_is_found_and_in_the_window(stage: Stage) -> None:
    assert [type(panel) for panel in stage.window.panels] == discover()
    assert len(stage.window.panels) >= 9
    assert all(panel.window() is stage.window for panel in stage.window.panels)


def test_an_idle_window_offers_a_start_only(stage: Stage) -> None:
    assert [name for name, enabled in buttons(stage).items() if enabled] == ["start"]


def test_start_runs_the_chosen_plan(make_stage: Callable[..., Stage], qtbot: QtBot) -> None:
    stage = make_stage(plan=Path("plans/artifact.toml"))
    qtbot.keyClick(stage.window, F5)
    assert stage.controller.asked == ["start"]
    assert stage.plans == [Path("plans/artifact.toml")]


def test_the_state_is_shown_in_words(stage: Stage) -> None:
    running(stage)
    panel: Any = stage.window.panel("StatePanel")
    assert panel.name.text() == "Measuring"
    assert panel.accessibleName() == "State of the scan: Measuring"
    stage.play(changed("measuring", "suspended", "the interlock of the source is open"))
    assert panel.name.text() == "Suspended"
    assert panel.text.text().startswith("The interlock of the source is open. The laboratory")


@pytest.mark.parametrize(("key", "command"), [(F6, "pause"), (F12, "halt")])
def test_keys_steer_a_running_scan(stage: Stage, qtbot: QtBot, key: Qt.Key, command: str) -> None:
    running(stage)
    qtbot.keyClick(stage.window, key)
    assert stage.controller.asked == ["start", command]


def test_resume_is_offered_when_the_scan_rests(stage: Stage, qtbot: QtBot) -> None:
    running(stage)
    assert not buttons(stage)["resume"]
    stage.play(changed("measuring", "pausing"), changed("pausing", "paused"))
    assert not buttons(stage)["pause"]
    qtbot.keyClick(stage.window, F7)
    assert stage.controller.asked[-1] == "resume"


def test_abort_asks_first_and_halt_does_not(stage: Stage, qtbot: QtBot) -> None:
    running(stage)
    qtbot.keyClick(stage.window, F8)
    answer(stage, qtbot, "Go on measuring")
    assert stage.controller.asked == ["start"]
    qtbot.keyClick(stage.window, F8)
    qtbot.keyClick(stage.window, F12)  # the open question does not stand before the emergency
    assert stage.controller.asked == ["start", "halt"]
    answer(stage, qtbot, "Abort the scan")
    assert stage.controller.asked == ["start", "halt", "abort"]


def test_halt_works_by_mouse(stage: Stage, qtbot: QtBot) -> None:
    running(stage)
    qtbot.mouseClick(stage.window.panel("ControlsPanel").buttons["halt"], Qt.MouseButton.LeftButton)  # type: ignore[attr-defined]
    assert stage.controller.asked[-1] == "halt"


def test_a_question_goes_away_when_the_scan_ends_by_itself(stage: Stage, qtbot: QtBot) -> None:
    running(stage)
    qtbot.keyClick(stage.window, F8)
    stage.play(*ending(POINTS), ControllerClosed())
    qtbot.waitUntil(lambda: not any(b.isVisible() for b in stage.window.findChildren(QMessageBox)))
    assert stage.controller.asked == ["start"]


def test_a_sample_change_is_answered_in_the_window(stage: Stage, qtbot: QtBot) -> None:
    running(stage, 0)
    banner: Any = stage.window.panel("RequestPanel")
    assert not banner.isVisible()
    stage.play(OperatorAsked("reference"))
    assert banner.isVisible()
    assert "reference sample" in banner.what.text()
    qtbot.keyClick(stage.window, F9)
    qtbot.waitUntil(lambda: stage.controller.asked == ["start", "answer True"])
    stage.play(OperatorAnswered())
    assert not banner.isVisible()


def test_a_sample_change_can_end_the_scan(stage: Stage, qtbot: QtBot) -> None:
    running(stage, 0)
    stage.play(OperatorAsked("sample"))
    qtbot.mouseClick(stage.window.panel("RequestPanel").give_up, Qt.MouseButton.LeftButton)  # type: ignore[attr-defined]
    answer(stage, qtbot, "Abort the scan")
    assert stage.controller.asked == ["start", "abort"]


def test_closing_an_idle_window_closes_it(stage: Stage) -> None:
    assert stage.window.close()
    assert not stage.window.isVisible()


def test_closing_during_a_scan_asks_and_then_waits_for_a_safe_end(stage: Stage, qtbot: QtBot) -> None:
    running(stage)
    assert not stage.window.close()
    answer(stage, qtbot, "Keep the window open")
    assert stage.window.isVisible()
    assert stage.controller.asked == ["start"]
    stage.window.close()
    answer(stage, qtbot, "End the scan and close")
    assert stage.controller.asked == ["start", "abort"]
    assert stage.window.isVisible()
    stage.play(changed("measuring", "aborting"), changed("aborting", "aborted"))
    assert stage.window.isVisible()
    stage.play(ControllerClosed())
    assert not stage.window.isVisible()


@pytest.fixture
def obedient(stage: Stage) -> Iterator[Stage]:
    """A window that hears the signals of this process, for one test."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, signal.SIG_DFL) for number in numbers}
    heart = obey_signals(stage.window)
    yield stage
    heart.stop()
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_terminate_ends_the_scan_before_the_window(obedient: Stage, number: signal.Signals) -> None:
    running(obedient)
    signal.raise_signal(number)
    assert obedient.controller.asked == ["start", "abort"]
    assert not obedient.window.asking
    assert obedient.window.isVisible()
    obedient.play(changed("measuring", "aborting"), changed("aborting", "aborted"), ControllerClosed())
    assert not obedient.window.isVisible()


def test_ctrl_c_asks_and_a_second_one_means_yes(obedient: Stage, qtbot: QtBot) -> None:
    running(obedient)
    signal.raise_signal(signal.SIGINT)
    answer(obedient, qtbot, "Keep the window open")
    signal.raise_signal(signal.SIGINT)
    assert obedient.window.asking
    assert obedient.controller.asked == ["start"]
    signal.raise_signal(signal.SIGINT)
    assert obedient.controller.asked == ["start", "abort"]
    obedient.play(ControllerClosed())
    assert not obedient.window.isVisible()


def test_a_second_scan_starts_afresh(stage: Stage) -> None:
    running(stage, len(POINTS))
    stage.play(*ending(POINTS), ControllerClosed())
    running(stage, 2)
    assert stage.controller.asked == ["start", "start"]
    assert stage.window.model.settled == 2
    assert len(stage.window.plots.measured.data) == 2


def test_the_drawn_sample_is_the_artifact_of_the_run(tmp_path: Path) -> None:
    from gui.solid.lines import Sample, sample_of

    assert sample_of(tmp_path) == Sample()  # none is known: a plain plate
    rows = "hole,x_mm,y_mm,diameter_mm,u_x_mm,u_y_mm,u_diameter_mm\n0,-4,1,2.5,0,0,0\n1,4,-1,2,0,0,0\n"
    (tmp_path / "holes.csv").write_text(rows)
    (tmp_path / "artifact.toml").write_text('holes = "holes.csv"\noutline = [30.0, 20.0]\n')
    assert sample_of(tmp_path) == Sample((30.0, 20.0), ((-4.0, 1.0, 2.5), (4.0, -1.0, 2.0)))
