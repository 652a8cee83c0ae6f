"""Symmetries of runs of a turned sample: what is equal depends on how it lies, a tilt of it turns with it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from synthetic_runs import grid, observed

from twin.diagnosis.observation import Observation
from twin.diagnosis.parity import Symmetry, equal_pairs, parity
from twin.diagnosis.parity_nadir import at_nadir
from twin.diagnosis.turned import ROTATION, from_sample, of_the_arms

NOISE = 0.001
Columns = dict[str, np.ndarray]


def run_of(angles: tuple[float, ...], change: Callable[[Columns], np.ndarray]) -> Observation:
    """A run at several rotations, with a relative change by the angles in degree that the sample sees."""
    one = grid({0.0: (0.0, 45.0, 90.0, 135.0), 30.0: (0.0, 45.0, 90.0, 135.0)}, 15.0)
    columns = {name: np.tile(column, len(angles)) for name, column in one.items()}
    columns[ROTATION] = np.repeat(angles, len(one["wavelength"]))
    noise = NOISE * np.random.default_rng(4).standard_normal(len(columns[ROTATION]))
    brf = 0.5 * (1 + change(from_sample(columns)) + noise)
    components = {"noise": NOISE * brf, "stability": 0.001 * brf}
    return Observation("run", np.arange(len(brf)), columns, brf, 2 * NOISE * brf, components)


def of_a_square_lattice(seen: Columns) -> np.ndarray:
    sine = np.sin(np.deg2rad(seen["sensor_zenith"])) ** 2
    return 0.05 * sine * np.cos(np.deg2rad(4 * seen["sensor_azimuth"]))


@pytest.mark.parametrize("angle", [30.0, 45.0, 90.0, -90.0, 180.0, 360.0])
def test_a_square_lattice_keeps_its_symmetry_however_it_is_turned(angle: float):
    assert not parity(run_of((0.0, angle), of_a_square_lattice)).broken


@pytest.mark.parametrize(
    ("symmetry", "angle", "alike"),
    [
        ("isotropic", 35.0, True),
        ("fourfold", 35.0, False),
        ("fourfold", -90.0, True),
        ("twofold", 90.0, False),
        ("twofold", 180.0, True),
        ("mirror", 180.0, False),
        ("mirror", 360.0, True),
    ],
)
def test_what_a_turn_leaves_alike_is_compared(symmetry: Symmetry, angle: float, alike: bool):
    run = run_of((0.0, angle), of_a_square_lattice)
    pairs = equal_pairs(run, symmetry=symmetry)
    assert np.any(run.columns[ROTATION][pairs[:, 0]] != run.columns[ROTATION][pairs[:, 1]]) == alike


def test_a_tilt_of_a_turned_sample_has_its_axis_in_the_sample():
    def tilted(seen: Columns) -> np.ndarray:
        zenith, azimuth = np.deg2rad(seen["sensor_zenith"]), np.deg2rad(seen["sensor_azimuth"])
        return -np.deg2rad(0.8) * np.tan(zenith) * np.sin(azimuth)

    found = parity(run_of((90.0, 180.0), tilted))
    assert found.broken
    assert found.terms[0].name == "tilt about x"
    assert found.terms[0].amplitude == pytest.approx(0.8, abs=0.05)


def test_light_from_all_around_keeps_its_side_where_hands_turn_the_sample():
    """At the sensor's zenith 0 the arm comes from either side; the light falls on another side of the sample."""
    azimuth = np.arange(-150.0, 180.0, 30.0)
    same = np.ones(len(azimuth))
    plan = {
        "wavelength": 500 * same,
        "illumination_zenith": 40 * same,
        "illumination_azimuth": azimuth,
        "sensor_zenith": 0 * same,
        "sensor_azimuth": 0 * same,
    }
    run = observed(of_the_arms(plan, np.zeros(len(azimuth))))
    run = Observation(
        "run", run.rows, run.columns, 0.5 * (1 + 0.01 * np.sin(np.deg2rad(azimuth))), run.u_brf, run.components
    )
    (found,) = at_nadir(run, np.zeros(0, dtype=np.int64))
    assert found.amplitude == pytest.approx(0.01, rel=1e-6)
