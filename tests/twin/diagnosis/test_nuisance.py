"""What the budget allows: columns by stated uncertainties and rows, with their quadratic parts."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_runs import SCALE, Formula, Parameter, grid, observed

from twin.diagnosis.nuisance import ROWS, STATED, budget_columns
from twin.diagnosis.observation import Observation

COLUMNS = grid({0.0: (0.0, 90.0), 30.0: (0.0, 60.0)}, 10.0)
COUNT = len(COLUMNS["wavelength"])
PATTERN = np.linspace(-1.0, 1.0, COUNT)


def run(**rows: float) -> Observation:
    """A run whose budget states some more rows, relative."""
    sound = observed(COLUMNS)
    added = {name: size * sound.brf for name, size in rows.items()}
    return Observation(**(vars(sound) | {"components": sound.components | added}))


def bent(budget: float = 0.0, cap: tuple[float, float] = (-9.0, 9.0), quadratic: float = 0.0) -> Formula:
    """Logarithm PATTERN x + quadratic x^2."""
    parameters = (Parameter("x", 1.0, cap, budget=budget),)
    return Formula("bent", parameters, lambda v: v[:, :1] * PATTERN + quadratic * v[:, :1] ** 2)


def test_stated_uncertainty_is_the_size_of_a_column():
    columns = budget_columns({STATED[0]: bent(0.03)}, run())
    np.testing.assert_allclose(columns[f"{STATED[0]} x"], 0.03 * PATTERN, atol=1e-12)


def test_effect_without_a_stated_uncertainty_has_no_column():
    assert set(budget_columns({STATED[0]: bent(0.0)}, run())) == {"scale"}


def test_effect_that_is_no_input_of_the_budget_has_no_column():
    assert set(budget_columns({"source_drift": bent(0.03)}, run())) == {"scale"}


@pytest.mark.parametrize(("row", "name"), [(row, names[0]) for row, names in ROWS.items()])
def test_row_of_the_budget_bounds_a_column(row: str, name: str):
    columns = budget_columns({name: bent(5.0)}, run(**{row: 0.004}))
    assert np.sqrt(np.mean(columns[f"{name} x"] ** 2)) == pytest.approx(0.004, rel=1e-6)


@pytest.mark.parametrize(("row", "name"), [(row, names[0]) for row, names in ROWS.items()])
def test_stated_uncertainty_smaller_than_the_row_counts(row: str, name: str):
    columns = budget_columns({name: bent(1e-3)}, run(**{row: 0.004}))
    np.testing.assert_allclose(columns[f"{name} x"], 1e-3 * PATTERN, atol=1e-12)


def test_quadratic_part_has_the_variance_of_a_squared_normal():
    sigma, curve = 0.05, 2.0
    columns = budget_columns({STATED[0]: bent(sigma, quadratic=curve)}, run())
    np.testing.assert_allclose(columns[f"{STATED[0]} x"], sigma * PATTERN, atol=1e-12)
    # Of curve x^2, x normal with standard deviation sigma: sqrt(2) curve sigma^2.
    np.testing.assert_allclose(columns[f"{STATED[0]} x, quadratic"], np.sqrt(2) * curve * sigma**2, rtol=1e-9)


def test_column_at_a_cap_is_linear():
    columns = budget_columns({STATED[0]: bent(0.05, cap=(0.0, 9.0), quadratic=2.0)}, run())
    assert set(columns) == {f"{STATED[0]} x", "scale"}


def test_parameter_of_shape_has_no_column():
    effect = Formula(
        STATED[0],
        (Parameter("x", 1.0, (-9, 9), budget=0.05), Parameter("power", 1.0, (0, 2), shape=True, budget=0.1)),
        lambda v: v[:, :1] * PATTERN,
    )
    assert {name for name in budget_columns({STATED[0]: effect}, run()) if "power" in name} == set()


def test_scale_is_that_of_reference_and_wavelength_together():
    np.testing.assert_allclose(budget_columns({}, run())["scale"], SCALE)
    np.testing.assert_allclose(budget_columns({}, run(wavelength=0.012))["scale"], np.hypot(SCALE, 0.012))


def test_scale_of_a_run_that_states_none_is_half_a_per_cent():
    plain = observed(COLUMNS, components=False)
    np.testing.assert_allclose(budget_columns({}, plain)["scale"], 0.005)
