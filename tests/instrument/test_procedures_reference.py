"""The certificate of the reference: what it says, when it is refused, and what it does to a run."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import numpy as np
import pytest
from scan_stage import FACILITY, plan_of, stage

from instrument.dataset import run_of_journal
from instrument.errors import InputError
from instrument.facility import read_facility
from instrument.forms import parse_form, parse_toml
from instrument.reference_standard import ReferenceStandard, at_wavelength, factor_at, objections
from instrument.run_folder import copy_facility

TEXT = """
version = 1
identity = "SRS-99 no. 7"
issuer = "a metrology institute"
number = "C-123"
valid_from = 2026-01-01
valid_until = 2027-06-30

[[reflectance_factor]]
wavelength = 500.0
sensor_zenith = 15.0
value = 0.990
u = 0.00495

[[reflectance_factor]]
wavelength = 700.0
sensor_zenith = 15.0
value = 0.980
u = 0.00294

[[reflectance_factor]]
wavelength = 500.0
sensor_zenith = 45.0
value = 0.960
u = 0.00960
"""
STANDARD = parse_form(parse_toml(TEXT, "test"), ReferenceStandard, "test")
TODAY = date(2026, 11, 22)


@pytest.mark.parametrize(
    ("wavelength", "zenith", "value", "u"),
    [
        (500.0, 15.0, 0.990, 0.005),
        (500.0, -15.0, 0.990, 0.005),
        (600.0, 15.0, 0.985, 0.005),
        (500.0, 30.0, 0.975, 0.010),
    ],
)
def test_values_between_certified_ones_are_interpolated_and_the_larger_uncertainty_counts(wavelength, zenith, value, u):
    found = factor_at(STANDARD, wavelength, 0.0, zenith)
    assert found.objections == ()
    assert (found.value, found.u_relative) == (pytest.approx(value), pytest.approx(u))


def test_what_is_not_certified_is_objected_to():
    assert objections(STANDARD, TODAY, [500.0, 650.0], 0.0, 15.0) == []
    assert objections(STANDARD, TODAY, [450.0], 0.0, 15.0) == ["450 nm is not certified (found 500 to 700 nm)"]
    assert "sensor zenith 60" in objections(STANDARD, TODAY, [500.0], 0.0, 60.0)[0]
    assert "illumination zenith 45" in objections(STANDARD, TODAY, [500.0], 45.0, 15.0)[0]


def test_the_last_day_of_validity_is_valid():
    assert objections(STANDARD, date(2027, 6, 30), [500.0], 0.0, 15.0) == []
    assert objections(STANDARD, date(2027, 7, 2), [500.0], 0.0, 15.0) == ["expired on 2027-06-30 (2 days ago)"]
    assert objections(STANDARD, date(2025, 12, 31), [500.0], 0.0, 15.0) == ["is valid from 2026-01-01 on only"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("valid_until = 2027-06-30", "valid_until = 2025-06-30", "lies before valid_from"),
        ("wavelength = 700.0", "wavelength = 500.0", "two values at 500 nm"),
        ("value = 0.990", "value = -0.990", "greater than 0"),
        ("version = 1", "version = 2", "version"),
    ],
)
def test_a_wrong_certificate_is_refused_with_its_key(old: str, new: str, message: str):
    with pytest.raises(InputError, match=message):
        parse_form(parse_toml(TEXT.replace(old, new, 1), "cert.toml"), ReferenceStandard, "cert.toml")


def test_the_certificate_takes_the_place_of_the_facility_s_numbers():
    reference = FACILITY.reference.model_copy(update={"certificate": STANDARD})
    facility = at_wavelength(FACILITY.model_copy(update={"reference": reference}), 700.0)
    assert facility.reference.reflectance_factor == pytest.approx(0.98)
    assert facility.reference.u_relative == facility.budget.reference_material == pytest.approx(0.003)
    assert at_wavelength(FACILITY, 700.0) is FACILITY


def facility_file(folder: Path, home: Path) -> Path:
    """The example facility with a certificate in a file of its own."""
    text = (home / "facility.toml").read_text().replace("[reference]", '[reference]\ncertificate = "standard.toml"')
    (folder / "standard.toml").write_text(TEXT)
    (folder / "facility.toml").write_text(text)
    return folder / "facility.toml"


EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"


def test_a_run_folder_s_copy_of_the_facility_holds_the_certificate(tmp_path: Path):
    path = facility_file(tmp_path, EXAMPLES)
    assert read_facility(path).reference.standard == STANDARD
    (tmp_path / "run").mkdir()
    copy = copy_facility(path, tmp_path / "run")
    (tmp_path / "standard.toml").unlink()
    assert read_facility(copy).reference.standard == STANDARD


def test_a_run_is_scaled_with_the_certificate_of_each_wavelength(tmp_path: Path):
    reference = FACILITY.reference.model_copy(update={"certificate": STANDARD})
    facility = FACILITY.model_copy(update={"reference": reference})
    for folder in ("with", "without"):
        (tmp_path / folder).mkdir()
    plan = plan_of(wavelength=(500.0, 700.0), zenith=(30.0,))
    certified = stage(tmp_path / "with", plan, facility=facility)
    stated = stage(tmp_path / "without", plan)
    assert {certified.run().outcome, stated.run().outcome} == {"finished"}
    with_it, without = run_of_journal(certified.journal()), run_of_journal(stated.journal())
    # The bench in memory reads alike both times; what was stated for both wavelengths is 0.99.
    ratio = with_it["brf"].values / without["brf"].values
    np.testing.assert_allclose(ratio, [0.990 / 0.99, 0.980 / 0.99], rtol=1e-3)
    relative = with_it["u_brf_reference"].values / with_it["brf"].values
    np.testing.assert_allclose(relative, [0.005, 0.003], rtol=1e-9)
    assert with_it.attrs["reference_standard"] == "SRS-99 no. 7"
    assert with_it.attrs["reference_certificate"] == "a metrology institute C-123"
