"""Runs of a turned sample: what stays with the arms and what turns with the sample."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from synthetic_runs import grid, nominal, observed
from traced_samples import columns, facility, flat

from instrument.angles import direction
from instrument.events import Geometry
from instrument.facility import read_facility
from instrument.turning import driven
from sim_fixtures.examples import example_files
from sim_fixtures.examples.coupon import flat_sample
from sim_fixtures.reality import Imperfections, Reality
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.covariance import smooth_gap
from twin.diagnosis.effects import ReadingEffect, effect
from twin.diagnosis.fit import fit_single
from twin.diagnosis.joint import join, joined
from twin.diagnosis.observation import Observation, observe, read_observation
from twin.diagnosis.plausible import flat_reflectance
from twin.diagnosis.preparation import Bench, Inputs, model_error
from twin.diagnosis.problem import Problem
from twin.diagnosis.renders import RenderStore
from twin.diagnosis.report_figures import illuminations
from twin.diagnosis.response import AnyResponse
from twin.diagnosis.responses import responses
from twin.diagnosis.turned import ROTATION, arm_columns, from_sample
from twin.diagnosis.where import regions
from twin.diagnosis.workbench import Workbench
from twin.material import lambertian

ZENITH = np.array([65.0, 40.0, 20.0, -20.0, -40.0, -65.0])
PLANE = columns(30.0, ZENITH, 0.0)


def run_file(where: dict[str, np.ndarray]) -> xr.Dataset:
    brf = nominal(where)
    values = where | {"brf": brf, "u_brf": 0.01 * brf}
    units = {"wavelength": "nm", "brf": "1", "u_brf": "1"}
    return xr.Dataset({name: ("point", v, {"units": units.get(name, "degree")}) for name, v in values.items()})


def turned(where: dict[str, np.ndarray], angle: float) -> dict[str, np.ndarray]:
    return where | {ROTATION: np.full(len(where["sensor_zenith"]), angle)}


def taken(where: dict[str, np.ndarray]) -> Acquisition:
    count = len(where["sensor_zenith"])
    order = np.arange(count)
    previous = np.concatenate([order[:1], order[:-1]])
    azimuth = np.array([0.0, 45.0, 90.0, 135.0])
    return Acquisition(where, np.ones(count), 15.0, azimuth, previous, travel_direction(where, order))


def reading(name: str, where: dict[str, np.ndarray], *values: float) -> np.ndarray:
    """Relative change of a reading by an effect that needs no ray."""
    found = effect(name)
    assert isinstance(found, ReadingEffect)
    run = taken(where)
    return found.reading(run, np.full(len(run), 0.5), np.array(values)) / 0.5 - 1


def response(name: str, where: dict[str, np.ndarray], bench: Workbench) -> AnyResponse:
    run = taken(where)
    store = RenderStore(bench, None)
    return responses(run, np.full(len(run), 0.5), store, effects=[effect(name)]).found[name]


def test_a_turned_run_keeps_the_angles_of_the_arms_and_says_how_far_it_was_turned():
    run = observe(run_file(turned(grid({30.0: (0.0, 90.0)}), 90.0)), "run.nc")
    assert set(run.columns["sensor_azimuth"]) == {0.0, 90.0}
    np.testing.assert_array_equal(run.columns[ROTATION], 90.0)
    seen = from_sample(run.columns)
    np.testing.assert_array_equal(seen["illumination_azimuth"], 270.0)
    assert set(seen["sensor_azimuth"]) == {270.0, 0.0}


def test_a_run_that_was_not_turned_says_nothing_of_it():
    run = observe(run_file(turned(grid({30.0: (0.0, 90.0)}), 0.0)), "run.nc")
    assert ROTATION not in run.columns
    assert from_sample(run.columns) == run.columns


@pytest.mark.parametrize(("azimuth", "sensor"), [(-90.0, 0.0), (90.0, 75.0), (45.0, 170.0), (-30.0, 180.0)])
def test_an_illumination_azimuth_is_a_sample_turned_the_other_way(azimuth: float, sensor: float):
    """The arms stand where the engine drives them, and the sample sees light and sensor where the plan says."""
    plan = columns(30.0, ZENITH, sensor, azimuth)
    found = arm_columns(run_file(plan))
    np.testing.assert_array_equal(found["illumination_azimuth"], 0.0)
    np.testing.assert_array_equal(found[ROTATION], -azimuth)
    for number in range(len(ZENITH)):
        point = Geometry(**{name: float(column[number]) for name, column in plan.items()})
        _, *arms = driven(point)
        assert [found["sensor_azimuth"][number], found["sensor_zenith"][number]] == arms
    seen = from_sample(found)
    for zenith, angle in (("illumination_zenith", "illumination_azimuth"), ("sensor_zenith", "sensor_azimuth")):
        np.testing.assert_allclose(
            direction(seen[zenith], seen[angle]), direction(plan[zenith], plan[angle]), atol=1e-12
        )


def test_anisotropy_changes_its_sign_in_a_sample_turned_by_a_right_angle_and_polarisation_does_not():
    above = columns(0.0, ZENITH, 0.0)
    quarter = turned(above, 90.0)
    sine = np.sin(np.deg2rad(ZENITH)) ** 2
    np.testing.assert_allclose(reading("anisotropy", above, 0.04, 0.0, 2.0, 1.0), 0.04 * sine)
    np.testing.assert_allclose(reading("anisotropy", quarter, 0.04, 0.0, 2.0, 1.0), -0.04 * sine)
    np.testing.assert_allclose(reading("polarization", quarter, 0.04, 0.0), reading("polarization", above, 0.04, 0.0))


@pytest.mark.parametrize("angle", [90.0, -35.0])
def test_a_grained_coating_that_is_turned_reads_as_another_program_says(angle: float):
    """Light comes along the grain or across it: that changes readings as the view's azimuth does."""
    known, grain, axis = read_facility(example_files().facility), 0.04, 20.0
    where = columns(45.0, ZENITH, 60.0)

    def seen(rotation_deg: float, **coating: float) -> np.ndarray:
        exact = Imperfections()
        wrong = replace(exact, coating=replace(exact.coating, **coating))
        reality = Reality(known, flat_sample(), wrong, 5, rays=4096)
        return np.array([reality.flux("sample", 45.0, z, 60.0, 500.0, rotation_deg) for z in ZENITH])

    plain = seen(0.0)
    np.testing.assert_allclose(seen(angle), plain, rtol=1e-3)
    spoiled = {"grain": grain, "grain_axis_deg": axis}
    for rotation_deg in (0.0, angle):
        wanted = np.log(seen(rotation_deg, **spoiled) / plain)
        found = np.log1p(reading("anisotropy", turned(where, rotation_deg), grain, axis, 2.0, 1.0))
        assert np.abs(wanted).max() > 0.01
        np.testing.assert_allclose(found, wanted, atol=2e-3)


