from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin.llvm import import_mitsuba
from twin.sequence import DIMENSIONS, INDEX_BITS, Points, byte_tables, coherent_order, mix, mix_numpy


@pytest.fixture(scope="module")
def draw() -> Any:
    mi = import_mitsuba()
    import drjit as dr

    points = Points(mi, dr)

    def coordinates(count: int, dimension: int, seed: int, first: int = 0) -> np.ndarray:
        index = dr.arange(mi.UInt32, count) + first
        return np.array(points.coordinate(index, dr.opaque(mi.UInt32, dimension), mi.UInt32(seed), True))

    return coordinates


def test_points_before_scrambling_are_those_of_scipy() -> None:
    """SciPy counts in Gray code: its point n is the one of index n ^ (n >> 1) here."""
    from scipy.stats import qmc

    points = qmc.Sobol(DIMENSIONS, scramble=False, bits=32)
    for number in (1, 5, 1000, 65_535, 2**INDEX_BITS - 1):
        points.reset().fast_forward(number)
        index = number ^ (number >> 1)
        parts = [byte_tables()[:, byte, (index >> 8 * byte) & 255] for byte in range(3)]
        reversed_bits = [f"{word:032b}" for word in parts[0] ^ parts[1] ^ parts[2]]
        coordinate = [int(bits[::-1], 2) / 2**32 for bits in reversed_bits]
        np.testing.assert_array_equal(points.random(1)[0], coordinate)


@pytest.mark.parametrize("dimension", [0, 1, 5, DIMENSIONS - 1])
def test_every_coordinate_is_stratified(draw: Any, dimension: int) -> None:
    x = draw(1024, dimension, 17)
    np.testing.assert_array_equal(np.sort((x * 1024).astype(int)), np.arange(1024))


def test_the_first_two_coordinates_are_a_net(draw: Any) -> None:
    """Every elementary box of area 1/1024 holds one point."""
    x, y = draw(1024, 0, 5, 4096), draw(1024, 1, 5, 4096)
    for bits in range(11):
        boxes = (x * 2**bits).astype(int) * 2 ** (10 - bits) + (y * 2 ** (10 - bits)).astype(int)
        assert len(np.unique(boxes)) == 1024


def test_randomisations_are_independent(draw: Any) -> None:
    first = np.array([draw(1, 3, seed)[0] for seed in range(400)])
    assert abs(first.mean() - 0.5) < 4 / np.sqrt(12 * 400)
    pairs = np.array([[draw(2, 3, seed)[0], draw(2, 4, seed)[0]] for seed in range(400)])
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / np.sqrt(400)


def test_past_the_last_dimension_numbers_are_uniform(draw: Any) -> None:
    x = draw(20000, DIMENSIONS + 3, 9)
    histogram = np.histogram(x, 20, (0, 1))[0]
    assert np.sum((histogram - 1000) ** 2 / 1000) < 45  # 19 degrees of freedom, p = 0.0007
    assert abs(np.corrcoef(x, draw(20000, DIMENSIONS + 4, 9))[0, 1]) < 0.03


@pytest.mark.parametrize("bits", [1, 4, 9, 10])
def test_the_coherent_order_walks_between_neighbours(draw: Any, bits: int) -> None:
    number = np.arange(2**bits)
    tables = coherent_order(bits)
    index = tables[0, number & 255] ^ tables[1, (number >> 8) & 255] ^ tables[2, number >> 16]
    np.testing.assert_array_equal(np.sort(index), number)
    x, y = (draw(2**bits, d, 3)[index] for d in (0, 1))
    if bits >= 9:
        packets = np.stack([x, y], 1).reshape(-1, 8, 2)
        assert np.max(np.ptp(packets, axis=1)) <= 8 / 2 ** (bits // 2)


def test_the_hash_is_the_same_on_both_sides() -> None:
    mi = import_mitsuba()
    values = np.array([0, 1, 12345, 2**32 - 1], dtype=np.uint32)
    np.testing.assert_array_equal(np.array(mix(mi.UInt32(values))), mix_numpy(values))
