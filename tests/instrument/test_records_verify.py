"""``runs verify`` computes the run file anew: whatever was changed in it since is found, by name."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from example_runs import four_points

from instrument.dataset import read_run, rebuild_run, write_run
from instrument.run_archive import first_difference, verify


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = four_points(tmp_path_factory.mktemp("made") / "run")
    write_run(rebuild_run(folder), folder / "run.nc")
    return folder


def scaled(name: str, factor: float) -> Callable[[xr.Dataset], object]:
    def change(run: xr.Dataset) -> None:
        run[name].values[1] *= factor

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (scaled("brf", 1 + 1e-6), r"brf\[1\]: found"),
        (scaled("u_brf_reference", 0.99), r"u_brf_reference\[1\]: found"),
        (scaled("dark", 1 + 1e-12), r"dark\[1\]: found"),
        (scaled("sensor_zenith", 1.1), r"sensor_zenith\[1\]: found 33.0; the journal gives 30.0"),
        (lambda run: run["readback_sensor_zenith"].attrs.update(units="rad"), r"units: found \['rad'\]"),
        (
            lambda run: run["u_brf_reference"].attrs.update(err_corr_1_form="random"),
            r"err_corr_1_form: found \['random'\]",
        ),
        (lambda run: run["u_brf_noise"].attrs.update(degrees_of_freedom=3.0), "degrees_of_freedom: found"),
        (lambda run: run.update({"u_brf_extra": run["u_brf"]}), "u_brf_extra: found; the journal gives no such"),
        (lambda run: run.attrs.update(scan_direction="serpentine"), "global attribute scan_direction"),
    ],
)
def test_a_changed_run_file_is_found(made: Path, change: Callable[[xr.Dataset], object], said: str) -> None:
    """By what ``verify`` compares the file with the journal."""
    expected = read_run(made / "run.nc")
    changed = expected.copy(deep=True)
    assert first_difference(changed, expected) == ""
    change(changed)
    assert re.search(said, first_difference(changed, expected))


def test_a_run_file_of_another_journal_is_found(made: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "run"))
    run = read_run(folder / "run.nc")
    run["brf"].values[1] *= 1 + 1e-6
    run.attrs["journal_digest"] = "0" * 64
    write_run(run, folder / "run.nc")
    found = {check.name: check.found for check in verify(folder).checks if not check.passed}
    assert set(found) == {"digest", "run.nc"}
    assert "made of another journal" in found["digest"]
    assert "brf[1]: found" in found["run.nc"]


def test_an_unchanged_one_passes_and_a_missing_one_does_not(made: Path, tmp_path: Path) -> None:
    assert verify(made).passed
    folder = Path(shutil.copytree(made, tmp_path / "run"))
    (folder / "run.nc").unlink()
    assert [check.name for check in verify(folder).checks if not check.passed] == ["run.nc"]
    (folder / "run.nc").write_bytes((made / "run.nc").read_bytes()[:3000])
    bad = next(check for check in verify(folder).checks if not check.passed)
    assert "damaged or truncated" in bad.found
    assert np.isfinite(read_run(made / "run.nc")["brf"]).all()
