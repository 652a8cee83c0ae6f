"""Reading and writing run files and predictions; what a wrong file is told."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import xarray as xr
from example_runs import SHARED, four_points, minimal_run
from hypothesis import given, settings
from hypothesis import strategies as st

from instrument.dataset import (
    capabilities,
    component_names,
    read_prediction,
    read_run,
    rebuild_run,
    write_prediction,
    write_run,
)
from instrument.errors import InputError
from instrument.run_check import checked
from instrument.run_schema import RUN

CASES = SHARED / "cases"
needs_cases = pytest.mark.skipif(not CASES.exists(), reason="../shared/cases is not there")


def saved(dataset: xr.Dataset, path: Path) -> Path:
    """A file as a foreign program would leave it: nothing checked, nothing added."""
    dataset.to_netcdf(path, engine="h5netcdf")
    return path


def refusal(path: Path, read: Callable[[Path], xr.Dataset] = read_run) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def full_run(tmp_path: Path) -> xr.Dataset:
    return rebuild_run(four_points(tmp_path / "journal-of-run"))


def test_the_least_that_is_a_run_is_accepted_and_says_what_it_lacks(tmp_path: Path) -> None:
    run = read_run(saved(minimal_run(), tmp_path / "run.nc"))
    lacks = "\n".join(capabilities(run))
    for expected in (
        "`time`: no test for drift",
        "`signal`",
        "reference readings",
        "uncertainty components",
        "`scan_dir",
    ):
        assert expected in lacks
    assert set(run.coords) >= {"wavelength", "sensor_zenith"}


def test_angles_may_be_plain_variables(tmp_path: Path) -> None:
    run = read_run(saved(minimal_run().reset_coords(), tmp_path / "run.nc"))
    assert "sensor_zenith" in run.coords


def test_a_full_run_survives_writing_and_reading(tmp_path: Path) -> None:
    run = full_run(tmp_path)
    write_run(run, tmp_path / "run.nc")
    back = read_run(tmp_path / "run.nc")
    xr.testing.assert_equal(back, run)
    assert back.attrs["Conventions"] == "CF-1.11"
    assert back["time"].dtype == run["time"].dtype
    assert capabilities(back) == ["no correlation stated for `u_brf_stability`"]
    assert component_names(back) == component_names(run)
    for name in run.data_vars:
        for key, value in run[name].attrs.items():
            np.testing.assert_array_equal(back[name].attrs[key], value, err_msg=f"{name}.{key}")


def test_the_file_says_what_the_conventions_ask_for(tmp_path: Path) -> None:
    write_run(full_run(tmp_path), tmp_path / "run.nc")
    with h5netcdf.File(tmp_path / "run.nc") as file:
        assert file.attrs["Conventions"] == "CF-1.11"
        assert file["time"].attrs["units"] == "nanoseconds since 1970-01-01"
        assert "_FillValue" not in file["brf"].attrs
        assert file["quality_flag"].attrs["flag_masks"].tolist() == [1, 2, 4, 8]
        assert file["quality_flag"].attrs["flag_meanings"].split() == ["saturated", "overload", "shadowed", "repeated"]
        assert "sensor_zenith" in file["brf"].attrs["coordinates"]
        noise, stability = file["u_brf_noise"].attrs, file["u_brf_stability"].attrs
        assert (noise["err_corr_1_dim"], noise["err_corr_1_form"]) == ("point", "random")
        assert len(noise["err_corr_1_params"]) == len(noise["err_corr_1_units"]) == 0
        assert not [key for key in stability if key.startswith("err_corr")]
        assert file["u_brf_reference"].attrs["err_corr_1_form"] == "systematic"


def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.nc"
    write_run(minimal_run(), path)
    before = path.read_bytes()

    def cut(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", cut)
        with pytest.raises(KeyboardInterrupt):
            write_run(minimal_run(5), path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.nc"]


def test_nothing_that_cannot_be_read_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="u_brf: missing"):
        write_run(minimal_run().drop_vars("u_brf"), tmp_path / "run.nc")
    assert not (tmp_path / "run.nc").exists()


@needs_cases
@pytest.mark.parametrize("name", ["common/material.nc", "dev/dev01.nc", "dev/dev16.nc"])
def test_files_of_another_program_are_read(name: str, tmp_path: Path) -> None:
    run = read_run(CASES / name)
    assert capabilities(run) == ["no correlation stated for `u_brf_stability`"]
    assert run.sizes["point"] in (390, 652)
    write_run(run, tmp_path / "copy.nc")
    xr.testing.assert_equal(read_run(tmp_path / "copy.nc"), run)


@needs_cases
def test_a_cut_down_copy_of_a_full_file_is_accepted(tmp_path: Path) -> None:
    run = read_run(CASES / "dev" / "dev01.nc")[["brf", "u_brf"]].drop_vars(["time", "point"])
    back = read_run(saved(run, tmp_path / "cut.nc"))  # its attribute unc_comps names what is not there
    assert component_names(back) == []
    assert "no uncertainty components" in "\n".join(capabilities(back))


def renamed(old: str, new: str) -> Callable[[xr.Dataset], xr.Dataset]:
    return lambda run: run.rename({old: new})


def with_unit(name: str, unit: str) -> Callable[[xr.Dataset], xr.Dataset]:
    def change(run: xr.Dataset) -> xr.Dataset:
        run[name].attrs["units"] = unit
        return run

    return change


def with_value(name: str, value: float) -> Callable[[xr.Dataset], xr.Dataset]:
    def change(run: xr.Dataset) -> xr.Dataset:
        run[name].values[1] = value
        return run

    return change


def in_radians(run: xr.Dataset) -> xr.Dataset:
    for name in ("sensor_zenith", "sensor_azimuth"):
        run[name] = ("point", np.deg2rad(run[name].values))
    return run


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda run: run.drop_vars("u_brf"), "u_brf: missing; expected combined standard uncertainty"),
        (lambda run: run.drop_vars("sensor_azimuth"), "sensor_azimuth: missing; expected"),
        (renamed("sensor_zenith", "sensor_zenit"), "sensor_zenith: missing"),
        (renamed("sensor_zenith", "sensor_zenit"), "found 'sensor_zenit', is that it?"),
        (renamed("sensor_zenith", "vza"), "found 'vza', is that it?"),
        (renamed("brf", "BRF"), "found 'BRF', is that it?"),
        (with_unit("sensor_zenith", "radian"), "sensor_zenith: found unit 'radian'; expected 'degree'"),
        (with_unit("wavelength", "um"), "wavelength: found unit 'um'; expected 'nm'"),
        (with_unit("brf", "sr-1"), "brf: found unit 'sr-1'; expected '1'; a BRDF in sr-1 times pi"),
        (with_unit("u_brf", "%"), "u_brf: found unit '%'"),
        (in_radians, "sensor_zenith: no unit, and no value beyond pi/2"),
        (with_value("brf", np.nan), "brf: no finite value at point 1"),
        (with_value("sensor_zenith", np.inf), "sensor_zenith: no finite value at point 1"),
        (with_value("u_brf", 0.0), "u_brf: found 0 at point 1; expected a standard uncertainty above 0"),
        (with_value("u_brf", -0.1), "u_brf: found -0.1 at point 1"),
        (with_value("sensor_zenith", 100.0), "sensor_zenith: found 100 at point 1; expected -90 to 90"),
        (with_value("sensor_azimuth", 1000.0), "sensor_azimuth: found 1000 at point 1"),
        (lambda run: run.assign_coords(wavelength=("point", [0.5] * 3)), "are these micrometres?"),
        (lambda run: run.assign(brf=("point", ["a", "b", "c"])), "brf: found"),
        (lambda run: run.isel(point=slice(0, 0)), "no points"),
        (lambda run: run.assign(singal=(("point", "sample"), np.ones((3, 9)))), "did you mean 'signal'"),
        (lambda run: run.assign(signal=("point", np.ones(3))), "signal: found dimensions (point)"),
        (lambda run: run.assign(u_brf_niose=("point", np.ones(3))), "did you mean 'u_brf_noise'"),
        (lambda run: run.assign(time=("point", np.arange(3.0))), "time: not a time"),
        (lambda run: run.assign_attrs(scan_direction="zigzag"), "scan_direction: found 'zigzag'"),
        (
            lambda run: run.assign_attrs(reference_reflectance_factor="high"),
            "reference_reflectance_factor: found 'high'",
        ),
    ],
)
def test_a_wrong_variable_is_named(change: Callable[[xr.Dataset], xr.Dataset], expected: str) -> None:
    with pytest.raises(InputError) as problem:
        checked(change(minimal_run()), "some/run.nc", RUN)
    assert expected in str(problem.value)
    assert str(problem.value).startswith("some/run.nc: ")


def test_a_file_is_checked_as_it_is_read(tmp_path: Path) -> None:
    assert "u_brf: missing" in refusal(saved(minimal_run().drop_vars("u_brf"), tmp_path / "run.nc"))
    rows = saved(minimal_run().rename(point="row"), tmp_path / "rows.nc")
    assert "dimension point: missing; found row" in refusal(rows)


def test_radians_are_believed_where_the_unit_says_degrees(tmp_path: Path) -> None:
    run = minimal_run()
    run["sensor_zenith"].values[:] = [-1.5, 0.1, 1.5]  # an alignment scan
    assert read_run(saved(run, tmp_path / "run.nc"))["sensor_zenith"].values.tolist() == [-1.5, 0.1, 1.5]


@pytest.mark.parametrize("spelling", ["degrees", "deg"])
def test_spellings_of_a_unit_are_understood(spelling: str, tmp_path: Path) -> None:
    run = read_run(saved(with_unit("sensor_zenith", spelling)(minimal_run()), tmp_path / "run.nc"))
    assert run["sensor_zenith"].attrs["units"] == "degree"


def test_missing_units_are_assumed_and_said(tmp_path: Path) -> None:
    run = minimal_run()
    del run["sensor_zenith"].attrs["units"]
    assert "no unit stated for `sensor_zenith`" in "\n".join(capabilities(read_run(saved(run, tmp_path / "run.nc"))))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "not a netCDF-4 file"),
        (b"hello world", "not a netCDF-4 file"),
        (b"CDF\x01" + b"\0" * 60, "a netCDF-3 file"),
        (b"\x89HDF\r\n\x1a\n" + b"\0" * 60, "damaged or truncated"),
    ],
)
def test_a_foreign_file_is_named(content: bytes, expected: str, tmp_path: Path) -> None:
    (tmp_path / "run.nc").write_bytes(content)
    assert expected in refusal(tmp_path / "run.nc")


@pytest.fixture(scope="module")
def whole_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return saved(minimal_run(400), tmp_path_factory.mktemp("whole") / "run.nc").read_bytes()


@settings(deadline=None, max_examples=25)
@given(share=st.floats(0.0, 0.999))
def test_a_truncated_file_is_an_error_and_never_half_a_run(
    share: float, whole_file: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("truncated")
    (folder / "run.nc").write_bytes(whole_file[: int(share * len(whole_file))])
    refusal(folder / "run.nc")


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "absent.nc")
    assert "no such file" in refusal(tmp_path / "absent.csv")
    assert "is a folder" in refusal(tmp_path)
    (tmp_path / "a.csv").mkdir()
    assert "is a folder" in refusal(tmp_path / "a.csv")


def test_a_table_holds_everything_but_the_reference_readings(tmp_path: Path) -> None:
    run = full_run(tmp_path)
    write_run(run, tmp_path / "run.csv")
    back = read_run(tmp_path / "run.csv")
    for name in run.variables:
        if "reference" not in run[name].dims:
            np.testing.assert_array_equal(back[name].values, run[name].values, err_msg=str(name))
    assert back.attrs["scan_direction"] == "unidirectional"
    assert back.attrs["reference_reflectance_factor"] == 0.99
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert len(lines) == 1 + run.sizes["point"]
    assert lines[0].startswith(
        "wavelength,illumination_zenith,illumination_azimuth,sensor_zenith,sensor_azimuth,brf,u_brf"
    )


HEADER = "wavelength,illumination_zenith,illumination_azimuth,sensor_zenith,sensor_azimuth,brf,u_brf"
ROW = "500,0,0,30,90,0.4,0.005"


def test_the_least_table_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("\ufeff" + HEADER + "\r\n" + ROW + "\r\n\r\n", encoding="utf-8")
    run = read_run(path)
    assert run["brf"].values.tolist() == [0.4]
    assert "units of the data contract are assumed" in "\n".join(capabilities(run))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "empty"),
        (HEADER + "\n", "no points"),
        (HEADER + "\n500,0,0,30,90,0.4\n", "line 2: found 6 columns; expected 7"),
        (HEADER + "\n500,0,0,thirty,90,0.4,0.005\n", "row 1: sensor_zenith: found 'thirty'; expected a number"),
        (HEADER + ",time\n" + ROW + ",yesterday\n", "time: found 'yesterday'; expected UTC like"),
        (HEADER + ",brf\n" + ROW + ",0.4\n", "'brf' stands twice"),
        (HEADER.replace("sensor_zenith", "vza") + "\n" + ROW + "\n", "found 'vza', is that it?"),
        (HEADER + "\n500,0,0,1.2,1.57,0.4,0.005\n500,0,0,-1.2,1.57,0.4,0.005\n", "are these radians?"),
        (HEADER + ",scan_direction\n" + ROW + ",a\n" + ROW + ",b\n", "expected one value for the whole run"),
    ],
)
def test_a_wrong_table_is_named(text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(text)
    assert expected in refusal(tmp_path / "run.csv")


@settings(deadline=None, max_examples=30)
@given(
    values=st.lists(
        st.tuples(st.floats(-90, 90), st.floats(-360, 360), st.floats(1e-6, 1e3), st.floats(1e-12, 1.0)),
        min_size=1,
        max_size=5,
    )
)
def test_tables_keep_every_digit(
    values: list[tuple[float, float, float, float]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    run = minimal_run(len(values))
    run["illumination_zenith"].values[:] = 70.0
    for position, name in enumerate(("sensor_zenith", "sensor_azimuth", "brf", "u_brf")):
        run[name].values[:] = [row[position] for row in values]
    run["sensor_zenith"].values[0] = 75.0  # beyond any radian
    path = tmp_path_factory.mktemp("table") / "run.csv"
    write_run(run, path)
    back = read_run(path)
    for name in ("sensor_zenith", "sensor_azimuth", "brf", "u_brf"):
        np.testing.assert_array_equal(back[name].values, run[name].values)


def test_predictions_are_written_and_read(tmp_path: Path) -> None:
    prediction = minimal_run().assign(u_brf_monte_carlo=("point", [1e-4] * 3))
    write_prediction(prediction, tmp_path / "prediction.nc")
    back = read_prediction(tmp_path / "prediction.nc")
    xr.testing.assert_equal(back, prediction)
    assert back["u_brf_monte_carlo"].attrs["units"] == "1"
    assert component_names(back) == ["u_brf_monte_carlo"]
    assert "did you mean" in refusal(
        saved(minimal_run().assign(u_brf_monte_crlo=("point", [1e-4] * 3)), tmp_path / "b.nc"), read_prediction
    )


def test_a_prediction_says_what_its_uncertainty_is_made_of(tmp_path):
    prediction = minimal_run()
    noise = prediction["u_brf"] * 0.6
    prediction["u_brf_monte_carlo"] = noise.assign_attrs(units="1")
    prediction["u_brf_inputs"] = (prediction["u_brf"] * 0.8).assign_attrs(units="1")
    write_prediction(prediction, tmp_path / "prediction.nc")
    with xr.open_dataset(tmp_path / "prediction.nc", engine="h5netcdf") as read:
        assert list(read["brf"].attrs["unc_comps"]) == ["u_brf_inputs", "u_brf_monte_carlo"]
        assert read["u_brf_monte_carlo"].attrs["err_corr_1_form"] == "random"
        assert read["u_brf_monte_carlo"].attrs["err_corr_1_dim"] == "point"
        assert "err_corr_1_form" not in read["u_brf_inputs"].attrs
        assert {str(name) for name in read.coords} >= {"wavelength", "sensor_zenith", "sensor_azimuth"}
        assert (read["brf"].attrs["units"], read["sensor_zenith"].attrs["units"]) == ("1", "degree")
    assert "unc_comps" not in prediction["brf"].attrs
