"""The tracer of the simulated reality against physics that must hold whatever the sample."""

from __future__ import annotations

import numpy as np
import pytest

from instrument.angles import FloatArray, direction
from instrument.facility import Beam, Facility, Sensor
from sim_fixtures.reality.bundle import Bundle, beam_bundle, sensor_bundle, square_sensor_bundle
from sim_fixtures.reality.coating import EXAMPLE_COATING, Reflection, lambertian, tabulated
from sim_fixtures.reality.flat import lambertian_radiance
from sim_fixtures.reality.scene import (
    BORE,
    CAVITY,
    ESCAPED,
    LEDGE,
    LOST,
    OUTSIDE,
    TOP,
    WALL,
    Scene,
    find_hole,
    follow,
    make_scene,
    pit_scene,
    sees_out,
)
from sim_fixtures.reality.tracer import _collect, _trace, collect, trace

TOPHAT = Beam(diameter=10.8, profile="tophat")
PARALLEL = Sensor(target_diameter=10.8)


def lattice(scatter: float = 0.0, rim: float = 0.0) -> Scene:
    """The paper's artifact; ``rim`` moves every hole outwards by that part of its distance from the middle."""
    nominal = (np.arange(12) - 5.5) * 3.6 * (1.0 + rim)
    x, y = (axis.ravel() for axis in np.meshgrid(nominal, nominal, indexing="ij"))
    generator = np.random.default_rng(3)
    x, y, diameter = (axis + scatter * generator.standard_normal(axis.size) for axis in (x, y, np.full(x.size, 2.55)))
    return make_scene(thickness=1.13, depth=3.26, x=x, y=y, diameter=diameter)


def seen(scene: Scene, reflection: Reflection, emitter: Bundle, receiver: Bundle, rays: int = 8192) -> FloatArray:
    """Sixteen independent estimates of what one bundle gets from the other."""
    estimates = []
    for seed in range(16):
        vertices = trace(scene, reflection, emitter, rays, seed)
        estimates.append(collect(scene, reflection, vertices, receiver, seed))
    return np.array(estimates)


def agree(a: FloatArray, b: FloatArray, largest: float) -> bool:
    """Whether two sets of estimates agree within four standard errors, and these are no larger than ``largest``."""
    error = np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / len(a))
    return bool(abs(a.mean() - b.mean()) < 4 * error + 1e-12 and error < largest * b.mean())


def is_free(scene: Scene, points: FloatArray) -> FloatArray:
    """Whether points, shape (..., 3), lie in air: told from the dimensions alone, hole by hole."""
    x, y, z = np.moveaxis(points, -1, 0)
    squared = (x[..., None] - scene.x) ** 2 + (y[..., None] - scene.y) ** 2
    in_hole = np.any(squared < scene.radius**2, axis=-1)
    in_cavity = (np.abs(x) < scene.inner_x) & (np.abs(y) < scene.inner_y)
    return np.where(z > 0, True, np.where(z > -scene.thickness, in_hole, in_cavity & (z > -scene.depth)))


@pytest.mark.parametrize("scene", [lattice(0.02), lattice(0.0, rim=0.004)], ids=["scattered", "past the rim"])
def test_a_ray_crosses_air_alone_and_ends_at_a_solid(scene: Scene) -> None:
    beam = beam_bundle(Beam(diameter=45.0, profile="tophat"), 25.0, azimuth=40.0)
    lit = trace(scene, lambertian(0.9), beam, 1024, 5)
    generator = np.random.default_rng(8)
    ends = []
    for row, surface, hole in zip(lit.values, lit.surface, lit.hole, strict=True):
        place = OUTSIDE if surface == TOP else BORE if surface in (WALL, LEDGE) else CAVITY
        way = generator.standard_normal(3)
        way /= np.linalg.norm(way)
        way *= np.sign(way @ row[3:6])
        met, _, _, *end = follow(scene, place, hole, *row[:3], *way)
        ends.append(met)
        assert bool(sees_out(scene, place, hole, *row[:3], *way)) == (met == ESCAPED)
        length = np.linalg.norm(np.array(end[:3]) - row[:3]) if met != ESCAPED else max(0.1, -row[2] / way[2] + 0.1)
        steps = np.linspace(1e-7, max(length - 1e-7, 2e-7), 40)
        assert np.all(is_free(scene, row[:3] + steps[:, None] * way)), (surface, met)
        if met != ESCAPED:
            assert not is_free(scene, np.array(end[:3]) - 1e-6 * np.array(end[3:]))
            assert is_free(scene, np.array(end[:3]) + 1e-6 * np.array(end[3:]))
    assert {int(s) for s in lit.surface} | set(ends) >= {ESCAPED, TOP, WALL, 4, 5, 6}


