"""The real window on the real engine, on the simulated laboratory."""

from __future__ import annotations

import json
import os
import signal
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

from gui import sessions
from gui.control import Controller, Listener, SessionController, WindowOperator
from gui.remote import RemoteController
from gui.setup import Setup
from gui.window import MainWindow
from instrument.journal import read_journal
from instrument.operators import Mounted
from instrument.prompts import Prompt
from instrument.session import ScanRequest, ScanSession
from instrument.states import State
from sim_fixtures.laboratory import SimulatedLaboratory, start_simulated

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


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedLaboratory]:
    """One simulated laboratory, which the scans of this module have one after the other."""
    with start_simulated(tmp_path_factory.mktemp("laboratory"), speed=SPEED) as started:
        yield started


@pytest.fixture
def open_window(qtbot: QtBot, tmp_path: Path, laboratory: SimulatedLaboratory) -> Iterator[Callable[..., MainWindow]]:
    plan = tmp_path / "short.toml"
    plan.write_text(PLAN)
    controllers: list[SessionController] = []
    files = laboratory.inputs

    def make(twin: bool = False, **how: Any) -> MainWindow:
        seen = {"artifact": files.artifact, "material": files.material} if twin else {}
        how.setdefault("make_session", lambda request, operator: ScanSession(request, laboratory.operator))

        def factory(listener: Listener, chosen: Path | None) -> Controller:
            where = {"devices": files.devices, "facility": files.facility, "out": tmp_path / "run"}
            request = ScanRequest(plan=chosen, twin=twin, **where, **seen)
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


#: Stands where the diagnosis would, which has tests of its own: reads what it is given, and finds nothing.
FINDS_NOTHING = """
import json, sys
from pathlib import Path
import h5py
given = dict(zip(sys.argv[3:-1:2], sys.argv[4:-1:2], strict=True))
assert sys.argv[1] == "diagnose" and sys.argv[-1] == "--force" and Path(given["--facility"]).is_file()
with h5py.File(sys.argv[2]) as run:
    found = {"verdict": "none", "measured": run["brf"][:].tolist(), "file": sys.argv[2]}
Path(given["--json"]).write_text(json.dumps(found))
"""


