"""Checks of the ray tracer that stand by themselves: invariants and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import qmc
from traced_samples import REGULAR, artifact, columns, facility, flat

from instrument.lambertian import lambertian_flux
from twin.artifact import Surface, build_mesh, square_pit
from twin.llvm import import_mitsuba
from twin.material import Material, lambertian
from twin.optics import Setup, lay_out
from twin.tracer import RANDOMISATIONS, UNRESTRICTED, Tracer, mean_and_error

IDEAL = facility("unbounded", shape="horizontal_disc")
REAL = facility(profile="gaussian", mirror=10.8)


def lobed() -> Material:
    """A table without any symmetry but the periodic one."""
    mu, phi = np.linspace(0, 1, 7), np.linspace(0, 2 * np.pi, 13)
    o, p, i = np.meshgrid(mu, phi, mu, indexing="ij")
    brf = 0.4 + 0.2 * (1 - o) * (1 + np.sin(p)) / 2 + 0.15 * (1 - i) * (1 + np.cos(2 * p)) + 0.05 * o
    return Material(mu, phi, mu, brf[None] / np.pi, name="lobed")


def trace(
    tracer: Tracer,
    instrument: Any,
    geometry: dict[str, Any],
    samples: int,
    seed: int = 1,
    setup: Setup | None = None,
    **options: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance factors and their standard errors, shape (point,)."""
    layout = lay_out(instrument, geometry, setup)
    flux = lambertian_flux(
        instrument,
        geometry["illumination_zenith"],
        geometry["sensor_zenith"],
        geometry["sensor_azimuth"],
        illumination_azimuth=geometry["illumination_azimuth"],
    )
    values = tracer.radiance(layout, np.zeros(len(layout), int), samples, seed=seed, **options) / flux[:, None]
    return mean_and_error(values)


def agree(a: Any, b: Any) -> None:
    """Equal within Monte Carlo error: no point 5 standard errors off, and chi-square in proportion."""
    difference, error = a[0] - b[0], np.hypot(a[1], b[1])
    z = difference / error
    assert np.max(np.abs(z)) < 5
    assert np.mean(z**2) < 1 + 4 * np.sqrt(2.5 / len(z))


PLAN = columns([0, 0, 15, 15, 30, 30, 45], [40.0, -65, 80, -30, 60, 5, -75], [45.0, 0, 50, 130, 60, 120, 10])


def test_a_flat_lambertian_sample_has_its_reflectance() -> None:
    tracer = Tracer(build_mesh(flat()), lambertian(1.0))
    value, error = trace(tracer, REAL, PLAN, 16384)
    np.testing.assert_allclose(value, 1.0, atol=1e-3)
    assert np.max(np.abs(value - 1) / error) < 5


def test_a_flat_sample_returns_its_table() -> None:
    material = lobed()
    plan = columns([15, 15, 30, 45, 80], [80.0, -30, 60, 0, -75], [50.0, 130, 60, 0, 10])
    value, _ = trace(Tracer(build_mesh(flat()), material), IDEAL, plan, 4)
    sen = plan["sensor_zenith"]
    expected = np.pi * material.evaluate(
        np.cos(np.deg2rad(sen)),
        np.deg2rad(plan["sensor_azimuth"] + 180.0 * (sen < 0)),
        np.cos(np.deg2rad(plan["illumination_zenith"])),
    )
    np.testing.assert_allclose(value, expected, rtol=2e-6)


def test_azimuths_count_from_the_illumination() -> None:
    tracer = Tracer(build_mesh(flat()), lobed())
    here = trace(tracer, IDEAL, columns(30.0, [50.0, -40], [20.0, 70]), 4)[0]
    turned = trace(tracer, IDEAL, columns(30.0, [50.0, -40], [65.0, 115], 45.0), 4)[0]
    np.testing.assert_allclose(turned, here, rtol=1e-5)


