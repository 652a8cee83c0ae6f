"""The store of arrays over geometries: what is known is not made again, what is damaged is, and processes agree."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.diagnosis.store import PointStore

NAMES = ("first", "second")


def columns(zenith) -> dict[str, np.ndarray]:
    zenith = np.asarray(zenith, dtype=float)
    fixed = {"wavelength": 500.0, "illumination_zenith": 15.0, "illumination_azimuth": 0.0, "sensor_azimuth": 50.0}
    return {"sensor_zenith": zenith} | {name: np.full(len(zenith), value) for name, value in fixed.items()}


class Making:
    """Arrays that are functions of the geometry, and which geometries were asked for."""

    def __init__(self) -> None:
        self.asked: list[list[float]] = []

    def __call__(self, where: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        zenith = where["sensor_zenith"]
        self.asked.append(zenith.tolist())
        return {"first": np.stack([zenith**2, zenith + 1]), "second": -zenith}


@settings(max_examples=25, deadline=None)
@given(st.lists(st.lists(st.integers(-80, 80), min_size=1, max_size=12), min_size=1, max_size=4))
def test_arrays_are_those_of_the_geometries_whatever_was_asked_before(tmp_path_factory, requests):
    store, make = PointStore(tmp_path_factory.mktemp("s"), NAMES), Making()
    for zenith in requests:
        found = store.get("content", columns(zenith), make)
        np.testing.assert_array_equal(found["first"], [np.square(zenith), np.add(zenith, 1)])
        np.testing.assert_array_equal(found["second"], np.negative(zenith))
    # Each geometry once, in all requests together.
    asked = [z for one in make.asked for z in one]
    assert sorted(asked) == sorted({z for zenith in requests for z in zenith})


def test_contents_do_not_share_what_is_kept(tmp_path: Path):
    store, make = PointStore(tmp_path, NAMES), Making()
    store.get("one", columns([10.0]), make)
    assert store.lacking("one", columns([10.0, 20.0, 20.0])) == 1
    assert store.lacking("other", columns([10.0, 20.0])) == 2


def test_without_a_folder_nothing_is_kept():
    store, make = PointStore(None, NAMES), Making()
    for _ in range(2):
        store.get("content", columns([10.0, 10.0]), make)
    assert make.asked == [[10.0], [10.0]]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(path.read_bytes()[:100]),
        lambda path: np.savez(path, geometry=np.zeros((1, 5))),
        lambda path: np.savez(path, geometry=np.zeros((1, 5)), first=np.full((2, 1), np.nan), second=np.zeros(1)),
        lambda path: np.savez(path, geometry=np.zeros((1, 5)), first=np.zeros((2, 3)), second=np.zeros(3)),
    ],
    ids=["cut short", "an array missing", "not a number", "of other lengths"],
)
def test_damaged_file_is_said_and_made_again(tmp_path: Path, caplog: pytest.LogCaptureFixture, spoil):
    store, make = PointStore(tmp_path, NAMES), Making()
    store.get("content", columns([10.0]), make)
    (kept,) = tmp_path.glob("*.npz")
    spoil(kept)
    with caplog.at_level(logging.WARNING):
        assert store.get("content", columns([10.0]), make)["second"] == -10.0
    assert "worked out again" in caplog.text
    assert store.lacking("content", columns([10.0])) == 0


def test_folder_that_cannot_be_written_costs_only_the_next_time(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    (tmp_path / "file").write_text("no folder")
    store, make = PointStore(tmp_path / "file", NAMES), Making()
    assert store.get("content", columns([10.0]), make)["second"] == -10.0
    assert "cannot be kept" in caplog.text