@pytest.mark.parametrize(
    ("name", "values"),
    [("cable_torsion", (0.02, 0.01)), ("ghost", (0.05, 30.0, 45.0, 12.0)), ("arm_shadow", (0.1, 8.0))],
)
def test_what_belongs_to_the_arms_does_not_ask_how_the_sample_lies(name: str, values: tuple[float, ...]):
    where = columns(30.0, ZENITH, 50.0)
    found = reading(name, turned(where, 35.0), *values)
    assert np.abs(found).max() > 5e-5
    np.testing.assert_array_equal(found, reading(name, where, *values))


def test_an_axis_in_the_sample_turns_with_it():
    """Turned by R, an axis at a looks like one at a + R."""
    where = columns(0.0, ZENITH, 50.0)
    found = reading("anisotropy", turned(where, 35.0), 0.04, 20.0, 2.0, 1.0)
    np.testing.assert_allclose(found, reading("anisotropy", where, 0.04, 55.0, 2.0, 1.0), atol=1e-15)


@pytest.fixture(scope="module")
def flat_bench() -> Workbench:
    """A narrow beam inside a wide field of view."""
    return Workbench(facility(4.0, target=40.0), flat(), lambertian(0.6), samples=1)


def test_a_tilt_turns_with_the_sample_and_a_zero_of_the_arm_does_not(flat_bench: Workbench):
    """Half a turn makes a tilt towards one side one towards the other; the arm knows nothing of it."""
    half = turned(PLANE, 180.0)
    tilt, back = (response("sample_tilt", where, flat_bench) for where in (PLANE, half))
    values = np.array([[0.3, 0.6, 12.0], [0.0, -0.9, -20.0]])
    opposite = values * [-1.0, -1.0, 1.0]
    np.testing.assert_allclose(back.log_ratio(values), tilt.log_ratio(opposite), atol=1e-6)
    assert np.abs(tilt.log_ratio(values)).max() > 0.01
    zero, same = (response("sensor_zenith_offset", where, flat_bench) for where in (PLANE, half))
    np.testing.assert_allclose(same.log_ratio(np.array([[0.7]])), zero.log_ratio(np.array([[0.7]])), atol=1e-6)


def test_a_quarter_of_a_turn_makes_a_tilt_about_x_one_about_y(flat_bench: Workbench):
    tilt, quarter = (response("sample_tilt", where, flat_bench) for where in (PLANE, turned(PLANE, 90.0)))
    # The sample's x axis points along the laboratory's y.
    np.testing.assert_allclose(
        quarter.log_ratio(np.array([[0.8, 0.0, 9.0]])), tilt.log_ratio(np.array([[0.0, 0.8, 9.0]])), atol=1e-4
    )


