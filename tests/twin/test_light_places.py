"""Which places a sight line is joined to: how many there are, times how much they see of its end."""

from __future__ import annotations

import numpy as np
import pytest
from traced_samples import artifact

from twin.artifact import build_mesh
from twin.light_places import BINS, LEVEL_RATE, SIDE_RATE, Favours
from twin.llvm import import_mitsuba
from twin.material import lambertian
from twin.plate import NEIGHBOURS, Plate, neighbours
from twin.tracer import Tracer

UP, SIDE, DOWN = range(3)


def test_bins_weigh_what_a_face_can_see() -> None:
    gap, depth = 3.6, 3.0
    plate = Plate((20.0, 20.0), np.array([[0.0, 0.0], [gap, 0.0]]), np.array([1.0, 1.0]), depth, closed=True)
    number, around = (neighbours(plate)[k] for k in (1, 0))
    favours = Favours(plate, around, number)
    # One randomisation; places that face up, sideways, down under either opening.
    starts = np.cumsum([0, 3, 2, 4, 1, 0, 5])
    amount = np.diff(favours.running_sums(starts, 2)[0], axis=-1, prepend=0.0)
    assert amount.shape == (2, 3, BINS)
    level = LEVEL_RATE / (1 + (gap / (1.5 * depth)) ** 2) ** 2
    side = SIDE_RATE / (1 + (gap / (1.25 * depth)) ** 2) ** 2
    expected = {
        UP: [2 * SIDE_RATE, 4 * LEVEL_RATE, 0 * side, 5 * level],
        SIDE: [3 * SIDE_RATE, 2.0, 1 * side, 0.0],
        DOWN: [3 * LEVEL_RATE, 2 * SIDE_RATE, 1 * level, 0 * side],
    }
    for end, values in expected.items():
        np.testing.assert_allclose(amount[0, end, :4], values, rtol=1e-5, atol=1e-6)
        assert not np.any(amount[0, end, 4:])


@pytest.fixture(scope="module")
def tracer() -> Tracer:
    row = 3.6 * np.arange(-1, 2)
    return Tracer(build_mesh(artifact([(x, y, 2.0) for x in row for y in row])), lambertian(0.5))


def test_a_place_is_weighed_in_the_kernel_as_in_the_bins(tracer: Tracer) -> None:
    mi = import_mitsuba()
    light = tracer._light
    assert light is not None
    assert tracer._plate is not None
    openings = len(tracer._plate.radius)
    # One place of each kind under every opening: the amount of a bin is the rate of a place.
    amount = np.diff(light._favours.running_sums(np.arange(3 * openings + 1), openings)[0], axis=-1, prepend=0.0)
    which = light._favours.bins()
    height = {UP: 1.0, SIDE: 0.0, DOWN: -1.0}
    for end, kinds in ((UP, (SIDE, DOWN)), (SIDE, (UP, SIDE)), (DOWN, (UP, SIDE))):
        for j, kind in enumerate(kinds):
            opening = np.repeat(np.arange(openings, dtype=np.uint32), openings)
            its = np.tile(np.arange(openings, dtype=np.uint32), openings)
            rate = np.array(
                light._rate(
                    mi.UInt32(opening), mi.UInt32(its), mi.Float(height[end]), mi.Float(height[kind]), mi.Bool(True)
                )
            ).reshape(openings, openings)
            table = np.zeros((openings, openings))
            for k in range(NEIGHBOURS + 1):
                bins = amount[:, end, 2 * k + j]
                table[np.arange(openings), which[:, 2 * k]] += bins
            np.testing.assert_allclose(rate, table, rtol=2e-5, atol=1e-6)
    # A face sees nothing of one that faces its way.
    same = light._rate(mi.UInt32(4), mi.UInt32(4), mi.Float(1.0), mi.Float(1.0), mi.Bool(True))
    assert np.all(np.array(same) == 0.0)
