"""Sweeps: what they mean, and what is said where they mean nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from traced_samples import artifact, flat

from instrument.artifact import ArtifactDimensions, Holes
from instrument.errors import InputError
from twin.design.candidates import Shape, combinations, parse_sweep, pitch_of, vary


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("hole_diameter=2.0:3.0:5", (2.0, 2.25, 2.5, 2.75, 3.0)),
        ("pitch=3.2,3.6", (3.2, 3.6)),
        ("depth = 3:5:2", (3.0, 5.0)),
        ("shape=square,hexagonal", (Shape.SQUARE, Shape.HEXAGONAL)),
    ],
)
def test_a_sweep_is_a_range_or_a_list(text: str, values: tuple) -> None:
    assert parse_sweep(text).values == values


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("diameter=2:3:4", "hole_diameter, pitch, depth"),
        ("hole_diameter", "expected one of"),
        ("hole_diameter=2:3", "start:stop:count"),
        ("hole_diameter=2:3:1", "at least 2"),
        ("hole_diameter=2:3:1000000000", "at most 50"),
        ("hole_diameter=2:x:3", "'x'"),
        ("hole_diameter=-2,3", "> 0"),
        ("hole_diameter=nan", "> 0"),
        ("pitch=3,3", "twice"),
        ("shape=round", "square, hexagonal, flat"),
    ],
)
def test_a_bad_sweep_is_explained(text: str, says: str) -> None:
    with pytest.raises(InputError) as raised:
        parse_sweep(text)
    assert text in str(raised.value)
    assert says in str(raised.value)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"hole_diameter": 3.7}, "overlap by 0.100 mm"),
        ({"pitch": 2.5}, "overlap"),
        ({"depth": 1.0}, "more than the plate's thickness"),
    ],
)
def test_what_cannot_be_made_is_explained(changes: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        vary(artifact(), changes)


def test_sweeps_combine() -> None:
    found = combinations(artifact(), [parse_sweep("depth=3,4"), parse_sweep("hole_diameter=2,2.2,2.4")])
    assert [tuple(candidate.changes.values()) for candidate in found] == [
        (depth, diameter) for depth in (3.0, 4.0) for diameter in (2.0, 2.2, 2.4)
    ]
    assert found[0].name == "depth 3 mm, hole diameter 2 mm"


@pytest.mark.parametrize(
    "sample", [flat(), artifact().__class__(artifact().form, artifact().holes, Path("a.ply"), Path("b"))]
)
def test_only_holes_are_swept(sample: ArtifactDimensions) -> None:
    with pytest.raises(InputError, match="expected holes and dimensions"):
        combinations(sample, [parse_sweep("depth=3,4")])


def test_one_parameter_is_swept_once() -> None:
    with pytest.raises(InputError, match="stands twice"):
        combinations(artifact(), [parse_sweep("depth=3,4"), parse_sweep("depth=5,6")])


def test_a_new_diameter_keeps_places_and_deviations() -> None:
    sample = artifact([(0.0, 0.0, 2.5), (3.6, 0.0, 2.7)])
    varied = vary(sample, {"hole_diameter": 2.0})
    np.testing.assert_allclose(varied.holes.diameter, [1.9, 2.1])
    np.testing.assert_array_equal(varied.holes.x, sample.holes.x)
    np.testing.assert_allclose(sample.holes.diameter, [2.5, 2.7])


def test_the_same_pitch_is_the_same_lattice() -> None:
    sample = artifact()
    varied = vary(sample, {"pitch": 3.6})
    order, as_before = (np.lexsort((h.y.round(6), h.x.round(6))) for h in (varied.holes, sample.holes))
    np.testing.assert_allclose(varied.holes.x[order], sample.holes.x[as_before], atol=1e-9)
    np.testing.assert_allclose(varied.holes.y[order], sample.holes.y[as_before], atol=1e-9)


@pytest.mark.parametrize("pitch", [2.7, 3.0, 3.3, 4.0, 5.0])
def test_a_new_pitch_fills_the_area_and_keeps_the_middle_between_holes(pitch: float) -> None:
    holes = vary(artifact(), {"pitch": pitch}).holes
    assert pitch_of(holes) == pytest.approx(pitch)
    assert holes.x.mean() == pytest.approx(0.0, abs=1e-9)
    assert np.hypot(holes.x, holes.y).min() == pytest.approx(pitch / np.sqrt(2))
    assert np.abs(holes.x).max() + pitch / 2 <= 21.6 + 1e-6
    assert np.abs(holes.x).max() + 1.5 * pitch > 21.6 - 1e-6


def test_a_hexagonal_lattice_has_six_neighbours() -> None:
    holes: Holes = vary(artifact(), {"shape": Shape.HEXAGONAL}).holes
    distance = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y)
    near = (distance < 3.6 * 1.01).sum(axis=1) - 1
    middle = np.hypot(holes.x, holes.y) < 12
    assert np.all(near[middle] == 6)
    assert pitch_of(holes) == pytest.approx(3.6)


def test_a_flat_shape_has_no_holes() -> None:
    assert len(vary(artifact(), {"shape": Shape.FLAT}).holes) == 0
