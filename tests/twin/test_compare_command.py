"""``goniotwin compare`` on the command line."""

from __future__ import annotations

import errno
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from instrument.__main__ import main
from instrument.dataset import write_prediction, write_run

CASES = Path(__file__).parents[2].parent / "shared" / "cases"
needs_cases = pytest.mark.skipif(not CASES.exists(), reason=f"example cases not found in {CASES}")


@dataclass
class Result:
    exit_code: int
    output: str


@pytest.fixture
def call(capsys):
    """Run ``goniotwin compare`` as from a shell."""

    def run(*arguments: object) -> Result:
        try:
            status = main(["compare", *map(str, arguments)])
        except SystemExit as end:
            status = end.code
        return Result(status, "".join(capsys.readouterr()))

    return run


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
def test_a_run_and_a_prediction_file(call, folder, run):
    result = call(folder / run, folder / "prediction.nc", "--json", folder / "c.json", "--figures", folder / "f")
    assert result.exit_code == 0, result.output
    assert "15°, 0°" in result.output
    found = json.loads((folder / "c.json").read_text())
    assert found["global"]["relative_rmse"] == pytest.approx(0.02)
    assert found["global"]["rms_t"] == pytest.approx(np.sqrt(2))
    assert (folder / "f" / "plane_500nm_ill15_azi0.png").exists()


def test_a_run_folder_brings_its_own_prediction(call, folder):
    assert call(folder).exit_code == 0


def test_points_that_were_not_predicted_are_named(call, folder):
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
        (["run.nc", "run.nc"], "run.nc: u_brf_monte_carlo: missing"),
        (["run.nc", "prediction.nc", "--standard-error", "0"], "--standard-error"),
        (["run.nc", "prediction.nc", "--json", "no/c.json"], "there is no folder no"),
        (["run.nc", "prediction.nc", "--figures", "run.nc"], "run.nc: is a file; expected a folder"),
        (["run.nc", "--artifact", "a", "--material", "b", "--facility", "c"], "c: no such file"),
    ],
)
def test_bad_input_is_one_message_and_status_2(call, folder, monkeypatch, arguments, said):
    monkeypatch.chdir(folder)
    result = call(*arguments)
    assert result.exit_code == 2
    assert said in result.output
    assert result.output.count("\n") == 1


def test_what_cannot_be_written_is_bad_input(call, folder, monkeypatch):
    def full(self, *_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    result = call(folder, "--figures", folder / "f")
    assert result.exit_code == 2
    assert f"{folder / 'f'}: cannot be written: No space left on device" in result.output


def test_a_file_of_the_barest_kind_is_compared_and_it_is_said_what_it_lacks(call, folder):
    result = call(folder / "run.nc", folder / "prediction.nc")
    assert result.exit_code == 0
    assert "run.nc: no `time`: no test for drift" in result.output
    assert "run.nc: no `quality_flag`: saturated or repeated points cannot be told" in result.output


def test_how_much_of_the_material_was_filled_is_said(call, folder):
    _, prediction = datasets()
    text = "material coupon.nc: 5 x 4 x 3 entries; filled: 2 for retroreflection"
    write_prediction(prediction.assign_attrs(material=text), folder / "prediction.nc")
    assert f"The twin's {text}." in " ".join(call(folder).output.split())


@pytest.mark.slow
@needs_cases
@pytest.mark.parametrize(("case", "lowest", "highest"), [("dev01", 0.9, 1.4), ("dev16", 0.9, 1.4), ("dev04", 1.9, 2.6)])
def test_measured_files_of_another_program(call, case, lowest, highest, tmp_path):
    """Cases without unmodelled effect agree within their uncertainty; dev04 (a tilted sample) does not."""
    common = CASES / "common"
    result = call(
        CASES / "dev" / f"{case}.nc", "--artifact", common / "artifact.toml", "--material", common / "material.nc",
        "--facility", common / "facility.toml", "--standard-error", "0.003", "--no-uncertainty",
        "--json", tmp_path / "c.json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert lowest <= json.loads((tmp_path / "c.json").read_text())["global"]["rms_t"] <= highest
