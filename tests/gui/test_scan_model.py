"""The model follows events without Qt."""

from __future__ import annotations

import subprocess
import sys
from datetime import timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scan_script import START, changed, ending, geometries, measured, predicted, preparation, readings, started

from gui.comparison import score
from gui.model import MESSAGES_KEPT, ScanModel
from gui.notices import ControllerClosed, ControllerFailed, ControllerStarting, OperatorAnswered, OperatorAsked
from gui.points import PlaneKey, plane_of
from instrument.events import Event, Message, PointSkipped, PointStarted, ScanEnded, from_json, to_json
from instrument.states import State

POINTS = geometries({0.0: (0.0, 90.0), 15.0: (0.0,)}, step=20)


def model_of(*events: object) -> ScanModel:
    model = ScanModel(score)
    for event in events:
        model.apply(event)  # type: ignore[arg-type]
    return model


def test_points_are_grouped_by_plane_and_sorted_by_sensor_zenith() -> None:
    model = model_of(started(tuple(reversed(POINTS))))
    assert len(model.planes) == 3
    assert sum(len(indices) for indices in model.planes.values()) == len(POINTS) == model.total
    for plane in model.planes:
        zeniths = [point.geometry.sensor_zenith for point in model.plane_points(plane)]
        assert zeniths == sorted(zeniths)


def test_a_plane_that_the_plan_does_not_have_is_empty() -> None:
    assert model_of(started(POINTS)).plane_points(PlaneKey(1.0, 2.0, 3.0, 4.0)) == []


def test_points_that_differ_in_wavelength_lie_in_different_planes() -> None:
    both = geometries({0.0: (0.0,)}, step=20) + geometries({0.0: (0.0,)}, step=20, wavelength=650.0)
    assert {plane.wavelength for plane in model_of(started(both)).planes} == {500.0, 650.0}


def test_prediction_and_reading_give_a_score_in_either_order() -> None:
    reading, prediction = measured(0, POINTS, 0.40, 0.01), predicted(0, 0.415, 0.0)
    for order in ((reading, prediction), (prediction, reading)):
        point = model_of(started(POINTS), *order).points[0]
        assert point.score is not None
        assert point.score.t == pytest.approx(1.5)
        assert point.score.relative_difference == pytest.approx(0.0375)
        assert point.score.category == "acceptable"


@pytest.mark.parametrize(
    ("simulated", "category"), [(0.4099, "good"), (0.3901, "good"), (0.385, "acceptable"), (0.4201, "poor")]
)
def test_tally_counts_each_category(simulated: float, category: str) -> None:
    model = model_of(started(POINTS), measured(0, POINTS, 0.40, 0.01), predicted(0, simulated, 0.0))
    assert {name: count for name, count in model.tally.items() if count} == {category: 1}
    assert model.plane_tally[plane_of(POINTS[0])] == model.tally


def test_a_better_prediction_moves_a_point_to_another_category() -> None:
    model = model_of(started(POINTS), measured(0, POINTS, 0.40, 0.01), predicted(0, 0.45, 0.0))
    assert model.tally["poor"] == 1
    model.apply(predicted(0, 0.40, 0.0))
    assert (model.tally["poor"], model.tally["good"]) == (0, 1)


def test_without_any_uncertainty_or_with_a_zero_reading_there_is_no_score() -> None:
    for brf, u_brf in ((0.4, 0.0), (0.0, 0.1)):
        model = model_of(started(POINTS), measured(0, POINTS, brf, u_brf), predicted(0, 0.41, 0.0))
        assert model.points[0].score is None
        assert sum(model.tally.values()) == 0


def test_annotations_of_other_observers_are_no_prediction() -> None:
    assert model_of(started(POINTS), predicted(0, 0.4, 0.1, source="weather")).points[0].simulated is None


def test_a_skipped_point_is_missing_and_a_later_reading_makes_it_good() -> None:
    model = model_of(started(POINTS), PointSkipped(time=START, index=2, geometry=POINTS[2], reason="arm stalled"))
    plane = plane_of(POINTS[2])
    assert (model.missing, model.plane_missing[plane], model.settled, model.measured) == (1, 1, 1, 0)
    model.apply(measured(2, POINTS, 0.4, 0.01))
    assert (model.missing, model.plane_missing[plane], model.settled, model.measured) == (0, 0, 1, 1)


def test_a_resumed_scan_counts_what_was_measured_before() -> None:
    model = model_of(started(POINTS, done=(0, 1, 2)))
    assert (model.measured, model.settled) == (3, 3)
    model.apply(measured(3, POINTS, 0.4, 0.01))
    assert (model.measured, model.settled) == (4, 4)


