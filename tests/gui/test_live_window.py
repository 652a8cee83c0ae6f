"""The real window on the real engine, on the simulated laboratory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
import xarray
from PySide6.QtCore import QSettings, Qt
from PySide6.QtWidgets import QMessageBox
from pytestqt.qtbot import QtBot

from gui.control import Controller, Listener, SessionController, WindowOperator
from gui.window import MainWindow
from instrument.journal import read_journal
from instrument.operators import Mounted
from instrument.session import ScanRequest, ScanSession
from instrument.states import State

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]
F5, F6, F7, F8, F12 = (getattr(Qt.Key, f"Key_F{n}") for n in (5, 6, 7, 8, 12))

PLAN = """
version = 1
title = "Short"
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0]
sensor_azimuth = [50.0]
sensor_zenith = { start = -60.0, stop = 60.0, step = 15.0 }
"""
SPEED = 200.0
LONG = 120_000  # ms


@pytest.fixture
def open_window(qtbot: QtBot, tmp_path: Path) -> Iterator[Callable[..., MainWindow]]:
    plan = tmp_path / "short.toml"
    plan.write_text(PLAN)
    controllers: list[SessionController] = []

    def make(twin: bool = False, **how: Any) -> MainWindow:
        def factory(listener: Listener, chosen: Path | None) -> Controller:
            request = ScanRequest(plan=chosen, simulate=True, speed=SPEED, out=tmp_path / "run", twin=twin)
            controllers.append(SessionController(request, listener, **how))
            return controllers[-1]

        settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)
        window = MainWindow(factory, settings, plan=plan)
        qtbot.addWidget(window, before_close_func=lambda w: setattr(w.model, "connected", False))
        with qtbot.waitActive(window):
            window.show()
            window.activateWindow()
        return window

    yield make
    for controller in controllers:
        controller.abort()
        assert controller.join(60.0)


def test_a_scan_is_started_paused_resumed_and_finished(
    open_window: Callable[..., MainWindow], qtbot: QtBot, tmp_path: Path
) -> None:
    window = open_window()
    model = window.model
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: model.measured >= 2, timeout=LONG)
    qtbot.keyClick(window, F6)
    qtbot.waitUntil(lambda: model.state is State.PAUSED, timeout=LONG)
    resting_at = model.measured
    assert not window.panel("ControlsPanel").buttons["pause"].isEnabled()  # type: ignore[attr-defined]
    qtbot.wait(1500)  # five minutes of the laboratory
    assert model.measured == resting_at < model.total
    qtbot.keyClick(window, F7)
    qtbot.waitUntil(lambda: model.state is State.FINISHED and not model.connected, timeout=LONG)
    assert model.measured == model.total == 9
    assert model.missing == 0
    assert len(model.references) == 4
    assert len(window.plots.measured.data) == 9
    recorded = xarray.load_dataset(tmp_path / "run" / "run.nc", engine="h5netcdf")
    assert [point.brf for point in model.points] == pytest.approx(recorded["brf"].values.tolist())
    assert [point.u_brf for point in model.points] == pytest.approx(recorded["u_brf"].values.tolist())
    assert window.panel("ControlsPanel").buttons["start"].isEnabled()  # type: ignore[attr-defined]


def test_a_scan_is_aborted_and_what_was_measured_is_kept(
    open_window: Callable[..., MainWindow], qtbot: QtBot, tmp_path: Path
) -> None:
    window = open_window()
    model = window.model
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: model.measured >= 1, timeout=LONG)
    qtbot.keyClick(window, F8)
    box = next(box for box in window.findChildren(QMessageBox) if box.isVisible())
    qtbot.mouseClick(next(b for b in box.buttons() if b.text() == "Abort the scan"), Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: model.state is State.ABORTED and not model.connected, timeout=LONG)
    assert 1 <= model.measured < model.total
    assert len(read_journal(tmp_path / "run").points) == model.measured


def test_halt_stops_the_scan(open_window: Callable[..., MainWindow], qtbot: QtBot) -> None:
    window = open_window()
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: window.model.measured >= 1, timeout=LONG)
    qtbot.keyClick(window, F12)
    qtbot.waitUntil(lambda: window.model.state is State.HALTED and not window.model.connected, timeout=LONG)
    assert window.model.measured < window.model.total


def test_closing_the_window_ends_the_scan_in_an_orderly_way(
    open_window: Callable[..., MainWindow], qtbot: QtBot, tmp_path: Path
) -> None:
    window = open_window()
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: window.model.measured >= 1, timeout=LONG)
    assert not window.close()
    box = next(box for box in window.findChildren(QMessageBox) if box.isVisible())
    qtbot.mouseClick(next(b for b in box.buttons() if b.text() == "End the scan and close"), Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=LONG)
    assert window.model.state is State.ABORTED
    assert len(read_journal(tmp_path / "run").points) == window.model.measured


def test_a_bad_plan_is_explained_and_nothing_starts(
    open_window: Callable[..., MainWindow], qtbot: QtBot, tmp_path: Path
) -> None:
    window = open_window()
    (tmp_path / "short.toml").write_text(PLAN.replace("sensor_azimuth", "sensor_azimut"))
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: window.model.state is State.FAULTED and not window.model.connected, timeout=LONG)
    line = window.model.messages[-1]
    assert "sensor_azimut" in line.text
    assert "Correct the file" in line.advice
    assert window.model.total == 0


@pytest.mark.skipif(
    not entry_points(group="goniotwin.observers", name="twin"), reason="no observer 'twin' is installed"
)
def test_every_reading_is_shown_beside_its_prediction(open_window: Callable[..., MainWindow], qtbot: QtBot) -> None:
    window = open_window(twin=True)
    model = window.model
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: model.state is State.FINISHED and not model.connected, timeout=LONG)
    assert sum(model.tally.values()) == model.total == 9
    assert len(window.plots.sim_line.getData()[0]) == len(window.plots.t_points.data) == 9
    scores = [point.score.t for point in model.points if point.score]
    assert max(map(abs, scores)) < 5  # the simulated laboratory has no imperfection beyond its budget


class Both(WindowOperator):
    """Asks in the window, then has the simulated laboratory do what the person would."""

    session: ScanSession

    def mount(self, what: Mounted) -> None:
        super().mount(what)
        assert self.session.laboratory is not None
        self.session.laboratory.operator.mount(what)


def test_the_person_at_the_window_changes_the_sample(open_window: Callable[..., MainWindow], qtbot: QtBot) -> None:
    """With real devices the window brings the operator; here it stands before the simulated laboratory's."""
    asking: list[Both] = []

    def make_session(request: ScanRequest, operator: WindowOperator | None) -> ScanSession:
        session = ScanSession(request, asking[-1])
        asking[-1].session = session
        return session

    def operator(listener: Listener) -> Both:
        asking.append(Both(listener))
        return asking[-1]

    window = open_window(make_session=make_session, make_operator=operator)
    qtbot.keyClick(window, F5)
    banner = window.panel("RequestPanel")
    for what in ("reference", "sample"):
        qtbot.waitUntil(banner.isVisible, timeout=LONG)
        assert window.model.request == what
        assert window.model.state is State.MOUNTING
        qtbot.mouseClick(banner.done, Qt.MouseButton.LeftButton)  # type: ignore[attr-defined]
        qtbot.waitUntil(lambda: not banner.isVisible(), timeout=LONG)
    qtbot.waitUntil(lambda: window.model.measured >= 1, timeout=LONG)


LOST = """
import sys
from pathlib import Path
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication
import gui.run
from gui.window import MainWindow

class Lost(MainWindow):
    def __init__(self, *given, **more):
        super().__init__(*given, **more)
        self.bridge.changed.connect(lambda _: self.model.measured >= 2 and QApplication.exit(1))
        QTimer.singleShot(0, lambda: self.do("start"))

gui.run.MainWindow = Lost
plan, out = map(Path, sys.argv[1:])
sys.exit(gui.run.run(gui.run.Options(plan, True, 200.0, 1, None, None, None, None, out, False)))
"""


def test_a_scan_ends_in_an_orderly_way_when_the_screen_is_lost(tmp_path: Path) -> None:
    """Qt leaves its loop then, with the window open and the scan running."""
    plan, out = tmp_path / "short.toml", tmp_path / "run"
    plan.write_text(PLAN)
    environment = os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    command = [sys.executable, "-c", LOST, str(plan), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, env=environment, check=False)
    assert done.returncode == 1, done.stderr
    ended = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    assert [entry["outcome"] for entry in ended if entry["kind"] == "ended"] == ["aborted"]
    assert ended[-1]["new"] == "aborted"
