"""The instrument in three dimensions: where its parts are, what follows the axes, and what is shown without OpenGL."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPointF, Qt
from PySide6.QtGui import QKeyEvent, QMouseEvent
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from gui.comparison import score
from gui.model import ScanModel
from gui.notices import ControllerStarting
from gui.panels.arms import ArmsPanel, wanted
from gui.solid import VARIABLE
from gui.solid.geometry import (
    Camera,
    Stance,
    beam,
    between,
    commanded,
    eye,
    from_direction,
    placement,
    reported,
    sample_placement,
)
from gui.solid.lines import direction
from gui.solid.renderer import Renderer
from gui.solid.view import SolidView
from gui.theme import LIGHT
from instrument.events import AxesRead, Geometry, PointStarted, ScanStarted

HALF, ROOT = 0.5, math.sqrt(0.75)
NOW = datetime(2026, 3, 2, tzinfo=UTC)
POINTS = (
    Geometry(wavelength=500.0, illumination_zenith=15.0, sensor_zenith=30.0, sensor_azimuth=90.0),
    Geometry(wavelength=500.0, illumination_zenith=15.0, sensor_zenith=-40.0, sensor_azimuth=90.0),
)


@pytest.mark.parametrize(
    ("zenith", "azimuth", "vector"),
    [
        (0.0, 123.0, (0.0, 0.0, 1.0)),
        (90.0, 0.0, (1.0, 0.0, 0.0)),
        (30.0, 0.0, (HALF, 0.0, ROOT)),
        (-30.0, 0.0, (-HALF, 0.0, ROOT)),
        (90.0, 90.0, (0.0, 1.0, 0.0)),
        (60.0, 180.0, (-ROOT, 0.0, HALF)),
        (90.0, 30.0, (ROOT, HALF, 0.0)),
    ],
)
def test_an_arm_points_where_its_angles_say(zenith: float, azimuth: float, vector: tuple[float, float, float]) -> None:
    matrix = placement(zenith, azimuth)
    np.testing.assert_allclose(matrix @ (0.0, 0.0, 1.0, 1.0), (*vector, 1.0), atol=1e-12)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)  # rigid
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)  # and no mirror


def test_the_pivot_of_an_arm_stays_in_its_place_while_the_zenith_changes() -> None:
    """Arms turn about a horizontal axis through the sample: at azimuth 90 that of the sensor is the x axis."""
    for zenith in (-60.0, 0.0, 75.0):
        np.testing.assert_allclose(placement(zenith, 0.0) @ (0, 1, 0, 1), (0, 1, 0, 1), atol=1e-12)
        np.testing.assert_allclose(placement(zenith, 90.0) @ (0, 1, 0, 1), (-1, 0, 0, 1), atol=1e-12)


def test_the_sample_turns_against_the_clock_seen_from_above() -> None:
    np.testing.assert_allclose(sample_placement(90.0, 2.0) @ (1, 0, 0, 1), (0, 2, 0, 1), atol=1e-12)


def test_a_slanting_beam_lights_an_ellipse() -> None:
    """At 60 degrees the foot is twice as long as the beam is wide, along the plane of incidence."""
    upper, lower = beam(60.0, 0.0, 1.0, 0.1, 0.1)
    np.testing.assert_allclose(lower[:, 2], 0.0, atol=1e-12)
    assert np.ptp(lower[:, 0]) == pytest.approx(0.4)
    assert np.ptp(lower[:, 1]) == pytest.approx(0.2)
    np.testing.assert_allclose(upper.mean(axis=0), (ROOT, 0.0, HALF), atol=1e-12)
    assert np.isfinite(beam(90.0, 0.0, 1.0, 0.1, 0.1)).all()


def test_presets_look_from_the_lamp_the_detector_and_above() -> None:
    stance = Stance(30.0, 90.0, -60.0)
    position, centre, up = eye(Camera("lamp"), stance)
    np.testing.assert_allclose(position / np.linalg.norm(position), (HALF, 0.0, ROOT), atol=1e-12)
    np.testing.assert_allclose(centre, 0.0)
    position, _, up = eye(Camera("detector"), stance)
    np.testing.assert_allclose(position / np.linalg.norm(position), (0.0, -ROOT, HALF), atol=1e-12)
    assert up @ position == pytest.approx(0.0, abs=1e-12)
    position, centre, up = eye(Camera(azimuth=-90.0, height=90.0), stance)
    np.testing.assert_allclose(position[:2], 0.0, atol=1e-12)
    assert position[2] > 1.0
    np.testing.assert_allclose(up, (0.0, 1.0, 0.0), atol=1e-12)  # azimuth 90 upwards, so 0 to the right
    assert from_direction(-60.0, 90.0) == pytest.approx((-90.0, 30.0))


def test_where_axes_are_sent_and_where_they_say_they_are() -> None:
    by_hand = Geometry(
        wavelength=500.0, illumination_zenith=10.0, illumination_azimuth=30.0, sensor_zenith=20.0, sensor_azimuth=20.0
    )
    # The sample turns by -30; 20 degrees of its azimuth are then -10 of the laboratory's, or 170 from the other side.
    assert commanded(by_hand) == Stance(10.0, 170.0, -20.0, -30.0)
    sent = Stance(10.0, 20.0, 30.0, 5.0)
    assert reported({"sensor_zenith": 29.9}, sent) == Stance(10.0, 20.0, 29.9, 5.0)
    assert reported({"sample_rotation": 45.0}, sent, 30.0).sample_turn == 15.0
    assert between(Stance(0, 0, 10, 0), Stance(20, 40, -10, 4), 0.25) == Stance(5, 10, 5, 1)


def play(panel: ArmsPanel, *events: Any) -> None:
    for event in events:
        panel.model.apply(event)
    panel.refresh(panel.model.take_changes())


@pytest.fixture
def panel(qtbot: QtBot) -> ArmsPanel:
    """The view of a scan that is on its way to its second point."""
    panel = ArmsPanel(ScanModel(score), LIGHT)
    qtbot.addWidget(panel, before_close_func=lambda panel: panel.solid._renderer.close())
    panel.show()
    play(panel, ControllerStarting(), ScanStarted(time=NOW, run_dir="", title="t", points=POINTS, duration_s=9.0))
    play(panel, PointStarted(time=NOW, index=1, geometry=POINTS[1]))
    return panel


def test_the_view_follows_the_drives_and_says_so(panel: ArmsPanel) -> None:
    assert panel.solid.target == Stance(15.0, 90.0, -40.0)
    assert panel.text.text().startswith("Where the axes are sent")
    seen = {"illumination_zenith": 15.0, "sensor_azimuth": 90.0, "sensor_zenith": -12.5}
    play(panel, AxesRead(time=NOW, positions=seen))
    assert panel.solid.target == Stance(15.0, 90.0, -12.5)
    assert panel.lines._to == panel.solid.target
    assert panel.text.text().startswith("Where the drives say that the axes are")
    assert "lines: there is no screen to render for" in panel.text.text()  # these tests have none
    play(panel, ScanStarted(time=NOW, run_dir="", title="t", points=POINTS, duration_s=9.0))
    assert panel.text.text().startswith("No axis has moved yet")  # what was said belongs to the scan before


def test_presets_have_keys_and_buttons(panel: ArmsPanel, qtbot: QtBot) -> None:
    panel.lines.setFocus()
    for key, view in ((Qt.Key.Key_L, "lamp"), (Qt.Key.Key_D, "detector"), (Qt.Key.Key_S, "free")):
        qtbot.keyClick(panel.lines, key)
        assert panel.solid.camera.view == view
    panel.buttons["Above"].click()
    assert (panel.solid.camera.view, panel.solid.camera.height) == ("free", 90.0)


def drag(view: Any, across: float, down: float) -> None:
    left, none = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
    there = QPointF(50 + across, 50 + down)
    steps = {QEvent.Type.MouseButtonPress: QPointF(50, 50), QEvent.Type.MouseMove: there}
    for kind, at in (steps | {QEvent.Type.MouseButtonRelease: there}).items():
        QApplication.sendEvent(view, QMouseEvent(kind, at, at, left, left, none))


def press(view: Any, key: Qt.Key) -> None:
    QApplication.sendEvent(view, QKeyEvent(QEvent.Type.KeyPress, key, Qt.KeyboardModifier.NoModifier))


def test_mouse_and_arrow_keys_turn_lines_and_rendered_picture_alike(panel: ArmsPanel) -> None:
    def seen_from() -> list[float]:
        (azimuth, height), camera = panel.lines._seen_from, panel.solid.camera
        assert [azimuth % 360, height] == pytest.approx([camera.azimuth % 360, camera.height])
        return [azimuth % 360, height]

    azimuth, height = seen_from()
    front = direction(90.0, azimuth)  # what stands before the eye
    middle = panel.lines._project(front)
    for view in (panel.lines, panel.solid):
        drag(view, 40.0, 20.0)
    assert seen_from() == pytest.approx([azimuth - 20.0, height + 8.0])
    assert panel.lines._project(front).x() > middle.x() + 10  # it follows the mouse
    assert panel.lines._project(front).y() > middle.y() + 5
    for key in (Qt.Key.Key_Left, Qt.Key.Key_Left, Qt.Key.Key_Down):
        for view in (panel.lines, panel.solid):
            press(view, key)
    assert seen_from() == pytest.approx([azimuth - 36.0, height + 2.0])
    press(panel.solid, Qt.Key.Key_Plus)
    assert panel.solid.camera.zoom == 1.25


def serving(tmp_path: Path, body: str) -> list[str]:
    """A process in place of the one that renders."""
    script = tmp_path / "serve.py"
    script.write_text("import json, os, signal, sys\nanswers = sys.stdout.buffer\n" + body)
    return [sys.executable, str(script)]


ANSWERS = """
for line in sys.stdin:
    request = json.loads(line)
    size = {"width": 4, "height": 3}
    said = size | {"places": {"light": [1, 1]}, "seconds": 0.01, "problem": "", "stance": request["stance"]}
    answers.write(json.dumps(said).encode() + b"\\n" + bytes([10, 200, 30]) * 12)
    answers.flush()
