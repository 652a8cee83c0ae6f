"""What the imperfect instrument reads: imperfections act on the truth, the scale stays the commanded one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from instrument.artifact import ArtifactDimensions, read_artifact
from instrument.errors import InputError
from instrument.facility import Facility
from instrument.plan import read_plan
from sim_fixtures.examples import example_files
from sim_fixtures.examples.coupon import flat_sample
from sim_fixtures.reality import Coating, Imperfections, Reality
from sim_fixtures.reality.imperfections import CoatingErrors, OpticsErrors, ShapeErrors
from sim_fixtures.reality.reality import true_dimensions
from sim_fixtures.reality.stability import Stability

RAYS = 4096


@pytest.fixture(scope="module")
def artifact() -> ArtifactDimensions:
    return read_artifact(example_files().artifact)


def test_a_perfect_instrument_reads_one_for_a_lambertian_plate(facility: Facility) -> None:
    reality = Reality(facility, flat_sample(), coating=Coating(base=1.0), rays=65536)
    for geometry in ((0.0, 15.0, 0.0), (30.0, -60.0, 60.0), (60.0, 80.0, 135.0)):
        assert reality.flux("sample", *geometry) / reality.normalisation(*geometry) == pytest.approx(1.0, abs=1e-3)
    assert reality.normalisation(0.0, 15.0, 90.0) == pytest.approx(1.0, abs=1e-12)


def test_a_flat_sample_returns_its_coating(facility: Facility) -> None:
    coating = Coating(base=0.5, forward=0.3)
    parallel = facility.model_copy(update={"sensor": facility.sensor.model_copy(update={"mirror_diameter": 0.0})})
    reality = Reality(parallel, flat_sample(), coating=coating, rays=65536)
    measured = reality.flux("sample", 60.0, -70.0, 0.0) / reality.normalisation(60.0, -70.0, 0.0)
    sines = np.sin(np.deg2rad(60.0)) * np.sin(np.deg2rad(70.0))
    assert measured == pytest.approx(0.5 + 0.3 * sines**3, rel=1e-3)


def test_the_reference_reads_its_true_reflectance(facility: Facility, artifact: ArtifactDimensions) -> None:
    reality = Reality(facility, artifact, Imperfections(reference_reflectance=1.004))
    assert reality.flux("reference", 0.0, 15.0, 45.0) == pytest.approx(0.99 * 1.004, rel=1e-9)


def test_a_zero_error_of_an_arm_is_a_move_of_that_arm(facility: Facility, artifact: ArtifactDimensions) -> None:
    perfect = Reality(facility, artifact, rays=RAYS)
    wrong = Imperfections(
        illumination_zenith_offset_deg=0.5, sensor_zenith_offset_deg=-0.25, sensor_azimuth_offset_deg=2.0
    )
    moved = Reality(facility, artifact, wrong, rays=RAYS)
    assert moved.flux("sample", 15.0, 60.0, 50.0) == pytest.approx(perfect.flux("sample", 15.5, 59.75, 52.0), rel=1e-9)
    assert moved.normalisation(15.0, 60.0, 50.0) == perfect.normalisation(15.0, 60.0, 50.0)


def test_a_tilt_in_the_plane_of_incidence_lowers_both_zenith_angles(
    facility: Facility, artifact: ArtifactDimensions
) -> None:
    perfect = Reality(facility, artifact, rays=RAYS)
    tilted = Reality(facility, artifact, Imperfections(sample_tilt_y_deg=0.5), rays=RAYS)
    assert tilted.flux("sample", 15.0, -60.0, 0.0) == pytest.approx(perfect.flux("sample", 14.5, -60.5, 0.0), rel=1e-9)


def test_a_zero_error_keeps_its_growth_with_the_tangent_of_the_zenith_angle(facility: Facility) -> None:
    plain, tilt = Coating(base=0.6), Imperfections(sample_tilt_y_deg=0.2)
    relative = [
        Reality(facility, flat_sample(), tilt, coating=plain).flux("sample", 0.0, zenith, 0.0)
        / Reality(facility, flat_sample(), coating=plain).flux("sample", 0.0, zenith, 0.0)
        - 1.0
        for zenith in (-75.0, 75.0)
    ]
    expected = np.deg2rad(0.2) * np.tan(np.deg2rad(75.0))
    assert relative == pytest.approx([-expected, expected], rel=0.1)


def test_a_turn_of_the_sample_is_a_turn_of_the_sensor_back(facility: Facility, artifact: ArtifactDimensions) -> None:
    turned = Reality(facility, artifact, Imperfections(sample_azimuth_deg=20.0), rays=32768)
    still = Reality(facility, artifact, rays=32768)
    assert turned.flux("sample", 0.0, 50.0, 45.0) == pytest.approx(still.flux("sample", 0.0, 50.0, 25.0), rel=0.006)


def test_a_raised_sample_shows_the_parallax_of_its_spot(facility: Facility) -> None:
    parallel = facility.model_copy(
        update={
            "beam": facility.beam.model_copy(update={"profile": "tophat"}),
            "sensor": facility.sensor.model_copy(update={"mirror_diameter": 0.0}),
        }
    )
    height, zenith, radius = 6.0, 40.0, 5.4
    # Across the view the spot is an ellipse, moved by the height times the sine; what falls on the target counts.
    x, y = np.meshgrid(*(np.linspace(-radius, radius, 1501),) * 2)
    target = np.hypot(x, y) < radius
    spot = [
        np.hypot((x - moved) / np.cos(np.deg2rad(zenith)), y) < radius
        for moved in (0.0, height * np.sin(np.deg2rad(zenith)))
    ]
    expected = np.sum(spot[1] & target) / np.sum(spot[0] & target)
    assert expected < 0.9
    flux = [
        Reality(parallel, flat_sample(), wrong, coating=Coating(base=0.6), rays=65536).flux("sample", 0.0, zenith, 0.0)
        for wrong in (Imperfections(), Imperfections(sample_height_mm=height))
    ]
    assert flux[1] / flux[0] == pytest.approx(expected, rel=2e-3)


def test_a_move_in_its_plane_changes_nothing_for_a_flat_sample_but_for_the_lattice_it_does(
    facility: Facility, artifact: ArtifactDimensions
) -> None:
    moved = Imperfections(sample_offset_x_mm=1.8, sample_offset_y_mm=1.8)
    flat = [Reality(facility, flat_sample(), wrong).flux("sample", 15.0, 50.0, 75.0) for wrong in (None, moved)]
    assert flat[1] == pytest.approx(flat[0], rel=1e-9)
    holes = [Reality(facility, artifact, wrong).flux("sample", 0.0, 10.0, 0.0) for wrong in (None, moved)]
    assert abs(holes[1] / holes[0] - 1.0) > 0.005  # the beam now centred on a hole


def test_the_detector_head_shadows_the_beam(facility: Facility, artifact: ArtifactDimensions) -> None:
    reality = Reality(facility, artifact, rays=16)
    assert reality.flux("sample", 30.0, 30.0, 0.0) == reality.flux("sample", 30.0, 26.0, 0.0) == 0.0
    assert reality.flux("sample", 30.0, 25.0, 0.0) > 0.0


def test_an_unbounded_beam_is_followed_from_the_sensor(facility: Facility) -> None:
    ideal = facility.model_copy(
        update={
            "beam": facility.beam.model_copy(update={"diameter": "unbounded"}),
            "sensor": facility.sensor.model_copy(update={"target_shape": "horizontal_disc", "mirror_diameter": 0.0}),
        }
    )
    reality = Reality(ideal, flat_sample(), coating=Coating(base=0.7), rays=256)
    assert reality.flux("sample", 30.0, 60.0, 0.0) == pytest.approx(0.7 * np.cos(np.deg2rad(30.0)), rel=1e-6)


def test_readings_do_not_depend_on_order_or_thread(facility: Facility, artifact: ArtifactDimensions) -> None:
    wrong = Imperfections.within_budget(facility, 4)
    geometries = [(i, z, a) for i in (0.0, 15.0, 30.0) for z in (-60.0, 40.0, 70.0) for a in (0.0, 75.0)]
    one = Reality(facility, artifact, wrong, 4, rays=1024)
    expected = [one.flux("sample", *geometry) for geometry in geometries]
    other = Reality(facility, artifact, wrong, 4, rays=1024)
    with ThreadPoolExecutor(4) as pool:
        backwards = list(pool.map(lambda geometry: other.flux("sample", *geometry), geometries[::-1]))
    assert backwards[::-1] == expected
    assert one.flux_many("sample", 15.0, [-60.0, 40.0], [75.0, 0.0]) == pytest.approx([expected[7], expected[8]])
    assert Reality(facility, artifact, wrong, 5, rays=1024).flux("sample", *geometries[0]) != expected[0]


@pytest.mark.slow
def test_the_monte_carlo_error_is_what_the_documentation_says(facility: Facility, artifact: ArtifactDimensions) -> None:
    geometries = [(15.0, z, a) for z, a in ((80.0, 0.0), (-80.0, 75.0), (45.0, 50.0), (-30.0, 130.0), (0.0, 0.0))]
    runs = [[Reality(facility, artifact, seed=s).flux("sample", *g) for g in geometries] for s in range(5)]
    relative = np.std(runs, axis=0, ddof=1) / np.mean(runs, axis=0)
    assert np.sqrt(np.mean(relative**2)) < 0.0025
    assert np.median(relative) < 0.0012


def test_a_mesh_is_refused(facility: Facility, artifact: ArtifactDimensions) -> None:
    with pytest.raises(InputError, match="mesh"):
        Reality(facility, replace(artifact, mesh=Path("a.ply"))).flux("sample", 0.0, 20.0, 0.0)


def test_no_imperfection_is_the_default() -> None:
    neutral = {"reference_reflectance": 1.0, "stability_kind": "none", "sample_pivot_mm": (0.0, 0.0, 0.0)}
    neutral |= {"shape": ShapeErrors(), "coating": CoatingErrors(), "optics": OpticsErrors()}
    assert all(field.default == neutral.get(field.name, 0.0) for field in fields(Imperfections))


def test_draws_within_the_budget_repeat_and_stay_inside_it(facility: Facility) -> None:
    draws = [Imperfections.within_budget(facility, seed) for seed in range(200)]
    assert draws[7] == Imperfections.within_budget(facility, 7)
    assert {draw.stability_kind for draw in draws} == {"slice", "angle", "global", "independent"}
    zenith = np.array([draw.sensor_zenith_offset_deg for draw in draws])
    grazing = np.deg2rad(np.abs(zenith)) * np.tan(np.deg2rad(80.0))
    assert 0.003 < np.sqrt(np.mean(grazing**2)) < 0.0052  # the row of the budget, cut at 1.5 of it
    assert np.max(np.abs([draw.reference_reflectance - 1.0 for draw in draws])) <= 1.5 * 0.005
    assert np.max(np.abs([draw.sample_height_mm for draw in draws])) <= 1.5 * 0.1


def test_another_mounting_of_the_same_instrument_changes_the_pose_alone(facility: Facility) -> None:
    first, second = (Imperfections.within_budget(facility, 3, mounting) for mounting in (0, 1))
    assert first.sensor_zenith_offset_deg == second.sensor_zenith_offset_deg
    assert first.reference_reflectance == second.reference_reflectance
    assert first.sample_tilt_x_deg != second.sample_tilt_x_deg


def test_true_dimensions_scatter_about_the_stated_ones(artifact: ArtifactDimensions) -> None:
    assert true_dimensions(artifact, 0.0, 1) is artifact
    truth = true_dimensions(artifact, 1.0, 1)
    assert np.std(truth.holes.diameter - artifact.holes.diameter) == pytest.approx(0.006, rel=0.2)
    assert np.std(truth.holes.x - artifact.holes.x) == pytest.approx(0.005, rel=0.2)
    thickness = [true_dimensions(artifact, 1.0, seed).form.plate_thickness for seed in range(300)]
    assert np.mean(thickness) == pytest.approx(1.13, abs=0.01)
    assert 0.03 < np.std(thickness) < 0.044


@pytest.mark.parametrize("kind", ["slice", "angle", "global", "independent"])
def test_stability_has_unit_variance_and_its_correlation(kind: str) -> None:
    places = [(0.0, 60.0, 45.0), (0.0, 55.0, 45.0), (0.0, -60.0, 45.0), (30.0, 60.0, 120.0)]
    draws = np.array([[Stability(kind, seed).value(*place) for place in places] for seed in range(600)])
    assert np.std(draws[:, 0]) == pytest.approx(0.89 if kind == "global" else 1.0, abs=0.1)
    correlation = np.corrcoef(draws.T)[0]
    expected = {
        "slice": [1.0, 1.0, 0.0],
        "angle": [0.98, 0.0, 0.0],
        "global": [1.0, 1.0, 1.0],
        "independent": [0.0, 0.0, 0.0],
    }
    assert correlation[1:] == pytest.approx(expected[kind], abs=0.12)


@pytest.mark.slow
def test_a_sound_run_agrees_with_a_perfect_model_as_well_as_the_papers(
    facility: Facility, artifact: ArtifactDimensions
) -> None:
    plan = read_plan(example_files().plan, facility)
    geometries = [(p.illumination_zenith, p.sensor_zenith, p.sensor_azimuth) for p in plan.points]
    perfect = Reality(facility, artifact, seed=77, rays=8192)
    expected = np.array([perfect.flux("sample", *geometry) for geometry in geometries])
    for seed in (1, 2):
        real = Reality(facility, artifact, Imperfections.within_budget(facility, seed), seed, rays=8192)
        reference = np.mean([real.flux("reference", 0.0, 15.0, a) for a in facility.reference.sensor_azimuth]) / 0.99
        difference = np.array([real.flux("sample", *g) for g in geometries]) / reference / expected - 1.0
        assert np.sqrt(np.mean(difference**2)) < 0.02
