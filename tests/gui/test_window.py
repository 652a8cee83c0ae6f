"""The real window, drawn into memory and driven by the events an engine would send."""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QPointF, Qt
from PySide6.QtWidgets import QApplication, QLabel, QMessageBox
from pytestqt.qtbot import QtBot
from scan_script import START, changed, ending, geometries, measured, predicted, preparation, readings
from window_stage import Stage

from gui.bridge import Bridge
from gui.comparison import score
from gui.model import Changes, ScanModel
from gui.notices import ControllerClosed, ControllerStarting, OperatorAnswered, OperatorAsked
from gui.panels import discover
from gui.points import plane_of
from gui.run import obey_signals
from instrument.events import Message, PointSkipped, PointStarted

POINTS = geometries({0.0: (0.0, 90.0), 15.0: (50.0,)}, step=10)
F5, F6, F7, F8, F9, F12 = (getattr(Qt.Key, f"Key_F{n}") for n in (5, 6, 7, 8, 9, 12))


def question(stage: Stage) -> QMessageBox:
    boxes = [box for box in stage.window.findChildren(QMessageBox) if box.isVisible()]
    assert len(boxes) == 1
    return boxes[0]


def answer(stage: Stage, qtbot: QtBot, text: str) -> None:
    button = next(button for button in question(stage).buttons() if button.text() == text)
    qtbot.mouseClick(button, Qt.MouseButton.LeftButton)


def running(stage: Stage, count: int = 5) -> None:
    stage.window.do("start")
    stage.window.show_page("watch")
    stage.play(ControllerStarting(), *preparation(POINTS), *readings(POINTS, count))


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


def test_progress_counts_points_and_says_when_it_ends(stage: Stage) -> None:
    running(stage, 10)
    panel: Any = stage.window.panel("ProgressPanel")
    assert (panel.bar.value(), panel.bar.maximum()) == (10, len(POINTS))
    assert panel.points.text().startswith(f"10 of {len(POINTS)}")
    assert "min" in panel.left.text()
    stage.play(*ending(POINTS), ControllerClosed())
    assert panel.left.text() == "none"
    assert panel.end.text() == "ended 11:00 UTC"


def test_the_plot_grows_point_by_point(stage: Stage) -> None:
    running(stage, 0)
    plots = stage.window.plots
    for count in range(1, 5):
        stage.play(
            PointStarted(time=START, index=count - 1, geometry=POINTS[count - 1]),
            measured(count - 1, POINTS, 0.3, 0.01),
            predicted(count - 1, 0.305, 0.002),
        )
        assert len(plots.measured.data) == count
        assert len(plots.sim_line.getData()[0]) == count
        assert len(plots.t_points.data) == count
    assert plots.measured.data["x"].tolist() == [p.sensor_zenith for p in POINTS[:4]]
    assert plots.u1.opts["height"].tolist() == pytest.approx([0.02] * 4)  # full length of a bar from -u to +u
    assert plots.u2.opts["height"].tolist() == pytest.approx([0.04] * 4)
    outer, inner = (band.boundingRect() for band in plots.sim_bands)
    assert (inner.height(), outer.height()) == (pytest.approx(0.004), pytest.approx(0.008))


def test_t_has_bands_at_one_and_two(stage: Stage) -> None:
    assert [band.getRegion() for band in stage.window.plots.t_bands] == [(-2.0, 2.0), (-1.0, 1.0)]


def test_categories_differ_in_shape(stage: Stage) -> None:
    running(stage, 0)
    stage.play(PointStarted(time=START, index=0, geometry=POINTS[0]))
    for index, t in enumerate((0.5, 1.5, 2.5)):
        stage.play(measured(index, POINTS, 0.3, 0.01), predicted(index, 0.3 + t * 0.01, 0.0))
    assert list(stage.window.plots.t_points.data["symbol"]) == ["o", "t1", "x"]


def test_the_plot_follows_the_arms_until_a_plane_is_chosen(stage: Stage) -> None:
    running(stage, 0)
    planes, plots = list(stage.window.model.planes), stage.window.plots
    first_of = {plane: stage.window.model.planes[plane][0] for plane in planes}

    def go(plane: Any) -> None:
        index = first_of[plane]
        stage.play(PointStarted(time=START, index=index, geometry=POINTS[index]))

    go(planes[0])
    assert plots.plane == planes[0]
    go(planes[1])
    assert plots.plane == planes[1]
    table: Any = stage.window.panel("PlanesPanel")
    table.view.selectRow(0)
    assert plots.plane == planes[0]
    assert not plots.follow.isChecked()
    go(planes[2])
    assert plots.plane == planes[0]
    plots.follow.setChecked(True)
    assert plots.plane == planes[2]
    assert table.view.currentIndex().row() == 2


def test_another_plane_is_drawn_beside_the_one_that_is_shown(stage: Stage) -> None:
    running(stage, 40)
    plots, planes = stage.window.plots, list(stage.window.model.planes)
    assert plots.beside.count() == 1 + len(planes)
    table: Any = stage.window.panel("PlanesPanel")
    table.view.selectRow(0)
    plots.beside.setCurrentIndex(2)
    points = [point for point in stage.window.model.plane_points(planes[1]) if point.brf is not None]
    x, y = plots.other.getData()
    assert (list(x), list(y)) == ([p.geometry.sensor_zenith for p in points], [p.brf for p in points])
    assert len(points) > 5
    plots.beside.setCurrentIndex(1)  # the plane itself: nothing beside it
    assert plots.other.getData()[0] is None or not len(plots.other.getData()[0])