def test_the_model_follows_the_arms_and_the_state() -> None:
    model = model_of(
        *preparation(POINTS),
        changed("mounting", "moving"),
        PointStarted(time=START, index=9, geometry=POINTS[9]),
    )
    assert model.state is State.MOVING
    assert model.current == 9
    assert model.current_plane == plane_of(POINTS[9])
    assert [reference.sensor_azimuth for reference in model.references] == [0.0, 45.0, 90.0, 135.0]


def test_a_whole_scan_ends_with_every_point_settled() -> None:
    model = model_of(*preparation(POINTS), *readings(POINTS, len(POINTS)), *ending(POINTS))
    assert model.state is State.FINISHED
    assert model.settled == model.measured == model.total == sum(model.tally.values()) == len(POINTS)
    assert model.time_left_s == 0
    assert model.current is None


def test_time_left_is_wall_clock_time() -> None:
    assert model_of(started(POINTS, duration_s=600.0, clock_speed=60.0)).time_left_s == pytest.approx(10.0)


def test_changes_name_the_planes_that_have_news() -> None:
    model = model_of(started(POINTS))
    assert model.take_changes().scan
    model.apply(measured(0, POINTS, 0.4, 0.01))
    changes = model.take_changes()
    assert changes.planes == {plane_of(POINTS[0])}
    assert changes.progress
    assert not changes.scan
    assert model.take_changes().planes == set()


def test_messages_are_kept_up_to_a_limit() -> None:
    model = model_of(*(Message(time=START, level="info", text=str(i)) for i in range(MESSAGES_KEPT + 5)))
    assert len(model.messages) == MESSAGES_KEPT
    assert model.messages[-1].text == str(MESSAGES_KEPT + 4)


def test_messages_survive_the_start_of_a_scan() -> None:
    assert len(model_of(Message(time=START, level="info", text="before"), started(POINTS)).messages) == 1


def test_a_controller_that_fails_leaves_a_fault_and_a_message() -> None:
    model = model_of(ControllerStarting())
    assert model.connected
    assert model.state is State.CONNECTING
    model.apply(ControllerFailed(START, "plan.toml: no such file", "Correct the file."))
    model.apply(ControllerClosed())
    assert model.state is State.FAULTED
    assert not model.connected
    assert model.messages[-1].advice == "Correct the file."


def test_a_failure_after_the_end_does_not_turn_a_finished_scan_into_a_fault() -> None:
    model = model_of(*preparation(POINTS), *ending(POINTS), ControllerFailed(START, "figures could not be drawn"))
    assert model.state is State.FINISHED
    assert model.messages[-1].level == "error"


def test_a_request_to_the_operator_is_open_until_it_is_answered() -> None:
    model = model_of(ControllerStarting(), OperatorAsked("sample"))
    assert model.request == "sample"
    model.apply(OperatorAnswered())
    assert model.request is None


def test_an_aborted_scan_has_no_time_left_to_show() -> None:
    end = ScanEnded(time=START + timedelta(minutes=3), outcome="aborted", done=4, total=len(POINTS))
    model = model_of(started(POINTS), end)
    assert model.state is State.ABORTED
    assert model.time_left_s is None


def test_what_is_no_event_is_refused() -> None:
    with pytest.raises(TypeError, match="no event"):
        model_of("hello")


@given(
    st.lists(
        st.one_of(
            st.builds(
                lambda i, v, u: measured(i, POINTS, v, u),
                st.integers(0, len(POINTS) - 1),
                st.floats(0, 1),
                st.floats(0, 0.1),
            ),
            st.builds(
                predicted,
                st.integers(0, len(POINTS) - 1),
                st.floats(0, 1),
                st.floats(0, 0.1),
            ),
            st.builds(
                lambda i: PointSkipped(time=START, index=i, geometry=POINTS[i], reason="stalled"),
                st.integers(0, len(POINTS) - 1),
            ),
        ),
        max_size=60,
    )
)
def test_counts_always_agree_with_the_points(events: list[Event]) -> None:
    model = model_of(started(POINTS), *events)
    assert model.measured == sum(point.brf is not None for point in model.points)
    assert model.missing == sum(bool(point.skipped) for point in model.points)
    assert model.settled == sum(point.settled for point in model.points)
    for category in ("good", "acceptable", "poor"):
        scores = [point.score for point in model.points if point.score]
        assert model.tally[category] == sum(s.category == category for s in scores)
        assert model.tally[category] == sum(tally[category] for tally in model.plane_tally.values())


def test_events_from_another_process_make_the_same_model() -> None:
    events = [*preparation(POINTS), *readings(POINTS, 12)]
    read_back = model_of(*(from_json(to_json(event)) for event in events))
    assert list(model_of(*events).points) == list(read_back.points)


def test_the_model_and_the_command_do_without_qt() -> None:
    code = "import sys, gui.model, gui.commands; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, timeout=60, capture_output=True, text=True)
    assert not {"PySide6", "shiboken6", "pyqtgraph"} & set(loaded.stdout.split())
