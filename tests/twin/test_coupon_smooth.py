from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from test_material import coupon

from instrument.errors import InputError
from twin.coupon import choose, coupon_readings, from_coupon, lay_out, smooth_gridding_error
from twin.material import Material
from twin.reflection_models.smooth import Directions, _factor, _weights, left_out, smooth


def rough(theta_i: Any, theta_o: Any, phi: Any) -> np.ndarray:
    """Reflectance factor of a coating that scatters forward at grazing angles; folded angles, degree."""
    s = np.sin(np.deg2rad(theta_i)) * np.sin(np.deg2rad(theta_o))
    cosine = np.cos(np.deg2rad(phi))
    return 0.58 + 0.35 * s**3 * ((1 - cosine) / 2) ** 2 + 0.06 * s * ((1 + cosine) / 2) ** 4


def glossy(theta_i: Any, theta_o: Any, phi: Any) -> np.ndarray:
    """A lobe a few degrees wide about the mirror direction."""
    i, o, p = np.deg2rad(theta_i), np.deg2rad(theta_o), np.deg2rad(phi)
    away = np.arccos(np.clip(np.cos(i) * np.cos(o) - np.sin(i) * np.sin(o) * np.cos(p), -1, 1))
    return 0.2 + 3.0 * np.exp(-np.rad2deg(away) / 9)


def run_of(brf: Any, noise: float = 0.0, seed: int = 0) -> xr.Dataset:
    run = coupon()
    o, p = np.abs(run.sensor_zenith.values), run.sensor_azimuth.values + 180.0 * (run.sensor_zenith.values < 0)
    values = brf(run.illumination_zenith.values, o, p)
    values = values * (1 + noise * np.random.default_rng(seed).standard_normal(len(values)))
    return run.assign(brf=("point", values))


def relative_error(material: Material, brf: Any, last_i: float, last_o: float, first_i: float = 0.0) -> float:
    """Root mean square over directions up to the zeniths given."""
    random = np.random.default_rng(4)
    cos_i = np.sqrt(random.uniform(np.cos(np.deg2rad(last_i)) ** 2, np.cos(np.deg2rad(first_i)) ** 2, 4000))
    cos_o = np.sqrt(random.uniform(np.cos(np.deg2rad(last_o)) ** 2, 1, 4000))
    phi = random.uniform(0, 2 * np.pi, 4000)
    truth = brf(np.rad2deg(np.arccos(cos_i)), np.rad2deg(np.arccos(cos_o)), np.rad2deg(phi))
    return float(np.sqrt(np.mean((np.pi * material.evaluate(cos_o, phi, cos_i) / truth - 1) ** 2)))


@pytest.mark.parametrize("noise", [0.0, 0.006])
def test_the_smooth_fit_is_closer_to_the_truth_than_linear_interpolation(noise: float) -> None:
    run = run_of(rough, noise)
    linear, fitted = from_coupon(run, "c", "linear"), from_coupon(run, "c", "smooth")
    assert relative_error(fitted, rough, 60, 80) < 0.5 * relative_error(linear, rough, 60, 80)


def test_reciprocity_tells_what_grazing_incidence_does() -> None:
    run = run_of(rough)
    nearest, filled = from_coupon(run, "c", "linear"), from_coupon(run, "c", "filled")
    worst = relative_error(nearest, rough, 80, 60, first_i=62)
    assert worst > 0.01
    assert relative_error(filled, rough, 80, 60, first_i=62) < 0.4 * worst


def test_filling_keeps_the_readings() -> None:
    run = run_of(rough, 0.01)
    material = from_coupon(run, "c", "filled")
    o, p = np.abs(run.sensor_zenith.values), run.sensor_azimuth.values + 180.0 * (run.sensor_zenith.values < 0)
    oblique = (o > 0) & (run.illumination_zenith.values > 0) & (run.sensor_azimuth.values == 0)
    value = np.pi * material.evaluate(
        np.cos(np.deg2rad(o)), np.deg2rad(p), np.cos(np.deg2rad(run.illumination_zenith.values))
    )
    np.testing.assert_allclose(value[oblique], run.brf.values[oblique], rtol=1e-9)


def test_entries_without_a_reading_are_counted_by_rule() -> None:
    filled = from_coupon(run_of(rough), "c", "filled")
    # The paper's gaps; emergence at 85 and 90 degrees; incidence from 65 to 90 in steps of 5.
    assert filled.filled == {
        "retroreflection": 4 + 5,
        "grazing emergence": 2 * 5 * 5,
        "grazing incidence": 6 * 5 * 19,
    }
    assert filled.entries == 19 * 5 * 11


def test_a_smooth_table_is_reciprocal_and_its_grid_changes_little() -> None:
    run = run_of(rough, 0.006)
    material = from_coupon(run, "c", "smooth")
    np.testing.assert_allclose(material.brdf[0], material.brdf[0].transpose(2, 1, 0), rtol=1e-9)
    (readings,) = coupon_readings(run, "c").values()
    layout = lay_out(readings.theta_i, readings.theta_o, readings.phi, "c")
    assert smooth_gridding_error(readings, layout) < 1e-3


@pytest.mark.parametrize(("brf", "expected"), [(rough, "smooth"), (glossy, "linear")])
def test_the_method_that_predicts_left_out_readings_better_is_chosen(brf: Any, expected: str) -> None:
    run = run_of(brf, 0.004)
    assert from_coupon(run, "c").method == expected
    (readings,) = coupon_readings(run, "c").values()
    assert choose([readings], [lay_out(readings.theta_i, readings.theta_o, readings.phi, "c")]) == expected


def test_leaving_one_out_is_what_a_fit_without_it_gives() -> None:
    random = np.random.default_rng(2)
    places = Directions(random.uniform(0, 1.2, 60), random.uniform(0, 1.2, 60), random.uniform(0, np.pi, 60))
    values = 0.5 + 0.1 * random.standard_normal(60)
    left = left_out(places, values)
    for one in (3, 40):
        others = np.delete(np.arange(60), one)
        # The mean that is taken off moves a little with the reading: its coefficient costs next to nothing.
        alone = smooth(places.take(others), values[others], places.take(np.array([one])))
        assert left[one] == pytest.approx(float(alone[0]), abs=1e-4)


def test_the_fit_is_linear_in_the_readings() -> None:
    one, other = run_of(rough, 0.01, seed=1), run_of(rough, 0.01, seed=2)
    mean = one.assign(brf=(one.brf + other.brf) / 2)
    tables = [from_coupon(run, "c", "smooth").brdf for run in (one, other, mean)]
    np.testing.assert_allclose((tables[0] + tables[1]) / 2, tables[2], rtol=1e-9)


def test_another_set_of_readings_in_the_same_geometry_needs_no_new_fit() -> None:
    from_coupon(run_of(rough), "c", "smooth")
    before = _factor.cache_info().misses, _weights.cache_info().misses
    from_coupon(run_of(rough, 0.01), "c", "smooth")
    assert (_factor.cache_info().misses, _weights.cache_info().misses) == before


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(InputError, match="method: found 'cubic'"):
        from_coupon(coupon(), "c", "cubic")  # type: ignore[arg-type]
