"""What the window shows of a scan while it runs."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtCore import QPointF
from scan_script import START, ending, measured, predicted
from window_stage import POINTS, Stage, running

from gui.notices import ControllerClosed
from gui.points import plane_of
from instrument.events import Message, PointSkipped, PointStarted


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
