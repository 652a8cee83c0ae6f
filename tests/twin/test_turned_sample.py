"""A sample that the instrument has turned about its normal."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from instrument.events import Geometry
from twin.matching import find_points
from twin.optics import geometry_columns, sample_columns
from twin.summary import prediction_dataset


def at(sensor_azimuth: float, rotation: float = 0.0, illumination_azimuth: float = 0.0) -> Geometry:
    return Geometry(
        wavelength=500,
        illumination_zenith=30,
        illumination_azimuth=illumination_azimuth,
        sensor_zenith=40,
        sensor_azimuth=sensor_azimuth,
        sample_rotation=rotation,
    )


def dataset(*points: Geometry) -> xr.Dataset:
    values = {i: {"brf": 0.5, "u_brf": 0.01, "u_brf_monte_carlo": 0.01} for i in range(len(points))}
    return prediction_dataset(points, values, {})


def test_a_turned_sample_sees_both_directions_turned_the_other_way() -> None:
    turned, still = sample_columns([at(50.0, 30.0)]), geometry_columns([at(20.0, 0.0, -30.0)])
    for name, values in still.items():
        np.testing.assert_allclose(turned[name], values)
    np.testing.assert_array_equal(sample_columns([at(50.0)])["sensor_azimuth"], [50.0])


def test_the_dataset_of_a_run_means_the_same_as_its_points() -> None:
    points = [at(50.0, 30.0), at(0.0, -90.0)]
    for name, values in sample_columns(points).items():
        np.testing.assert_allclose(sample_columns(dataset(*points))[name], values)


def test_points_are_matched_by_what_the_sample_sees() -> None:
    predicted = dataset(at(50.0, 0.0), at(50.0, 90.0), at(20.0, 30.0))
    assert find_points(dataset(at(50.0, 90.0)), predicted).tolist() == [1]
    assert find_points(dataset(at(50.0, 45.0)), predicted).tolist() == [-1]
    # The same seen from the sample, reached in another way.
    assert find_points(dataset(at(110.0, 120.0, 90.0)), predicted).tolist() == [2]


def test_runs_without_rotation_are_matched_as_ever() -> None:
    assert "sample_rotation" not in dataset(at(50.0))
    assert find_points(dataset(at(50.0)), dataset(at(20.0), at(50.0))).tolist() == [1]


def test_a_prediction_of_a_turned_sample_is_that_of_turned_directions(small_twin) -> None:
    one = small_twin.predict([at(50.0, 30.0)], samples=256)
    other = small_twin.predict([at(20.0, 0.0, -30.0)], samples=256)
    np.testing.assert_array_equal(one["brf"].values, other["brf"].values)
    assert one["sample_rotation"].values.tolist() == [30.0]
    assert one["sensor_azimuth"].values.tolist() == [50.0]


@pytest.fixture(scope="module")
def small_twin():
    from sim_fixtures.examples import example_files
    from twin.prediction import Twin

    files = example_files()
    return Twin.from_files(files.facility, files.artifact, files.material)
