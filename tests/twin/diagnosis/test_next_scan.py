"""What a next scan is expected to say: against closed forms, and against what such a scan must be able to tell."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import quad
from synthetic_runs import Formula, Parameter, grid, nominal, observed

from instrument.errors import InputError
from instrument.facility import Facility, read_facility
from instrument.forms import parse_form, parse_toml
from instrument.plan import PlanForm, make_plan
from sim_fixtures.examples import example_files
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.covariance import Structure
from twin.diagnosis.followup import ranked, write_plans
from twin.diagnosis.next_explanations import Explanation, entropy, known_of
from twin.diagnosis.next_information import Outlook
from twin.diagnosis.next_plan import duration_of, plan_columns, plan_text
from twin.diagnosis.next_scans import TURNED, Scan, between, other_geometries, scans, thinned, turned_geometries
from twin.diagnosis.next_stage import Stage, read_again, taken_again
from twin.diagnosis.problem import Problem
from twin.diagnosis.turned import ROTATION, alike, of_the_arms, rotation
from twin.optics import geometry_columns, sample_rotation

PLANES = {30.0: (0.0, 90.0)}
NOISE = 0.006
TRAVEL = (0.0, 180.0)


@dataclass(frozen=True)
class Anywhere(Formula):
    """An effect that knows itself in other scans: its size times the arm's direction of travel, or everywhere alike."""

    turns: bool = False

    def again(self, run: Acquisition, rows: np.ndarray) -> Anywhere:
        way = run.travel if self.turns else np.ones(len(rows))
        return replace(self, function=lambda values: values[:, :1] * way)


def constant(name: str, *, turns: bool = False, count: int = 0) -> Anywhere:
    """The logarithm of the reading moves by the parameter; a run from + to - travels in the direction -1."""
    way = -1.0 if turns else 1.0
    parameters = (Parameter("amount", 0.02, (-0.3, 0.3)),)
    return Anywhere(name, parameters, lambda values: values[:, :1] * np.full(count, way), turns=turns)


def stage(library: list[Anywhere]) -> tuple[Problem, Stage]:
    """A run whose errors are noise alone, and itself as the geometries of the next scan."""
    columns = grid(PLANES, 20.0)
    expected = nominal(columns)
    run = replace(observed(columns), components={"noise": NOISE * expected, "stability": np.zeros(len(expected))})
    count = len(run)
    nothing = np.zeros((count, 1))
    problem = replace(
        Problem.of(run, expected, np.full(count, 1e-9), nothing, library),
        structures=[Structure("none", 1.0, np.eye(count) * NOISE**2)],
    )
    taken = Acquisition(
        columns, np.ones(count), 15.0, np.zeros(1), np.arange(count), np.full(count, -1.0), np.linspace(0, 1, count)
    )
    responses = {one.name: one for one in library}
    return problem, Stage(run, taken, responses, {}, nothing, np.full(count, 1e-9), count)


def explained(name: str, probability: float, value: float, u: float = 0.0) -> Explanation:
    names = (name,) if name else ()
    values = np.array([value]) if name else np.zeros(0)
    return Explanation(
        names, False, probability, values, np.diag(u**2 * np.ones(len(names))), (1,) * len(names), MEMBER
    )


MEMBER = (((0, None), 1.0),)


def two_normals(apart: float, one: float, other: float | None = None) -> float:
    """Mutual information of a fair choice between two normal distributions of these standard deviations."""
    means, spreads = (0.0, apart), (one, other or one)

    def density(x: float, number: int) -> float:
        return np.exp(-0.5 * ((x - means[number]) / spreads[number]) ** 2) / spreads[number] / np.sqrt(2 * np.pi)

    def term(x: float, number: int) -> float:
        mine = density(x, number)
        return mine * np.log(mine / (0.5 * (density(x, 0) + density(x, 1)))) if mine > 0 else 0.0

    ends = [(m - 9 * s, m + 9 * s) for m, s in zip(means, spreads, strict=True)]
    return 0.5 * sum(quad(term, *ends[number], args=(number,))[0] for number in (0, 1))


