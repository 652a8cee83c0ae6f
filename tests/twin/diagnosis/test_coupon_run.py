"""Runs of the flat coupon beside those of the sample: what they see, against the simulated laboratory's own coupon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_runs import sweep

from instrument.errors import InputError
from instrument.facility import Facility
from sim_fixtures.examples import example_files
from sim_fixtures.examples.coupon import flat_sample
from sim_fixtures.reality import Imperfections, Reality
from twin.diagnosis.coupon_run import acts_without_sample, only_places, prepare_coupon, table_errors
from twin.diagnosis.effects import effect, library
from twin.diagnosis.observation import Observation
from twin.diagnosis.plausible import flat_reflectance
from twin.diagnosis.preparation import Bench, Inputs, Prepared
from twin.diagnosis.response import no_response

OFF_DEG = 1.2
NAMES = ("sensor_zenith_offset", "sample_tilt", "hole_diameter", "reflectance_scale", "anisotropy", "polarization")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    files = example_files()
    return Bench(Inputs(files.facility, files.artifact, files.material), tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def flat(bench: Bench) -> Bench:
    return bench.flat()


def coupon(bench: Bench, factor: float = 1.0) -> Observation:
    """A run whose readings are the table's, times a factor."""
    run = sweep("coupon.nc", 30.0, (70.0, 45.0, 20.0, -20.0, -45.0, -70.0))
    return replace(run, brf=factor * flat_reflectance(bench.material, run))


@pytest.fixture(scope="module")
def prepared(bench: Bench, flat: Bench) -> Prepared:
    known = bench.workbench.known
    shown = [no_response(effect(name), effect(name).resolve(known), 1) for name in NAMES]
    return prepare_coupon(flat, coupon(bench), shown)


def reading_with(facility: Facility, run: Observation, off: float) -> np.ndarray:
    """What another program than the twin says of the coupon with the sensor's zenith off, reference included."""
    exact = Imperfections()
    reality = Reality(facility, flat_sample(), replace(exact, sensor_zenith_offset_deg=off), 5, rays=16384)
    angles = zip(*(run.columns[n] for n in ("illumination_zenith", "sensor_zenith", "sensor_azimuth")), strict=True)
    sample = np.array([reality.flux("sample", *map(float, g), 500.0) for g in angles])
    at = facility.reference
    azimuth = np.array(at.sensor_azimuth)
    plate = reality.flux_many("reference", at.illumination_zenith, np.full(len(azimuth), at.sensor_zenith), azimuth)
    return sample / plate.mean()


def test_an_arm_that_is_off_changes_the_coupon_as_another_program_says(bench: Bench, prepared: Prepared) -> None:
    run = coupon(bench)
    found = prepared.responses.found["sensor_zenith_offset"].log_ratio(np.array([[OFF_DEG]]))[0]
    wanted = np.log(reading_with(bench.facility, run, OFF_DEG) / reading_with(bench.facility, run, 0.0))
    assert np.ptp(wanted) > 0.05
    np.testing.assert_allclose(found, wanted, atol=0.003)


def test_an_arm_that_is_off_errs_oppositely_on_the_two_sides_of_the_coupon_as_another_program_says(
    bench: Bench,
) -> None:
    run = coupon(bench)
    zenith = run.columns["sensor_zenith"]
    change = np.log(reading_with(bench.facility, run, OFF_DEG) / reading_with(bench.facility, run, 0.0))
    at_zenith = dict(zip(zenith, change, strict=True))
    assert all(at_zenith[z] < at_zenith[-z] for z in (20.0, 45.0, 70.0))
    state = bench.state()
    (error,) = (block for block in state.blocks if block.name == "material sensor zenith")
    coupon_error = state.inputs(np.where(np.array(state.labels) == error.labels[0], 1.0, state.nominal)).coupon_error
    assert coupon_error is not None
    assert state.coupon is not None
    side = np.sign(state.coupon["sensor_zenith"].values)
    np.testing.assert_array_equal(np.sign(coupon_error), side)


@pytest.mark.parametrize("name", ["sample_tilt", "hole_diameter", "reflectance_scale", "anisotropy"])
def test_effects_of_the_sample_are_none_of_the_coupon(prepared: Prepared, name: str) -> None:
    response = prepared.responses.found[name]
    values = np.array([[p.cap[1] for p in response.parameters]])
    np.testing.assert_array_equal(response.log_ratio(values), 0.0)


def test_the_coupon_has_an_error_of_placement_of_its_own(prepared: Prepared) -> None:
    assert "sample_tilt x_deg" not in prepared.budget
    assert np.any(prepared.budget["coupon sample_tilt x_deg"])


def test_effects_are_told_apart_by_what_they_change(bench: Bench) -> None:
    known = bench.workbench.known
    resolved = {name: (one, one.resolve(known)) for name, one in library().items() if not one.not_applicable(known)}
    acting = {name for name, (one, parameters) in resolved.items() if acts_without_sample(one, parameters)}
    placing = {name for name, (one, parameters) in resolved.items() if only_places(one, parameters)}
    assert placing == {"sample_tilt", "sample_height", "sample_offset", "sample_azimuth"}
    of_the_sample = {"hole_diameter", "cavity_depth", "reflectance_scale", "cavity_reflectance", "specular_lobe"}
    of_the_sample |= {"retroreflection", "translucency", "anisotropy", "edge_chamfer", "plate_thickness"}
    assert not acting & (placing | of_the_sample)
    assert acting >= {"illumination_zenith_offset", "beam_divergence", "field_of_view", "dark_offset", "source_drift"}


def test_a_common_error_of_the_first_coupon_run_is_the_same_on_every_point(bench: Bench) -> None:
    """The reference's reflectance is uncertain by 0.5 %, and so is every value of the table."""
    found = dict(table_errors(bench, coupon(bench)))
    np.testing.assert_allclose(found["material reference", 0], 0.005, rtol=1e-3)
    np.testing.assert_allclose(found["material reference", 1], 0.0, atol=1e-5)


def test_another_sample_is_not_taken_for_the_coupon(bench: Bench, flat: Bench) -> None:
    with pytest.raises(InputError, match=r"coupon.nc: brf: found 0.7 times what a flat coupon of material.nc reflects"):
        prepare_coupon(flat, coupon(bench, 0.7), [])
