"""Responses of effects: closed forms on a flat Lambertian sample, tables against direct renderings, the cache."""

from __future__ import annotations

import logging
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from traced_samples import artifact, columns, facility, flat

from instrument.plane_flux import plane_flux
from twin.artifact import build_mesh
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.direct_light import once_reflected, pierced_plate
from twin.diagnosis.effects import Known, SceneEffect, effect
from twin.diagnosis.effects.base import nodes_between
from twin.diagnosis.renders import RenderStore
from twin.diagnosis.response import AnyResponse, cardinal_spline
from twin.diagnosis.responses import responses
from twin.diagnosis.transport import transported
from twin.diagnosis.variation import Variation, together
from twin.diagnosis.workbench import Workbench
from twin.material import lambertian
from twin.optics import Setup, lay_out

#: A narrow beam inside a wide field of view: the footprint stays inside the target at every angle.
OVERFILLED = facility(4.0, target=40.0)
PLANE = columns(0.0, np.array([70.0, 45.0, 20.0, -20.0, -45.0, -70.0]), 0.0)
HOLES = [(x, y, 2.55) for x, y in product((-3.6, 0.0, 3.6), repeat=2)]


def run_of(where: dict) -> Acquisition:
    count = len(where["sensor_zenith"])
    order = np.arange(count)
    previous = np.concatenate([order[:1], order[:-1]])
    azimuth = np.array([0.0, 45.0, 90.0, 135.0])
    return Acquisition(where, np.ones(count), 15.0, azimuth, previous, travel_direction(where, order))


def response(name: str, where: dict, bench: Workbench, folder: Path | None = None) -> AnyResponse:
    run = run_of(where)
    found = responses(run, np.full(len(run), 0.5), RenderStore(bench, folder), effects=[effect(name)])
    return found.found[name]


@pytest.fixture(scope="module")
def flat_bench() -> Workbench:
    return Workbench(OVERFILLED, flat(), lambertian(0.6), samples=1)


def test_tilt_of_a_flat_sample_has_the_tangent_of_the_view(flat_bench: Workbench):
    # A normal turned by t towards the view at u: flux goes with 1/cos of the view and the cosine of the light.
    u, tilt = np.deg2rad(PLANE["sensor_zenith"]), np.deg2rad(0.5)
    expected = np.cos(u) / np.cos(u - tilt) * np.cos(tilt)
    found = response("sample_tilt", PLANE, flat_bench).relative(np.array([[0.0, 0.5, 0.0]]))[0]
    np.testing.assert_allclose(found, 1 / (expected / np.cos(tilt) ** 2) - 1, atol=2e-4)


def test_sensor_zenith_offset_keeps_the_tangent_and_the_reference(flat_bench: Workbench):
    u, off = np.deg2rad(PLANE["sensor_zenith"]), np.deg2rad(0.5)
    expected = np.cos(u + off) / np.cos(u) / (np.cos(np.deg2rad(15.5)) / np.cos(np.deg2rad(15)))
    found = response("sensor_zenith_offset", PLANE, flat_bench).relative(np.array([[0.5]]))[0]
    np.testing.assert_allclose(found, expected - 1, atol=3e-4)


def test_backlash_has_opposite_signs_for_opposite_travel(flat_bench: Workbench):
    down = response("backlash", PLANE, flat_bench).relative(np.array([[1.0]]))[0]
    upwards = {name: column[::-1].copy() for name, column in PLANE.items()}
    up = response("backlash", upwards, flat_bench).relative(np.array([[1.0]]))[0][::-1]
    # Downwards the true zenith is smaller than commanded by half a degree.
    expected = np.cos(np.deg2rad(PLANE["sensor_zenith"] - 0.5)) / np.cos(np.deg2rad(PLANE["sensor_zenith"])) - 1
    np.testing.assert_allclose(down, expected, atol=3e-4)
    np.testing.assert_allclose(up, -down, atol=2e-3)


