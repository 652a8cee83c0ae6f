"""Hemispherical patterns against closed forms, symmetry and an independent program; what of them can be measured."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from traced_samples import artifact, columns_of, facility, flat, reference_run

from instrument.facility import Arms, Budget
from twin.design.pattern import Cells, hemispherical_pattern, ideal, measurable, signal
from twin.material import lambertian
from twin.optics import COORDINATES
from twin.prediction import Twin

COARSE = Cells.of(10.0, 45.0)


def test_cells_cover_the_hemisphere_with_the_projected_solid_angle() -> None:
    cells = Cells.of(5.0, 10.0)
    weight = cells.weights()
    assert weight.sum() == pytest.approx(1.0)
    # The mean of sin^2(zenith) over the projected solid angle is 1/2.
    assert np.sum(weight * np.sin(np.deg2rad(cells.zenith))[:, None] ** 2) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("reflectance", [0.5, 1.0])
def test_a_flat_lambertian_sample_is_the_same_everywhere(reflectance: float) -> None:
    found = hemispherical_pattern(facility(), flat(), lambertian(reflectance), np.array([0.0, 40.0]), cells=COARSE)
    np.testing.assert_allclose(found["brf"], reflectance, rtol=2e-5)
    np.testing.assert_allclose(found["hemispherical_reflectance"], reflectance, rtol=2e-5)
    strength = signal(found, facility())
    assert strength.structure == pytest.approx(0.0, abs=1e-4)
    assert strength.share == 0.0


def test_a_white_cavity_gives_all_light_back() -> None:
    """What enters a single hole of a white sample leaves by it again: together the directions return everything."""
    sample = artifact([(0.0, 0.0, 2.55)], spacer=22.5, plate=0.5, depth=1.5)
    # Cells of an illumination share its light paths: only other random numbers show the error of their sum.
    found = [
        hemispherical_pattern(
            facility(target=4.0),
            sample,
            lambertian(1.0),
            np.array([20.0]),
            cells=Cells.of(10.0, 45.0),
            samples=4096,
            seed=seed,
        )
        for seed in range(1, 9)
    ]
    together = np.array([float(one["hemispherical_reflectance"][0]) for one in found])
    error = together.std(ddof=1) / np.sqrt(len(together))
    assert abs(together.mean() - 1.0) < 4 * error
    assert error < 0.01
    assert float(found[0]["brf"].std()) > 0.02


@pytest.fixture(scope="module")
def pattern() -> xr.Dataset:
    """Of the paper's artifact with every hole in place."""
    return hemispherical_pattern(
        facility(), artifact(), lambertian(0.5), np.array([0.0, 30.0]), cells=Cells.of(10.0, 45.0), standard_error=0.01
    )


def normalised(first: xr.DataArray, second: xr.DataArray, error: xr.Dataset) -> np.ndarray:
    return ((first - second) / (np.sqrt(2) * error)).values


def test_at_normal_incidence_the_pattern_has_the_symmetry_of_the_lattice(pattern: xr.Dataset) -> None:
    brf, error = (pattern[name].isel(illumination_zenith=0) for name in ("brf", "u_brf_monte_carlo"))
    quarter = normalised(brf, brf.roll(azimuth=2, roll_coords=False), error)
    assert np.sqrt(np.mean(quarter**2)) < 1.35
    assert float(brf.std()) > 5 * float(error.mean())


def test_the_plane_of_incidence_mirrors_the_pattern(pattern: xr.Dataset) -> None:
    brf, error = (pattern[name].isel(illumination_zenith=1) for name in ("brf", "u_brf_monte_carlo"))
    mirrored = brf.isel(azimuth=[(-i) % 8 for i in range(8)])
    z = normalised(brf, xr.DataArray(mirrored.values, dims=brf.dims), error)[:, [1, 2, 3]]
    assert np.sqrt(np.mean(z**2)) < 1.4


def test_a_pierced_plate_reflects_less_and_back_to_the_light(pattern: xr.Dataset) -> None:
    reflectance = pattern["hemispherical_reflectance"].values
    # More than the plate between the holes alone would, less than a flat plate.
    assert np.all(reflectance > 0.5 * (1 - np.pi * (2.55 / 2 / 3.6) ** 2))
    assert np.all(reflectance < 0.5)
    tilted = pattern["brf"].isel(illumination_zenith=1)
    assert float(tilted.sel(zenith=25.0, azimuth=0.0)) > 1.15 * float(tilted.sel(zenith=25.0, azimuth=180.0))