def test_negative_zenith_means_the_opposite_azimuth() -> None:
    tracer = Tracer(build_mesh(flat()), lobed())
    folded = trace(tracer, IDEAL, columns([-30.0, 30.0], [50.0, 50.0], [20.0, 20.0], [0.0, 180.0]), 4)[0]
    assert folded[0] == pytest.approx(folded[1], rel=1e-5)
    signed = trace(tracer, IDEAL, columns(30.0, [-50.0, 50.0], [20.0, 200.0]), 4)[0]
    assert signed[0] == pytest.approx(signed[1], rel=1e-5)


@pytest.mark.parametrize("sample", [artifact(), artifact([(0.0, 0.0, 9.0)])])
def test_white_furnace(sample: Any) -> None:
    """White walls under uniform light from everywhere look white from everywhere.

    By reciprocity: the hemispherical reflectance seen from one direction, sampled over the light's directions. Each set
    of directions has a seed of its own, for the light of all illuminations in one launch is followed by the same
    random numbers.
    """
    tracer = Tracer(build_mesh(sample), lambertian(1.0))
    repeats, count = 8, 32
    narrow = facility("unbounded", shape="horizontal_disc", target=3.6 * 2.0)
    everywhere = np.ones(count)

    def mean_of_a_set(seed: int) -> float:
        u, v = qmc.Sobol(2, rng=np.random.default_rng(seed)).random(count).T
        plan = columns(np.rad2deg(np.arccos(np.sqrt(u))), 25.0 * everywhere, 33.0 * everywhere, 360 * v)
        return float(trace(tracer, narrow, plan, 256, seed=seed)[0].mean())

    means = np.array([mean_of_a_set(seed) for seed in range(repeats)])
    spread = means.std(ddof=1) / np.sqrt(repeats)
    assert abs(means.mean() - 1.0) < 4 * spread + 1e-4
    assert spread < 0.02


def test_the_lattice_is_symmetric() -> None:
    """Quarter turns and reflections of the square lattice, with an isotropic, mirror-symmetric material."""
    tracer = Tracer(build_mesh(artifact()), lambertian(0.6))
    base = trace(tracer, REAL, columns(30.0, [40.0, 60, -50], [20.0, 75, 10]), 2048, seed=1)
    turned = trace(tracer, REAL, columns(30.0, [40.0, 60, -50], [110.0, 165, 100], 90.0), 2048, seed=2)
    mirrored = trace(tracer, REAL, columns(30.0, [40.0, 60, -50], [-20.0, -75, -10]), 2048, seed=3)
    agree(base, turned)
    agree(base, mirrored)


def test_helmholtz_reciprocity() -> None:
    """Beam and sensor may be exchanged under ideal light on the lattice's cell."""
    tracer = Tracer(build_mesh(artifact()), lambertian(0.5))
    cell = facility("unbounded", shape="horizontal_disc", target=7.2)
    square = Setup(square_target=True)  # two by two whole cells
    forth = trace(tracer, cell, columns([10.0, 35], [50.0, 20], [70.0, 140]), 4096, seed=1, setup=square)
    back = trace(tracer, cell, columns([50.0, 20], [10.0, 35], 0.0, [70.0, 140]), 4096, seed=2, setup=square)
    agree(forth, back)


def test_a_single_deep_hole_seen_along_the_normal_shows_its_floor_and_top() -> None:
    """Black walls: what is left is geometry. Half the disc is hole, its floor fully lit at normal incidence."""
    tracer = Tracer(
        build_mesh(artifact([(0.0, 0.0, 5.0)], plate=1.0, depth=1.5)),
        lambertian(0.5),
        surface_factor={Surface.HOLE_WALL: 0.0, Surface.UNDERSIDE: 0.0, Surface.SPACER: 0.0, Surface.FLOOR: 0.0},
    )
    disc = facility("unbounded", shape="horizontal_disc", target=10.0)
    value, error = trace(tracer, disc, columns(0.0, [0.0], 0.0), 8192)
    assert value[0] == pytest.approx(0.5 * 0.75, abs=4 * error[0] + 1e-6)


