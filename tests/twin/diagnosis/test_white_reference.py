"""Scans of the white reference: closed forms of what an instrument that is off does to an ideal plate."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_runs import sweep

from instrument.artifact import read_artifact
from instrument.errors import InputError
from instrument.facility import read_facility
from sim_fixtures.examples import example_files
from twin.diagnosis.effects import Known, effect
from twin.diagnosis.joint import JointResponse, dimmed, light_of
from twin.diagnosis.observation import Observation
from twin.diagnosis.white_reference import prepare_white
from twin.material import lambertian

NAMES = (
    "illumination_zenith_offset",
    "sensor_zenith_offset",
    "sample_tilt",
    "reflectance_scale",
    "anisotropy",
    "detector_nonlinearity",
    "polarization",
)


@pytest.fixture(scope="module")
def bench() -> SimpleNamespace:
    """An unbounded even beam: the plate is lit with the cosine of incidence, and looks alike from everywhere."""
    files = example_files()
    facility = read_facility(files.facility)
    beam = facility.beam.model_copy(update={"diameter": "unbounded", "profile": "tophat", "radius_1_e2": None})
    facility = facility.model_copy(update={"beam": beam})
    known = Known(facility, read_artifact(files.artifact), lambertian(0.6))
    return SimpleNamespace(facility=facility, workbench=SimpleNamespace(known=known), inputs=None)


def plate(reading: float = 0.99) -> Observation:
    return sweep("white.nc", 40.0, (60.0, 40.0, 20.0, -20.0, -40.0, -60.0), reading)


@pytest.fixture(scope="module")
def prepared(bench):
    return prepare_white(bench, plate(), [effect(name) for name in NAMES])


def test_illumination_that_is_off_changes_the_cosine_of_incidence(prepared):
    """Reading over that of the reference, which is lit along the normal: cos(40 + d)/cos(40)/cos(d)."""
    off = 2.0
    found = prepared.responses.found["illumination_zenith_offset"].log_ratio(np.array([[off]]))[0]
    angle, by = np.deg2rad(40.0), np.deg2rad(off)
    np.testing.assert_allclose(found, np.log(np.cos(angle + by) / np.cos(angle) / np.cos(by)), atol=2e-4)


def test_a_lambertian_plate_in_an_even_beam_does_not_know_the_view(prepared):
    found = prepared.responses.found["sensor_zenith_offset"].log_ratio(np.array([[1.5]]))[0]
    np.testing.assert_allclose(found, 0.0, atol=1e-6)


@pytest.mark.parametrize("name", ["sample_tilt", "reflectance_scale", "anisotropy"])
def test_effects_of_the_sample_are_none_of_the_reference(prepared, name: str):
    response = prepared.responses.found[name]
    values = np.array([[p.cap[1] for p in response.parameters]])
    np.testing.assert_allclose(response.log_ratio(values), 0.0, atol=1e-12)


def test_effects_of_the_detector_act_on_the_reference(prepared):
    found = prepared.responses.found["polarization"].log_ratio(np.array([[0.1, 0.0]]))[0]
    # At azimuth 90 cos(180 degrees) sin^2(zenith); the reference's four azimuths cancel.
    np.testing.assert_allclose(found, np.log(1 - 0.1 * np.sin(np.deg2rad([60, 40, 20, 20, 40, 60])) ** 2), atol=1e-9)


def test_the_plate_has_an_error_of_placement_of_its_own(prepared):
    """Lit from 40 degrees, a tilt about y by d changes the cosine of incidence by -+ tan(40) d."""
    column = prepared.budget["white sample_tilt y_deg"]
    assert "sample_tilt y_deg" not in prepared.budget
    size = np.sqrt(np.mean((plate().components["placement"] / plate().brf) ** 2))
    assert np.sqrt(np.mean(column**2)) <= 1.05 * size
    assert np.ptp(column) < 1e-3 * abs(column[0])


def test_another_sample_is_not_taken_for_the_reference(bench):
    with pytest.raises(InputError, match=r"white.nc: brf: found a median of 0.45; expected the white reference"):
        prepare_white(bench, plate(0.45), [])


def test_a_dimmed_run_shares_the_nonlinearity_with_the_other(prepared):
    """To first order a quarter of the light has a quarter of the deviation, for a power of one."""
    part = prepared.responses.found["detector_nonlinearity"]
    bright, dim = (replace(part, run=replace(part.run, reference_current=i)) for i in (8e-7, 2e-7))
    assert light_of((bright, dim)) == (1.0, 0.25)
    assert light_of((bright, part)) == (1.0, 1.0)
    both = JointResponse((bright, dim), light=light_of((bright, dim)))
    value = np.array([[0.08, 1.0]])
    first, second = np.split(both.log_ratio(value)[0], 2)
    np.testing.assert_allclose(first, part.log_ratio(value)[0])
    np.testing.assert_allclose(second, part.log_ratio(np.array([[0.02, 1.0]]))[0])
    np.testing.assert_array_equal(dimmed("stray_light", value, 0.25), value)
