"""The tracer against independent programs: reference runs and the example cases beside the checkout."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from traced_samples import artifact, columns_of, facility, flat, not_retroreflection, reference_run, shared_file

from instrument.dataset import read_run
from twin.artifact import SurfaceMesh, build_mesh, square_pit
from twin.material import Material, lambertian, read_material
from twin.optics import Setup, lay_out
from twin.prediction import Twin
from twin.tracer import Tracer, mean_and_error

DESIGN_PHASE = facility("unbounded", shape="horizontal_disc")
#: The references' light comes from a point 2 m away.
POINT_SOURCE = Setup(source_distance_mm=2000.0)


def trace(
    mesh: SurfaceMesh, material: Material, instrument: Any, run: xr.Dataset, samples: int, setup: Setup | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance factors over the reference's own L_ref, and their standard errors."""
    layout = lay_out(instrument, columns_of(run), setup)
    values = Tracer(mesh, material).radiance(layout, np.zeros(len(layout), int), samples, seed=20)
    lambert = np.pi * run.L_ref.values if "L_ref" in run else np.cos(np.deg2rad(run.theta_ill.values))
    values = values / lambert[:, None]
    return mean_and_error(values)


def assert_agree(value: np.ndarray, error: np.ndarray, run: xr.Dataset) -> None:
    """Chi-square per point between 0.8 and 1.25; mean ratio within three of its standard errors."""
    use = (run.R_se.values > 0) & not_retroreflection(run)
    reference, reference_error = run.R.values[use], run.R_se.values[use]
    value, error = value[use], error[use]
    variance = error**2 + reference_error**2
    chi_square = np.mean((value - reference) ** 2 / variance)
    ratio = np.mean(value / reference)
    ratio_error = np.sqrt(np.sum(variance / reference**2)) / len(value)
    assert 0.8 <= chi_square <= 1.25
    assert abs(ratio - 1) <= 3 * ratio_error


@pytest.mark.slow
def test_artifact_with_the_quasi_diffuse_table() -> None:
    run = reference_run("artifact_qdfix_tophat_llvm.nc")
    table = read_material(shared_file("reference", "table_brdf.nc"))
    value, error = trace(build_mesh(artifact()), table, facility(), run, 4096, POINT_SOURCE)
    assert_agree(value, error, run)
    use = not_retroreflection(run)
    assert np.mean(value[use] / run.R.values[use]) == pytest.approx(1.0, abs=5e-4)


def test_lambertian_artifact_in_the_design_phase() -> None:
    run = reference_run("artifact_lamb05_ideal_hdisk.nc")
    assert_agree(*trace(build_mesh(artifact()), lambertian(0.5), DESIGN_PHASE, run, 2048), run)


def test_lambertian_reference_surface() -> None:
    run = reference_run("flat_lamb1_tophat.nc")
    assert_agree(*trace(build_mesh(flat()), lambertian(1.0), facility(), run, 2048, POINT_SOURCE), run)


def test_square_pit() -> None:
    run = reference_run("pit_lamb05_ideal.nc")
    aperture = facility("unbounded", shape="horizontal_disc", target=10.0)
    pit = square_pit(50.0, 10.0, 10.0)
    assert_agree(*trace(pit, lambertian(0.5), aperture, run, 2048, Setup(square_target=True)), run)


def test_flat_sample_with_the_quasi_diffuse_table() -> None:
    run = reference_run("flat_qd_ideal.nc")
    table = read_material(shared_file("reference", "table_brdf.nc"))
    value, _ = trace(build_mesh(flat()), table, DESIGN_PHASE, run, 1)
    np.testing.assert_allclose(value, run.R.values, rtol=1e-5)


@pytest.fixture(scope="module")
def common_twin() -> Twin:
    folder = shared_file("cases", "common", "facility.toml").parent
    return Twin.from_files(folder / "facility.toml", folder / "artifact.toml", folder / "material.nc")


def rms_t(twin: Twin, case: str) -> float:
    run = read_run(shared_file("cases", "dev", f"{case}.nc"))
    prediction = twin.predict(run, standard_error=0.003)
    gap = (prediction.brf - run.brf) / np.hypot(run.u_brf, prediction.u_brf_monte_carlo)
    return float(np.sqrt((gap**2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("case", ["dev01", "dev02", "dev03", "dev16"])
def test_cases_without_an_unmodelled_effect_agree(common_twin: Twin, case: str) -> None:
    assert 0.85 <= rms_t(common_twin, case) <= 1.4


@pytest.mark.slow
def test_a_case_with_an_unmodelled_effect_does_not(common_twin: Twin) -> None:
    assert rms_t(common_twin, "dev04") > 1.8
