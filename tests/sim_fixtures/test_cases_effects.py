"""Effects of the case maker against closed forms and limiting cases."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from instrument.angles import FloatArray
from instrument.artifact import read_artifact
from instrument.facility import Facility
from instrument.plan import Plan, PlanForm, make_plan
from sim_fixtures.cases import FAMILIES, CaseMaker, Laboratory, known_effects
from sim_fixtures.cases.families import Draw
from sim_fixtures.cases.readings import Clean, clean, light
from sim_fixtures.cases.sample_effects import ROUNDING
from sim_fixtures.cases.signal_effects import lag_of, leaving_polarization
from sim_fixtures.cases.world import World, moments_of
from sim_fixtures.examples import example_files
from sim_fixtures.examples.coupon import GAINS, flat_sample
from sim_fixtures.reality import EXAMPLE_COATING, Coating, Reality
from sim_fixtures.reality.bores import ellipse, rounded_rim

ALBEDO = 0.6
RAYS = 4096


def plan_of(facility: Facility, zeniths: list[float], azimuths: list[float], illumination: list[float]) -> Plan:
    grid = {
        "wavelength": [500.0],
        "illumination_zenith": illumination,
        "sensor_azimuth": azimuths,
        "sensor_zenith": zeniths,
    }
    return make_plan(PlanForm.model_validate({"version": 1, "grid": [grid]}), facility, "test")


@pytest.fixture(scope="module")
def flat(facility: Facility) -> Laboratory:
    """A flat Lambertian sample."""
    plan = plan_of(facility, [-75.0, -60.0, -40.0, -20.0, 10.0, 30.0, 50.0, 70.0], [0.0, 45.0, 90.0], [0.0, 15.0])
    return Laboratory(facility, flat_sample(), Coating(base=ALBEDO), plan, RAYS)


@pytest.fixture(scope="module")
def holes(facility: Facility) -> Laboratory:
    """The example artifact, a few geometries."""
    plan = plan_of(facility, [-70.0, -45.0, -25.0, 0.0, 20.0, 40.0, 65.0], [0.0, 60.0], [15.0])
    return Laboratory(facility, read_artifact(example_files().artifact), EXAMPLE_COATING, plan, RAYS)


def measured(laboratory: Laboratory, effects: Mapping[str, Mapping[str, float]] | None = None) -> Clean:
    """Noise-free readings with nothing wrong but the effects."""
    world = World()
    for name, parameters in (effects or {}).items():
        world = known_effects()[name].apply(world, parameters)
    return clean(laboratory, world, light(laboratory, world, 5))


def change(laboratory: Laboratory, name: str, **parameters: float) -> FloatArray:
    """Ratio of the reflectance factors with and without an effect."""
    return np.asarray(measured(laboratory, {name: parameters}).brf / measured(laboratory).brf)


def test_every_effect_of_the_contract_and_a_dozen_others_exist() -> None:
    contract = [
        "sample_tilt",
        "sample_azimuth",
        "sample_height",
        "sample_offset",
        "illumination_zenith_offset",
        "sensor_zenith_offset",
        "sensor_azimuth_offset",
        "sensor_arm_runout",
        "backlash",
        "beam_offset",
        "beam_radius",
        "field_of_view",
        "acceptance_angle",
        "beam_divergence",
        "retroreflection",
        "specular_lobe",
        "anisotropy",
        "translucency",
        "cavity_reflectance",
        "reflectance_scale",
        "reference_scale",
        "hole_diameter",
        "plate_thickness",
        "cavity_depth",
        "edge_chamfer",
        "stray_light",
        "dark_offset",
        "detector_nonlinearity",
        "gain_step",
        "source_drift",
        "session_scale",
        "stale_sample",
        "polarization",
        "arm_shadow",
        "arm_sag",
        "encoder_eccentricity",
    ]
    known = known_effects()
    assert {name for name, one in known.items() if not one.outside} == set(contract)
    assert sum(one.outside for one in known.values()) >= 12


def test_a_case_without_effects_is_the_perfect_reality(holes: Laboratory) -> None:
    perfect = Reality(holes.facility, holes.artifact, None, 5, rays=RAYS)
    at = holes.moments
    geometries = list(zip(at.illumination_zenith, at.sensor_zenith, at.sensor_azimuth, strict=True))
    expected = [perfect.flux("sample", *g) / perfect.normalisation(*g) for g in geometries]
    reference = np.mean([perfect.flux("reference", 0.0, 15.0, a) for a in holes.facility.reference.sensor_azimuth])
    expected = np.array(expected) / (reference / holes.facility.reference.reflectance_factor)
    assert measured(holes).brf == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", sorted(known_effects()))
def test_an_effect_of_no_amplitude_changes_nothing(holes: Laboratory, name: str) -> None:
    one = known_effects()[name]
    nothing = one.scaled(one.draw(np.random.default_rng(1)), 0.0)
    assert measured(holes, {name: nothing}).brf == pytest.approx(measured(holes).brf, rel=1e-12)


@pytest.mark.parametrize("offset", [0.7, -0.7])
def test_a_zero_error_of_the_sensor_gives_the_ratio_of_cosines(flat: Laboratory, offset: float) -> None:
    zenith = np.deg2rad(flat.moments.sensor_zenith)
    expected = np.cos(zenith + np.deg2rad(offset)) / np.cos(zenith)
    expected *= np.cos(np.deg2rad(15.0)) / np.cos(np.deg2rad(15.0 + offset))  # the reference is read askew too
    inside = np.abs(flat.moments.sensor_zenith) < 65
    assert change(flat, "sensor_zenith_offset", angle_deg=offset)[inside] == pytest.approx(expected[inside], rel=4e-3)


def test_backlash_is_half_a_zero_error_in_the_direction_of_travel(flat: Laboratory) -> None:
    upwards = change(flat, "backlash", angle_deg=1.4)
    zenith = np.deg2rad(flat.moments.sensor_zenith)
    expected = np.cos(zenith + np.deg2rad(0.7)) / np.cos(zenith)
    inside = np.abs(flat.moments.sensor_zenith) < 65
    assert np.all(flat.moments.travel == 1.0)
    assert upwards[inside] == pytest.approx(expected[inside], rel=4e-3)


def test_a_tilted_flat_sample_shows_its_cosine(flat: Laboratory) -> None:
    at = flat.moments
    normal = np.array([np.sin(np.deg2rad(1.0)), 0.0, np.cos(np.deg2rad(1.0))])
    zenith, azimuth, lamp = (np.deg2rad(x) for x in (at.sensor_zenith, at.sensor_azimuth, at.illumination_zenith))
    sensor = np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
    source = np.stack([np.sin(lamp), 0 * lamp, np.cos(lamp)])
    # Where the target holds the whole spot, the sensor's cosine matters alone.
    inside = (np.abs(at.sensor_zenith) < 45) & (at.illumination_zenith == 0)
    expected = (normal @ sensor) / np.cos(zenith)
    assert np.all(normal @ source > 0.9)
    ratio = change(flat, "sample_tilt", x_deg=0.0, y_deg=1.0)
    assert (ratio / ratio.mean())[inside] == pytest.approx((expected / ratio.mean())[inside], rel=6e-3)


@pytest.mark.parametrize("name", ["reflectance_scale", "reference_scale"])
def test_scales_are_exact(flat: Laboratory, name: str) -> None:
    ratio = change(flat, name, ratio=1.03)
    assert ratio == pytest.approx(1.03 if name == "reflectance_scale" else 1 / 1.03, rel=1e-6)


def test_faces_scaled_alike_are_the_coating_scaled(holes: Laboratory) -> None:
    walls = World().with_coating(cavity_scale=0.9, wall_scale=0.9)
    whole = World().with_coating(scale=0.9)
    one, other = (clean(holes, world, light(holes, world, 5)).brf for world in (walls, whole))
    top = measured(holes).brf - one
    assert np.all(other < one)
    assert np.all(top >= 0.0)


def test_stray_light_adds_a_constant_over_the_normalisation(flat: Laboratory) -> None:
    fraction, sound = 0.01, measured(flat)
    unit = sound.reference_current.mean() / flat.facility.reference.reflectance_factor
    per_flux = sound.current.mean(axis=1) / (sound.brf * unit * flat.normalisation)
    assert per_flux == pytest.approx(1.0, rel=1e-12)
    stray = measured(flat, {"stray_light": {"fraction": fraction}})
    reference = light(flat, World(), 5).reference.mean()
    expected = (sound.brf + fraction * flat.facility.reference.reflectance_factor / reference / flat.normalisation) / (
        1.0 + fraction / reference
    )
    assert stray.brf == pytest.approx(expected, rel=1e-9)


def test_a_voltage_matters_by_the_gain(flat: Laboratory) -> None:
    sound, wrong = measured(flat), measured(flat, {"dark_offset": {"voltage_v": 0.01}})
    added = (wrong.current - sound.current) * sound.gain[:, None]
    assert added == pytest.approx(0.01, rel=1e-9)
    assert set(sound.gain) == set(GAINS)


def test_dead_time_has_the_slope_of_the_contract_at_the_reference(flat: Laboratory) -> None:
    fraction, sound = 0.02, measured(flat)
    wrong = measured(flat, {"detector_nonlinearity": {"fraction": fraction}})
    s = sound.current.mean(axis=1) / sound.reference_current.mean()
    tau = -fraction / (1.0 + fraction)
    assert wrong.brf / sound.brf == pytest.approx((1.0 + tau) / (1.0 + tau * s), rel=1e-12)
    assert wrong.brf / sound.brf == pytest.approx(1.0 + fraction * (s - 1.0), rel=1e-3)
    assert wrong.reference_current.mean() == pytest.approx(sound.reference_current.mean(), rel=1e-12)


def test_the_higher_gain_alone_is_wrong(flat: Laboratory) -> None:
    ratio, high = change(flat, "gain_step", fraction=0.02), measured(flat).gain > GAINS[0]
    assert ratio[high] == pytest.approx(1.02, rel=1e-12)
    assert ratio[~high] == pytest.approx(1.0, rel=1e-12)


def test_a_filter_leaves_the_share_of_the_point_before(flat: Laboratory) -> None:
    sound, wrong = measured(flat), measured(flat, {"stale_sample": {"fraction": 0.1}})
    level, mean, last = sound.current[:, 0], wrong.current.mean(axis=1), wrong.current[:, -1]
    assert wrong.current[0] == pytest.approx(level[0])
    assert mean[1:] == pytest.approx(0.9 * level[1:] + 0.1 * last[:-1], rel=1e-9)
    steps = np.diff(np.log(np.abs(wrong.current - level[:, None])[1]))
    assert steps == pytest.approx(-lag_of(0.1))


def test_a_drift_runs_from_nothing_to_all_of_it(flat: Laboratory) -> None:
    ratio = change(flat, "source_drift", fraction=0.03)
    assert ratio[0] == pytest.approx(1.0, rel=1e-12)
    assert ratio[-1] == pytest.approx(1.03, rel=1e-12)
    assert np.all(np.diff(ratio) > 0)
    assert ratio[len(ratio) // 2] > 1.018  # ahead of a straight line


def test_a_session_has_one_factor(flat: Laboratory) -> None:
    ratio = change(flat, "session_scale", ratio_1=1.0, ratio_2=1.02)
    assert ratio == pytest.approx(np.where(flat.moments.illumination_zenith == 15.0, 1.02, 1.0), rel=1e-12)


def test_polarization_is_that_of_the_contract_at_its_ends() -> None:
    assert leaving_polarization(0.0) == pytest.approx(0.0)
    n, grazing = 1.5, np.pi / 2
    # At grazing angles Fresnel's amplitudes give t_p^2/t_s^2 = n^2 for light that leaves.
    assert leaving_polarization(grazing) == pytest.approx((n**2 - 1) / (n**2 + 1), rel=1e-9)


def test_light_is_lost_close_to_the_shadow_cone(flat: Laboratory) -> None:
    ratio, gap = change(flat, "arm_shadow", fraction=0.2), flat.moments.retro_angle
    reference = ratio[gap > 25]
    assert np.ptp(reference) < 1e-12
    near = gap < 19.5
    assert np.all(ratio[near] < reference[0])
    order = np.argsort(gap[near])
    assert np.all(np.diff(ratio[near][order]) >= -1e-12)


def test_a_backscatter_peak_is_added_to_a_flat_sample(flat: Laboratory) -> None:
    added = (change(flat, "retroreflection", amplitude=0.1, width_deg=10.0) - 1.0) * ALBEDO
    gap = flat.moments.retro_angle
    at_width = np.isclose(gap, 10.0)
    assert at_width.any()
    assert added[at_width] == pytest.approx(0.1 / np.e, rel=0.05)
    assert np.all(added[gap > 60] < 0.004)


def test_grain_on_a_flat_sample_has_twice_the_azimuth(flat: Laboratory) -> None:
    ratio, at = change(flat, "anisotropy", amplitude=0.05, axis_deg=45.0), flat.moments
    source, sensor = np.deg2rad(at.illumination_zenith), np.deg2rad(at.sensor_zenith)
    towards = np.cos(2 * np.deg2rad(at.sensor_azimuth - 45.0)) * np.sin(sensor) ** 2
    expected = 1.0 + 0.05 * (towards + np.cos(np.deg2rad(-90.0)) * np.sin(source) ** 2)
    assert ratio == pytest.approx(expected, abs=6e-4)


def test_facets_send_light_to_the_mirror_direction(flat: Laboratory) -> None:
    ratio, at = change(flat, "specular_lobe", amplitude=0.02, roughness=0.2), flat.moments
    slanted = at.illumination_zenith == 15.0
    strongest = np.flatnonzero(slanted)[np.argmax(ratio[slanted])]
    assert at.sensor_zenith[strongest] == -20.0
    assert at.sensor_azimuth[strongest] == 0.0


def test_diffusion_leaves_a_wide_flat_sample_as_it_is(flat: Laboratory) -> None:
    ratio = change(flat, "translucency", length_mm=0.1, fraction=0.8)
    assert np.abs(ratio - 1.0).max() < 0.01
    assert ratio.mean() == pytest.approx(1.0, abs=2e-3)


def test_light_that_diffuses_around_edges_changes_the_artifact(holes: Laboratory) -> None:
    assert np.std(change(holes, "translucency", length_mm=0.3, fraction=0.8)) > 0.01


def test_a_rounded_rim_takes_off_what_a_chamfer_would() -> None:
    profile = rounded_rim(1.13, ROUNDING * 0.1, facets=400)
    section = np.trapezoid(profile[::-1, 1], profile[::-1, 0])
    assert section == pytest.approx(0.5 * 0.1**2, rel=1e-3)
    assert profile[0] == pytest.approx([0.0, ROUNDING * 0.1])
    assert profile[-1] == pytest.approx([-1.13, 0.0])


def test_a_stack_of_straight_frusta_is_the_cylinder(holes: Laboratory) -> None:
    from sim_fixtures.reality.bores import ellipse as circle
    from sim_fixtures.reality.bundle import beam_bundle, sensor_bundle
    from sim_fixtures.reality.gather import gather
    from sim_fixtures.reality.scene import artifact_scene, with_bores
    from sim_fixtures.reality.tracer import trace

    plain = artifact_scene(holes.artifact)
    profile = np.column_stack([np.linspace(0.0, -plain.thickness, 4), np.zeros(4)])
    stacked = with_bores(plain, profile, circle(0.0, 0.0))
    reflection = EXAMPLE_COATING.at()
    sensors = [sensor_bundle(holes.facility.sensor, zenith, 30.0) for zenith in (-60.0, 5.0, 40.0)]
    beam = beam_bundle(holes.facility.beam, 15.0)
    seen = [
        gather(scene, reflection, trace(scene, reflection, beam, RAYS, 3), sensors, 3) for scene in (plain, stacked)
    ]
    assert seen[1] == pytest.approx(seen[0], rel=2e-3)


def test_an_ellipse_keeps_the_area() -> None:
    assert np.linalg.det(ellipse(0.3, 25.0)) == pytest.approx(1.0)
    assert ellipse(0.0, 25.0) == pytest.approx(np.eye(2))


def test_a_sagging_arm_balances(flat: Laboratory) -> None:
    from sim_fixtures.reality.imperfections import OpticsErrors
    from sim_fixtures.reality.spoiled import bent_zenith

    for shown in (-70.0, 0.0, 30.0, 80.0):
        true = bent_zenith(shown, OpticsErrors(arm_sag_deg=1.0))
        assert true == pytest.approx(shown + np.sin(np.deg2rad(true)), abs=1e-9)


@pytest.mark.parametrize("phase", [0.0, 90.0, 200.0])
def test_an_eccentric_scale_errs_by_a_sine_and_not_at_the_normal(phase: float) -> None:
    from sim_fixtures.reality.imperfections import OpticsErrors
    from sim_fixtures.reality.spoiled import bent_zenith

    wrong = OpticsErrors(eccentricity_deg=0.1, eccentricity_phase_deg=phase)
    zenith = np.array([-80.0, -30.0, 0.0, 45.0, 75.0])
    error = np.array([bent_zenith(z, wrong) - z for z in zenith])
    expected = 0.1 * (np.sin(np.deg2rad(phase - zenith)) - np.sin(np.deg2rad(phase)))
    assert error == pytest.approx(expected, abs=3e-4)


@pytest.mark.parametrize("family", sorted(set(FAMILIES) - {"none"}))
def test_instability_has_unit_variance(facility: Facility, family: str) -> None:
    draw: Draw = FAMILIES[family]
    moments = moments_of(plan_of(facility, [-60.0, -20.0, 20.0, 60.0], [0.0, 90.0], [0.0, 15.0]))
    draws = np.array([draw(moments, np.random.default_rng(seed)) for seed in range(1500)])
    # One draw for a whole run is cut at 1.5 standard deviations.
    expected = 0.7426 if family == "global" else 1.0
    assert np.std(draws) == pytest.approx(expected, rel=0.04)
    assert abs(draws.mean()) < 0.05


def test_a_severity_is_found(holes: Laboratory) -> None:
    maker = CaseMaker(holes)
    for name in ("sensor_zenith_offset", "stray_light"):
        _, truth = maker.make([name], 1.5, seed=3)
        assert truth.gap_over_u == pytest.approx(1.5, rel=0.03)
        in_u = truth.delta / holes.relative_uncertainty
        assert truth.gap_over_u == pytest.approx(float(np.sqrt(np.mean(in_u**2))))
        assert list(truth.where) == list(np.flatnonzero(np.abs(in_u) > 1.0))


def test_what_cannot_be_that_severe_is_said(holes: Laboratory) -> None:
    _, truth = CaseMaker(holes).make(["floor_wedge"], 50.0, seed=3)
    assert truth.amplitudes["floor_wedge"] == known_effects()["floor_wedge"].cap
    assert truth.gap_over_u < 25.0


def test_a_case_is_a_run_and_repeats(holes: Laboratory, tmp_path: Path) -> None:
    from instrument.run_read import read_run
    from sim_fixtures.examples.files import write_packed

    maker = CaseMaker(holes)
    run, truth = maker.make({"gain_step": {"fraction": 0.01}}, seed=9, noise_family="slice", nuisance=0.5)
    again, _ = maker.make({"gain_step": {"fraction": 0.01}}, seed=9, noise_family="slice", nuisance=0.5)
    other, _ = maker.make({"gain_step": {"fraction": 0.01}}, seed=10, noise_family="slice", nuisance=0.5)
    assert np.array_equal(run["signal"], again["signal"])
    assert not np.array_equal(run["signal"], other["signal"])
    assert truth.effects == {"gain_step": {"fraction": 0.01}}
    write_packed(run, tmp_path / "run.nc")
    back = read_run(tmp_path / "run.nc")
    assert back["brf"].values == pytest.approx(run["brf"].values)
    assert run["signal"].shape == (len(holes.plan), 9)
    quiet = replace(holes, plan=replace(holes.plan, samples=9))
    assert quiet.normalisation == pytest.approx(holes.normalisation)