@pytest.mark.parametrize("points", [1, 4, 8])
def test_information_about_two_explanations_is_that_of_two_normal_distributions(points: int):
    library = [constant("shift", count=18)]
    problem, here = stage(library)
    size = 0.006
    leading = [explained("shift", 0.5, size), explained("", 0.5, 0.0)]
    # The run itself agrees with both: its readings are left out of what the scan is expected to say.
    worth = Outlook(problem, [here], leading).worth(Scan("", "", np.arange(points)), draws=4000)
    distance = size / NOISE * np.sqrt(points)
    assert worth.information == pytest.approx(two_normals(distance, 1.0), abs=0.015)
    assert worth.gains[0, 1] == pytest.approx(distance**2 / 2, rel=0.1)
    assert worth.gains[1, 0] == pytest.approx(distance**2 / 2, rel=0.1)


@pytest.mark.parametrize("u", [0.0, 0.006, 0.012])
def test_a_parameter_that_the_run_leaves_open_says_less(u: float):
    """All that eight points alike say is in their mean: about 0, or about the parameter, as far as that is known."""
    library = [constant("shift", count=18)]
    problem, here = stage(library)
    leading = [explained("shift", 0.5, 0.006, u), explained("", 0.5, 0.0)]
    found = Outlook(problem, [here], leading).worth(Scan("", "", np.arange(8)), draws=4000).information
    noise = NOISE / np.sqrt(8)
    assert found == pytest.approx(two_normals(0.006, noise, np.hypot(noise, u)), abs=0.015)


def test_only_the_opposite_direction_tells_what_depends_on_the_direction():
    library = [constant("always", count=18), constant("play", turns=True, count=18)]
    problem, here = stage(library)
    leading = [explained("always", 0.5, 0.01), explained("play", 0.5, -0.01)]
    outlook = Outlook(problem, [here], leading)
    found = {scan.kind: outlook.worth(scan) for scan in scans([here])}
    assert found["as it was"].information == pytest.approx(0.0, abs=1e-9)
    assert found["dimmed"].information == pytest.approx(0.0, abs=1e-9)
    assert found["reversed"].information == pytest.approx(np.log(2), abs=0.02)
    assert found["reversed"].right > 0.98
    best, *others = ranked(outlook, read_facility(example_files().facility), 3)
    assert best.scan.kind in ("reversed", "serpentine")
    assert all(one.rate <= best.rate for one in others)
    assert best.separates == (("always", "play"),)
    assert all(one.scan.kind != "as it was" for one in others)


def test_budget_that_run_and_scan_share_does_not_hide_a_difference_in_direction():
    """An error common to both cancels; one that is drawn anew in the scan does not."""
    library = [constant("always", count=18), constant("play", turns=True, count=18)]
    problem, here = stage(library)
    leading = [explained("always", 0.5, 0.01), explained("play", 0.5, -0.01)]
    back = Scan("", "", np.arange(8)[::-1])
    column = np.full(len(problem.run), 0.02)
    # The effect explains a third of what is read; the rest is the error, which the scan has again if it is shared.
    reading = replace(problem, run=replace(problem.run, brf=problem.nominal * np.exp(0.03)))

    def information(label: str) -> float:
        return Outlook(reading, [replace(here, labelled={label: column})], leading).worth(back).information

    assert information("sensor_zenith_offset angle_deg") == pytest.approx(np.log(2), abs=0.03)
    assert information("scale") < 0.4


def test_entropy_bounds_what_a_scan_can_say():
    library = [constant("shift", count=18)]
    problem, here = stage(library)
    leading = [explained("shift", 0.9, 0.1), explained("", 0.1, 0.0)]
    worth = Outlook(problem, [here], leading).worth(Scan("", "", np.arange(8)))
    assert worth.information == pytest.approx(entropy(leading), rel=1e-3)
    assert entropy(leading) == pytest.approx(-0.9 * np.log(0.9) - 0.1 * np.log(0.1))


def test_explanations_by_effects_that_a_stage_does_not_know_are_left_out():
    leading = [explained("a", 0.6, 1.0), explained("b", 0.3, 1.0), explained("", 0.1, 0.0)]
    kept = known_of(leading, ["a"])
    assert [one.label for one in kept] == ["a", "none"]
    assert [one.probability for one in kept] == pytest.approx([6 / 7, 1 / 7])


def test_plans_of_an_earlier_diagnosis_do_not_stay_among_those_of_a_later_one(tmp_path):
    for name in ("plan-1.toml", "plan-12.toml", "plan-mine.toml", "notes.txt"):
        (tmp_path / name).write_text("# Expected information 0.50 nats in 7 min (4.29 nats an hour).\n")
    assert write_plans([], tmp_path) == []
    assert {path.name for path in tmp_path.iterdir()} == {"plan-mine.toml", "notes.txt"}


