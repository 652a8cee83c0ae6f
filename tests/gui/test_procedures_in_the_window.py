"""Prompts with answers, and procedures that have the instrument: shown on every page, answered, halted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot
from scan_script import geometries, preparation
from window_stage import Stage

from gui.notices import ControllerStarting, OperatorAsked
from gui.pages import discover
from gui.setup import Setup
from instrument.procedures.people import LineOperator, Rehearsal
from instrument.procedures.results import read_results
from instrument.prompts import Prompt

POINTS = geometries({0.0: (0.0,)}, step=20)
NUMBER = Prompt(key="align:level", title="Read the micrometer", kind="number", unit="mm", lower=0.0, upper=50.0)
CHOICE = Prompt(key="align:centre", title="Does it stay?", kind="choice", choices=("yes", "no"))
NUMBERS = {"align:level": "12.5", "align:distance": "800"}  # others are 0


def asked(stage: Stage, prompt: Prompt) -> Any:
    stage.window.do("start")
    stage.play(ControllerStarting(), *preparation(POINTS), OperatorAsked(prompt))
    return stage.window.panel("RequestPanel")


def test_a_number_is_checked_while_it_is_typed_and_answered_by_key(stage: Stage, qtbot: QtBot) -> None:
    banner = asked(stage, NUMBER)
    assert banner.what.text() == "Read the micrometer"
    assert banner.field.line.placeholderText() == "0 to 50"
    assert banner.field.unit.text() == "mm"
    assert not banner.done.isEnabled()  # no answer yet, and no complaint
    assert banner.problem.isHidden()
    qtbot.keyClicks(banner.field.line, "60")
    assert banner.problem.text() == "⚠ expected 0 to 50 mm"
    assert banner.field.line.property("wrong")
    qtbot.keyClick(banner.field.line, Qt.Key.Key_Return)
    assert stage.controller.asked == ["start"]
    banner.field.line.clear()
    qtbot.keyClicks(banner.field.line, "12,5")
    assert not banner.field.line.property("wrong")
    qtbot.keyClick(stage.window, Qt.Key.Key_F9)
    qtbot.waitUntil(lambda: stage.controller.asked == ["start", "answer 12.5"])


def test_a_choice_is_made_with_a_button_each(stage: Stage, qtbot: QtBot) -> None:
    banner = asked(stage, CHOICE)
    assert [button.text() for button in banner.field.buttons] == ["&yes", "&no"]
    assert not banner.done.isEnabled()
    qtbot.mouseClick(banner.field.buttons[1], Qt.MouseButton.LeftButton)
    qtbot.mouseClick(banner.done, Qt.MouseButton.LeftButton)
    assert stage.controller.asked == ["start", "answer 'no'"]


class Lines:
    """Stands where the standard input would."""

    def __init__(self, *lines: str) -> None:
        self.lines = list(lines)

    def line(self, wait: float) -> str | None:
        if not self.lines:
            raise EOFError
        return self.lines.pop(0)


def test_a_program_in_between_gets_prompts_as_lines_and_wrong_answers_back(capsys: pytest.CaptureFixture[str]) -> None:
    lines = Lines("nonsense", '{"answer": 51}', '{"answer": 7}')
    assert LineOperator(lines).reply(NUMBER) == 7.0  # type: ignore[arg-type]
    said = capsys.readouterr().out.splitlines()
    prompts = [Prompt.model_validate(json.loads(line)["prompt"]) for line in said if line.startswith("{")]
    assert prompts == [NUMBER, NUMBER]
    assert any("expected 0 to 50 mm" in line for line in said)
    with pytest.raises(KeyboardInterrupt):
        LineOperator(Lines('{"give_up": true}')).reply(CHOICE)  # type: ignore[arg-type]
    with pytest.raises(KeyboardInterrupt):
        LineOperator(Lines()).reply(CHOICE)  # type: ignore[arg-type]


def test_in_a_rehearsal_the_hands_move_after_the_person_has_answered() -> None:
    did: list[str] = []

    class One:
        def __init__(self, name: str) -> None:
            self.name = name

        def reply(self, prompt: Prompt) -> str | None:
            did.append(f"{self.name} {prompt.key}")
            return self.name

    rehearsal = Rehearsal(One("person"), One("hands"))
    assert rehearsal.reply(CHOICE) == "person"
    rehearsal.mount("sample")
    assert did == ["person align:centre", "hands align:centre", "person mount:sample", "hands mount:sample"]


@pytest.fixture
def rehearsal(make_stage: Callable[..., Stage], tmp_path: Path) -> Stage:
    return make_stage(setup=Setup(simulate=True, speed=600.0, operator="Ada", calibrations=tmp_path / "results"))


def answered_to_the_end(rehearsal: Stage, qtbot: QtBot) -> list[str]:
    """Answer whatever the procedure that runs asks; the keys of its questions."""
    window = rehearsal.window
    banner: Any = window.panel("RequestPanel")
    keys: list[str] = []

    def answered() -> bool:
        request = window.model.request
        if isinstance(request, Prompt) and banner.isVisible():
            keys.append(request.key)
            if request.kind == "number":
                qtbot.keyClicks(banner.field.line, NUMBERS.get(request.key, "0"))
            elif request.kind == "choice":
                banner.field.buttons[0].click()
            qtbot.mouseClick(banner.done, Qt.MouseButton.LeftButton)
            assert rehearsal.controller.asked == []  # no scan hears of it
            qtbot.waitUntil(lambda: window.model.request is not request, timeout=60_000)
        return not window.model.procedure

    qtbot.waitUntil(answered, timeout=200_000)
    return keys


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_the_alignment_is_led_through_in_the_window(rehearsal: Stage, qtbot: QtBot, tmp_path: Path) -> None:
    window = rehearsal.window
    window.show_page("instrument")
    page: Any = window.page("instrument")
    page.align.click()
    qtbot.waitUntil(lambda: window.model.procedure == "Alignment", timeout=5_000)
    assert not page.align.isEnabled()
    keys = answered_to_the_end(rehearsal, qtbot)
    assert page.guided.state.text() == "✓ Done; the result is stored."
    steps = ("laser", "level", "height", "mirror", "distance", "back-x", "back-y", "centre", "tidy")
    assert [key for key in keys if key.startswith("align:")] == [f"align:{step}" for step in steps]
    assert "start-source" in keys
    [result] = read_results(tmp_path / "results")
    values = {answer.key: answer.value for answer in result.answers}
    assert (values["align:level"], values["align:distance"], values["align:centre"]) == (12.5, 800.0, "yes")
    assert {answer.who for answer in result.answers} == {"Ada"}
    assert page.align.isEnabled()


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_a_calibration_is_halted_from_any_page_and_then_carried_out(
    rehearsal: Stage, qtbot: QtBot, tmp_path: Path
) -> None:
    window = rehearsal.window
    window.show_page("calibration")
    page: Any = window.page("calibration")
    qtbot.waitUntil(lambda: page.table.rowCount() > 0, timeout=60_000)
    page.table.selectRow([each.command for each in page.procedures].index("dark"))
    halt = window.panel("ControlsPanel").buttons["halt"]  # type: ignore[attr-defined]
    assert not halt.isEnabled()
    page.begin.click()
    qtbot.waitUntil(halt.isEnabled, timeout=5_000)
    assert not window.panel("ControlsPanel").buttons["start"].isEnabled()  # type: ignore[attr-defined]
    assert window.panel("StatePanel").name.text() == "Procedure"  # type: ignore[attr-defined]
    qtbot.waitUntil(lambda: isinstance(window.model.request, Prompt), timeout=200_000)
    for each in discover():
        window.show_page(each.name)
        assert halt.isEnabled()
        assert window.panel("RequestPanel").isVisible()
    assert not window.close()  # a procedure is not left behind
    qtbot.keyClick(QApplication.focusWidget() or window, Qt.Key.Key_F12)
    qtbot.waitUntil(lambda: not window.model.procedure, timeout=60_000)
    assert page.guided.state.text().startswith("Ended before its end; nothing is stored")
    assert "emergency stop" in page.guided.words.toPlainText()
    assert read_results(tmp_path / "results") == []
    assert not halt.isEnabled()
    assert rehearsal.controller.asked == []
    # Once more, to its end
    window.show_page("calibration")
    page.begin.click()
    qtbot.waitUntil(lambda: window.model.procedure == "Dark", timeout=5_000)
    answered_to_the_end(rehearsal, qtbot)
    assert page.guided.state.text() == "✓ Done; the result is stored.", page.guided.words.toPlainText()
    [result] = read_results(tmp_path / "results")
    assert (result.procedure, result.who) == ("dark-level", "Ada")
    dark = [each.command for each in page.procedures].index("dark")
    qtbot.waitUntil(lambda: page.table.item(dark, 1).text() == result.verdict, timeout=60_000)
