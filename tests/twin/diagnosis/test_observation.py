"""What the diagnosis takes from run files: which points, which slices, and refusals that say what is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from synthetic_runs import TABLE_IV, grid, nominal, observed

from instrument.errors import InputError
from twin.diagnosis.observation import LEAST_POINTS, observe, read_observation


def minimal(columns: dict | None = None, **changes: np.ndarray) -> xr.Dataset:
    """A file's dataset with geometry, ``brf`` and ``u_brf`` alone."""
    columns = columns or grid({0.0: (0.0, 90.0)})
    brf = changes.pop("brf", nominal(columns))
    u_brf = changes.pop("u_brf", 0.012 * brf)
    units = {"wavelength": "nm"}
    variables = {name: ("point", values, {"units": units.get(name, "degree")}) for name, values in columns.items()}
    variables |= {"brf": ("point", brf, {"units": "1"}), "u_brf": ("point", u_brf, {"units": "1"})}
    return xr.Dataset(variables | {name: ("point", value) for name, value in changes.items()})


def written(folder: Path, **changes: np.ndarray) -> Path:
    file = folder / "run.nc"
    minimal(**changes).to_netcdf(file, engine="h5netcdf")
    return file


def with_readings(count: int, **changes: np.ndarray | None) -> xr.Dataset:
    """A dataset with raw readings: 2 V less 0.5 V at 1e6 V/A of every point, 1 V less 0.25 V of the reference."""
    run = minimal(grid({0.0: (0.0, 90.0)}, shadow=False))
    assert run.sizes["point"] == count
    added = {
        "signal": (("point", "sample"), 2.0 + np.tile(np.array([-0.1, 0.0, 0.1]), (count, 1))),
        "dark": ("point", np.full(count, 0.5)),
        "gain": ("point", np.full(count, 1e6)),
        "reference_signal": (("reference", "sample"), np.full((2, 3), 1.0)),
        "reference_dark": ("reference", np.full(2, 0.25)),
        "reference_gain": ("reference", np.full(2, 1e6)),
    }
    return run.assign({name: value for name, value in added.items() if name not in changes})


def test_minimal_file_is_read_and_says_what_it_lacks(tmp_path: Path):
    run = read_observation(written(tmp_path))
    assert len(run) == 64
    np.testing.assert_allclose(run.brf, nominal(grid({0.0: (0.0, 90.0)})))
    np.testing.assert_allclose(run.relative_u, 0.012)
    assert run.components == {}
    assert run.seconds is None
    assert run.reading is None
    for lacking in ("time", "signal", "reference readings", "components"):
        assert any(lacking in note for note in run.notes), lacking


def test_run_folder_is_read_like_its_file(tmp_path: Path):
    file = written(tmp_path)
    np.testing.assert_array_equal(read_observation(tmp_path).brf, read_observation(file).brf)


def test_progress_follows_the_times_and_without_them_the_order():
    start = np.datetime64("2026-01-01T08:00:00", "ns")
    seconds = np.arange(64) ** 2 * 10.0
    with_times = observe(minimal(time=start + (seconds * 1e9).astype("timedelta64[ns]")), "run.nc")
    np.testing.assert_allclose(with_times.seconds, seconds)
    np.testing.assert_allclose(with_times.progress, seconds / seconds[-1])
    np.testing.assert_allclose(observe(minimal(), "run.nc").progress, np.arange(64) / 63)


def test_times_of_which_one_is_missing_are_no_times():
    time = np.datetime64("2026-01-01", "ns") + np.arange(64) * np.timedelta64(1, "s")
    time[5] = np.datetime64("NaT")
    assert observe(minimal(time=time), "run.nc").seconds is None


def test_rows_count_points_of_the_file_where_some_are_left_out():
    brf = nominal(grid({0.0: (0.0, 90.0)}))
    brf[3], brf[10] = np.nan, 0.0
    flags = np.zeros(64, dtype=np.int32)
    flags[20], flags[21], flags[22] = 4, 2, 4 | 8
    run = observe(minimal(brf=brf, u_brf=np.full(64, 0.005), quality_flag=flags), "run.nc")
    # 20 and 22 are shadowed; 21 has another flag, and stays.
    assert set(range(64)) - set(run.rows.tolist()) == {3, 10, 20, 22}
    np.testing.assert_array_equal(run.brf, brf[run.rows])
    assert any("4 points" in note and "left out" in note for note in run.notes)


