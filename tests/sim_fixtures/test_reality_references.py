"""The simulated reality against results of an independent ray tracer (../shared/reference)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from instrument.angles import FloatArray, angle_between, direction
from instrument.facility import Beam, Sensor
from sim_fixtures.reality.bundle import Bundle, beam_bundle, sensor_bundle, square_sensor_bundle
from sim_fixtures.reality.coating import Reflection, lambertian, reflectance_factor, tabulated
from sim_fixtures.reality.flat import lambertian_radiance
from sim_fixtures.reality.scene import Scene, make_scene, pit_scene
from sim_fixtures.reality.tracer import collect, trace

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "reference"
REPLICATES = 16

TOPHAT = Beam(diameter=10.8, profile="tophat")
UNBOUNDED = Beam(diameter="unbounded", profile="tophat")
PARALLEL = Sensor(target_diameter=10.8)
HORIZONTAL = Sensor(target_diameter=10.8, target_shape="horizontal_disc")


def reference(name: str) -> xr.Dataset:
    path = FOLDER / f"{name}.nc"
    if not path.exists():
        pytest.skip(f"{path} is not there: the independent reference results are not part of the project")
    with xr.open_dataset(path) as data:
        return data.load()


def table() -> Reflection:
    data = reference("table_brdf")
    return tabulated(data["brdf"].transpose("cos_theta_o", "phi_d", "cos_theta_i").values)


def plate() -> Scene:
    nominal = (np.arange(12) - 5.5) * 3.6
    x, y = (axis.ravel() for axis in np.meshgrid(nominal, nominal, indexing="ij"))
    return make_scene(thickness=1.13, depth=3.26, x=x, y=y, diameter=np.full(x.size, 2.55))


def point_source(zenith: float) -> Bundle:
    return beam_bundle(TOPHAT, zenith, source_distance_mm=2000.0)


def geometries(data: xr.Dataset) -> FloatArray:
    """Illumination zenith, sensor zenith, sensor azimuth, shape (point, 3)."""
    return np.stack([data[name].values.astype(float) for name in ("theta_ill", "theta_sen", "phi_sen")], axis=1)


def by_photons(
    points: FloatArray,
    scene: Scene,
    reflection: Reflection,
    sensor: Callable[[float, float], Bundle],
    rays: int,
    beam: Callable[[float], Bundle] | None = None,
) -> FloatArray:
    """Radiances of independent replicates, shape (replicate, point), photons shared by an illumination."""
    beam = beam or point_source
    result = np.zeros((REPLICATES, len(points)))
    for illumination in np.unique(points[:, 0]):
        for replicate in range(REPLICATES):
            seed = 1000 * int(illumination) + replicate
            lit = trace(scene, reflection, beam(float(illumination)), rays, seed)
            for i in np.flatnonzero(points[:, 0] == illumination):
                result[replicate, i] = collect(scene, reflection, lit, sensor(*points[i, 1:]), seed)
    return result


def by_sight_lines(
    points: FloatArray, scene: Scene, reflection: Reflection, sensor: Callable[[float, float], Bundle], rays: int
) -> FloatArray:
    """Radiances of independent replicates, shape (replicate, point), for an unbounded beam."""
    result = np.zeros((REPLICATES, len(points)))
    for i, (illumination, zenith, azimuth) in enumerate(points):
        for replicate in range(REPLICATES):
            seed = REPLICATES * i + replicate
            sight = trace(scene, reflection, sensor(zenith, azimuth), rays, seed)
            beam = beam_bundle(UNBOUNDED, float(illumination))
            result[replicate, i] = collect(scene, reflection, sight, beam, seed)
    return result


def check(estimates: FloatArray, data: xr.Dataset) -> None:
    """Chi-square a point between 0.8 and 1.25; mean ratio within three standard errors of that mean."""
    points = geometries(data)
    retro = angle_between(direction(points[:, 0], 0.0), direction(points[:, 1], points[:, 2])) < 0.01
    used = (data["R_se"].values > 0) & ~retro
    assert used.sum() > 0.9 * len(used)
    ours, theirs, u_theirs = estimates[:, used], data["L_art"].values[used], data["L_art_se"].values[used]
    u_ours = ours.std(axis=0, ddof=1) / np.sqrt(len(ours))
    assert np.median(u_ours / u_theirs) < 1.0
    chi_square = np.mean((ours.mean(axis=0) - theirs) ** 2 / (u_ours**2 + u_theirs**2))
    assert 0.8 < chi_square < 1.25
    ratios = np.mean(ours / theirs, axis=1)
    u_ratio = np.hypot(ratios.std(ddof=1) / np.sqrt(len(ours)), np.sqrt(np.sum((u_theirs / theirs) ** 2)) / used.sum())
    assert abs(ratios.mean() - 1.0) < 3 * u_ratio
    assert u_ratio < 0.001


@pytest.mark.slow
def test_the_artifact_under_a_narrow_beam() -> None:
    data = reference("artifact_qdfix_tophat_llvm")
    estimates = by_photons(
        geometries(data), plate(), table(), lambda zenith, azimuth: sensor_bundle(PARALLEL, zenith, azimuth), 4096
    )
    check(estimates, data)


@pytest.mark.slow
def test_the_artifact_under_ideal_illumination() -> None:
    data = reference("artifact_lamb05_ideal_hdisk")
    estimates = by_sight_lines(
        geometries(data),
        plate(),
        lambertian(0.5),
        lambda zenith, azimuth: sensor_bundle(HORIZONTAL, zenith, azimuth),
        512,
    )
    check(estimates, data)


@pytest.mark.slow
def test_a_square_pit_under_ideal_illumination() -> None:
    data = reference("pit_lamb05_ideal")

    def through_the_aperture(zenith: float) -> Bundle:
        """The part of an unbounded beam that enters the pit: no other light is ever seen."""
        return square_sensor_bundle(10.0, zenith, 0.0)._replace(density=float(np.cos(np.deg2rad(zenith))))

    estimates = by_photons(
        geometries(data),
        pit_scene(10.0, 10.0, 50.0),
        lambertian(0.5),
        lambda zenith, azimuth: square_sensor_bundle(10.0, zenith, azimuth),
        8192,
        through_the_aperture,
    )
    check(estimates, data)


def test_the_reference_surface_under_a_narrow_beam() -> None:
    data = reference("flat_lamb1_tophat")
    estimates = by_photons(
        geometries(data),
        make_scene(outline=(200.0, 200.0)),
        lambertian(1.0),
        lambda zenith, azimuth: sensor_bundle(PARALLEL, zenith, azimuth),
        1024,
    )
    check(estimates, data)


def test_the_quadrature_of_the_reference_surface() -> None:
    data = reference("flat_lamb1_tophat")
    ours = [
        lambertian_radiance(point_source(illumination), sensor_bundle(PARALLEL, zenith, azimuth))
        for illumination, zenith, azimuth in geometries(data)
    ]
    assert ours == pytest.approx(data["L_ref"].values, rel=2e-4)


def test_a_flat_plate_returns_the_table() -> None:
    data = reference("flat_qd_ideal")
    points = geometries(data)
    material = table()
    source, sensor = direction(points[:, 0], 0.0), direction(points[:, 1], points[:, 2])
    between = np.sum(source * sensor, axis=1)
    ours = [reflectance_factor(material, a[2], b[2], c) for a, b, c in zip(source, sensor, between, strict=True)]
    assert ours == pytest.approx(data["R"].values, abs=1e-5)
    traced = by_sight_lines(
        points[::40], make_scene(), material, lambda zenith, azimuth: sensor_bundle(HORIZONTAL, zenith, azimuth), 16
    )
    cosine = np.cos(np.deg2rad(points[::40, 0]))
    assert traced.mean(axis=0) * np.pi / cosine == pytest.approx(data["R"].values[::40], abs=1e-5)
