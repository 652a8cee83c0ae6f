"""Effects on the reading against the laboratory that makes sealed cases, which states them by other laws.

A flat sample, noise-free, the reference reading included. What the laws leave open (widths, powers) is fitted; what is
left of the change must be small, and the size must be that which was asked for.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from instrument.facility import read_facility
from instrument.plan import Plan, PlanForm, make_plan
from sim_fixtures.cases import Laboratory, known_effects
from sim_fixtures.cases.readings import clean, light
from sim_fixtures.cases.world import World
from sim_fixtures.examples import example_files
from sim_fixtures.examples.coupon import flat_sample
from sim_fixtures.reality import Coating
from twin.corrections import plan_acquisition
from twin.diagnosis.effects import ReadingEffect, effect
from twin.optics import geometry_columns

ALBEDO = 0.6


@pytest.fixture(scope="module")
def laboratory() -> Laboratory:
    facility = read_facility(Path(example_files().facility))
    grid = {
        "wavelength": [500.0],
        "illumination_zenith": [0.0, 30.0],
        "sensor_azimuth": [0.0, 30.0, 75.0, 120.0],
        "sensor_zenith": [-75.0, -60.0, -45.0, -30.0, -20.0, -10.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0],
    }
    plan: Plan = make_plan(PlanForm.model_validate({"version": 1, "grid": [grid]}), facility, "test")
    return Laboratory(facility, flat_sample(), Coating(base=ALBEDO), plan, 2048)


@pytest.fixture(scope="module")
def nominal(laboratory: Laboratory) -> np.ndarray:
    """Reflectance factors with nothing wrong."""
    return clean(laboratory, World(), light(laboratory, World(), 5)).brf


@pytest.mark.parametrize(
    ("name", "asked", "start", "left"),
    [
        # A penumbra that ends at 20 degrees, against one that falls as a Gaussian.
        ("arm_shadow", {"fraction": 0.15}, (0.1, 8.0), 0.1),
        # A grain that acts on the light as on the view.
        ("anisotropy", {"amplitude": 0.08, "axis_deg": 25.0}, (0.05, 10.0, 2.0, 0.5), 0.05),
        # Fresnel's polarisation of light that leaves the coating.
        ("polarization", {"fraction": 0.1}, (0.05, 0.5), 0.02),
        ("reference_scale", {"ratio": 1.04}, (1.0,), 1e-6),
    ],
)
def test_change_is_that_of_the_simulated_laboratory(
    laboratory: Laboratory,
    nominal: np.ndarray,
    name: str,
    asked: dict[str, float],
    start: tuple[float, ...],
    left: float,
):
    world = known_effects()[name].apply(World(), asked)
    wanted = np.log(clean(laboratory, world, light(laboratory, world, 5)).brf / nominal)
    reading, run = effect(name), plan_acquisition(geometry_columns(laboratory.plan.points), laboratory.facility)
    assert isinstance(reading, ReadingEffect)

    def change(values: np.ndarray) -> np.ndarray:
        return np.log(reading.reading(run, nominal, values) / nominal)

    low, high = np.array([p.cap for p in reading.parameters]).T
    fit = least_squares(lambda values: change(values) - wanted, start, bounds=(low, high), x_scale=high - low)
    assert np.std(wanted) > 0.005 or name == "reference_scale"
    assert np.sqrt(np.mean(fit.fun**2) / np.mean(wanted**2)) < left
    size = next(iter(asked))
    assert fit.x[0] == pytest.approx(asked[size], rel=0.12 if left > 1e-6 else 1e-9)
