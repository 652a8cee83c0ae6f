"""Example inputs: the committed files are what the generator makes, and follow the data contract."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from instrument.artifact import read_artifact
from instrument.facility import Facility
from instrument.plan import read_plan
from sim_fixtures.examples import COMMITTED_SEED, example_files, write_examples
from sim_fixtures.examples.files import write_material
from sim_fixtures.examples.holes import write_holes
from sim_fixtures.reality.coating import EXAMPLE_COATING

SHORT_PLAN = """
version = 1
[[grid]]
wavelength = [500.0]
illumination_zenith = [0.0]
sensor_azimuth = [0.0]
sensor_zenith = [-60.0, -45.0, -30.0, -20.0, -10.0, 10.0, 20.0, 30.0, 45.0, 60.0]
"""


def load(path: Path) -> xr.Dataset:
    with xr.open_dataset(path) as data:
        return data.load()


@pytest.fixture(scope="module")
def material() -> xr.Dataset:
    return load(example_files().material)


def test_the_plans_are_those_of_the_paper(facility: Facility) -> None:
    files = example_files()
    artifact, coupon = read_plan(files.plan, facility), read_plan(files.coupon_plan, facility)
    assert (len(artifact), len(artifact.blocked)) == (390, 6)
    assert (len(coupon), len(coupon.blocked)) == (652, 8)


def test_the_holes_scatter_as_the_paper_says() -> None:
    artifact = read_artifact(example_files().artifact)
    x, y = artifact.holes.x.reshape(12, 12), artifact.holes.y.reshape(12, 12)
    spacing = np.concatenate([np.diff(x, axis=0).ravel(), np.diff(y, axis=1).ravel()])
    assert np.mean(spacing) == pytest.approx(3.600, abs=0.002)
    assert np.std(spacing) == pytest.approx(0.012, rel=0.2)
    assert np.mean(artifact.holes.diameter) == pytest.approx(2.55, abs=0.005)
    assert np.std(artifact.holes.diameter) == pytest.approx(0.02, rel=0.2)


def test_the_table_of_holes_can_be_made_anew(tmp_path: Path) -> None:
    write_holes(tmp_path / "holes.csv")
    assert (tmp_path / "holes.csv").read_text() == (example_files().artifact.parent / "artifact_holes.csv").read_text()


def test_a_laboratory_gets_its_files(tmp_path: Path, facility: Facility) -> None:
    files = write_examples(tmp_path)
    assert files.material.read_bytes() == example_files().material.read_bytes()
    assert len(read_artifact(files.artifact).holes) == 144
    assert len(read_plan(files.plan, facility)) == 390


@pytest.mark.slow
def test_the_coupon_run_can_be_made_anew(tmp_path: Path, material: xr.Dataset) -> None:
    files = write_examples(tmp_path)
    files.material.unlink()
    write_material(files, COMMITTED_SEED)
    xr.testing.assert_allclose(load(files.material), material, rtol=1e-6)


def test_another_seed_is_another_coupon_run(tmp_path: Path) -> None:
    files = write_examples(tmp_path)
    files.coupon_plan.write_text(SHORT_PLAN)
    found = []
    for seed in (COMMITTED_SEED, COMMITTED_SEED, COMMITTED_SEED + 1):
        write_material(files, seed)
        found.append(load(files.material)["brf"].values)
    np.testing.assert_array_equal(found[0], found[1])
    assert len(found[0]) == 10
    assert np.std(found[2] / found[0]) > 0.003


def test_the_coupon_run_has_every_variable_of_the_contract(material: xr.Dataset) -> None:
    reference = {f"reference_{name}" for name in ("signal", "sensor_azimuth", "gain", "dark", "time")}
    assert set(material.data_vars) >= {"signal", "dark", "gain", "brf", "u_brf", "quality_flag"} | reference
    assert dict(material.sizes) == {"point": 652, "sample": 9, "reference": 4}
    assert set(material.coords) == {
        "wavelength",
        "illumination_zenith",
        "illumination_azimuth",
        "sensor_zenith",
        "sensor_azimuth",
        "time",
    }
    components = material["brf"].attrs["unc_comps"]
    assert len(components) == 12
    squares = sum(material[name].values.astype(float) ** 2 for name in components)
    assert np.sqrt(squares) == pytest.approx(material["u_brf"].values, rel=1e-6)
    assert np.all(np.diff(material["time"].values) > np.timedelta64(0))
    assert material.attrs["scan_direction"] == "unidirectional"
    assert material["signal"].values.max() < 10.0


def test_the_budget_of_the_coupon_closes_as_in_the_paper(material: xr.Dataset) -> None:
    relative = (material["u_brf"] / material["brf"]).values
    assert relative.min() == pytest.approx(0.0116, abs=0.0002)
    assert relative.max() == pytest.approx(0.0150, abs=0.0002)


def test_the_noise_of_the_readings_is_the_budgets(material: xr.Dataset) -> None:
    current = material["signal"].values - material["dark"].values[:, None]
    spread = current.std(axis=1, ddof=1) / current.mean(axis=1) / 3.0
    stated = (material["u_brf_noise"] / material["brf"]).values
    assert np.sqrt(np.mean((spread / stated) ** 2)) == pytest.approx(1.0, abs=0.1)


def test_the_coupon_run_shows_the_coating_within_its_uncertainty(material: xr.Dataset) -> None:
    illumination, sensor = (np.deg2rad(material[f"{name}_zenith"].values) for name in ("illumination", "sensor"))
    azimuth = np.deg2rad(material["sensor_azimuth"].values) + np.pi * (sensor < 0)
    s, coating = np.sin(illumination) * np.abs(np.sin(sensor)), EXAMPLE_COATING
    forward = s**coating.forward_sine_power * (0.5 * (1 - np.cos(azimuth))) ** coating.forward_azimuth_power
    backward = s * (0.5 * (1 + np.cos(azimuth))) ** coating.backward_azimuth_power
    expected = coating.base + coating.forward * forward + coating.backward * backward
    normalised = (material["brf"].values - expected) / material["u_brf"].values
    assert 0.3 < np.sqrt(np.mean(normalised**2)) < 1.4
