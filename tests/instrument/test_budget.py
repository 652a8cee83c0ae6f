"""The uncertainty budget against Table II of the paper and against files that others made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from example_runs import SHARED, facility

from instrument.budget import COMPONENTS, combined, point_budget
from instrument.dataset import read_run
from instrument.facility import Budget, read_facility

CASES = sorted((SHARED / "cases" / "dev").glob("*.nc")) if (SHARED / "cases").exists() else []


def relative(illumination_zenith: float, sensor_zenith: float) -> dict[str, float]:
    parts = point_budget(facility().budget, [illumination_zenith], [sensor_zenith], [1.0])
    return {name: float(values[0]) for name, values in parts.items()}


def test_components_have_the_names_of_the_data_contract_in_the_order_of_table_ii() -> None:
    assert list(relative(0, 0)) == [
        "u_brf_noise",
        "u_brf_stability",
        "u_brf_wavelength",
        "u_brf_straylight",
        "u_brf_linearity",
        "u_brf_placement",
        "u_brf_illumination_zenith",
        "u_brf_sensor_zenith",
        "u_brf_sensor_azimuth",
        "u_brf_surface_level",
        "u_brf_polarization",
        "u_brf_reference",
    ]
    assert set(COMPONENTS) == set(Budget.model_fields)


@pytest.mark.parametrize(
    ("name", "geometry", "expected"),
    [
        # Quadratic: half way out in sensor zenith is a quarter of the way from best to worst.
        ("u_brf_noise", (0, 40), 0.0051 + 0.0019 / 4),
        ("u_brf_noise", (0, -80), 0.0070),
        ("u_brf_sensor_zenith", (30, 40), 0.0010 + 0.0042 / 4),
        ("u_brf_sensor_azimuth", (0, 20), 0.0020 + 0.0038 / 16),
        # Linear in sensor zenith, and in illumination zenith.
        ("u_brf_linearity", (0, 40), 0.0014),
        ("u_brf_linearity", (60, -20), 0.0012),
        ("u_brf_illumination_zenith", (30, 80), 0.0021 + 0.0017 / 2),
        ("u_brf_illumination_zenith", (-30, 0), 0.0021 + 0.0017 / 2),
        # One number holds everywhere.
        ("u_brf_stability", (60, 80), 0.0082),
        ("u_brf_reference", (0, 0), 0.0050),
    ],
)
def test_pairs_run_from_best_to_worst(name: str, geometry: tuple[float, float], expected: float) -> None:
    assert relative(*geometry)[name] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("geometry", "percent"), [((0, 0), 1.16), ((60, 80), 1.50)])
def test_the_budget_closes_on_the_papers_combined_uncertainty(geometry: tuple[float, float], percent: float) -> None:
    parts = point_budget(facility().budget, [geometry[0]], [geometry[1]], [1.0])
    assert 100 * combined(parts)[0] == pytest.approx(percent, abs=0.0055)


def test_combined_is_the_root_of_the_sum_of_squares() -> None:
    assert combined({"a": [3.0, 1.0], "b": [4.0, 0.0]}).tolist() == [5.0, 1.0]


def test_components_scale_with_the_reflectance_factor_and_are_never_negative() -> None:
    one, many = relative(15, 50), point_budget(facility().budget, 15.0, [50.0, 50.0], [0.4, -0.02])
    for name, values in many.items():
        assert values == pytest.approx([0.4 * one[name], 0.02 * one[name]])


@pytest.mark.skipif(not CASES, reason="../shared/cases is not there")
@pytest.mark.parametrize("path", CASES[::8], ids=lambda path: Path(path).stem)
def test_components_of_files_of_another_program_come_out_the_same(path: Path) -> None:
    run = read_run(path)
    budget = read_facility(SHARED / "cases" / "common" / "facility.toml").budget
    parts = point_budget(budget, run["illumination_zenith"].values, run["sensor_zenith"].values, run["brf"].values)
    for name, values in parts.items():
        np.testing.assert_allclose(values, run[name].values, rtol=1e-12)
    np.testing.assert_allclose(combined(parts), run["u_brf"].values, rtol=1e-12)