def test_a_plan_of_a_person_is_neither_replaced_nor_taken_away(tmp_path):
    mine = tmp_path / "plan-2.toml"
    mine.write_text("version = 1\n")
    with pytest.raises(InputError, match=r"plan-2\.toml: is no plan of a diagnosis; expected another folder"):
        write_plans([], tmp_path)
    assert mine.read_text() == "version = 1\n"


def test_nothing_is_proposed_where_one_explanation_is_left():
    problem, here = stage([constant("shift", count=18)])
    assert ranked(Outlook(problem, [here], [explained("shift", 1.0, 0.01)]), None, 3) == []


def test_a_dimmed_scan_has_more_noise_and_less_current():
    _, here = stage([constant("shift", count=18)])
    here = replace(here, acquisition=replace(here.acquisition, reference_current=1e-6))
    rows = np.array([3, 2, 1])
    np.testing.assert_allclose(
        read_again(here, rows, 0.25).components["noise"], 4 * here.observation.components["noise"][rows]
    )
    taken = taken_again(here, rows, 0.25)
    assert taken.reference_current == 0.25e-6
    # The run went down; its points in the opposite order go up.
    np.testing.assert_array_equal(taken.travel, [1, 1, 1])
    np.testing.assert_array_equal(taken.previous, [0, 0, 1])


@pytest.mark.parametrize(
    ("azimuths", "expected"),
    [
        ([0.0, 90.0], [45.0, 135.0]),
        ([0.0, 60.0, 120.0], [30.0, 90.0]),
        ([0.0], [90.0]),
        ([0.0, 45.0, 90.0, 135.0, 180.0], [22.5, 67.5]),
        ([10.0, 100.0], [55.0, 145.0]),
    ],
)
def test_other_planes_lie_in_the_widest_gaps(azimuths: list[float], expected: list[float]):
    assert between(np.array(azimuths), TRAVEL) == expected


def test_other_planes_stay_within_the_travel_of_the_arm():
    assert between(np.array([0.0, 90.0]), (0.0, 100.0)) == [45.0]


def test_other_geometries_are_none_of_the_run_and_none_in_the_shadow():
    arms = read_facility(example_files().facility).arms
    run = observed(grid(PLANES, 10.0))
    found = other_geometries(run, arms)
    rows = {tuple(row) for row in np.stack(list(run.columns.values()), axis=1)}
    assert not rows & {tuple(found[name][k] for name in run.columns) for k in range(len(found["wavelength"]))}
    light, zenith, azimuth = (found[n] for n in ("illumination_zenith", "sensor_zenith", "sensor_azimuth"))
    assert set(light) == {30.0, 45.0, 60.0}
    assert not np.any((azimuth == 0) & (np.abs(zenith - light) < arms.shadow_half_angle))
    assert set(azimuth[light == 30]) == {45.0, 135.0}


def test_long_slices_are_thinned_evenly_and_keep_their_direction():
    zenith = np.arange(80.0, -81.0, -5.0)
    found = thinned(zenith)
    assert len(found) == 17
    assert set(np.diff(found)) == {-10.0}
    assert list(thinned(zenith[::-1])) == list(found[::-1])


