"""The Lambertian flux against brute force, closed forms and an independent ray tracer."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from example_runs import SHARED, facility
from numpy.typing import NDArray
from scipy.stats import qmc

from instrument.angles import direction
from instrument.facility import Beam, Facility, Sensor
from instrument.lambertian import lambertian_flux

REFERENCE = SHARED / "reference" / "flat_lamb1_tophat.nc"
needs_reference = pytest.mark.skipif(not REFERENCE.exists(), reason="../shared/reference is not there")


def instrument(beam: dict | None = None, sensor: dict | None = None) -> Facility:
    known = facility()
    return known.model_copy(
        update={
            "beam": Beam.model_validate(known.beam.model_dump() | (beam or {})),
            "sensor": Sensor.model_validate(known.sensor.model_dump() | (sensor or {})),
        }
    )


def brute_force(
    of: Facility,
    illumination_zenith: float,
    sensor_zenith: float,
    sensor_azimuth: float,
    rays: int,
    seed: int,
    numbers: NDArray[np.float64] | None = None,
) -> tuple[float, float]:
    """Mean and standard error over random rays from target to mirror, without any of the cleverness.

    ``numbers``, shape (rays, 4), uniform in 0 to 1, stand for random ones.
    """
    drawn = iter(np.random.default_rng(seed).random((4, rays)) if numbers is None else numbers.T)

    def disc(diameter: float) -> NDArray[np.float64]:
        radius, angle = diameter / 2 * np.sqrt(next(drawn)), 2 * np.pi * next(drawn)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)

    view = direction(sensor_zenith, sensor_azimuth)
    basis = np.stack([direction(sensor_zenith + 90, sensor_azimuth), direction(90, sensor_azimuth + 90)])
    target = disc(of.sensor.target_diameter) @ basis
    if of.sensor.mirror_diameter > 0:
        mirror = of.sensor.mirror_distance * view + disc(of.sensor.mirror_diameter) @ basis
        ray = target - mirror
        above = mirror[:, 2] > 0
    else:
        ray, above = np.broadcast_to(-view, target.shape), np.full(rays, view[2] > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        hit = target - ray * (target[:, 2:] / ray[:, 2:])
        cosine = np.cos(np.deg2rad(illumination_zenith))
        across = np.hypot(hit[:, 0] * cosine, hit[:, 1])
        lit = (across < of.beam.diameter / 2) if of.beam.diameter != "unbounded" else np.ones(rays, dtype=bool)
        profile = np.exp(-2 * (across / of.beam.radius_1_e2) ** 2) if of.beam.profile == "gaussian" else 1.0
        flux = cosine * np.where(lit & above & (ray[:, 2] < 0), profile, 0.0)
    return float(flux.mean()), float(flux.std() / np.sqrt(rays))


@pytest.mark.parametrize(
    ("beam", "sensor"),
    [
        ({}, {}),
        ({"profile": "tophat"}, {}),
        ({}, {"mirror_diameter": 0.0}),
        ({"radius_1_e2": 2.0}, {"target_diameter": 20.0}),
        ({}, {"target_diameter": 4.0, "mirror_diameter": 40.0, "mirror_distance": 120.0}),
        ({"diameter": "unbounded"}, {}),
    ],
)
@pytest.mark.parametrize(
    "geometry", [(0.0, 15.0, 0.0), (30.0, 35.0, 0.0), (60.0, -70.0, 45.0), (15.0, 80.0, 105.0), (-45.0, 20.0, 90.0)]
)
def test_brute_force_gives_the_same(beam: dict, sensor: dict, geometry: tuple[float, float, float]) -> None:
    of = instrument(beam, sensor)
    mean, error = brute_force(of, *geometry, rays=100_000, seed=7)
    assert abs(lambertian_flux(of, *geometry) - mean) < 4.5 * error + 1e-12


@pytest.mark.parametrize("sensor_zenith", [85.0, 88.0, 89.5, 90.0])
def test_brute_force_gives_the_same_at_grazing_views(sensor_zenith: float) -> None:
    mean, error = brute_force(facility(), 30.0, sensor_zenith, 60.0, rays=400_000, seed=3)
    assert abs(lambertian_flux(facility(), 30.0, sensor_zenith, 60.0) - mean) < 4.5 * error


@pytest.mark.parametrize("geometry", [(0.0, 15.0, 0.0), (30.0, 35.0, 0.0), (60.0, -75.0, 45.0)])
def test_evenly_spread_rays_agree_to_a_few_parts_in_a_hundred_thousand(geometry: tuple[float, float, float]) -> None:
    # Scrambled Sobol points: half a million are worth far more than twenty million at random.
    spread = [qmc.Sobol(4, scramble=True, seed=seed).random_base2(15) for seed in range(16)]
    means = [brute_force(facility(), *geometry, rays=len(points), seed=0, numbers=points)[0] for points in spread]
    error = np.std(means, ddof=1) / 4
    assert abs(lambertian_flux(facility(), *geometry) - np.mean(means)) < 4.5 * error
    assert error / np.mean(means) < 2e-4


def test_a_wide_uniform_beam_gives_the_cosine_of_illumination() -> None:
    of = instrument({"diameter": "unbounded", "profile": "tophat"})
    illumination = np.array([0.0, 30.0, -60.0, 85.0])
    np.testing.assert_allclose(
        lambertian_flux(of, illumination, 40.0, 70.0), np.cos(np.deg2rad(illumination)), rtol=1e-14
    )


def test_a_beam_inside_the_field_of_view_is_seen_whole() -> None:
    # Parallel sensor: all of the beam's power, over the target's area projected on the plane: r^2 cos(view)/R^2.
    of = instrument({"profile": "tophat", "diameter": 4.0}, {"target_diameter": 12.0, "mirror_diameter": 0.0})
    views = np.array([0.0, 30.0, -60.0, 75.0])
    expected = (2 / 6) ** 2 * np.cos(np.deg2rad(views))
    np.testing.assert_allclose(lambertian_flux(of, 0.0, views, 20.0), expected, rtol=1e-6)
    np.testing.assert_allclose(lambertian_flux(of, 50.0, 0.0, 20.0), (2 / 6) ** 2, rtol=1e-6)


def test_a_gaussian_on_a_small_disc_has_its_closed_form() -> None:
    of = instrument({"radius_1_e2": 3.0, "diameter": 30.0}, {"target_diameter": 6.0, "mirror_diameter": 0.0})
    expected = (1 - np.exp(-2)) / 2  # mean of exp(-2 r^2/w^2) over r < w
    assert lambertian_flux(of, 0.0, 0.0, 0.0) == pytest.approx(expected, rel=1e-9)


def test_the_horizontal_target_does_not_care_where_it_is_seen_from() -> None:
    of = instrument(sensor={"target_shape": "horizontal_disc"})
    values = lambertian_flux(of, 30.0, [0.0, 40.0, -80.0], [0.0, 90.0, 135.0])
    assert np.ptp(values) < 1e-15


def test_symmetries_of_the_instrument() -> None:
    base = lambertian_flux(facility(), 25.0, 50.0, 65.0)
    assert lambertian_flux(facility(), -25.0, -50.0, 65.0) == pytest.approx(base, rel=1e-12)
    assert lambertian_flux(facility(), 25.0, 50.0, -65.0) == pytest.approx(base, rel=1e-6)
    assert lambertian_flux(facility(), 25.0, -50.0, 245.0) == pytest.approx(base, rel=1e-6)
    assert lambertian_flux(facility(), 25.0, 50.0, 165.0, illumination_azimuth=100.0) == pytest.approx(base, rel=1e-12)


def test_shapes_broadcast_and_repeat() -> None:
    zenith = np.array([[10.0], [20.0]])
    values = lambertian_flux(facility(), 0.0, zenith, np.array([0.0, 90.0, 0.0]))
    assert values.shape == (2, 3)
    np.testing.assert_array_equal(values[:, 0], values[:, 2])
    assert lambertian_flux(facility(), 0.0, np.zeros(0), 0.0).shape == (0,)


def test_light_and_sensor_beyond_the_horizon_give_nothing() -> None:
    assert lambertian_flux(facility(), 0.0, 93.0, 0.0) == 0.0
    assert lambertian_flux(instrument(sensor={"mirror_diameter": 0.0}), 0.0, 95.0, 0.0) == 0.0


@needs_reference
def test_the_independent_reference_surface_agrees() -> None:
    # Their source is a point 2 m away, ours is parallel: some 1e-4 apart, and more where the edges of beam and target
    # fall on each other on the sample.
    of = instrument({"profile": "tophat"}, {"mirror_diameter": 0.0})
    with xr.open_dataset(REFERENCE, engine="h5netcdf") as reference:
        reference.load()
    illumination, sensor, azimuth = (reference[name].values for name in ("theta_ill", "theta_sen", "phi_sen"))
    flux = lambertian_flux(of, illumination, sensor, azimuth)
    edges_meet = (np.abs(sensor) == illumination) & (azimuth == 0)
    ratio = np.pi * reference["L_ref"].values / flux
    assert np.abs(ratio - 1)[~edges_meet].max() < 2e-4
    assert np.abs(ratio - 1)[edges_meet].max() < 2e-3
    traced = (reference["L_art_se"].values > 0) & ~edges_meet
    deviation = (np.pi * reference["L_art"].values - flux)[traced]
    chi_square = np.mean((deviation / (np.pi * reference["L_art_se"].values[traced])) ** 2)
    assert 0.8 < chi_square < 1.25