"""
DIES = (
    "sys.stdin.readline()\nprint('no OpenGL here', file=sys.stderr, flush=True)\nos.kill(os.getpid(), signal.SIGABRT)\n"
)


@pytest.fixture
def shown(qtbot: QtBot) -> Callable[[list[str]], SolidView]:
    def show(command: list[str]) -> SolidView:
        view = SolidView(LIGHT, Renderer(command=command))
        qtbot.addWidget(view, before_close_func=lambda view: view._renderer.close())
        view.resize(300, 240)
        view.show()
        view.go_to(Stance(0.0, 0.0, 30.0))
        view.begin()
        return view

    return show


def test_pictures_are_asked_for_when_something_moves_and_not_otherwise(
    tmp_path: Path, shown: Callable[[list[str]], SolidView], qtbot: QtBot
) -> None:
    view = shown(serving(tmp_path, ANSWERS))
    pictures: list[dict[str, Any]] = []
    view._renderer.pictured.connect(lambda picture, answer: pictures.append(answer))
    qtbot.waitUntil(lambda: not view._clock.isActive(), timeout=30_000)
    assert view.picture is not None
    assert view.picture.pixelColor(2, 1).getRgb()[:3] == (10, 200, 30)
    assert view._asked["fine"]  # what stands still is worth a better one
    quiet = len(pictures)
    qtbot.wait(400)
    assert len(pictures) == quiet  # nothing has moved: nothing is rendered
    view.go_to(Stance(0.0, 0.0, 60.0))
    qtbot.waitUntil(lambda: pictures[-1]["stance"][2] == 60.0, timeout=30_000)
    on_the_way = [answer["stance"][2] for answer in pictures[quiet:]]
    assert on_the_way == sorted(on_the_way)
    view.hide()
    view.go_to(Stance(0.0, 0.0, -60.0))
    qtbot.wait(400)
    assert pictures[-1]["stance"][2] > -60.0  # nobody looks


def test_a_renderer_that_is_aborted_leaves_lines_and_the_reason(panel: ArmsPanel, tmp_path: Path, qtbot: QtBot) -> None:
    panel.solid._renderer._command = serving(tmp_path, DIES)
    panel.solid.begin()
    qtbot.waitUntil(lambda: "nothing can be rendered here (no OpenGL here)" in panel.text.text(), timeout=30_000)
    assert panel.stack.currentWidget() is panel.lines
    play(panel, PointStarted(time=NOW, index=0, geometry=POINTS[0]))
    assert panel.lines._to == Stance(15.0, 90.0, 30.0)  # and they go on
    assert not panel.solid._renderer.ask({})  # it is not tried again


def test_a_renderer_that_cannot_be_started_or_talks_nonsense_is_told(
    tmp_path: Path, shown: Callable[[list[str]], SolidView], qtbot: QtBot
) -> None:
    for command in ([str(tmp_path / "none")], serving(tmp_path, "sys.stdin.readline()\nprint('what?', flush=True)\n")):
        reasons: list[str] = []
        view = shown(command)
        view.failed.connect(reasons.append)
        qtbot.waitUntil(lambda: len(reasons) == 1, timeout=30_000)  # noqa: B023
        assert reasons[0]


def test_the_own_window_is_told_what_is_to_be_seen_and_its_end_is_said(
    panel: ArmsPanel, tmp_path: Path, qtbot: QtBot
) -> None:
    heard = tmp_path / "heard.json"
    body = f"open({str(heard)!r}, 'w').write(sys.stdin.readline())\nsys.exit('no context')\n"
    panel.apart._command = serving(tmp_path, body)
    panel.buttons["Own window"].setEnabled(True)  # as on a screen
    panel.buttons["Own window"].click()
    assert panel.apart.open
    qtbot.waitUntil(lambda: not panel.apart.open, timeout=30_000)
    assert json.loads(heard.read_text())["stance"] == [15.0, 90.0, -40.0, 0.0]
    assert "the window of its own has ended: no context" in panel.text.text()
    panel.apart._command = serving(tmp_path, "sys.stdin.read()\n")
    panel.open_apart()
    panel.apart.close()
    qtbot.waitUntil(lambda: not panel.apart.open, timeout=30_000)
    assert "of its own" not in panel.text.text()  # a person has closed it


def test_a_person_can_ask_for_lines_or_for_pictures(monkeypatch: pytest.MonkeyPatch, qapp: object) -> None:
    assert not wanted()  # drawn into memory
    monkeypatch.setenv(VARIABLE, "solid")
    assert wanted()
    monkeypatch.setenv(VARIABLE, "lines")
    assert not wanted()


def test_requests_are_lines_of_json(panel: ArmsPanel) -> None:
    request = panel.solid.request(Stance(0.0, 0.0, 45.0))
    assert request is not None
    assert json.loads(json.dumps(request)) == request
    assert request["width"] * request["height"] <= 1.3e6