def test_shadow_in_a_square_pit_has_its_closed_form() -> None:
    """Only the floor reflects: the part that is lit and seen is the overlap of three squares."""
    width, depth = 10.0, 4.0
    tracer = Tracer(square_pit(50.0, width, depth), lambertian(0.5), surface_factor={Surface.HOLE_WALL: 0.0})
    aperture = facility("unbounded", shape="horizontal_disc", target=width)
    ill, sen = np.array([30.0, 45, 60, 20]), np.array([-20.0, 30, 10, 65])
    value, error = trace(tracer, aperture, columns(ill, sen, np.zeros(4)), 4096, setup=Setup(square_target=True))
    shift_light, shift_view = depth * np.tan(np.deg2rad(ill)), depth * np.tan(np.deg2rad(sen))
    # The floor's lit part is [-w/2 - s, w/2 - s]; the seen part the same with the view's shift.
    low = np.maximum.reduce([-width / 2 - shift_light, -width / 2 - shift_view, np.full(4, -width / 2)])
    high = np.minimum.reduce([width / 2 - shift_light, width / 2 - shift_view, np.full(4, width / 2)])
    expected = 0.5 * np.maximum(high - low, 0) / width
    np.testing.assert_allclose(value, expected, atol=5 * error.max() + 2e-5)


def test_restricted_sight_lines_agree_with_unrestricted_ones() -> None:
    """Also where light scattered in the cavity shows outside the lit volume, which a mere restriction would lose."""
    tracer = Tracer(build_mesh(artifact()), lambertian(0.8))
    plan = columns([0, 15, 30, 30, 0, 15], [50.0, 55, -60, 80, 75, -80], [0.0, 50, 60, 120, 45, 0])
    restricted = trace(tracer, REAL, plan, 8192, seed=1)
    whole = trace(tracer, REAL, plan, 16384, seed=2, mixture=UNRESTRICTED)
    agree(restricted, whole)
    np.testing.assert_allclose(restricted[0], whole[0], rtol=0.01)


