"""The flux of a flat Lambertian sample with an instrument that is off: closed forms and an independent quadrature."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from example_runs import facility
from scipy.integrate import quad
from scipy.special import erf
from scipy.stats import ncx2

from instrument.beam_image import BeamImage
from instrument.facility import Beam, Facility, Reference, Sensor
from instrument.lambertian import lambertian_flux, reference_change
from instrument.optics import Setup, lay_out
from instrument.plane_flux import plane_flux
from sim_fixtures.reality.bundle import Pose, beam_bundle, seen_from_sample, sensor_bundle
from sim_fixtures.reality.flat import lambertian_radiance


def instrument(
    beam: dict[str, Any] | None = None, sensor: dict[str, Any] | None = None, zenith: float = 15.0
) -> Facility:
    known = facility()
    changes: dict[str, Any] = {
        "beam": Beam.model_validate(known.beam.model_dump() | (beam or {})),
        "sensor": Sensor.model_validate(known.sensor.model_dump() | (sensor or {})),
        "reference": Reference.model_validate(known.reference.model_dump() | {"sensor_zenith": zenith}),
    }
    return known.model_copy(update=changes)


def flux(of: Facility, illumination: float, sensor: float, azimuth: float, setup: Setup) -> float:
    columns = {
        "illumination_zenith": np.array([illumination]),
        "illumination_azimuth": np.zeros(1),
        "sensor_zenith": np.array([sensor]),
        "sensor_azimuth": np.array([azimuth]),
    }
    return float(plane_flux(lay_out(of, columns, setup))[0])


def lens(a: float, b: float, distance: float) -> float:
    """Area that two circles share."""
    if distance <= abs(a - b):
        return float(np.pi * min(a, b) ** 2)
    u = (distance**2 + a**2 - b**2) / (2 * distance)
    v = distance - u
    return float(
        a**2 * np.arccos(u / a) - u * np.sqrt(a**2 - u**2) + b**2 * np.arccos(v / b) - v * np.sqrt(b**2 - v**2)
    )


UNIFORM, PARALLEL = {"profile": "tophat"}, {"mirror_diameter": 0.0}


@pytest.mark.parametrize("distance", [0.01, 0.3, 2.0, 5.0, 9.0])
def test_displaced_uniform_beams_share_a_lens_with_the_target(distance: float) -> None:
    of = instrument(UNIFORM | {"diameter": 9.0}, PARALLEL)
    expected = lens(4.5, 5.4, distance) / (np.pi * 5.4**2)
    assert flux(of, 0.0, 0.0, 0.0, Setup(beam_y_mm=distance)) == pytest.approx(expected, rel=2e-5)
    assert flux(of, 0.0, 0.0, 0.0, Setup(sensor_runout_mm=-distance)) == pytest.approx(expected, rel=2e-5)


@pytest.mark.parametrize("distance", [0.001, 0.25, 2.0, 6.0])
def test_a_displaced_gaussian_on_the_target_is_a_rice_distribution(distance: float) -> None:
    of = instrument({"radius_1_e2": 3.0, "diameter": "unbounded"}, PARALLEL)
    squared = (2 / 3.0) ** 2  # of the standard deviation, 1/mm2
    expected = ncx2.cdf(5.4**2 * squared, 2, distance**2 * squared) * 3.0**2 / 2 / 5.4**2
    assert flux(of, 0.0, 0.0, 0.0, Setup(beam_x_mm=distance)) == pytest.approx(expected, rel=1e-6)


def test_a_beam_within_the_field_of_view_may_move_there() -> None:
    of = instrument(UNIFORM | {"diameter": 2.0}, PARALLEL)
    for setup in (Setup(beam_x_mm=0.3, beam_y_mm=-0.2), Setup(sensor_runout_mm=0.5)):
        assert reference_change(of, setup) == pytest.approx(1.0, abs=1e-5)
    assert reference_change(of, Setup(beam_radius_mm=0.1)) == pytest.approx(1.1**2, rel=1e-6)
    assert reference_change(of, Setup(target_radius_mm=0.6)) == pytest.approx((5.4 / 6.0) ** 2, rel=1e-6)
    change = np.cos(np.deg2rad(15.5)) / np.cos(np.deg2rad(15.0))
    assert reference_change(of, Setup(sensor_zenith_deg=0.5)) == pytest.approx(change, rel=1e-6)


@pytest.mark.parametrize("step", [1e-3, 1e-2])
def test_small_changes_have_their_derivative(step: float) -> None:
    """A beam much smaller than the target: a sampled mean would see nothing of these."""
    of = instrument(UNIFORM | {"diameter": 1.0}, PARALLEL)
    slope = (reference_change(of, Setup(beam_radius_mm=step)) - 1) / step
    assert slope == pytest.approx(2 / 0.5, rel=2 * step)
    slope = (reference_change(of, Setup(sensor_zenith_deg=step)) - 1) / np.deg2rad(step)
    assert slope == pytest.approx(-np.tan(np.deg2rad(15.0)), rel=2 * step)


def test_a_point_source_near_by_lights_the_rim_of_the_target_less() -> None:
    of = instrument({"profile": "tophat", "diameter": "unbounded"}, PARALLEL)
    distance = 40.0
    expected = 2 * distance**3 / 5.4**2 * (1 / distance - 1 / np.hypot(distance, 5.4))
    assert flux(of, 0.0, 0.0, 0.0, Setup(source_distance_mm=distance)) == pytest.approx(expected, rel=1e-6)


def test_a_diverging_beam_falls_less_steeply() -> None:
    of = instrument(UNIFORM | {"diameter": 30.0}, PARALLEL)
    spread = np.deg2rad(2.0)
    expected, _ = quad(lambda r: r / spread**2 * np.exp(-(r**2) / 2 / spread**2) / np.sqrt(1 + r**2), 0, 10 * spread)
    assert flux(of, 0.0, 10.0, 0.0, Setup(divergence_deg=2.0)) == pytest.approx(expected, rel=1e-6)


SETUPS = [
    {"sensor_runout_mm": 0.7},
    {"beam_x_mm": 0.8, "beam_y_mm": -0.5},
    {"beam_radius_mm": 0.4, "target_radius_mm": -0.3, "mirror_radius_mm": 2.0},
    {"illumination_zenith_deg": 0.7, "sensor_zenith_deg": -0.6, "sensor_azimuth_deg": 0.9},
    {"tilt_x_deg": 2.0, "tilt_y_deg": -1.5, "sample_azimuth_deg": 20.0},
    {"height_mm": 0.6, "offset_x_mm": 0.4, "offset_y_mm": -0.3},
    {"source_distance_mm": 1500.0, "beam_x_mm": 0.4},
    {"divergence_deg": 0.5},
]


@pytest.mark.parametrize("off", SETUPS, ids=",".join)
@pytest.mark.parametrize("geometry", [(0.0, 15.0, 45.0), (40.0, -55.0, 30.0)])
def test_the_simulated_laboratory_sees_the_same_flux(
    off: dict[str, float], geometry: tuple[float, float, float]
) -> None:
    of, setup = facility(), Setup(**off)
    illumination, sensor, azimuth = geometry
    beam = of.beam.model_copy(update={"diameter": float(of.beam.diameter) + 2 * setup.beam_radius_mm})
    seen = of.sensor.model_copy(
        update={
            "target_diameter": of.sensor.target_diameter + 2 * setup.target_radius_mm,
            "mirror_diameter": of.sensor.mirror_diameter + 2 * setup.mirror_radius_mm,
        }
    )
    source = setup.source_distance_mm
    beam_rays = beam_bundle(
        beam,
        illumination + setup.illumination_zenith_deg,
        offset_mm=(setup.beam_x_mm, setup.beam_y_mm),
        extra_divergence=setup.divergence_deg,
        source_distance_mm=source if np.isfinite(source) else None,
    )
    sensor_rays = sensor_bundle(seen, sensor + setup.sensor_zenith_deg, azimuth + setup.sensor_azimuth_deg)
    aside = setup.sensor_runout_mm * sensor_rays.frame[1]
    sensor_rays = sensor_rays._replace(centre=sensor_rays.centre + aside)
    pose = Pose.of(
        setup.tilt_x_deg,
        setup.tilt_y_deg,
        setup.sample_azimuth_deg,
        (setup.offset_x_mm, setup.offset_y_mm),
        setup.height_mm,
    )
    theirs = np.pi * lambertian_radiance(seen_from_sample(beam_rays, pose), seen_from_sample(sensor_rays, pose))
    assert flux(of, *geometry, setup) == pytest.approx(theirs, rel=1.5e-4)


def test_the_reference_change_is_the_mean_over_its_azimuths() -> None:
    of = facility()
    setup = Setup(sensor_runout_mm=0.4, beam_x_mm=0.3)
    azimuths = of.reference.sensor_azimuth
    true = sum(flux(of, 0.0, 15.0, azimuth, setup) for azimuth in azimuths)
    nominal = float(np.sum(lambertian_flux(of, 0.0, 15.0, azimuths)))
    assert reference_change(of, setup) == pytest.approx(true / nominal, rel=1e-12)


def test_what_happens_to_the_sample_leaves_the_reference_alone() -> None:
    assert reference_change(facility(), Setup(tilt_x_deg=1.0, height_mm=0.3, sample_azimuth_deg=4.0)) == 1.0


def test_what_differs_from_point_to_point_counts_with_its_mean() -> None:
    swaying = Setup(sensor_zenith_deg=np.array([0.1, 0.3]))
    assert reference_change(facility(), swaying) == pytest.approx(
        reference_change(facility(), Setup(sensor_zenith_deg=0.2)), rel=1e-12
    )


def test_a_square_target_is_refused() -> None:
    with pytest.raises(ValueError, match="discs"):
        flux(facility(), 0.0, 0.0, 0.0, Setup(square_target=True))


def strips(width: Callable[[float], float], half: float) -> float:
    """Integral over a figure from its strips, over the area of the target."""
    area, _ = quad(width, -half, half, epsabs=1e-10, epsrel=1e-10, limit=200)
    return area / (np.pi * 5.4**2)


@pytest.mark.parametrize("orientation", [0.0, 35.0])
def test_an_elliptic_gaussian_on_the_target(orientation: float) -> None:
    of = instrument(
        {"radius_1_e2": 3.0, "radius_1_e2_across": 5.0, "diameter": "unbounded", "orientation": orientation}, PARALLEL
    )
    root = np.sqrt(2) / 5.0
    expected = strips(
        lambda x: np.exp(-2 * x**2 / 9.0) * erf(root * np.sqrt(5.4**2 - x**2)) * np.sqrt(np.pi) / root, 5.4
    )
    assert flux(of, 0.0, 0.0, 0.0, Setup()) == pytest.approx(expected, rel=1e-6)


def test_an_elliptic_iris_on_the_target() -> None:
    of = instrument(UNIFORM | {"diameter": 14.0, "diameter_across": 6.0}, PARALLEL)
    expected = strips(lambda x: 2 * min(np.sqrt(5.4**2 - x**2), 3.0 * np.sqrt(1 - x**2 / 49)), 5.4)
    assert flux(of, 0.0, 0.0, 0.0, Setup()) == pytest.approx(expected, rel=1e-6)
    wider = strips(lambda x: 2 * min(np.sqrt(5.4**2 - x**2), 3.2 * np.sqrt(1 - x**2 / 7.2**2)), 5.4)
    assert flux(of, 0.0, 0.0, 0.0, Setup(beam_radius_mm=0.2)) == pytest.approx(wider, rel=1e-6)


def test_an_ellipse_turns_with_its_orientation() -> None:
    elliptic = {"radius_1_e2": 4.0, "radius_1_e2_across": 9.0, "diameter": 14.0, "diameter_across": 24.0}
    straight = flux(instrument(elliptic), 0.0, 60.0, 20.0, Setup())
    turned = flux(instrument(elliptic | {"orientation": 50.0}), 0.0, 60.0, 70.0, Setup())
    assert turned == pytest.approx(straight, rel=1e-5)
    assert flux(instrument(elliptic), 0.0, 60.0, 70.0, Setup()) != pytest.approx(straight, rel=1e-2)


def test_an_ellipse_stays_with_the_illumination_arm() -> None:
    of = instrument({"radius_1_e2": 4.0, "radius_1_e2_across": 9.0, "orientation": 30.0})
    there = lambertian_flux(of, -35.0, 50.0, 65.0)
    assert there == pytest.approx(flux(of, -35.0, 50.0, 65.0, Setup()), rel=1e-9)


def picture(u: Any, v: Any, values: Any) -> BeamImage:
    return BeamImage(np.asarray(values, dtype=float), (u[1] - u[0], v[1] - v[0]), (float(u[0]), float(v[0])))


def pictured(image: BeamImage, sensor: dict[str, Any], orientation: float = 0.0) -> Facility:
    beam = Beam(diameter="unbounded", profile="image", image="beam.npy", pixel_pitch=0.1, orientation=orientation)
    return instrument(sensor=sensor).model_copy(update={"beam": beam.with_picture(image)})


@pytest.mark.parametrize("geometry", [(0.0, 15.0, 0.0), (50.0, -40.0, 60.0)])
def test_the_picture_of_a_gaussian_is_a_gaussian(geometry: tuple[float, float, float]) -> None:
    u, v = np.arange(-12, 12.01, 0.1), np.arange(-11, 11.01, 0.1)
    image = picture(u, v, np.exp(-2 * (u[None] ** 2 / 16 + v[:, None] ** 2 / 9)))
    of = pictured(image, {}, orientation=25.0)
    known = instrument(
        {"diameter": "unbounded", "radius_1_e2": 4.0, "radius_1_e2_across": 3.0, "orientation": 25.0}, {}
    )
    assert lambertian_flux(of, *geometry) == pytest.approx(lambertian_flux(known, *geometry), rel=3e-4)


def test_a_picture_lies_the_right_way_round() -> None:
    """A slope of the irradiance shows where the target lies: u grows with the illumination's zenith, v with azimuth."""
    u = np.arange(-20, 20.5, 0.5)
    image = picture(u, u, 1 + u[None] / 50 + u[:, None] / 100)
    of = pictured(image, PARALLEL)
    for azimuth, expected in ((0.0, 1 + 0.7 / 50), (90.0, 1 + 0.7 / 100), (180.0, 1 - 0.7 / 50)):
        setup = Setup(sensor_runout_mm=0.7)
        assert flux(of, 0.0, 0.0, azimuth, setup) == pytest.approx(expected, rel=1e-5)
    turned = pictured(image, PARALLEL, orientation=90.0)
    assert flux(turned, 0.0, 0.0, 90.0, Setup(sensor_runout_mm=0.7)) == pytest.approx(1 + 0.7 / 50, rel=1e-5)