def test_readings_are_means_over_samples_less_dark_over_the_reference():
    run = observe(with_readings(66), "run.nc")
    np.testing.assert_allclose(run.signal_v, 1.5)
    np.testing.assert_allclose(run.reading, 1.5 / 0.75)
    assert run.reference_v == pytest.approx(0.75)
    assert run.reference_gain == pytest.approx(1e6)


@pytest.mark.parametrize("lost", ["signal", "dark", "gain"])
def test_readings_without_one_of_their_parts_are_none(lost: str):
    run = observe(with_readings(66, **{lost: None}), "run.nc")
    assert run.signal_v is None
    assert run.reading is None


def test_readings_without_reference_keep_the_signal():
    run = observe(with_readings(66, reference_dark=None), "run.nc")
    np.testing.assert_allclose(run.signal_v, 1.5)
    assert run.reading is None


@pytest.mark.parametrize("serpentine", [False, True])
def test_planes_of_table_iv_are_numbered_in_the_order_of_the_scan(serpentine: bool):
    run = observed(grid(serpentine=serpentine))
    assert len(run) == 390
    assert run.plane.max() + 1 == sum(len(azimuths) for azimuths in TABLE_IV.values())
    assert np.all(np.diff(run.plane) >= 0)
    np.testing.assert_array_equal(np.bincount(run.illumination), [128, 164, 98])


def test_wavelengths_lie_in_planes_of_their_own():
    columns = grid({0.0: (0.0,)})
    twice = {name: np.tile(value, 2) for name, value in columns.items()}
    twice["wavelength"] = np.repeat([500.0, 600.0], len(columns["wavelength"]))
    run = observed(twice)
    assert run.plane.max() == 1
    assert run.illumination.max() == 0


def test_unknown_wavelength_is_one_plane():
    columns = grid({0.0: (0.0, 90.0)})
    columns["wavelength"] = np.full_like(columns["wavelength"], np.nan)
    assert observed(columns).plane.max() == 1


@given(st.lists(st.integers(0, 63), min_size=1, max_size=40, unique=True))
def test_taken_points_are_those_asked_for(chosen: list[int]):
    run = observed(grid({0.0: (0.0, 90.0)}), np.linspace(0, 0.1, 64))
    rows = np.array(chosen)
    some = run.take(rows)
    np.testing.assert_array_equal(some.rows, rows)
    np.testing.assert_array_equal(some.brf, run.brf[rows])
    np.testing.assert_array_equal(some.columns["sensor_zenith"], run.columns["sensor_zenith"][rows])
    np.testing.assert_array_equal(some.components["noise"], run.components["noise"][rows])
    np.testing.assert_array_equal(some.seconds, run.seconds[rows])
    assert len(some) == len(chosen)


def test_too_few_points_are_refused(tmp_path: Path):
    columns = {name: value[: LEAST_POINTS - 1] for name, value in grid({0.0: (0.0,)}).items()}
    file = written(tmp_path, columns=columns)
    with pytest.raises(InputError, match=rf"run\.nc: found {LEAST_POINTS - 1} usable points; expected at least"):
        read_observation(file)


@pytest.mark.parametrize("value", [0.0, -0.01])
def test_uncertainty_of_zero_or_less_names_file_variable_and_point(tmp_path: Path, value: float):
    u_brf = np.full(64, 0.006)
    u_brf[7] = value
    with pytest.raises(InputError, match=r"run\.nc: u_brf: .*7"):
        read_observation(written(tmp_path, u_brf=u_brf))


def test_missing_uncertainty_names_file_and_variable(tmp_path: Path):
    file = tmp_path / "run.nc"
    minimal().drop_vars("u_brf").to_netcdf(file, engine="h5netcdf")
    with pytest.raises(InputError, match=r"run\.nc: u_brf: missing"):
        read_observation(file)


def test_reflectance_in_per_cent_is_refused():
    columns = grid({0.0: (0.0, 90.0)})
    with pytest.raises(InputError, match=r"run\.nc: brf: .*not per cent"):
        observe(minimal(brf=100 * nominal(columns)), "run.nc")


def test_uncertainty_in_per_cent_of_brf_is_refused():
    with pytest.raises(InputError, match=r"run\.nc: u_brf: .*expected an absolute standard"):
        observe(minimal(u_brf=np.full(64, 1.2)), "run.nc")
