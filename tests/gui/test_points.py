"""Points kept in columns come back as they were stored."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scan_script import geometries, measured, predicted, started

from gui.comparison import score
from gui.model import ScanModel
from gui.points import Point, Points, lay_out, plane_of
from gui.scores import CATEGORIES, Score

POINTS = geometries({0.0: (0.0, 90.0), 15.0: (0.0,)}, step=20)
_NUMBERS = st.floats(allow_nan=False)
_MAYBE = st.none() | _NUMBERS
_CATEGORY = st.sampled_from(CATEGORIES)
_SCORES = st.none() | st.builds(Score, _NUMBERS, _NUMBERS, _CATEGORY, _NUMBERS, _CATEGORY, _CATEGORY)
_TIMES = st.none() | st.datetimes(timezones=st.just(UTC))


@given(
    st.builds(
        Point,
        st.just(2),
        st.just(POINTS[2]),
        brf=_MAYBE,
        u_brf=_MAYBE,
        time=_TIMES,
        quality_flag=st.integers(0, 15),
        simulated=_MAYBE,
        u_simulated=_MAYBE,
        score=_SCORES,
        skipped=st.text(max_size=5),
        earlier=st.booleans(),
    )
)
def test_a_point_comes_back_as_it_was_stored(point: Point) -> None:
    points = Points(POINTS)
    neighbours = points[1], points[3]
    points.store(replace(point, skipped="first this"))
    points.store(point)
    assert points[2] == point
    assert (points[1], points[3]) == neighbours
    scored = {each: getattr(point.score, each, "") for each in ("category", "difference_category", "level_category")}
    for of, category in scored.items():
        bare = "measured" if point.settled else "waiting"
        assert points.standing(2, of) == ("missing" if point.skipped else category or bare)


def test_a_value_that_is_no_number_is_a_value_nevertheless() -> None:
    points = Points(POINTS)
    points.store(Point(0, POINTS[0], brf=float("nan"), u_brf=0.0))
    assert points[0].brf is not None
    assert points[0].u_brf == 0.0
    assert points[0].settled
    assert not points[1].settled


def test_points_are_counted_from_both_ends() -> None:
    points = Points(POINTS, done=(len(POINTS) - 1,))
    points.store(Point(len(POINTS) - 1, POINTS[-1], skipped="blocked", earlier=True))
    assert points[-1] == points[len(POINTS) - 1] == points[len(POINTS) - 2 :][1]
    assert points[-1].skipped == "blocked"
    with pytest.raises(IndexError):
        points[len(POINTS)]


def test_a_scan_is_laid_out_in_planes_by_ascending_zenith() -> None:
    laid = lay_out(started(tuple(reversed(POINTS)), done=(1,)))
    assert sorted(index for indices in laid.planes.values() for index in indices) == list(range(len(POINTS)))
    for plane, indices in laid.planes.items():
        shown = [laid.points[index].geometry for index in indices]
        assert {plane_of(geometry) for geometry in shown} == {plane}
        assert [g.sensor_zenith for g in shown] == sorted(g.sensor_zenith for g in shown)
    assert [point.index for point in laid.points if point.earlier] == [1]


def test_readings_take_no_memory() -> None:
    """What a scan takes is taken when it starts: of 400 readings, each adds less than 100 bytes."""
    plan = geometries({0.0: tuple(range(0, 180, 9))}, step=4)[:400]
    model = ScanModel(score)
    model.apply(started(plan))
    model.take_changes()
    later = timedelta(seconds=20)
    for index in (0, len(plan) - 1):  # what is made once
        model.apply(predicted(index, 0.4, 0.01))
        model.apply(measured(index, plan, 0.41, 0.01))
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for index in range(1, len(plan) - 1):
        model.apply(predicted(index, 0.4, 0.01))
        model.apply(measured(index, plan, 0.41, 0.01).model_copy(update={"time": datetime.now(UTC) + index * later}))
        model.take_changes()
    gc.collect()  # what tests before have left behind may be swept meanwhile, and what is made here
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert model.measured == len(plan)
    assert grown < 100 * len(plan)
