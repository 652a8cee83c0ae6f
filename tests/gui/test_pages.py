"""The pages of the real window, drawn into memory: set-up, look back, understand, and how they fit together."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QPointF, Qt
from PySide6.QtWidgets import QAbstractButton, QApplication, QLineEdit
from pytestqt.qtbot import QtBot
from scan_script import ending, geometries, preparation, readings
from window_stage import Stage

from gui.export import write_points
from gui.notices import ControllerClosed, ControllerStarting
from gui.pages import discover
from gui.plan_cells import PlanDraft, cell_text, cell_value, new_content
from gui.polar_map import PolarMap, Spot
from gui.setup import Setup
from gui.theme import LIGHT

POINTS = geometries({0.0: (0.0, 90.0), 15.0: (50.0,)}, step=10)
PLAN = """
version = 1
title = "Two planes"
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0]
sensor_azimuth = [0.0, 50.0]
sensor_zenith = { start = -60.0, stop = 60.0, step = 15.0 }
"""


def page(stage: Stage, name: str) -> Any:
    stage.window.show_page(name)
    return stage.window.page(name)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "two.toml"
    path.write_text(PLAN)
    return path


# The frame


def test_pages_stand_in_the_order_in_which_a_laboratory_works(stage: Stage) -> None:
    names = [page.name for page in discover()]
    assert names == ["start", "instrument", "setup", "calibration", "acquire", "watch", "understand", "runs"]
    assert list(stage.window.navigation) == names


def test_every_page_is_reached_by_a_key(stage: Stage, qtbot: QtBot) -> None:
    for number, each in enumerate(discover(), start=1):
        qtbot.keyClick(stage.window, getattr(Qt.Key, f"Key_{number}"), Qt.KeyboardModifier.ControlModifier)
        assert stage.window.stack.currentWidget() is stage.window.page(each.name)


def test_the_emergency_stop_is_in_sight_and_at_hand_on_every_page(stage: Stage, qtbot: QtBot) -> None:
    stage.window.do("start")
    stage.play(ControllerStarting(), *preparation(POINTS), *readings(POINTS, 2))
    halt = stage.window.panel("ControlsPanel").buttons["halt"]  # type: ignore[attr-defined]
    for each in discover():
        stage.window.show_page(each.name)
        assert halt.isVisible()
        assert halt.isEnabled()
        stage.controller.asked.clear()
        qtbot.keyClick(QApplication.focusWidget() or stage.window, Qt.Key.Key_F12)
        assert stage.controller.asked == ["halt"]
        qtbot.keyClick(QApplication.focusWidget() or stage.window, Qt.Key.Key_Space)
        assert stage.controller.asked == ["halt"]  # no button that steers a scan has the focus by itself


def test_everything_that_can_be_pressed_has_a_name_and_can_be_reached_by_key(stage: Stage) -> None:
    for each in discover():
        stage.window.show_page(each.name)
        for button in stage.window.page(each.name).findChildren(QAbstractButton):
            if button.isVisible():
                assert button.text() or button.accessibleName() or button.parent().inherits("QTableView"), each.name
                assert button.focusPolicy() != Qt.FocusPolicy.NoFocus or not button.text(), button.text()


def test_a_pause_may_be_asked_for_at_once(stage: Stage, qtbot: QtBot) -> None:
    stage.window.do("start")
    stage.play(ControllerStarting(), *preparation(POINTS), *readings(POINTS, 2))
    qtbot.keyClick(stage.window, Qt.Key.Key_F6, Qt.KeyboardModifier.ShiftModifier)
    assert stage.controller.asked[-1] == "pause now"


def test_closing_leaves_a_scan_that_has_a_process_of_its_own(stage: Stage, qtbot: QtBot) -> None:
    stage.controller.detached = True  # type: ignore[misc]
    left: list[bool] = []
    stage.controller.leave = lambda: left.append(True)  # type: ignore[attr-defined]
    stage.window.do("start")
    stage.play(ControllerStarting(), *preparation(POINTS), *readings(POINTS, 2))
    assert not stage.window.close()
    question = stage.window._question
    assert question is not None
    texts = [button.text() for button in question.buttons()]
    assert texts.count("End the scan and close") == 1
    button = next(b for b in question.buttons() if b.text() == "Close the window, go on measuring")
    qtbot.mouseClick(button, Qt.MouseButton.LeftButton)
    assert left == [True]
    assert "abort" not in stage.controller.asked
    assert not stage.window.isVisible()


# Set-up


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0, 15, 30", [0.0, 15.0, 30.0]),
        ("-80 : 80 : 5", {"start": -80.0, "stop": 80.0, "step": 5.0}),
        ("−7.5°", [-7.5]),
        ("500;", [500.0]),
    ],
)
def test_a_cell_is_read_as_it_is_written(text: str, value: Any) -> None:
    assert cell_value(text) == value
    assert cell_value(cell_text(value)) == value


@pytest.mark.parametrize(
    ("text", "words"),
    [("", "empty"), ("ten", "'ten'; expected a number"), ("1:2", "found 2 numbers"), ("inf", "finite")],
)
def test_a_wrong_cell_says_what_is_expected(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        cell_value(text)


def test_a_draft_keeps_what_the_table_does_not_show(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN + 'repeats = 2\norder = ["wavelength"]\n')
    draft = PlanDraft.read(path)
    draft.parts[0]["sensor_azimuth"] = cell_value("0, 90")
    draft.save(path)
    kept = tomllib.loads(path.read_text())
    assert kept["grid"][0]["repeats"] == 2
    assert kept["grid"][0]["sensor_azimuth"] == [0.0, 90.0]
    assert "repeats 2" in draft.further(0)


def test_the_plan_is_checked_and_drawn(make_stage: Callable[..., Stage], qtbot: QtBot, plan: Path) -> None:
    setup = page(make_stage(plan=plan), "setup")
    qtbot.waitUntil(lambda: setup.checked is not None, timeout=20_000)
    # 2 planes of 9 zeniths; only zenith 15 at azimuth 0 looks back along the light of 15 degrees
    assert setup.facts["Points"].text().startswith("17, and")
    assert setup.facts["Blocked"].text().startswith("1: closer than 5 degrees to retro-reflection")
    assert [spot.kind for spot in setup.map.spots].count("blocked") == 1
    blocked = next(i for i, spot in enumerate(setup.map.spots) if spot.kind == "blocked")
    setup.map.pointed.emit(blocked)
    assert setup.readout.text().startswith("sensor zenith 15°, azimuth 0°: blocked, closer than")
    assert setup.start.isEnabled()


def test_a_value_beyond_an_arm_is_marked_while_it_is_typed(
    make_stage: Callable[..., Stage], qtbot: QtBot, plan: Path
) -> None:
    stage = make_stage(plan=plan)
    setup = page(stage, "setup")
    qtbot.waitUntil(lambda: setup.checked is not None, timeout=20_000)
    setup.table.setCurrentCell(0, 3)
    setup.table.editItem(setup.table.item(0, 3))
    editor = setup.table.findChild(QLineEdit)
    editor.selectAll()
    qtbot.keyClicks(editor, "0, 95")
    assert editor.property("wrong")
    assert setup.problem.text() == "Row 1, sensor zenith: found 95 °; expected -90 to 90 °"
    assert not setup.start.isEnabled()
    qtbot.keyClick(editor, Qt.Key.Key_Backspace)  # 0, 9
    assert not editor.property("wrong")
    qtbot.keyClick(editor, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: setup.facts["Points"].text().startswith("4,"), timeout=20_000)
    assert "(changed)" in setup.where.text()
    assert not setup.start.isEnabled()  # what runs is the file
    stage.window.do("start")
    assert stage.controller.asked == []
    setup._write(plan)
    assert setup.start.isEnabled()
    stage.window.do("start")
    assert stage.controller.asked == ["start"]
    assert tomllib.loads(plan.read_text())["grid"][0]["sensor_zenith"] == [0.0, 9.0]


def test_what_only_the_whole_plan_shows_is_marked_where_it_is(
    make_stage: Callable[..., Stage], qtbot: QtBot, plan: Path
) -> None:
    setup = page(make_stage(plan=plan), "setup")
    qtbot.waitUntil(lambda: setup.checked is not None, timeout=20_000)
    setup.table.item(0, 3).setText("-60 : 60 : 7")  # does not meet 60
    qtbot.waitUntil(lambda: "do not meet stop" in setup.problem.text(), timeout=20_000)
    assert setup.table.wrong == {(0, 3)}
    assert setup.table.item(0, 3).font().underline()  # not by colour alone
    assert setup.checked is None


def test_a_missing_file_is_marked_in_the_form(make_stage: Callable[..., Stage], tmp_path: Path) -> None:
    setup = page(make_stage(setup=Setup(simulate=True)), "setup")
    line = setup.form.lines["artifact"]
    line.setText(str(tmp_path / "none.toml"))
    line.textEdited.emit(line.text())
    assert line.property("wrong")
    assert "no such file" in setup.form.problem.text()
    setup.form.lines["operator"].textEdited.emit("Grace")
    assert setup.desk.setup.content()["request"]["record"]["operator"] == "Grace"


def test_a_new_plan_can_be_measured_as_it_is(tmp_path: Path) -> None:
    from gui.plan_check import Checked, check_draft

    found = check_draft(PlanDraft(new_content()), None)
    assert isinstance(found, Checked)
    assert len(found.plan) == 12  # 13 zeniths, straight above blocked


# Maps


def test_a_map_puts_a_negative_zenith_on_the_other_side(qtbot: QtBot) -> None:
    polar = PolarMap(LIGHT)
    qtbot.addWidget(polar)
    polar.resize(300, 300)
    polar.show_spots([Spot(-40.0, 30.0, "good"), Spot(40.0, 210.0, "good"), Spot(90.0, 0.0, "poor")])
    there, here, rim = (polar.place(spot) for spot in polar.spots)
    assert (there - here).manhattanLength() < 1e-9
    assert rim.y() == pytest.approx(150.0)
    assert rim.x() > 250.0
    assert polar.nearest(QPointF(rim.x() + 3, rim.y())) == 2
    assert polar.nearest(QPointF(2.0, 2.0)) == -1


def test_the_three_maps_show_the_category_of_their_own_metric(stage: Stage) -> None:
    from scan_script import measured, predicted

    watch = page(stage, "watch")
    watch.tabs.setCurrentIndex(1)
    stage.window.do("start")
    stage.play(ControllerStarting(), *preparation(POINTS))
    # 3 % apart with u of 2 %: acceptable by difference (2 to 4 %), acceptable by t' = 1.5
    stage.play(measured(0, POINTS, 0.3, 0.006), predicted(0, 0.309, 0.0))
    # 5 % apart with u of 10 %: poor by difference, good by t' = 0.5
    stage.play(measured(1, POINTS, 0.3, 0.03), predicted(1, 0.315, 0.0))
    maps = stage.window.panel("PolarPanel").maps  # type: ignore[attr-defined]
    kinds = {name: [each.spots[0].kind, each.spots[1].kind] for name, each in maps.items()}
    assert kinds == {
        "Relative difference": ["acceptable", "poor"],
        "t′": ["acceptable", "good"],
        "Level of agreement n′": ["good", "good"],  # a step at |t'| = 2 where the simulation is exact
    }


# Look back, export, understand


def test_an_export_holds_every_point(stage: Stage, tmp_path: Path) -> None:
    stage.window.do("start")
    stage.play(ControllerStarting(), *preparation(POINTS), *readings(POINTS, 3))
    write_points(stage.window.model.points, tmp_path / "points.csv")
    rows = (tmp_path / "points.csv").read_text().splitlines()
    assert len(rows) == 1 + len(POINTS)
    first = dict(zip(rows[0].split(","), rows[1].split(","), strict=True))
    point = stage.window.model.points[0]
    assert float(first["brf"]) == point.brf
    assert point.score is not None
    assert float(first["t"]) == point.score.t
    assert rows[-1].split(",")[5] == ""


def test_one_step_exports_table_and_pictures(stage: Stage, tmp_path: Path, qtbot: QtBot) -> None:
    stage.window.do("start")
    first, *rest = preparation(POINTS)
    stage.play(ControllerStarting(), first, *rest, *readings(POINTS, 3))
    stage.window.model.run_dir = str(tmp_path)
    page(stage, "watch")
    folder = stage.window.export()
    assert folder is not None
    assert folder.parent == tmp_path
    expected = ["instrument.png", "over-time.png", "planes.png", "points.csv", "polar-maps.png"]
    qtbot.waitUntil(lambda: sorted(path.name for path in folder.iterdir()) == expected, timeout=20_000)


DIAGNOSIS = {
    "verdict": "effects",
    "probabilities": {"none": 0.01, "unknown": 0.04},
    "consistency": {"consistent": False, "p_value": 1e-5},
    "where": [{"points": [1, 2, 3], "description": "grazing sensor zeniths at azimuth 0", "strength": 4.2}],
    "effects": [
        {"effect": "sensor_zenith_offset", "class": ["sensor_zenith_offset"], "probability": 0.95,
         "parameters": {"angle_deg": {"value": -0.41, "u": 0.05}, "mean_slope": {"value": 2, "u": 1}}},
    ],
    "ranking": [
        {"effect": "sensor_zenith_offset", "class": ["sensor_zenith_offset", "backlash"], "probability": 0.95},
        {"effect": "beam_offset", "class": ["beam_offset"], "probability": 0.02},
    ],
    "gap": {"heldout_rms_before": 0.031, "heldout_rms_after": 0.012, "shrink": 0.6, "shrink_interval": [0.5, 0.7]},
    "next_scan": [{"description": "a slice backwards", "separates": [["sensor_zenith_offset", "backlash"]]}],
}  # fmt: skip


def test_a_diagnosis_is_read_as_where_which_how_far_and_what_next(stage: Stage, tmp_path: Path) -> None:
    (tmp_path / "diagnosis.json").write_text(json.dumps(DIAGNOSIS))
    (tmp_path / "diagnosis.html").write_text("<html>")
    (tmp_path / "corrected-twin.toml").write_text("")
    (tmp_path / "plan.toml").write_text(PLAN)
    understand = page(stage, "understand")
    understand.hear(f"run:{tmp_path}")
    assert understand.verdict.text() == "A cause is found"
    assert "grazing sensor zeniths" in understand.where.text()
    row = [understand.effects.item(0, column).text() for column in range(4)]
    assert row == ["sensor zenith offset", "0.950", "angle −0.410 ± 0.050 °, mean slope 2.0 ± 1.0", "backlash"]
    assert "3.10 % before, 1.20 % after" in understand.far.text()
    assert "a slice backwards" in understand.next.text()
    understand.apply.click()
    assert stage.window.setup.corrections == (tmp_path / "corrected-twin.toml").resolve()
    assert stage.window.setup.request().corrections == stage.window.setup.corrections
    understand.load.click()
    assert stage.window.setup.plan == (tmp_path / "plan.toml").resolve()
    assert stage.window.stack.currentWidget() is stage.window.page("setup")


def test_a_diagnosis_that_cannot_be_made_says_why(stage: Stage, qtbot: QtBot, tmp_path: Path) -> None:
    understand = page(stage, "understand")
    understand.hear(f"run:{tmp_path}")
    understand.diagnose()
    qtbot.waitUntil(lambda: understand.state.text().startswith("⚠"), timeout=20_000)
    assert "journal" in understand.state.text()
    assert understand.begin.isEnabled()


def test_no_runs_is_said_in_words(make_stage: Callable[..., Stage], qtbot: QtBot, tmp_path: Path) -> None:
    stage = make_stage(setup=Setup(simulate=True, runs=tmp_path / "none"))
    start = page(stage, "start")
    qtbot.waitUntil(lambda: bool(start._rows), timeout=20_000)
    assert start._rows[0].text().startswith("No runs in")


def test_a_finished_scan_frees_the_pages_again(make_stage: Callable[..., Stage], plan: Path, qtbot: QtBot) -> None:
    stage = make_stage(plan=plan)
    start = page(stage, "start")
    assert start.heading.text() == "Ready: two.toml"
    start.begin.click()
    assert stage.controller.asked == ["start"]
    assert stage.window.stack.currentWidget() is stage.window.page("acquire")
    stage.play(ControllerStarting(), *preparation(POINTS))
    assert not start.begin.isEnabled()
    assert start.heading.text() == "A scan is running: Artifact"
    stage.play(*readings(POINTS, len(POINTS)), *ending(POINTS), ControllerClosed())
    assert start.begin.isEnabled()
