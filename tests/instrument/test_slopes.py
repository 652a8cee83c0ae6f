"""Slopes of a measured reflectance factor, and angle terms of the budget: against functions of known derivative."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from example_runs import facility

from instrument.angles import FloatArray
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux
from instrument.quality.slopes import angle_terms, brf_slopes, flux_slopes

RAD = np.pi / 180


def grid(
    illumination: tuple[float, ...] = (0.0,),
    azimuth: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0),
    zenith: tuple[float, ...] = tuple(range(-80, 81, 5)),
) -> dict[str, FloatArray]:
    axes = np.meshgrid(illumination, azimuth, zenith, indexing="ij")
    columns = dict(zip(("illumination_zenith", "sensor_azimuth", "sensor_zenith"), map(np.ravel, axes), strict=True))
    same = np.zeros(len(columns["sensor_zenith"]))
    return {name: np.asarray(v, dtype=float) for name, v in columns.items()} | {
        "wavelength": same + 500.0,
        "illumination_azimuth": same,
    }


def with_budget(u: float = 0.25, **rows: Any) -> Facility:
    known = facility()
    arms = known.arms.model_copy(
        update={f"u_{angle}": u for angle in ("illumination_zenith", "sensor_zenith", "sensor_azimuth")}
    )
    return known.model_copy(update={"arms": arms, "budget": known.budget.model_copy(update=rows)})


def test_a_parabola_has_its_exact_slope_on_unequal_steps() -> None:
    """Second-order differences are exact for it everywhere but at the ends, also across the gap of the cone."""
    at = grid(azimuth=(90.0,), zenith=(-30.0, -20.0, -12.0, -5.0, 5.0, 8.0, 20.0))
    zenith = at["sensor_zenith"]
    slope = brf_slopes(at, 1.0 + 0.01 * zenith + 2e-4 * zenith**2)["sensor_zenith"]
    brf = 1.0 + 0.01 * zenith + 2e-4 * zenith**2
    assert (slope.relative * brf)[1:-1] == pytest.approx((0.01 + 4e-4 * zenith)[1:-1], rel=1e-9)
    assert (slope.relative * brf)[0] == pytest.approx(0.01 + 2e-4 * (-30.0 - 20.0))
    assert slope.known.all()


def test_a_cosine_of_the_azimuth_is_followed_around_the_circle() -> None:
    """Negative zeniths are the other half of it: every point has two neighbours at 45 degrees."""
    at = grid()
    zenith = at["sensor_zenith"] * RAD
    brf = 1.0 + 0.1 * np.sin(zenith) * np.cos(at["sensor_azimuth"] * RAD)
    slope = brf_slopes(at, brf)["sensor_azimuth"]
    exact = -0.1 * np.sin(zenith) * np.sin(at["sensor_azimuth"] * RAD) * RAD
    # Central differences over h make sin(h)/h of the slope of a cosine.
    assert slope.relative * brf == pytest.approx(exact * np.sin(45 * RAD) / (45 * RAD), abs=1e-12)
    assert slope.known.all()


def test_the_slope_in_illumination_needs_the_same_view_at_another_illumination() -> None:
    at = grid(illumination=(0.0, 15.0, 30.0), azimuth=(60.0,), zenith=(10.0, 20.0))
    slope = brf_slopes(at, np.exp(0.01 * at["illumination_zenith"]))["illumination_zenith"]
    expected = {0.0: np.expm1(0.15) / 15, 15.0: np.sinh(0.15) / 15, 30.0: -np.expm1(-0.15) / 15}
    assert slope.relative == pytest.approx([expected[zenith] for zenith in at["illumination_zenith"]])
    lonely = brf_slopes(grid(), np.ones(132))["illumination_zenith"]
    assert not lonely.known.any()


def test_neighbours_too_far_away_tell_nothing() -> None:
    at = grid(azimuth=(0.0, 90.0), zenith=(-60.0, -30.0, 0.0, 30.0))
    slopes = brf_slopes(at, np.linspace(1, 2, 8))
    assert not slopes["sensor_zenith"].known.any()
    assert slopes["sensor_azimuth"].known.tolist() == [False, False, True, False] * 2


def test_wavelengths_and_polarisations_do_not_mix_and_repeats_count_with_their_mean() -> None:
    one = grid(azimuth=(90.0,), zenith=(10.0, 20.0, 30.0))
    twice = {name: np.tile(values, 4) for name, values in one.items()}
    twice["wavelength"] = np.repeat([500.0, 500.0, 600.0, 600.0], 3)
    twice["polarization"] = np.repeat(["s", "p", "s", "s"], 3)
    brf = np.concatenate([[1.0, 1.1, 1.2], [2.0, 2.4, 2.8], [1.0, 1.0, 1.0], [1.4, 1.2, 1.0]])
    slope = brf_slopes(twice, brf)["sensor_zenith"].relative * brf
    assert slope == pytest.approx(np.repeat([0.01, 0.04, -0.01, -0.01], 3), abs=1e-12)


def test_the_flux_seen_by_a_sensor_that_sees_the_whole_beam_falls_with_the_cosine() -> None:
    """So an error of the sensor's zenith counts with its tangent: 2.5 % for 0.25 degrees at 80."""
    at = grid(azimuth=(0.0,), zenith=(-80.0, -70.0, 0.0, 70.0, 80.0))
    slope = flux_slopes(facility(), at)["sensor_zenith"]
    assert slope == pytest.approx(-np.tan(at["sensor_zenith"] * RAD) * RAD, rel=2e-3, abs=1e-9)
    assert 0.25 * slope[0] == pytest.approx(0.0247, abs=1e-4)