def test_plan_has_the_points_of_the_scan_in_their_order(tmp_path):
    facility = read_facility(example_files().facility)
    _, here = stage([constant("shift", count=18)])
    back_and_forth = next(scan for scan in scans([here]) if scan.kind == "serpentine")
    columns = {name: column[back_and_forth.rows] for name, column in here.observation.columns.items()}
    text = plan_text('a "quoted" title', columns, "with a quarter of the light")
    plan = make_plan(parse_form(parse_toml(text, "x"), PlanForm, "x"), facility, "x")
    for name, column in columns.items():
        np.testing.assert_allclose([getattr(point, name) for point in plan.points], column)
    assert plan.title == 'a "quoted" title'
    assert plan.record.remarks == "with a quarter of the light"
    half = plan_text("", {name: column[: len(back_and_forth.rows) // 2] for name, column in columns.items()})
    # What does not grow with the points (homing, reference) is paid once.
    assert duration_of(half, facility) < duration_of(text, facility) < 2 * duration_of(half, facility)


def test_of_many_planes_those_along_and_across_the_plane_of_incidence_are_read_again():
    columns = grid({0.0: (0.0, 45.0, 90.0, 135.0), 30.0: (20.0, 70.0, 120.0)}, 20.0)
    library = [constant("shift", count=len(columns["wavelength"]))]
    run = observed(columns)
    count = len(run)
    taken = Acquisition(columns, np.ones(count), 15.0, np.zeros(1), np.arange(count), np.ones(count))
    here = Stage(run, taken, {one.name: one for one in library}, {}, np.zeros((count, 1)), np.zeros(count), count)
    found = {
        (columns["illumination_zenith"][scan.rows[0]], columns["sensor_azimuth"][scan.rows[0]])
        for scan in scans([here])
    }
    assert found == {(0.0, 0.0), (0.0, 90.0), (30.0, 20.0), (30.0, 70.0)}


def facility_that_turns(**arms: tuple[float, float]) -> Facility:
    known = read_facility(example_files().facility)
    return known.model_copy(update={"arms": known.arms.model_copy(update=arms)})


def planned(columns: dict[str, np.ndarray], facility: Facility) -> dict[str, np.ndarray]:
    """What the arms have at the points of a proposed plan, as a run of it would say."""
    text = plan_text("", plan_columns(columns, facility.arms))
    points = make_plan(parse_form(parse_toml(text, "x"), PlanForm, "x"), facility, "x").points
    assert duration_of(text, facility) > 0
    return of_the_arms(geometry_columns(points), sample_rotation(points))


@pytest.mark.parametrize(
    ("arms", "rotations"),
    [
        ({"sample_rotation": (-180.0, 180.0)}, {90.0, 180.0}),
        ({"sample_rotation": (-100.0, 0.0)}, {-90.0}),
        # Hands turn the sample by minus the azimuth of the light.
        ({"illumination_azimuth": (-90.0, 90.0)}, {-90.0}),
        ({"illumination_azimuth": (-90.0, 0.0)}, {90.0}),
        ({"illumination_azimuth": (0.0, 180.0)}, {-90.0, -180.0}),
        ({}, set()),
    ],
)
def test_a_turned_sample_is_offered_where_stage_or_hands_can_turn_it(arms: dict, rotations: set[float]):
    facility = facility_that_turns(**arms)
    run = observed(grid({30.0: (0.0, 45.0, 90.0)}))
    found = other_geometries(run, facility.arms)
    turned = {name: column[rotation(found) != 0] for name, column in found.items()}
    assert set(rotation(turned)) == rotations
    if rotations:
        # Two slices of eleven points, one of which lies in the shadow.
        assert len(rotation(turned)) == 21 * len(rotations)
        assert np.all(np.sin(np.deg2rad(2 * turned["sensor_azimuth"])) < 1e-9)
        assert set(turned["illumination_zenith"]) == {30.0}
        # The plan, and the run that follows from it, have the arms where the scan was weighed.
        for name, column in planned(turned, facility).items():
            np.testing.assert_allclose(column, turned[name], atol=1e-9)


def test_slices_of_a_turned_sample_are_a_kind_of_their_own_and_say_how_far():
    facility = facility_that_turns(sample_rotation=(-180.0, 180.0))
    _, here = stage([constant("shift", count=18)])
    more = turned_geometries(here.observation, facility.arms, 500.0)
    every = alike([here.observation.columns, *more])
    columns = {name: np.concatenate([part[name] for part in every]) for name in every[0]}
    wide = replace(here, observation=observed(columns))
    found = {scan.description for scan in scans([wide]) if scan.kind == TURNED}
    assert len(found) == 4
    assert any("sensor azimuth 90 degrees, sample turned by 180 degrees (" in text for text in found)


@pytest.mark.parametrize(
    ("known", "expected"),
    [
        ((90.0,), {90.0, 180.0, -90.0}),
        ((0.0, 90.0), {0.0, -90.0, 180.0}),
        # Half a turn the other way is the same half of a turn.
        ((0.0, 180.0), {0.0, 90.0}),
    ],
)
def test_a_run_of_a_turned_sample_is_followed_by_other_rotations(known: tuple[float, ...], expected: set[float]):
    """Other planes at the usual rotation, and slices at those that the run lacks."""
    facility = facility_that_turns(sample_rotation=(-180.0, 180.0))
    columns = grid({30.0: (0.0, 90.0)}, 10.0)
    parts = [columns | {ROTATION: np.full(len(columns["wavelength"]), angle)} for angle in known]
    run = observed({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
    assert set(rotation(other_geometries(run, facility.arms))) == expected