def test_a_hole_past_the_inner_wall_of_the_spacer_ends_partly_on_a_ledge() -> None:
    scene = lattice(0.0, rim=0.004)
    centre = float(scene.x.max())
    outside = centre + float(scene.radius[0]) - 0.01
    assert centre < scene.inner_x < outside
    hole = find_hole(scene, outside, float(scene.y[-1]))
    surface, place, found, _, _, z, _, _, nz = follow(
        scene, OUTSIDE, -1, outside, float(scene.y[-1]), 5.0, 0.0, 0.0, -1.0
    )
    assert (surface, place, found, z, nz) == (LEDGE, BORE, hole, -scene.thickness, 1.0)


def test_light_beside_the_plate_is_lost() -> None:
    assert follow(lattice(), OUTSIDE, -1, 24.9, 0.0, 1.0, 0.6, 0.0, -0.8)[0] == LOST


@pytest.mark.parametrize("scene", [make_scene(), lattice(), pit_scene(10.0, 10.0, 50.0)], ids=["flat", "holes", "pit"])
@pytest.mark.parametrize("albedo", [1.0, 0.6])
def test_what_leaves_is_what_sensors_all_around_see(scene: Scene, albedo: float) -> None:
    beam = beam_bundle(TOPHAT, 20.0)
    lit = trace(scene, lambertian(albedo), beam, 4096, 3)
    if albedo == 1.0:
        assert lit.escaped == pytest.approx(beam.total, rel=1e-3)  # what is still inside after 100 reflections
    cosines, weights = np.polynomial.legendre.leggauss(18)
    turns = 30
    total = 0.0
    for cosine, weight in zip(0.5 * (1 + cosines), 0.5 * weights, strict=True):
        for turn in range(turns):
            wide = Sensor(target_diameter=2000.0)
            sensor = sensor_bundle(wide, float(np.rad2deg(np.arccos(cosine))), 360.0 * (turn + 0.3) / turns)
            intensity = collect(scene, lambertian(albedo), lit, sensor, 0) / sensor.density
            total += intensity * weight * 2 * np.pi / turns
    assert total == pytest.approx(lit.escaped, rel=0.015)


@pytest.mark.parametrize("divergence", [0.0, 0.2])
@pytest.mark.parametrize("geometry", [(0.0, 15.0, 0.0), (30.0, -70.0, 60.0), (60.0, 75.0, 135.0)])
def test_a_flat_sample_reads_from_either_end_as_by_quadrature(
    facility: Facility, geometry: tuple[float, float, float], divergence: float
) -> None:
    beam = beam_bundle(facility.beam, geometry[0], extra_divergence=divergence)
    sensor = sensor_bundle(facility.sensor, *geometry[1:])
    expected = lambertian_radiance(beam, sensor)
    for emitter, receiver in ((beam, sensor), (sensor, beam)):
        estimates = seen(make_scene(), lambertian(1.0), emitter, receiver)
        error = estimates.std(ddof=1) / np.sqrt(len(estimates))
        assert error < 5e-4 * expected
        assert abs(estimates.mean() - expected) < 4 * error + 2e-4 * expected