@pytest.mark.parametrize("angle", [90.0, 35.0])
def test_the_beam_stays_in_the_laboratory(angle: float):
    """A flat sample looks the same however it is turned: so must a beam that is displaced, at any angle."""
    bench = Workbench(facility(4.0, target=5.0), flat(), lambertian(0.6), samples=1)
    where = columns(30.0, ZENITH[:3], 50.0)
    along, across = np.array([[1.4, 0.0]]), np.array([[0.0, 1.4]])
    still, seen = response("beam_offset", where, bench), response("beam_offset", turned(where, angle), bench)
    assert np.abs(still.log_ratio(along) - still.log_ratio(across)).max() > 0.02
    for values in (along, across, np.array([[-0.7, 1.4]])):
        np.testing.assert_allclose(seen.log_ratio(values), still.log_ratio(values), atol=2e-3)


def test_points_of_several_rotations_are_each_seen_from_their_own_sample(flat_bench: Workbench):
    still, half = columns(30.0, ZENITH[:2], 50.0), columns(30.0, ZENITH[:2], 50.0)
    both = {name: np.concatenate([still[name], half[name]]) for name in still} | {ROTATION: np.repeat([0.0, 180.0], 2)}
    for name, values in {"beam_offset": [1.0, -0.5], "sample_tilt": [1.0, -0.5, 15.0]}.items():
        found = [response(name, w, flat_bench) for w in (both, still, turned(half, 180.0))]
        together, *apart = (one.log_ratio(np.array([values])) for one in found)
        np.testing.assert_array_equal(together, np.concatenate(apart, axis=1))


def test_slices_of_different_rotations_are_different_planes():
    still, quarter = observed(grid({30.0: (0.0,)})), observed(turned(grid({30.0: (0.0,)}), 90.0))
    together = joined([still, quarter])
    np.testing.assert_array_equal(together.columns[ROTATION], np.repeat([0.0, 90.0], len(still)))
    np.testing.assert_array_equal(together.plane, np.repeat([0, 1], len(still)))


def test_errors_of_the_reflection_model_are_those_of_the_same_directions_seen_from_the_light():
    still = observed(grid({30.0: (0.0, 90.0)}))
    together = joined([still, observed(turned(grid({30.0: (0.0, 90.0)}), 90.0))])
    first, second = np.split(model_error(together), 2)
    np.testing.assert_allclose(first, second, atol=1e-12)


def test_half_of_a_gap_of_unknown_cause_turns_with_the_sample():
    still = columns(0.0, np.array([60.0, 60.0]), np.array([0.0, 90.0]))
    run = observed(still | {ROTATION: np.array([0.0, 90.0])})
    shapes = dict(smooth_gap(run))["local, 8 degrees"]
    # The sample sees both points from the same side, the arms from two.
    np.testing.assert_allclose(shapes, [[1.0, 0.5], [0.5, 1.0]], atol=1e-6)


def test_the_diagnosis_reads_a_turned_run_from_its_file(tmp_path: Path):
    file = tmp_path / "run.nc"
    run_file(turned(grid({30.0: (0.0, 90.0)}), -45.0)).to_netcdf(file, engine="h5netcdf")
    np.testing.assert_array_equal(read_observation(file).columns[ROTATION], -45.0)


def test_a_stain_turns_with_the_sample(flat_bench: Workbench):
    """What lies at (x, y) of the sample is at (-y, x) of the laboratory after a quarter of a turn."""
    where = columns(50.0, np.array([60.0, -60.0]), 0.0)
    x, y, radius = 1.2, 0.5, 1.0
    still, quarter = (response("stain", w, flat_bench) for w in (where, turned(where, 90.0)))
    found = quarter.log_ratio(np.array([[-0.5, x, y, radius]]))
    np.testing.assert_allclose(found, still.log_ratio(np.array([[-0.5, -y, x, radius]])), rtol=1e-6)
    assert np.abs(found - still.log_ratio(np.array([[-0.5, x, y, radius]]))).max() > 1e-3