def test_the_table_of_planes_counts_points_and_categories(stage: Stage) -> None:
    running(stage, 8)
    stage.play(PointSkipped(time=START, index=8, geometry=POINTS[8], reason="stalled"))
    table = stage.window.panel("PlanesPanel").table  # type: ignore[attr-defined]
    row = table.row(plane_of(POINTS[8]))
    texts = [table.data(table.index(row, column)) or "" for column in range(table.columnCount())]
    tally = stage.window.model.plane_tally[plane_of(POINTS[8])]
    expected = [str(tally[c] or "") for c in ("good", "acceptable", "poor")]
    assert texts == ["0°", "0°", f"8/{len(stage.window.model.planes[plane_of(POINTS[8])])}", "1", *expected]


def test_the_tally_shows_counts_and_shares(stage: Stage) -> None:
    running(stage, 0)
    for index, t in enumerate((0.1, 0.2, 0.3, 3.0)):
        stage.play(measured(index, POINTS, 0.3, 0.01), predicted(index, 0.3 + t * 0.01, 0.0))
    panel: Any = stage.window.panel("TallyPanel")
    assert [panel.counts[c].text() for c in ("good", "acceptable", "poor")] == ["3", "0", "1"]
    assert [panel.shares[c].text() for c in ("good", "acceptable", "poor")] == ["75 %", "0 %", "25 %"]


def test_pointing_at_a_value_reads_it(stage: Stage) -> None:
    running(stage, 6)
    plots = stage.window.plots
    view = plots.brf_plot.getViewBox()
    plots._point_at(view.mapViewToScene(QPointF(POINTS[2].sensor_zenith, 0.3)))
    assert "measured" in plots.readout.text()
    assert f"sensor zenith {POINTS[2].sensor_zenith:g}°".replace("-", "−") in plots.readout.text()


def test_messages_say_what_to_do_newest_first(stage: Stage) -> None:
    stage.play(
        Message(time=START, level="info", text="first"),
        Message(time=START, level="error", text="The shutter does not answer", advice="Check its cable."),
    )
    table = stage.window.panel("MessagesPanel").table  # type: ignore[attr-defined]
    assert [table.data(table.index(0, c)) for c in range(1, 4)] == [
        "error",
        "The shutter does not answer",
        "Check its cable.",
    ]
    assert table.line(1).text == "first"


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


def test_events_of_many_threads_arrive_in_the_qt_thread_in_batches(qtbot: QtBot) -> None:
    model = ScanModel(score)
    bridge = Bridge(model)
    batches: list[tuple[Changes, threading.Thread]] = []
    bridge.changed.connect(lambda changes: batches.append((changes, threading.current_thread())))
    each, threads = 200, 4

    def write() -> None:
        for number in range(each):
            bridge.on_event(Message(time=START, level="info", text=str(number)))

    writers = [threading.Thread(target=write) for _ in range(threads)]
    for writer in writers:
        writer.start()
    qtbot.waitUntil(lambda: len(model.messages) == each * threads, timeout=5000)
    qtbot.wait(100)  # the Qt thread sleeps again
    bridge.on_event(Message(time=START, level="info", text="one more"))
    qtbot.waitUntil(lambda: len(model.messages) == each * threads + 1, timeout=5000)
    for writer in writers:
        writer.join()
    assert len(batches) < each * threads / 4
    assert sum(changes.messages for changes, _ in batches) == each * threads + 1
    assert {thread for _, thread in batches} == {threading.main_thread()}


def test_a_burst_of_events_does_not_hold_the_window_up(stage: Stage, qtbot: QtBot) -> None:
    points = geometries({float(i): (0.0, 45.0, 90.0) for i in range(0, 45, 5)}, step=5)
    events = [*preparation(points), *readings(points, len(points))]
    longest, last = 0.0, time.thread_time()
    for event in events:
        stage.window.bridge.on_event(event)
    while stage.window.model.settled < len(points):
        QApplication.processEvents()
        now = time.thread_time()
        longest, last = max(longest, now - last), now
    assert longest < 0.25  # generous, and of this thread: other programs may keep the machine busy


def test_memory_of_the_plot_does_not_grow_with_the_number_of_updates(stage: Stage) -> None:
    running(stage, 20)
    stage.window.plots._draw()
    gc.collect()
    before = len(stage.window.plots.graphics.scene().items())
    for _ in range(50):
        stage.window.plots._draw()
    assert len(stage.window.plots.graphics.scene().items()) == before


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="they are immortal since Python 3.12")
def test_qt_does_not_use_up_the_references_to_none_and_true(stage: Stage) -> None:
    running(stage, 20)
    before = {constant: sys.getrefcount(constant) for constant in (None, True, False)}
    for _ in range(5000):  # each emits two signals
        stage.window.plots.brf_plot.setYRange(0.0, 1.0, padding=0)
    for constant, count in before.items():
        assert sys.getrefcount(constant) > count - 1000  # PySide6 6.12.0 loses one a call and more


def test_the_drawn_sample_is_the_artifact_of_the_run(tmp_path: Path) -> None:
    from gui.solid.lines import Sample, sample_of

    assert sample_of(tmp_path) == Sample()  # none is known: a plain plate
    rows = "hole,x_mm,y_mm,diameter_mm,u_x_mm,u_y_mm,u_diameter_mm\n0,-4,1,2.5,0,0,0\n1,4,-1,2,0,0,0\n"
    (tmp_path / "holes.csv").write_text(rows)
    (tmp_path / "artifact.toml").write_text('holes = "holes.csv"\noutline = [30.0, 20.0]\n')
    assert sample_of(tmp_path) == Sample((30.0, 20.0), ((-4.0, 1.0, 2.5), (4.0, -1.0, 2.0)))