def test_a_wide_parallel_beam_on_a_flat_sample_follows_the_cosine_law() -> None:
    ideal = Sensor(target_diameter=10.8, target_shape="horizontal_disc")
    for zenith in (0.0, 30.0, 70.0):
        beam = beam_bundle(Beam(diameter="unbounded"), zenith)
        expected = np.cos(np.deg2rad(zenith)) / np.pi
        assert lambertian_radiance(beam, sensor_bundle(ideal, -50.0, 20.0)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("geometry", [(30.0, 60.0, 40.0), (15.0, -75.0, 75.0), (0.0, 45.0, 0.0)])
def test_sight_lines_and_photons_give_the_same_reading(
    facility: Facility, geometry: tuple[float, float, float]
) -> None:
    scene, coating = lattice(0.02), EXAMPLE_COATING.at()
    beam, sensor = beam_bundle(facility.beam, geometry[0]), sensor_bundle(facility.sensor, *geometry[1:])
    assert agree(seen(scene, coating, beam, sensor), seen(scene, coating, sensor, beam), largest=0.004)


def test_swapping_source_and_sensor_changes_nothing() -> None:
    scene, coating = lattice(), EXAMPLE_COATING.at()

    def reading(source: tuple[float, float], sensor: tuple[float, float]) -> FloatArray:
        beam = beam_bundle(TOPHAT, source[0], azimuth=source[1])
        return seen(scene, coating, beam, sensor_bundle(PARALLEL, *sensor))

    assert agree(reading((25.0, 10.0), (65.0, 130.0)), reading((65.0, 130.0), (25.0, 10.0)), largest=0.003)


def test_the_lattice_looks_the_same_along_both_axes_and_from_both_sides() -> None:
    scene, coating = lattice(), EXAMPLE_COATING.at()
    beam = beam_bundle(TOPHAT, 0.0)
    first = seen(scene, coating, beam, sensor_bundle(PARALLEL, 50.0, 0.0))
    for zenith, azimuth in ((-50.0, 0.0), (50.0, 90.0), (-50.0, 90.0)):
        assert agree(seen(scene, coating, beam, sensor_bundle(PARALLEL, zenith, azimuth)), first, largest=0.003)
    diagonal = seen(scene, coating, beam, sensor_bundle(PARALLEL, 50.0, 45.0))
    assert not agree(diagonal, first, largest=0.003)


def test_the_form_of_the_inputs_never_compiles_the_kernels_anew(facility: Facility) -> None:
    table = tabulated(np.full((3, 4, 3), 0.2))
    for scene in (make_scene(), lattice(), pit_scene(10.0, 10.0, 50.0)):
        for emitter in (
            beam_bundle(TOPHAT, 0, source_distance_mm=2000.0),
            beam_bundle(facility.beam, 10.0, extra_divergence=0.1),
            square_sensor_bundle(10.0, 20.0, 0.0),
        ):
            lit = trace(scene, table, emitter, 16, 1)
            collect(scene, EXAMPLE_COATING.at(), lit, sensor_bundle(facility.sensor, 15, 0), 1)
            collect(scene, table, lit, beam_bundle(Beam(diameter="unbounded"), 0.0), 1)
    assert len(_trace.signatures) == len(_collect.signatures) == 1


def test_one_seed_gives_one_result_and_another_seed_another() -> None:
    beam = beam_bundle(TOPHAT, 10.0)
    first, again, other = (trace(lattice(), lambertian(0.5), beam, 1024, seed) for seed in (1, 1, 2))
    assert np.array_equal(first.values, again.values)
    assert not np.array_equal(first.values[:100], other.values[:100])


def test_an_emitter_without_bounds_and_an_odd_number_of_rays_are_refused() -> None:
    with pytest.raises(ValueError, match="unbounded"):
        trace(lattice(), lambertian(0.5), beam_bundle(Beam(diameter="unbounded"), 0.0), 16, 1)
    with pytest.raises(ValueError, match="power of two, found 100"):
        trace(lattice(), lambertian(0.5), beam_bundle(TOPHAT, 0.0), 100, 1)


def test_directions_of_a_bundle_point_where_they_should() -> None:
    assert beam_bundle(TOPHAT, 30.0).frame[0] == pytest.approx(direction(30.0, 0.0))
    assert sensor_bundle(PARALLEL, -30.0, 40.0).frame[0] == pytest.approx(direction(30.0, 220.0))