def test_an_angle_term_is_the_change_that_the_angle_makes() -> None:
    """An arm off by its uncertainty, before a sample of known BRF: the term is the change of what is read."""
    at = grid(illumination=(15.0,), azimuth=(90.0,))
    known = with_budget(0.25, sensor_zenith="slope")

    def true_brf(zenith: FloatArray) -> FloatArray:
        return np.asarray(0.5 + 0.1 * np.cos(3 * zenith * RAD))

    def read(off: float) -> FloatArray:
        zenith = at["sensor_zenith"]
        flux = [lambertian_flux(known, 15.0, zenith + d, at["sensor_azimuth"]) for d in (off, 0.0)]
        return np.asarray(true_brf(zenith + off) * flux[0] / flux[1])

    term = angle_terms(known, at, read(0.0))["sensor_zenith"]
    change = (read(0.25) - read(-0.25)) / 2
    assert term.signed[1:-1] == pytest.approx(change[1:-1], rel=0.02, abs=1e-5)
    assert "slope of brf and flux times 0.25 degrees" in term.source


def test_the_papers_way_leaves_the_flux_out() -> None:
    at = grid(azimuth=(90.0,))
    terms = angle_terms(with_budget(0.25, sensor_zenith="brf-slope"), at, np.full(33, 0.5))
    assert list(terms) == ["sensor_zenith"]
    assert np.abs(terms["sensor_zenith"].signed) == pytest.approx(np.zeros(33))


def test_rows_with_a_number_are_left_alone() -> None:
    assert angle_terms(with_budget(), grid(), np.ones(132)) == {}


def test_points_without_neighbours_get_the_root_mean_square_of_the_others() -> None:
    at = grid(azimuth=(90.0,), zenith=(10.0, 20.0, 30.0, 75.0))
    brf = np.array([1.0, 1.1, 1.2, 1.5])
    term = angle_terms(with_budget(0.2, sensor_zenith="brf-slope"), at, brf)["sensor_zenith"]
    slopes = 0.01 / brf[:3]
    assert term.signed[3] == pytest.approx(0.2 * 1.5 * np.sqrt(np.mean(slopes**2)))
    assert "from neighbours at 3 of 4 points, elsewhere their root mean square" in term.source


def test_errors_on_two_sides_of_a_peak_are_opposite() -> None:
    at = grid(azimuth=(90.0,), zenith=(-20.0, -10.0, 10.0, 20.0))
    term = angle_terms(with_budget(sensor_zenith="brf-slope"), at, np.array([0.4, 0.5, 0.5, 0.4]))["sensor_zenith"]
    assert term.correlation.tolist() == [[1, 1, -1, -1]] * 2 + [[-1, -1, 1, 1]] * 2
