"""Order of live predictions: nearest first, every point in every stage, one bad point harms no other."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from instrument.events import Geometry
from twin.schedule import PATIENCE, Schedule, Stage

STAGES = (Stage(0.01, 4), Stage(0.001, 2))


def points(planes: int, length: int) -> list[Geometry]:
    return [
        Geometry(wavelength=500, illumination_zenith=0, sensor_zenith=z, sensor_azimuth=azimuth)
        for azimuth in range(planes)
        for z in range(length)
    ]


def work_off(schedule: Schedule, bad: frozenset[int] = frozenset(), limit: int = 10_000) -> list:
    """Do everything; batches with a bad point fail."""
    done = []
    while (batch := schedule.next_batch()) is not None:
        assert len(done) < limit
        done.append(batch)
        if bad & set(batch.indices):
            schedule.failed(batch)
        else:
            schedule.succeeded(batch)
    return done


def test_a_slice_at_a_time_coarse_before_fine():
    batches = work_off(Schedule(points(2, 6), STAGES))
    assert [b.indices for b in batches[:4]] == [(0, 1, 2, 3), (4, 5), (6, 7, 8, 9), (10, 11)]
    assert [b.standard_error for b in batches] == [0.01] * 4 + [0.001] * 6
    assert batches[4].indices == (0, 1)


def test_a_first_look_names_its_sight_lines_and_later_stages_their_error():
    batches = work_off(Schedule(points(1, 2), (Stage(0.01, 2, sight_lines=64), Stage(0.001, 2))))
    assert [(b.standard_error, b.sight_lines) for b in batches] == [(0.01, 64), (0.001, None)]


def test_what_lies_ahead_of_the_scan_comes_first():
    schedule = Schedule(points(2, 6), STAGES)
    schedule.move_to(8)
    order = [b.indices for b in work_off(schedule) if b.standard_error == 0.01]
    assert order == [(8, 9, 10, 11), (0, 1, 2, 3), (4, 5), (6, 7)]


def test_a_moving_scan_redirects_the_work():
    schedule = Schedule(points(3, 4), STAGES)
    schedule.succeeded(schedule.next_batch())
    schedule.move_to(8)
    assert schedule.next_batch().indices == (8, 9, 10, 11)


def test_after_the_scan_only_measured_points_matter():
    schedule = Schedule(points(2, 6), STAGES)
    schedule.restrict({1, 7})
    assert {i for b in work_off(schedule) for i in b.indices} == {1, 7}
    assert schedule.remaining == 0


def test_a_point_that_always_fails_is_found_and_given_up_and_costs_few_crashes():
    schedule = Schedule(points(1, 33), (Stage(0.01, 33), Stage(0.001, 11)))
    batches = work_off(schedule, bad=frozenset({17}))
    assert schedule.given_up == {17}
    assert sum(17 in b.indices for b in batches) <= 3 + PATIENCE


def test_a_refused_point_is_asked_for_alone_and_never_again():
    schedule = Schedule(points(1, 4), STAGES)
    schedule.refused(schedule.next_batch())
    asked = []
    while (batch := schedule.next_batch()) is not None:
        asked.append(batch.indices)
        (schedule.refused if 2 in batch.indices else schedule.succeeded)(batch)
    assert asked == [(i,) for i in (0, 1, 2, 3, 0, 1, 3)]
    assert schedule.given_up == {2}


def test_a_batch_lost_once_is_repeated_before_later_slices():
    schedule = Schedule(points(3, 4), STAGES)
    schedule.failed(schedule.next_batch())
    assert schedule.next_batch().indices == (0,)


def test_points_that_failed_twice_wait_behind_the_others():
    schedule = Schedule(points(2, 4), STAGES)
    for _ in range(2):
        schedule.failed(schedule.next_batch())
    assert schedule.next_batch().indices == (1,)
    assert work_off(schedule)[-1].indices == (0,)


@given(
    st.integers(1, 4), st.integers(1, 9), st.sets(st.integers(0, 35)), st.integers(0, 40), st.sets(st.integers(0, 35))
)
def test_every_wanted_point_reaches_the_last_stage_or_is_given_up(planes, length, bad, position, wanted):
    count = planes * length
    schedule = Schedule(points(planes, length), STAGES)
    schedule.move_to(position)
    schedule.restrict(wanted & set(range(count)))
    batches = work_off(schedule, frozenset(bad))
    assert schedule.given_up == (wanted & bad & set(range(count)))
    for index in wanted & set(range(count)) - bad:
        assert [b.standard_error for b in batches if index in b.indices and not bad & set(b.indices)] == [0.01, 0.001]
    assert all(len(b.indices) <= 4 for b in batches)