def test_sampling_weight_times_density_is_the_reflection() -> None:
    mi = import_mitsuba()
    import drjit as dr

    from twin.reflection import TableLookup

    material = lobed()
    lookup = TableLookup(mi, dr, material, {Surface.FLOOR: 0.5})
    random = np.random.default_rng(8)
    count = 5000
    normal = random.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    towards = random.normal(size=(count, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    towards *= np.sign(np.sum(towards * normal, axis=1))[:, None]
    n, t = (mi.Vector3f(*(mi.Float(c) for c in v.T)) for v in (normal, towards))
    place = lookup.at(mi.UInt32(0), mi.UInt32(int(Surface.FLOOR)), True)
    u, v = (mi.Float(random.uniform(size=count)) for _ in range(2))
    incoming, weight, density = lookup.sample(place, mi.Normal3f(n), t, u, v, True)
    incoming = np.array(incoming).reshape(3, -1).T.astype(float)
    cos_o, cos_i = np.sum(normal * towards, axis=1), np.sum(normal * incoming, axis=1)
    # The azimuth difference, independently: angle about the normal from the light's to the sensor's direction.
    a, b = (x - normal * c[:, None] for x, c in ((incoming, cos_i), (towards, cos_o)))
    phi = np.arctan2(np.sum(normal * np.cross(a, b), axis=1), np.sum(a * b, axis=1))
    expected = 0.5 * material.evaluate(cos_o, phi, cos_i) * cos_i
    np.testing.assert_allclose(np.array(weight) * np.array(density), expected, atol=3e-6)
    np.testing.assert_allclose(np.array(density), cos_i / np.pi, atol=1e-6)
    # The density is that of the directions drawn: mean of 1/density over a cap is the cap's solid angle.
    assert np.mean(cos_i > np.sqrt(0.5)) == pytest.approx(0.5, abs=0.03)


def test_a_prediction_repeats_and_other_seeds_differ() -> None:
    tracer = Tracer(build_mesh(artifact()), lambertian(0.6))
    first, second, other = (trace(tracer, REAL, PLAN, 64, seed=seed)[0] for seed in (1, 1, 2))
    np.testing.assert_allclose(first, second, rtol=1e-12)
    assert np.all(first != other)


def test_blocks_of_samples_add_up() -> None:
    tracer = Tracer(build_mesh(artifact()), lambertian(0.6))
    layout, table = lay_out(REAL, PLAN), np.zeros(7, int)
    whole = tracer.radiance(layout, table, 1024, seed=3)
    parts = [tracer.radiance(layout, table, 512, seed=3, first=first) for first in (0, 512)]
    # Not bit for bit: of each block another quarter is followed beyond the first reflection.
    np.testing.assert_allclose(np.mean(parts, axis=0).mean(axis=1), whole.mean(axis=1), rtol=0.05)


def test_the_error_falls_faster_than_with_random_points() -> None:
    tracer = Tracer(build_mesh(artifact()), lambertian(0.6))
    plan = columns(15.0, np.arange(-75.0, 76, 10), 50.0)
    errors = [np.sqrt(np.mean(trace(tracer, REAL, plan, n, seed=4)[1] ** 2)) for n in (256, 4096)]
    slope = np.log(errors[1] / errors[0]) / np.log(16)
    assert slope < -0.58  # random points: -0.5


@pytest.mark.slow
def test_standard_errors_are_honest() -> None:
    """The scatter of independent runs is what each of them states: 68 and 95 % are covered."""
    tracer = Tracer(build_mesh(artifact()), lambertian(0.6))
    plan = columns([0, 15, 30, 30], [50.0, -25, 75, 5], [45.0, 50, 60, 120])
    runs = [trace(tracer, REAL, plan, 256, seed=seed) for seed in range(60)]
    value, error = (np.array([run[k] for run in runs]) for k in (0, 1))
    truth = value.mean(axis=0)
    z = np.abs(value - truth) / error
    assert np.mean(z < 1) == pytest.approx(0.70, abs=0.09)
    assert np.mean(z < 2) == pytest.approx(0.95, abs=0.045)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.3)


def test_memory_does_not_grow_with_the_samples() -> None:
    assert _lanes(100, 2**8) == _lanes(100, 2**14)


def _lanes(points: int, samples: int) -> int:
    from twin.tracer import _streams

    return points * RANDOMISATIONS * _streams(points * RANDOMISATIONS, samples)


def test_other_parameters_run_the_same_kernel() -> None:
    """Angles, tables of another size, another sample, more samples: nothing is compiled again."""
    import_mitsuba()
    import drjit as dr

    tracer = Tracer(build_mesh(artifact()), lambertian(0.6))
    trace(tracer, REAL, PLAN, 64)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        trace(tracer, REAL, columns(10.0, [33.0, 44.0], [5.0, 6.0]), 256, seed=9, setup=Setup(tilt_x_deg=0.5))
        trace(Tracer(build_mesh(artifact([(0.0, 0.0, 2.0)])), lobed()), facility(9.0), PLAN, 128)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 2
    assert all(kernel["cache_hit"] for kernel in kernels if kernel["operation_count"] > 500)


def test_kernels_hold_no_operation_that_some_llvm_cannot_compile() -> None:
    import_mitsuba()
    import drjit as dr

    tracer = Tracer(build_mesh(artifact([(0.0, 0.0, 2.0)])), lobed())
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        trace(tracer, facility(divergence=0.05), PLAN, 32)
        code = [kernel["ir"].read() for kernel in dr.kernel_history([dr.KernelType.JIT])]
    assert max(map(len, code)) > 10_000
    assert not [text for text in code if "llvm.minimum" in text or "llvm.maximum" in text]


def test_a_diverging_beam_blurs_the_edge_and_keeps_the_flux() -> None:
    tracer = Tracer(build_mesh(flat()), lambertian(1.0))
    wide = columns(30.0, [10.0], 60.0)
    sharp = trace(tracer, facility(6.0), wide, 8192)
    blurred = trace(tracer, facility(6.0, divergence=0.5), wide, 8192)
    assert blurred[0][0] == pytest.approx(sharp[0][0], abs=3e-3)


def test_a_tilt_keeps_its_signature() -> None:
    """Flux of the true geometry over that of the commanded one: a tilted flat sample reads cos(i')/cos(i)."""
    tracer = Tracer(build_mesh(flat()), lambertian(1.0))
    narrow = facility(30.0, target=2.0)
    value, _ = trace(tracer, narrow, columns(30.0, [20.0, -50], 0.0), 64, setup=Setup(tilt_y_deg=1.0))
    np.testing.assert_allclose(value, np.cos(np.deg2rad(29.0)) / np.cos(np.deg2rad(30.0)), rtol=1e-5)
    view, _ = trace(
        tracer, facility(1.0, target=12.0), columns(0.0, [50.0], 0.0), 16384, setup=Setup(sensor_zenith_deg=1)
    )
    # The target holds the whole spot, which looks shorter from the true angle.
    assert view[0] == pytest.approx(np.cos(np.deg2rad(51)) / np.cos(np.deg2rad(50)), rel=4e-3)


def test_holes_lie_where_the_table_says() -> None:
    """A hole under a narrow beam darkens the view; the same beam between holes does not."""
    tracer = Tracer(build_mesh(artifact()), lambertian(0.5))
    x, y = float(REGULAR[6]), float(REGULAR[7])
    thin = facility(1.0, target=6.0)
    plan = columns(0.0, [65.0], 0.0)
    in_hole = trace(tracer, thin, plan, 2048, setup=Setup(offset_x_mm=-x, offset_y_mm=-y))
    between = trace(tracer, thin, plan, 2048)
    assert between[0][0] == pytest.approx(0.5, abs=0.01)
    assert in_hole[0][0] < 0.2  # the lit floor is out of sight


def test_bad_numbers_of_samples_are_refused() -> None:
    tracer = Tracer(build_mesh(flat()), lambertian(1.0))
    layout, table = lay_out(REAL, PLAN), np.zeros(7, int)
    for samples, first in ((0, 0), (24, 0), (64, 32), (2**25, 0)):
        with pytest.raises(ValueError, match="expected a power of two"):
            tracer.radiance(layout, table, samples, seed=1, first=first)


@pytest.mark.parametrize("sample", [flat(), artifact([(1.0, 0.5, 2.0)])], ids=["whole", "one hole"])
def test_a_table_that_changes_within_the_beam_is_followed(sample: Any) -> None:
    """Light from 100 mm comes from up to 3.1 degrees off the axis; there the table has lost a third."""
    cos_i = np.array([0.0, 0.5, 0.998, 1.0])
    brf = np.broadcast_to([0.5, 0.5, 0.5, 1.0], (1, 4, 5, 4))
    peaked = Material(cos_i, np.linspace(0, 2 * np.pi, 5), cos_i, brf / np.pi, name="peaked")
    tracer, geometry = Tracer(build_mesh(sample), peaked), columns(0, [40.0], 30)
    setup = Setup(source_distance_mm=100.0)
    value, error = trace(tracer, facility(), geometry, 1024, setup=setup)
    whole, whole_error = trace(tracer, facility(), geometry, 8192, seed=2, setup=setup, mixture=UNRESTRICTED)
    assert error < 0.002 * value
    assert abs(value - whole) < 4 * np.hypot(error, whole_error)