def test_a_hard_stop_sees_its_own_disc() -> None:
    wide = UNIFORM | {"diameter": "unbounded"}
    of = instrument(wide, PARALLEL | {"field_stop_diameter": 6.0})
    assert flux(of, 0.0, 0.0, 0.0, Setup()) == pytest.approx((3.0 / 5.4) ** 2, rel=1e-6)
    assert flux(of, 0.0, 60.0, 0.0, Setup(stop_radius_mm=0.5)) == pytest.approx((3.5 / 5.4) ** 2, rel=1e-6)


def test_a_soft_stop_is_a_frustum() -> None:
    of = instrument(
        UNIFORM | {"diameter": "unbounded"}, PARALLEL | {"field_stop_diameter": 6.0, "field_stop_edge": 2.0}
    )
    expected = (2.0**2 + 2.0 * 4.0 + 4.0**2) / 3 / 5.4**2
    assert flux(of, 0.0, 30.0, 0.0, Setup()) == pytest.approx(expected, rel=1e-9)


def test_a_stop_off_the_target_has_the_penumbra_of_the_mirror() -> None:
    stop = {"field_stop_diameter": 8.0, "field_stop_distance": 80.0, "mirror_distance": 200.0, "mirror_diameter": 10.0}
    of = instrument(UNIFORM | {"diameter": "unbounded"}, stop)
    share = 0.4
    expected, _ = quad(
        lambda m: 2 * m / 25.0 * lens(4.0 / (1 - share), 5.4, share * m / (1 - share)) / (np.pi * 5.4**2),
        0,
        5.0,
        points=[1.9],
    )
    assert flux(of, 0.0, 0.0, 0.0, Setup()) == pytest.approx(expected, rel=5e-4)


def test_a_stop_and_a_beam_that_cross() -> None:
    of = instrument(UNIFORM | {"diameter": 7.0}, PARALLEL | {"field_stop_diameter": 8.0, "target_diameter": 20.0})
    expected = lens(3.5, 4.0, 1.5) / (np.pi * 100.0)
    assert flux(of, 0.0, 0.0, 0.0, Setup(beam_x_mm=1.5)) == pytest.approx(expected, rel=1e-6)