def test_the_twin_and_its_inputs_are_asked_for_what_the_sample_sees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    files = example_files()
    bench = Bench(Inputs(files.facility, files.artifact, files.material), tmp_path)
    asked: list[xr.Dataset] = []

    def predicted(self: object, where: xr.Dataset, **options: float) -> xr.Dataset:
        asked.append(where)
        return where.assign(brf=0.5 + 0 * where["sensor_zenith"], u_brf_monte_carlo=0 * where["sensor_zenith"])

    def found(state: object, where: xr.Dataset, **options: object) -> SimpleNamespace:
        asked.append(where)
        return SimpleNamespace(result=None)

    monkeypatch.setattr("twin.prediction.Twin.predict", predicted)
    monkeypatch.setattr("twin.diagnosis.preparation.find_input_uncertainty", found)
    run = observed(turned(columns(30.0, ZENITH, 50.0), 90.0))
    bench.nominal(run)
    bench.input_errors(run)
    assert len(asked) == 2
    for where in asked:
        np.testing.assert_array_equal(where["sensor_azimuth"], 320.0)
        np.testing.assert_array_equal(where["illumination_azimuth"], 270.0)
        assert ROTATION not in where


def test_a_turn_of_the_sample_begins_another_slice():
    """The arm goes down twice, and back up between: its first point counts as arriving the way the slice goes on."""
    two = columns(30.0, np.tile([60.0, 0.0, -60.0], 2), 50.0) | {ROTATION: np.repeat([0.0, 90.0], 3)}
    np.testing.assert_array_equal(travel_direction(two, np.arange(6)), -1.0)


def test_where_a_run_differs_is_said_with_the_rotation_of_the_sample():
    still = grid({30.0: (0.0, 90.0)}, 10.0)
    both = joined([observed(still), observed(turned(still, 90.0))])
    gap = np.where((both.columns[ROTATION] == 90) & (both.columns["sensor_zenith"] > 30), 0.05, 0.0)
    (found,) = regions(both, gap)
    assert found.description.endswith("every azimuth, illumination zenith 30 degrees, sample turned by 90 degrees")
    assert set(both.columns[ROTATION][found.points]) == {90.0}
    assert [title for title, _ in illuminations(both)] == ["illumination 30 deg", "illumination 30 deg, turned 90"]


PLANES = (0.0, 90.0)
RIVALS = ("anisotropy", "polarization")


@pytest.fixture(scope="module")
def coupon_bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Of a flat sample: nothing is traced that takes time."""
    files = example_files()
    return Bench(Inputs(files.facility, files.artifact, files.material), tmp_path_factory.mktemp("cache")).flat()


def of_the_laboratory(bench: Bench, wrong: Imperfections, angle: float, seed: int) -> Observation:
    """A run of the simulated laboratory, which shares no physics with the twin, with noise and an error of scale."""
    zenith = np.arange(70.0, -71.0, -20.0)
    where = columns(30.0, np.tile(zenith, 2), np.repeat(PLANES, len(zenith)))
    free = (where["sensor_azimuth"] != 0) | (where["sensor_zenith"] != 30)
    where = {name: column[free] for name, column in where.items()} | {ROTATION: np.full(np.sum(free), angle)}
    good, bad = (Reality(bench.facility, flat_sample(), one, 5, rays=2048) for one in (Imperfections(), wrong))
    arms = list(zip(where["sensor_zenith"], where["sensor_azimuth"], strict=True))
    ratio = np.array([bad.flux("sample", 30.0, *a, 500.0, angle) / good.flux("sample", 30.0, *a) for a in arms])
    count = len(arms)
    u = {"noise": 0.004, "stability": 0.004, "reference": 0.005}
    run = Observation("run", np.arange(count), where, np.ones(count), np.ones(count), {}, 22.0 * np.arange(count))
    draw = np.random.default_rng(seed)
    errors = 0.004 * draw.standard_normal(count) + 0.003 * draw.standard_normal()
    brf = flat_reflectance(bench.material, run) * ratio * np.exp(errors)
    components = {name: size * brf for name, size in u.items()}
    return replace(run, brf=brf, u_brf=np.sqrt(sum(size**2 for size in u.values())) * brf, components=components)


def evidence(problem: Problem) -> list[float]:
    """Logarithmic evidence of the rivals."""
    return [fit_single(problem.component(name), problem.residual, problem.members).log_evidence for name in RIVALS]


@pytest.mark.slow
@pytest.mark.parametrize("right", [0, 1])
def test_a_turned_sample_tells_anisotropy_from_polarisation(coupon_bench: Bench, right: int):
    exact = Imperfections()
    grained = replace(exact, coating=replace(exact.coating, grain=0.03, grain_axis_deg=0.0))
    wrong = (grained, replace(exact, polarization=0.03))[right]
    effects = [effect(name) for name in RIVALS]
    parts = [
        coupon_bench.prepare(of_the_laboratory(coupon_bench, wrong, angle, seed), effects=effects)
        for seed, angle in enumerate((0.0, 90.0))
    ]
    alone = evidence(parts[0].problem)
    assert abs(alone[0] - alone[1]) < 2
    together = evidence(join(parts, np.zeros((len(parts[0].problem.run) * 2, 1))).problem)
    assert together[right] - together[1 - right] > 15
