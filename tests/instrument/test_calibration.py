"""From readings to reflectance factors."""

from __future__ import annotations

import numpy as np
import pytest
from example_runs import SHARED, facility, geometry, reading

from instrument.calibration import Photocurrent, brf_from_readings, photocurrent
from instrument.dataset import read_run
from instrument.facility import read_facility

CASE = SHARED / "cases" / "dev" / "dev01.nc"


def test_a_photocurrent_is_the_voltage_above_dark_over_the_gain() -> None:
    result = photocurrent([[1.0, 2.0, 3.0], [2.0, 2.0, 2.0]], [0.5, 0.0], [1e6, 1e7])
    assert result.current == pytest.approx([1.5e-6, 2e-7])
    assert result.standard_error == pytest.approx([1e-6 / np.sqrt(3), 0.0])


def test_one_sample_has_no_standard_error() -> None:
    assert np.isnan(photocurrent([[1.0]], [0.0], [1e6]).standard_error).all()


def test_the_reflectance_factor_comes_back_whatever_gain_and_geometry() -> None:
    points = [geometry(60.0, illumination_zenith=30.0), geometry(-75.0, sensor_azimuth=130.0), geometry(10.0)]
    truth = [0.3, 0.5, 1.2]
    rows = [reading(point, value, 0.0) for point, value in zip(points, truth, strict=True)]
    azimuths = [0.0, 45.0, 90.0, 135.0]
    known = [reading(geometry(15.0, sensor_azimuth=azimuth), 0.99, 0.0) for azimuth in azimuths]
    result = brf_from_readings(
        facility(),
        [p.illumination_zenith for p in points],
        [p.sensor_zenith for p in points],
        [p.sensor_azimuth for p in points],
        photocurrent(*([row[key] for row in rows] for key in ("signal", "dark", "gain"))),
        azimuths,
        photocurrent(*([row[key] for row in known] for key in ("signal", "dark", "gain"))),
    )
    np.testing.assert_allclose(result.brf, truth, rtol=1e-5)


def test_the_scatter_of_the_samples_is_propagated() -> None:
    # 0.3 % of the point; the mean of four reference readings with 0.4 % each has 0.2 %.
    reference = Photocurrent(np.full(4, 2e-7), np.full(4, 0.004 * 2e-7))
    result = brf_from_readings(
        facility(), [0.0], [40.0], [0.0], Photocurrent(np.array([1e-7]), np.array([3e-10])), [0, 45, 90, 135], reference
    )
    assert result.standard_error / result.brf == pytest.approx([np.hypot(0.003, 0.002)], rel=1e-6)


@pytest.mark.skipif(not CASE.exists(), reason="../shared/cases is not there")
def test_the_readings_of_another_program_give_its_reflectance_factors() -> None:
    run = read_run(CASE)
    result = brf_from_readings(
        read_facility(SHARED / "cases" / "common" / "facility.toml"),
        run["illumination_zenith"].values,
        run["sensor_zenith"].values,
        run["sensor_azimuth"].values,
        photocurrent(run["signal"].values, run["dark"].values, run["gain"].values),
        run["reference_sensor_azimuth"].values,
        photocurrent(*(run[f"reference_{name}"].values for name in ("signal", "dark", "gain"))),
    )
    deviation = result.brf / run["brf"].values - 1
    # That program's N is a Monte Carlo estimate: 2e-4 of scatter, 1e-3 at grazing views, and no bias.
    assert abs(deviation.mean()) < 5e-5
    assert np.sqrt(np.mean(deviation**2)) < 3e-4
    assert np.abs(deviation).max() < 1.5e-3