def test_scale_of_the_azimuth_turns_every_point_by_its_own_angle():
    bench = Workbench(OVERFILLED, artifact(HOLES), lambertian(0.6), samples=1)
    where = columns(30.0, np.array([50.0, 50.0, 50.0]), np.array([0.0, 90.0, 150.0]))
    scaled = response("azimuth_scale", where, bench).relative(np.array([[0.05]]))[0]
    offset = response("sensor_azimuth_offset", where, bench)
    for point, azimuth in enumerate(where["sensor_azimuth"]):
        turned = offset.relative(np.array([[0.05 * azimuth]]))[0]
        assert scaled[point] == pytest.approx(turned[point], abs=1e-9)
    assert scaled[0] == pytest.approx(0.0, abs=1e-12)
    assert abs(scaled[2]) > 1e-4


def test_stain_on_a_flat_sample_takes_its_share_of_the_lit_area(flat_bench: Workbench):
    # A spot exp(-(r/R)^4) has the area pi^1.5 R^2/2; the beam lights pi 2^2/cos(illumination), all of it seen.
    where = columns(np.array([0.0, 60.0, 0.0]), np.array([40.0, 20.0, -40.0]), np.array([0.0, 90.0, 45.0]))
    found = response("stain", where, flat_bench).relative(np.array([[-0.1, 0.3, -0.2, 0.8]]))[0]
    lit = np.pi * 2.0**2 / np.cos(np.deg2rad(where["illumination_zenith"]))
    np.testing.assert_allclose(found, -0.1 * (np.pi**1.5 * 0.8**2 / 2) / lit, rtol=0.02)


def test_stain_beside_the_target_of_the_sensor_is_not_seen():
    narrow = Workbench(facility(8.0, target=3.0), flat(), lambertian(0.6), samples=1)
    where = columns(0.0, np.array([5.0, 70.0]), 0.0)
    found = response("stain", where, narrow).relative(np.array([[-0.1, 3.0, 0.0, 0.6]]))[0]
    # Seen at 70 degrees the target reaches 1.5/cos(70 degrees) = 4.4 mm along x, seen from above 1.5 mm.
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    # The spot's 1.0 mm^2 of the 20 mm^2 of that ellipse, little of which lies outside the beam.
    assert found[1] == pytest.approx(
        -0.1 * (np.pi**1.5 * 0.6**2 / 2) / (np.pi * 1.5**2 / np.cos(np.deg2rad(70))), rel=0.05
    )


def test_reflectance_of_a_flat_coating_is_a_scale(flat_bench: Workbench):
    found = response("reflectance_scale", PLANE, flat_bench).relative(np.array([[0.93]]))[0]
    np.testing.assert_allclose(found, -0.07, atol=1e-4)


def test_derivative_is_the_slope_of_the_response(flat_bench: Workbench):
    found = response("sensor_zenith_offset", PLANE, flat_bench)
    slope = -np.tan(np.deg2rad(PLANE["sensor_zenith"])) + np.tan(np.deg2rad(15))
    np.testing.assert_allclose(found.derivative()[0], np.deg2rad(slope), atol=2e-4)


def test_cardinal_spline_follows_a_smooth_function_between_nodes():
    nodes = np.linspace(-2, 2, 7)
    x = np.linspace(-2, 2, 41)
    np.testing.assert_allclose(cardinal_spline(nodes)(x) @ np.sin(nodes), np.sin(x), atol=0.01)
    np.testing.assert_allclose(cardinal_spline(nodes)(nodes), np.eye(7), atol=1e-12)


def test_joined_variations_add_their_setups():
    both = together(Variation(Setup(tilt_x_deg=1.0)), effect("cavity_reflectance").variation(np.array([0.9])))
    assert both.setup.tilt_x_deg == 1.0
    assert len(both.surface_factor) == 3