def test_the_reference_of_the_design_phase_is_met() -> None:
    """The same path as the command's: an ideal facility, made of a real one, and the twin."""
    run = reference_run("artifact_lamb05_ideal_hdisk.nc")
    columns = columns_of(run)
    points = xr.Dataset(coords={name: ("point", columns[name]) for name in COORDINATES})
    real = facility(10.8, profile="gaussian", mirror=10.8)
    found = Twin(ideal(real), artifact(), lambertian(0.5)).predict(points, samples=2**14, seed=3)
    variance = found.u_brf_monte_carlo.values**2 + run.R_se.values**2
    assert 0.8 <= np.mean((found.brf.values - run.R.values) ** 2 / variance) <= 1.25
    # Points of an illumination share light paths, so their mean is less certain than independent points' would be.
    assert np.mean(found.brf.values / run.R.values) == pytest.approx(1.0, abs=2e-3)


def test_the_shadow_cone_and_the_arms_limit_what_is_measurable() -> None:
    arms = Arms(sensor_zenith=(-90.0, 60.0), sensor_azimuth=(0.0, 90.0))

    def seen(zenith: float, azimuth: float) -> bool:
        return bool(measurable(arms, 15.0, np.array(zenith), np.array(azimuth)))

    assert not seen(15.0, 0.0)
    assert not seen(19.9, 0.0)
    assert seen(20.1, 0.0)
    assert seen(59.0, 45.0)
    assert not seen(61.0, 45.0)
    assert seen(61.0, 225.0)  # with a negative zenith from the opposite azimuth
    assert seen(61.0, 180.0)
    assert not seen(30.0, 135.0)
    assert not seen(30.0, 315.0)
    assert not measurable(Arms(illumination_zenith=(0.0, 10.0)), 15.0, np.array(40.0), np.array(0.0))


def made_up(brf: np.ndarray, noise: float = 0.0) -> xr.Dataset:
    cells = Cells.of(10.0, 30.0)
    weight = cells.weights()
    dims = ("illumination_zenith", "zenith", "azimuth")
    return xr.Dataset(
        {
            "brf": (dims, brf[None]),
            "u_brf_monte_carlo": (dims, np.full((1, *brf.shape), noise)),
            "weight": (dims[1:], weight),
            "hemispherical_reflectance": (dims[:1], [np.sum(brf * weight)]),
        },
        coords={"illumination_zenith": [0.0], "zenith": cells.zenith, "azimuth": cells.azimuth},
    )


def test_signal_is_the_relative_departure_on_measurable_directions() -> None:
    halves = np.where(np.arange(12) < 6, 1.1, 0.9)[None, :] * np.full((9, 1), 0.4)
    strength = signal(made_up(halves), facility().model_copy(update={"budget": Budget(measurement_noise=0.01)}))
    assert strength.structure == pytest.approx(0.1)
    assert strength.over_budget == pytest.approx(np.sqrt(np.mean([(0.1 / 0.011) ** 2, (0.1 / 0.009) ** 2])), rel=1e-6)
    assert strength.share == pytest.approx(strength.directions)


def test_signal_takes_monte_carlo_noise_off() -> None:
    noisy = 0.5 + 0.05 * np.random.default_rng(4).standard_normal((9, 12))
    assert signal(made_up(noisy), facility()).structure > 0.08
    assert signal(made_up(noisy, 0.05), facility()).structure < 0.05


def test_structure_behind_the_detector_head_does_not_count() -> None:
    peak = np.full((9, 12), 0.4)
    peak[0] = 0.8
    wide = facility().model_copy(update={"arms": Arms(shadow_half_angle=8.0)})
    narrow = facility().model_copy(update={"arms": Arms(shadow_half_angle=1.0)})
    assert signal(made_up(peak), wide).share < 0.1
    assert signal(made_up(peak), narrow).share == pytest.approx(1.0)
    assert signal(made_up(peak), narrow).over_budget is None