def diagnosed_so_far(window: MainWindow, qtbot: QtBot, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scan that runs is diagnosed as far as it is measured."""
    (folder / "finds_nothing.py").write_text(FINDS_NOTHING)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
    window.show_page("understand")
    page: Any = window.page("understand")
    assert page.folder == folder / "run"  # offered without being asked for
    run = page._child.run
    monkeypatch.setattr(page._child, "run", lambda module, arguments: run("finds_nothing", arguments))
    page.begin.click()
    qtbot.waitUntil(lambda: page.state.text().startswith(("Done in", "⚠")), timeout=LONG)
    assert page.state.text().startswith("Done in"), page.state.text()
    assert page.verdict.text() == "No gap beyond the uncertainties"
    measured = [point.brf for point in window.model.points if point.brf is not None]
    assert page.found["measured"] == pytest.approx(measured, rel=0.1)  # the closing reference is not yet there
    assert not Path(page.found["file"]).parent.exists()  # the copy is gone


def test_a_scan_is_started_paused_diagnosed_resumed_and_finished(
    open_window: Callable[..., MainWindow], qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = open_window()
    model = window.model
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: model.measured >= 2, timeout=LONG)
    qtbot.keyClick(window, F6)
    qtbot.waitUntil(lambda: model.state is State.PAUSED, timeout=LONG)
    resting_at = model.measured
    assert not window.panel("ControlsPanel").buttons["pause"].isEnabled()  # type: ignore[attr-defined]
    diagnosed_so_far(window, qtbot, tmp_path, monkeypatch)
    qtbot.wait(500)  # two minutes of the laboratory
    assert model.measured == resting_at < model.total
    qtbot.keyClick(window, F7)
    qtbot.waitUntil(lambda: model.state is State.FINISHED and not model.connected, timeout=LONG)
    assert model.measured == model.total == 9
    assert model.missing == 0
    assert len(model.references) == 4
    window.show_page("watch")
    qtbot.waitUntil(lambda: len(window.plots.measured.data) == 9, timeout=LONG)
    recorded = xarray.load_dataset(tmp_path / "run" / "run.nc", engine="h5netcdf")
    assert [point.brf for point in model.points] == pytest.approx(recorded["brf"].values.tolist())
    assert [point.u_brf for point in model.points] == pytest.approx(recorded["u_brf"].values.tolist())
    assert window.panel("ControlsPanel").buttons["start"].isEnabled()  # type: ignore[attr-defined]


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
    window.show_page("watch")
    qtbot.waitUntil(lambda: len(window.plots.t_points.data) == 9, timeout=LONG)
    assert len(window.plots.sim_line.getData()[0]) == 9
    scores = [point.score.t for point in model.points if point.score]
    assert max(map(abs, scores)) < 5  # the simulated laboratory has no imperfection beyond its budget


def test_a_fault_is_shown_the_scan_aborted_and_gone_on_with_from_the_start_page(
    open_window: Callable[..., MainWindow], qtbot: QtBot, tmp_path: Path, laboratory: SimulatedLaboratory
) -> None:
    """The door of the laser opens and is closed again; then the scan is aborted and gone on with."""

    def make_session(request: ScanRequest, operator: WindowOperator | None) -> ScanSession:
        if (tmp_path / "run" / "journal.jsonl").exists():
            request = ScanRequest(resume=tmp_path / "run", devices=laboratory.inputs.devices, twin=False)
        return ScanSession(request, laboratory.operator)

    window = open_window(make_session=make_session)
    model = window.model
    qtbot.keyClick(window, F5)
    qtbot.waitUntil(lambda: model.measured >= 1, timeout=LONG)
    laboratory.control("open_interlock")
    qtbot.waitUntil(lambda: model.state is State.SUSPENDED, timeout=LONG)
    panel: Any = window.panel("StatePanel")
    qtbot.waitUntil(lambda: panel.name.text() == "Suspended", timeout=LONG)
    assert "interlock" in panel.text.text()
    laboratory.control("close_interlock")
    qtbot.wait(200)
    qtbot.keyClick(window, F7)
    before = model.measured
    qtbot.waitUntil(lambda: model.measured > before, timeout=LONG)
    qtbot.keyClick(window, F8)
    box = next(box for box in window.findChildren(QMessageBox) if box.isVisible())
    qtbot.mouseClick(next(b for b in box.buttons() if b.text() == "Abort the scan"), Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: model.state is State.ABORTED and not model.connected, timeout=LONG)
    done = model.measured
    assert 0 < done < 9
    assert len(read_journal(tmp_path / "run").points) == done
    window.setup.runs = tmp_path
    window.show_page("start")
    start: Any = window.page("start")
    qtbot.waitUntil(lambda: bool(start.resume_buttons), timeout=LONG)
    assert start.resume_buttons[0].text() == f"Go on with it: {9 - done} points are missing"
    start.resume_buttons[0].click()
    qtbot.waitUntil(lambda: model.state is State.FINISHED and not model.connected, timeout=LONG)
    assert sorted(read_journal(tmp_path / "run").points) == list(range(9))


def test_the_person_at_the_window_changes_the_sample(
    open_window: Callable[..., MainWindow], qtbot: QtBot, laboratory: SimulatedLaboratory
) -> None:
    """Asked in the window; then the simulated laboratory's hands do what the person would."""

    class Both(WindowOperator):
        def mount(self, what: Mounted) -> None:
            super().mount(what)
            laboratory.operator.mount(what)

        def reply(self, prompt: Prompt) -> float | str | None:
            super().reply(prompt)
            return laboratory.operator.reply(prompt)

    window = open_window(make_session=ScanSession, make_operator=Both)
    qtbot.keyClick(window, F5)
    banner = window.panel("RequestPanel")
    requests: list[Mounted | Prompt] = []

    def answered() -> bool:
        request = window.model.request
        if request is not None and banner.isVisible() and (not requests or request is not requests[-1]):
            requests.append(request)
            qtbot.mouseClick(banner.done, Qt.MouseButton.LeftButton)  # type: ignore[attr-defined]
        return window.model.measured >= 1

    qtbot.waitUntil(answered, timeout=LONG)
    assert [request for request in requests if isinstance(request, str)] == ["reference", "sample"]


LOST = """
import os
import signal
import sys
from pathlib import Path
from PySide6.QtCore import QTimer
import gui.run
from gui.window import MainWindow

class Lost(MainWindow):
    def __init__(self, *given, **more):
        super().__init__(*given, **more)
        self.rests = False
        self.bridge.changed.connect(self.look)
        QTimer.singleShot(0, lambda: self.do("start"))

    def look(self, _):
        if self.model.measured >= 2 and not self.rests:
            self.rests = True
            self.do("pause")  # so that the scan still runs when the next window comes, however busy the machine is
        if self.model.state.value == "paused":
            os.kill(os.getpid(), signal.SIGKILL)

gui.run.MainWindow = Lost
plan, out = map(Path, sys.argv[1:])
sys.exit(gui.run.run(gui.run.Options(plan, True, 200.0, 1, None, None, None, None, out, False)))
"""


def test_a_scan_outlives_the_screen_and_a_new_window_joins_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot, laboratory: SimulatedLaboratory
) -> None:
    """Qt leaves its loop where the screen is lost, with the window open; here it is killed outright."""
    plan, out = tmp_path / "short.toml", tmp_path / "run"
    plan.write_text(PLAN)
    home = tmp_path / "s"
    monkeypatch.setenv(sessions.VARIABLE, str(home))
    environment = os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    command = [sys.executable, "-c", LOST, str(plan), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, env=environment, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    [session] = sessions.live_sessions()
    settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)
    setup = Setup(simulate=True, runs=tmp_path)
    window = MainWindow(lambda listener, plan: RemoteController(listener, setup.content()), settings, setup=setup)
    qtbot.addWidget(window, before_close_func=lambda w: setattr(w.model, "connected", False))
    with qtbot.waitActive(window):
        window.show()
        window.activateWindow()
    window.join(RemoteController(window.bridge, folder=session.folder))
    model = window.model
    qtbot.waitUntil(lambda: model.state is State.PAUSED, timeout=LONG)
    assert 2 <= model.measured < 9  # what was measured before this window was there
    qtbot.keyClick(window, F7)
    qtbot.waitUntil(lambda: model.state is State.FINISHED and not model.connected, timeout=LONG)
    assert model.measured == model.total == 9
    live = [(point.geometry, point.brf, point.u_brf) for point in model.points]
    journal = read_journal(out)
    assert sorted(journal.points) == list(range(9))
    indices = [json.loads(line).get("index") for line in (out / "journal.jsonl").read_text().splitlines()]
    assert sorted(index for index in indices if index is not None)[-1] == 8  # each point exactly once
    window.page("runs").open_folder(out)  # type: ignore[attr-defined]
    qtbot.waitUntil(lambda: model.duration_s == 0.0 and model.measured == 9, timeout=LONG)
    for point, (geometry, brf, u_brf) in zip(model.points, live, strict=True):
        assert point.geometry == geometry
        assert point.brf == pytest.approx(brf, rel=1e-9)
        assert point.u_brf == pytest.approx(u_brf, rel=1e-9)
    headless = headless_records(tmp_path, plan, laboratory)
    assert records_of(out) == headless


def records_of(run: Path) -> list[tuple[object, ...]]:
    """What a journal records, without times, readings, and rests that a person asked for."""
    lines = [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    kept = [(line["kind"], line.get("index"), str(line.get("geometry"))) for line in lines]
    return [line for line in kept if line[0] in ("header", "reference", "point", "ended")]


def headless_records(folder: Path, plan: Path, laboratory: SimulatedLaboratory) -> list[tuple[object, ...]]:
    """The same scan without a window."""
    out, files = folder / "headless", laboratory.inputs
    request = ScanRequest(plan=plan, devices=files.devices, facility=files.facility, out=out, twin=False)
    with ScanSession(request, laboratory.operator) as session:
        session.start()
        session.wait()
        session.finish()
    return records_of(out)