def ring(width_mm: float) -> float:
    """Volume of a 45 degree chamfer around a hole of 2.55 mm (Pappus)."""
    return float(np.pi * (1.275 * width_mm**2 + width_mm**3 / 3))


@pytest.mark.parametrize(("there", "added"), [(0.0, 0.1), (0.1, 0.05), (0.1, -0.1)])
def test_chamfer_is_added_to_the_one_that_is_there(there: float, added: float):
    plain = artifact(HOLES)
    known = Known(OVERFILLED, plain.changed(edge_chamfer=there), lambertian(0.6))
    (change,) = effect("edge_chamfer").variation(np.array([added])).artifact
    meshes = [build_mesh(dimensions) for dimensions in (known.artifact, change.dimensions(known.artifact))]
    cut = meshes[0].volume() - meshes[1].volume()
    assert cut / len(HOLES) == pytest.approx(ring(there + added) - ring(there), rel=3e-3)
    low, high = effect("edge_chamfer").resolve(known)[0].cap
    assert low == -there
    assert 2 * (there + high) < 3.6 - 2.55


def test_light_reflected_once_by_a_plate_seen_and_lit_along_the_normal_is_closed_form():
    # Nothing is hidden: top and floor have the same irradiance and BRDF, so the holes do not show.
    bench, where = facility(8.0, target=40.0), columns(0.0, [0.0], 0.0)
    layout = lay_out(bench, where)
    pierced = once_reflected(pierced_plate(artifact(HOLES)), lambertian(0.6), layout, np.zeros(1, int), nodes=2000)
    whole = once_reflected(pierced_plate(flat()), lambertian(0.6), layout, np.zeros(1, int))
    assert whole[0] == pytest.approx(0.6 * (8 / 40) ** 2, rel=1e-3)
    assert pierced[0] == pytest.approx(whole[0], rel=5e-3)


@pytest.mark.parametrize(
    "setup",
    [
        Setup(divergence_deg=12.0),
        Setup(mirror_radius_mm=15.0),
        Setup(target_radius_mm=-1.0),
        Setup(beam_x_mm=0.5, beam_y_mm=1.4),
        Setup(height_mm=2.0),
    ],
    ids=["divergence", "mirror", "target", "beam", "height"],
)
def test_light_reflected_once_by_a_lambertian_coupon_is_the_integral_of_its_irradiance(setup: Setup):
    bench = facility(profile="gaussian", mirror=10.8)
    where = columns([0.0, 0.0, 0.0, 30.0, 30.0], [15.0, 45.0, -80.0, 45.0, -80.0], 0.0)
    plate, tables = pierced_plate(flat()), np.zeros(5, int)
    off, nominal = (lay_out(bench, where, s) for s in (setup, Setup()))
    found = once_reflected(plate, lambertian(0.6), off, tables)
    found = found / once_reflected(plate, lambertian(0.6), nominal, tables)
    np.testing.assert_allclose(found, plane_flux(off) / plane_flux(nominal), rtol=3e-3)


def test_wide_mirror_sees_directions_that_mirror_each_other_alike():
    # The points that stand for the mirror must not lean to one side: that is an arm that is off.
    zenith = np.array([20.0, 50.0, 75.0])
    where = columns(0.0, np.concatenate([zenith, -zenith]), 0.0)
    bench, plate = facility(profile="gaussian", mirror=10.8), pierced_plate(artifact())
    layout = lay_out(bench, where, Setup(mirror_radius_mm=40.0))
    left, right = np.split(once_reflected(plate, lambertian(0.6), layout, np.zeros(6, int)), 2)
    np.testing.assert_allclose(left / right, 1, atol=0.012)


