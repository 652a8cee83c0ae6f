"""``goniotwin compare`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
import xarray as xr
from typer.testing import CliRunner

from instrument.dataset import write_prediction, write_run
from twin.compare_command import compare_command

CASES = Path(__file__).parents[2].parent / "shared" / "cases"
needs_cases = pytest.mark.skipif(not CASES.exists(), reason=f"example cases not found in {CASES}")


def call(*arguments: object):
    app = typer.Typer()
    app.command()(compare_command)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def datasets() -> tuple[xr.Dataset, xr.Dataset]:
    units = {"wavelength": "nm"} | dict.fromkeys(
        ("illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth"), "degree"
    )
    table = np.array([(500.0, 15.0, 0.0, zenith, 0.0) for zenith in (-40, 0, 40)])
    coords = {name: ("point", table[:, i], {"units": unit}) for i, (name, unit) in enumerate(units.items())}
    one = {"units": "1"}

    def of(**columns: float) -> xr.Dataset:
        return xr.Dataset({name: ("point", np.full(3, value), one) for name, value in columns.items()}, coords=coords)

    return of(brf=0.5, u_brf=0.005), of(brf=0.51, u_brf=0.005, u_brf_monte_carlo=0.001)


@pytest.fixture
def folder(tmp_path):
    run, prediction = datasets()
    write_run(run, tmp_path / "run.nc")
    write_run(run, tmp_path / "run.csv")
    write_prediction(prediction, tmp_path / "prediction.nc")
    return tmp_path


@pytest.mark.parametrize("run", ["run.nc", "run.csv"])
def test_a_run_and_a_prediction_file(folder, run):
    result = call(folder / run, folder / "prediction.nc", "--json", folder / "c.json", "--figures", folder / "f")
    assert result.exit_code == 0, result.output
    assert "15°, 0°" in result.output
    found = json.loads((folder / "c.json").read_text())
    assert found["global"]["relative_rmse"] == pytest.approx(0.02)
    assert found["global"]["rms_t"] == pytest.approx(np.sqrt(2))
    assert (folder / "f" / "plane_500nm_ill15_azi0.png").exists()


def test_a_run_folder_brings_its_own_prediction(folder):
    assert call(folder).exit_code == 0


def test_points_that_were_not_predicted_are_named(folder):
    _, prediction = datasets()
    write_prediction(prediction.isel(point=[0, 2]), folder / "prediction.nc")
    result = call(folder)
    assert result.exit_code == 2
    assert "point 1 has no prediction" in result.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["missing.nc", "prediction.nc"], "missing.nc: no such file"),
        (["run.nc"], "--artifact, --material, --facility missing"),
        (["run.nc", "--artifact", "a.toml"], "--material, --facility missing"),
        (["run.nc", "prediction.nc", "--artifact", "a.toml"], "both a prediction file and --artifact"),
        (["run.nc", "run.nc"], "u_brf_monte_carlo"),
        (["run.nc", "prediction.nc", "--standard-error", "0"], "--standard-error"),
        (["run.nc", "prediction.nc", "--json", "no/c.json"], "there is no folder no"),
        (["run.nc", "prediction.nc", "--figures", "run.nc"], "--figures: run.nc: is a file"),
        (["run.nc", "--artifact", "a", "--material", "b", "--facility", "c"], "c: no such file"),
    ],
)
def test_bad_input_is_one_message_and_status_2(folder, monkeypatch, arguments, said):
    monkeypatch.chdir(folder)
    result = call(*arguments)
    assert result.exit_code == 2
    assert said in result.output
    assert "Traceback" not in result.output


@pytest.mark.slow
@needs_cases
@pytest.mark.parametrize(("case", "lowest", "highest"), [("dev01", 0.9, 1.4), ("dev16", 0.9, 1.4), ("dev04", 1.9, 2.6)])
def test_measured_files_of_another_program(case, lowest, highest, tmp_path):
    """Cases without unmodelled effect agree within their uncertainty; dev04 (a tilted sample) does not."""
    common = CASES / "common"
    result = call(
        CASES / "dev" / f"{case}.nc", "--artifact", common / "artifact.toml", "--material", common / "material.nc",
        "--facility", common / "facility.toml", "--standard-error", "0.003", "--json", tmp_path / "c.json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert lowest <= json.loads((tmp_path / "c.json").read_text())["global"]["rms_t"] <= highest
