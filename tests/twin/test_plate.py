"""Light through the openings of a plate: how it is shared out, and that it agrees with paths over the whole target."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from traced_samples import artifact, columns, facility, flat

from twin.artifact import build_mesh
from twin.material import lambertian
from twin.optics import Setup, lay_out
from twin.plate import in_proportion, make_plate, nearest_openings, neighbours, served, share_out, spot_on_top
from twin.tracer import UNRESTRICTED, Part, Tracer, mean_and_error

REAL = facility(profile="gaussian", mirror=10.8)
PLAN = columns([0, 15, 30, 30, 15], [40.0, -65, 80, -30, 5], [45.0, 50, 60, 120, 75])


@given(
    hnp.arrays(float, (3, 7), elements=st.floats(1e-6, 1e6) | st.just(0.0)).filter(lambda w: np.all(w.max(axis=1) > 0))
)
def test_slots_are_in_proportion_and_none_is_forgotten(weight: Any) -> None:
    count = in_proportion(weight, 512)
    np.testing.assert_array_equal(count.sum(axis=1), 512)
    assert np.all((count >= 1) == (weight > 0))
    share = weight / weight.sum(axis=1, keepdims=True)
    assert np.max(np.abs(count - share * 512)) <= 8.5  # one for each opening, and rounding


def test_neighbours_are_all_the_openings_within_their_distance() -> None:
    plate = build_mesh(artifact()).plate
    assert plate is not None
    index, number, reach = neighbours(plate)
    distance = np.linalg.norm(plate.centre[:, None] - plate.centre[None], axis=-1)
    for opening in range(len(plate.radius)):
        near = np.flatnonzero((distance[opening] <= reach[opening]) & (distance[opening] > 0))
        np.testing.assert_array_equal(np.sort(index[opening, : number[opening]]), near)
    assert number[66] == 8


def test_a_lone_opening_has_no_neighbours() -> None:
    plate = build_mesh(artifact([(1.0, 2.0, 3.0)])).plate
    assert plate is not None
    assert neighbours(plate)[1].tolist() == [0]
    assert np.all(nearest_openings(plate)[0] == 0)


def test_discs_that_overlap_or_leave_the_outline_are_no_plate() -> None:
    centre = np.array([[0.0, 0.0], [2.0, 0.0]])
    assert make_plate((5.0, 5.0), centre, np.array([0.9, 0.9]), 1.0, closed=True) is not None
    assert make_plate((5.0, 5.0), centre, np.array([1.1, 0.95]), 1.0, closed=True) is None
    assert make_plate((2.5, 5.0), centre, np.array([0.9, 0.9]), 1.0, closed=True) is None


def test_openings_serve_where_no_light_gets_past_the_top() -> None:
    plate = build_mesh(artifact()).plate
    assert plate is not None

    def serves(instrument: Any, setup: Setup | None = None, spacer_closed: bool = True) -> bool:
        layout = lay_out(instrument, columns(15.0, [80.0], 30.0), setup)
        own = plate if spacer_closed else build_mesh(artifact(spacer=0.0)).plate
        assert own is not None
        return bool(served(own, layout, spot_on_top(layout))[0])

    assert serves(REAL)
    assert not serves(REAL, Setup(offset_x_mm=21.0))  # the beam reaches the edge
    assert not serves(facility("unbounded"))  # long footprint of the target, light everywhere
    assert serves(facility("unbounded", shape="horizontal_disc"))
    assert not serves(REAL, spacer_closed=False)


def test_an_opening_off_the_target_gets_no_sight_line_and_any_other_some() -> None:
    plate = build_mesh(artifact()).plate
    assert plate is not None
    layout = lay_out(REAL, columns(0.0, [0.5], 0.0))
    slots = share_out(plate, layout, spot_on_top(layout), scattered=False)
    distance = np.linalg.norm(plate.centre, axis=1)
    chosen = np.zeros(len(distance), dtype=bool)
    chosen[slots.opening[0]] = True
    assert np.all(chosen[distance < 5.4 + plate.radius])
    assert not np.any(chosen[distance > 9.0])


@pytest.mark.parametrize(
    ("sample", "instrument", "setup"),
    [
        (artifact(), REAL, None),
        (artifact(), REAL, Setup(tilt_x_deg=2.0, height_mm=0.5, offset_x_mm=1.0, source_distance_mm=300.0)),
        (artifact(), facility(divergence=0.5, mirror=10.8), Setup(square_target=True)),
        (artifact(spacer=0.0), facility("unbounded", shape="horizontal_disc"), None),
        (artifact(plate=3.0, depth=3.01, diameter=2.0), REAL, None),  # a corner of wall and floor
        (artifact([(0.5, 0.3, 4.0), (4.0, 1.0, 1.0)]), REAL, None),
        (flat(), REAL, None),
    ],
    ids=["plain", "displaced", "diverging", "open cavity", "blind holes", "two holes", "flat"],
)
def test_both_ways_of_tracing_agree(sample: Any, instrument: Any, setup: Setup | None) -> None:
    tracer = Tracer(build_mesh(sample), lambertian(0.8))
    layout, table = lay_out(instrument, PLAN, setup), np.zeros(5, int)
    assert np.all(tracer.prepare(layout, table).through)
    value, error = mean_and_error(tracer.radiance(layout, table, 4096, seed=1))
    whole, whole_error = mean_and_error(tracer.radiance(layout, table, 16384, seed=2, mixture=UNRESTRICTED))
    z = (value - whole) / np.hypot(error, whole_error)
    assert np.max(np.abs(z)) < 5
    assert np.mean(z**2) < 1 + 4 * np.sqrt(2.5 / 5)
    assert np.all(error < 0.02 * value)


def test_light_is_the_same_whatever_was_traced_before() -> None:
    mesh = build_mesh(artifact())
    layout, table = lay_out(REAL, PLAN), np.zeros(5, int)
    fresh, used = Tracer(mesh, lambertian(0.8)), Tracer(mesh, lambertian(0.8))
    for seed in range(3, 12):
        used.part(Part.SCATTERED, used.prepare(layout, table), 1024, seed=seed)
    first, later = (t.part(Part.SCATTERED, t.prepare(layout, table), 1024, seed=1) for t in (fresh, used))
    np.testing.assert_allclose(first, later, rtol=1e-12)