def test_nodes_crowd_around_the_nominal_value():
    nodes = nodes_between((-6.0, 3.0), 0.0, 10, 2.0)
    np.testing.assert_allclose(nodes, [-6, -6 * 25 / 36, -6 * 16 / 36, -1.5, -6 * 4 / 36, -6 / 36, 0, 3 / 9, 12 / 9, 3])
    np.testing.assert_allclose(nodes_between((0.0, 4.0), 0.0, 3, 2.0), [0, 1, 4])
    np.testing.assert_allclose(nodes_between((-4.0, 0.0), 0.0, 3, 2.0), [-4, -1, 0])


def test_light_that_goes_sideways_stays_on_a_flat_sample_that_is_seen_whole():
    layout = lay_out(OVERFILLED, columns(0.0, np.array([0.0, 40.0]), 0.0))
    plate, coating, table = pierced_plate(flat()), lambertian(0.6), np.zeros(2, int)
    moved = transported(plate, coating, layout, table, 0.1) / once_reflected(plate, coating, layout, table)
    np.testing.assert_allclose(moved, 0, atol=1e-3)


def test_damaged_file_is_rendered_again_and_said(
    flat_bench: Workbench, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    first = response("sensor_zenith_offset", PLANE, flat_bench, tmp_path).relative(np.array([[1.0]]))
    (kept,) = (tmp_path / "responses").glob("*.npz")
    kept.write_bytes(kept.read_bytes()[:200])
    with caplog.at_level(logging.WARNING):
        again = response("sensor_zenith_offset", PLANE, flat_bench, tmp_path).relative(np.array([[1.0]]))
    assert caplog.text.count("worked out again") == 1
    np.testing.assert_array_equal(again, first)


def test_subset_of_a_plan_needs_no_rendering(flat_bench: Workbench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    whole = response("sensor_zenith_offset", PLANE, flat_bench, tmp_path).relative(np.array([[1.0]]))
    monkeypatch.setattr(Workbench, "render", None)
    some = {name: column[[4, 1]] for name, column in PLANE.items()}
    part = response("sensor_zenith_offset", some, flat_bench, tmp_path).relative(np.array([[1.0]]))
    np.testing.assert_array_equal(part, whole[:, [4, 1]])


def test_points_added_to_a_plan_join_those_kept(flat_bench: Workbench, tmp_path: Path):
    some = {name: column[:3] for name, column in PLANE.items()}
    response("sensor_zenith_offset", some, flat_bench, tmp_path)
    other = {name: column[2:] for name, column in PLANE.items()}
    response("sensor_zenith_offset", other, flat_bench, tmp_path)
    store = RenderStore(flat_bench, tmp_path)
    assert isinstance(effect("sample_height"), SceneEffect)
    kept = np.load(next((tmp_path / "responses").glob("*.npz")))
    assert len(kept["geometry"]) == len(PLANE["sensor_zenith"])
    assert store.missing([[Variation(Setup(height_mm=1.0))]], PLANE) == 1


@pytest.mark.slow
def test_table_reproduces_renderings_between_its_nodes():
    bench = Workbench(facility(mirror=10.8, profile="gaussian"), artifact(), lambertian(0.6), samples=128)
    where = columns(np.repeat([0.0, 30.0], 4), np.tile([-65.0, -25.0, 15.0, 75.0], 2), np.repeat([0.0, 60.0], 4))
    run, store = run_of(where), RenderStore(bench, None)
    between = {
        "sample_tilt": [0.8, -1.1, 30.0],
        "beam_offset": [0.5, 0.9],
        "hole_diameter": [0.13],
        "sample_height": [1.3],
    }
    for name, values in between.items():
        scene = effect(name)
        assert isinstance(scene, SceneEffect)
        found = responses(run, np.ones(len(run)), store, effects=[scene]).found[name]
        variation = scene.variation(np.array(values))
        direct = store.get([[variation]], where)[0].log_ratio(where)[0]
        direct = direct - np.log(bench.reference_change(variation.reference_setup()))
        np.testing.assert_allclose(found.log_ratio(np.array([values]))[0], direct, atol=6e-3)
