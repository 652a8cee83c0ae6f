"""Runs of one sample merged: means, the variance between them, and what is common to all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from example_runs import minimal_run
from typer.testing import CliRunner

from instrument.__main__ import build
from instrument.angles import FloatArray
from instrument.dataset import read_run, write_run
from instrument.errors import InputError
from instrument.quality.merge import merge_runs, run_factors
from instrument.run_budget import correlated
from instrument.run_read import capabilities


def run_with(
    brf: FloatArray | list[float],
    noise: float = 0.004,
    stability: float = 0.008,
    reference: float = 0.005,
    **attrs: str,
) -> xr.Dataset:
    """A run with three components: relative noise, stability, and a reference that all runs share."""
    values = np.asarray(brf, dtype=float)
    run = minimal_run(len(values))
    run["brf"] = ("point", values, {"units": "1", "unc_comps": ["u_brf_noise", "u_brf_stability", "u_brf_reference"]})
    for name, relative, form in (
        ("u_brf_noise", noise, "random"),
        ("u_brf_stability", stability, None),
        ("u_brf_reference", reference, "systematic"),
    ):
        run[name] = ("point", relative * values, {"units": "1"} | correlated(form))
    run["u_brf"] = ("point", np.sqrt(noise**2 + stability**2 + reference**2) * values, {"units": "1"})
    run.attrs = dict(attrs)
    return run


def test_two_runs_by_hand() -> None:
    """One geometry would do: 0.99 and 1.01 about 1 with noise 0.004 give tau^2 = 2e-4 - 0.16e-4."""
    merged = merge_runs({"a": run_with([0.99, 1.98]), "b": run_with([1.01, 2.02])})
    assert merged["brf"].values == pytest.approx([1.0, 2.0])
    tau2 = 2e-4 - 0.16e-4
    assert merged.attrs["between_run_standard_deviation"] ** 2 == pytest.approx(tau2, rel=1e-4)
    assert merged["u_brf_noise"].values == pytest.approx([0.004 / np.sqrt(2), 0.008 / np.sqrt(2)], rel=1e-3)
    assert merged["u_brf_stability"].values == pytest.approx([np.sqrt(tau2 / 2), 2 * np.sqrt(tau2 / 2)], rel=1e-3)
    assert merged["u_brf_reference"].values == pytest.approx([0.005, 0.01])
    # With noise the same everywhere the mean's own scatter, s^2/n, comes out of both together.
    scatter = merged["u_brf_noise"] ** 2 + merged["u_brf_stability"] ** 2
    assert scatter.values == pytest.approx([1e-4, 4e-4], rel=1e-3)
    assert merged["u_brf"].values == pytest.approx(np.sqrt(scatter + merged["u_brf_reference"] ** 2))
    assert run_factors(merged) == pytest.approx([0.99, 1.01])


def test_few_runs_leave_few_degrees_of_freedom() -> None:
    """Two runs have one, whatever the number of points; the reference, known exactly, raises the effective number."""
    merged = merge_runs({"a": run_with([0.99, 1.98]), "b": run_with([1.01, 2.02])})
    freedom = (merged["u_brf"] / merged["u_brf_stability"]) ** 4
    assert merged["brf_effective_degrees_of_freedom"].values == pytest.approx(freedom.values)
    assert merged["brf_coverage_factor"].values[0] > 3
    expanded = merged["brf_coverage_factor"] * merged["u_brf"]
    assert merged["brf_expanded_uncertainty"].values == pytest.approx(expanded.values)


def test_runs_that_differ_by_no_more_than_noise_leave_no_uncertainty_of_remounting() -> None:
    runs = {"a": run_with([1.0, 2.0], noise=0.01), "b": run_with([1.001, 2.001], noise=0.01)}
    found, stated, larger = (merge_runs(runs, stability=s) for s in ("found", "stated", "larger"))
    assert found["u_brf_stability"].values.tolist() == [0.0, 0.0]
    expected = 0.008 / np.sqrt(2) * stated["brf"].values
    assert stated["u_brf_stability"].values == pytest.approx(expected, rel=1e-3)
    assert larger["u_brf_stability"].values == pytest.approx(expected, rel=1e-3)
    assert np.isinf(larger["brf_effective_degrees_of_freedom"].values).all()


def test_remounting_comes_back_from_simulated_runs() -> None:
    """Five runs of 400 points: 0.8 % between them at every point, 0.5 % of noise, 0.3 % common to all."""
    rng = np.random.default_rng(5)
    true = rng.uniform(0.3, 0.7, 400)
    common = 1 + 0.003 * rng.standard_normal()
    runs = {}
    for name in "abcde":
        read = true * common * (1 + 0.008 * rng.standard_normal(400)) * (1 + 0.005 * rng.standard_normal(400))
        runs[name] = run_with(read, noise=0.005)
    merged = merge_runs(runs)
    assert merged.attrs["between_run_standard_deviation"] == pytest.approx(0.008, rel=0.06)
    random = np.hypot(merged["u_brf_noise"], merged["u_brf_stability"]).values
    # chi^2 of 400 points: within four of its standard deviations.
    chi2 = np.sum(((merged["brf"].values - common * true) / random) ** 2)
    assert chi2 == pytest.approx(400, abs=4 * np.sqrt(800))
    other = merge_runs(runs, method="dersimonian-laird")
    assert other.attrs["between_run_standard_deviation"] == pytest.approx(0.008, rel=0.06)


def test_points_of_one_run_alone_are_kept_as_uncertain_as_one_run() -> None:
    short = run_with([0.99, 1.98, 2.97]).isel(point=[0, 1])
    merged = merge_runs({"a": run_with([1.01, 2.02, 3.03]), "b": short})
    assert merged["run_count"].values.tolist() == [2, 2, 1]
    assert merged["brf"].values == pytest.approx([1.0, 2.0, 3.03])
    ratio = merged["u_brf_stability"].values / merged["brf"].values
    assert ratio[2] == pytest.approx(np.sqrt(2) * ratio[0])
    assert np.isnan(merged["run_brf"].values[1, 2])


def test_repeated_points_count_with_their_mean_and_less_noise() -> None:
    repeated = run_with([1.0, 1.0, 2.0, 2.0])
    repeated["sensor_zenith"] = ("point", [10.0, 10.0, 40.0, 40.0], {"units": "degree"})
    single = run_with([1.0, 2.0])
    single["sensor_zenith"] = ("point", [10.0, 40.0], {"units": "degree"})
    for run in (repeated, single):
        run["sensor_azimuth"] = ("point", np.full(run.sizes["point"], 90.0), {"units": "degree"})
    merged = merge_runs({"a": repeated, "b": single})
    assert merged.sizes["point"] == 2
    # Weights 2 : 1 of variances 8e-6 and 16e-6, so the mean has 16e-6/3.
    assert merged["run_weight"].values[:, 0] == pytest.approx([2 / 3, 1 / 3])
    assert merged["u_brf_noise"].values[0] ** 2 == pytest.approx(16e-6 / 3)


def test_saturated_points_are_left_out_and_counted() -> None:
    bad = run_with([5.0, 2.0, 3.0]).assign(quality_flag=("point", np.array([1, 8, 0], dtype=np.int8)))
    merged = merge_runs({"a": run_with([1.0, 2.0, 3.0]), "b": bad})
    assert merged["run_count"].values.tolist() == [1, 2, 2]
    assert merged["brf"].values[0] == 1.0
    assert merged.attrs["points_left_out"] == 1


def test_a_run_whose_reference_was_not_repeated_has_no_drift_to_share() -> None:
    """Half the weight of a drift of 0.004: 0.002."""
    drifting = run_with([1.01, 2.02])
    drifting["u_brf_drift"] = ("point", 0.004 * drifting["brf"].values, {"units": "1"} | correlated("systematic"))
    drifting["brf"].attrs["unc_comps"] = [*drifting["brf"].attrs["unc_comps"], "u_brf_drift"]
    merged = merge_runs({"a": run_with([0.99, 1.98]), "b": drifting})
    assert merged["u_brf_drift"].values == pytest.approx([0.00202, 0.00404])


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (run_with([1.0, 2.0], sample="B"), "sample: expected one for all runs, found a: A; b: B"),
        (minimal_run(2), "no uncertainty components"),
        (run_with([1.0, 2.0]).drop_vars("u_brf_reference"), "differ from those of the runs before it: u_brf_reference"),
        (run_with([1.0, 2.0]).assign_coords(wavelength=("point", [600.0, 600.0])), "no geometry is in two"),
    ],
)
def test_what_cannot_be_merged_is_said(second: xr.Dataset, message: str) -> None:
    with pytest.raises(InputError, match=message):
        merge_runs({"a": run_with([1.0, 2.0], sample="A"), "b": second})


def test_one_run_is_not_several() -> None:
    with pytest.raises(InputError, match="at least two"):
        merge_runs({"a": run_with([1.0])})


def command(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(build(list(words)), list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_the_command_writes_a_run_that_others_read(tmp_path: Path) -> None:
    for name, factor in (("a", 0.99), ("b", 1.0), ("c", 1.01)):
        write_run(run_with(factor * np.linspace(0.4, 0.6, 5)), tmp_path / f"{name}.nc")
    files = [str(tmp_path / f"{name}.nc") for name in "abc"]
    status, output = command(
        "runs", "merge", *files, "--out", str(tmp_path / "m.nc"), "--json", str(tmp_path / "m.json")
    )
    assert status == 0
    assert "5 of 5 points are in every run" in output
    assert "-1.00" in output
    assert "+1.00" in output
    merged = read_run(tmp_path / "m.nc")
    assert merged["brf"].values == pytest.approx(np.linspace(0.4, 0.6, 5))
    assert merged.attrs["merged_runs"] == files
    assert not any("u_brf_reference" in sentence for sentence in capabilities(merged))
    assert "u_brf_stability" in " ".join(capabilities(merged))
    assert "better than their noise" not in output
    write_run(run_with(np.linspace(0.4, 0.6, 9)), tmp_path / "d.nc")
    write_run(run_with(np.linspace(0.4, 0.6, 9)), tmp_path / "e.nc")
    alike = [str(tmp_path / "d.nc"), str(tmp_path / "e.nc")]
    assert "better than their noise" in command("runs", "merge", *alike, "--out", str(tmp_path / "f.nc"))[1]
    with pytest.raises(InputError, match=r"is the same run as"):
        command("runs", "merge", files[0], files[0], "--out", str(tmp_path / "n.nc"))
    with pytest.raises(InputError, match=r"expected the name of a run file"):
        command("runs", "merge", *files, "--out", str(tmp_path / "n.txt"))
