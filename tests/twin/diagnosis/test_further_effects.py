"""Causes beyond the catalogue: readings against closed forms, limits of the sample, and that none is ever named."""

from __future__ import annotations

import numpy as np
import pytest
from traced_samples import artifact, columns, facility, flat

from twin.artifact import Surface
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.effects import (
    AzimuthEffect,
    Known,
    ReadingEffect,
    SceneEffect,
    TopEffect,
    ZenithEffect,
    effect,
    library,
)
from twin.material import lambertian

ZENITH = np.array([60.0, 30.0, 0.0, -30.0, -60.0])
AZIMUTH = np.array([0.0, 45.0, 90.0, 135.0, 180.0])


def acquisition(zenith: np.ndarray = ZENITH, azimuth: np.ndarray = AZIMUTH) -> Acquisition:
    where = columns(30.0, zenith, azimuth)
    count = len(zenith)
    order = np.arange(count)
    previous, travel = np.maximum(order - 1, 0), travel_direction(where, order)
    of_reference = np.array([0.0, 90.0, 180.0, 270.0])
    return Acquisition(where, np.full(count, 0.8), 60.0, of_reference, previous, travel, np.linspace(0, 1, count))


def read(name: str, *values: float, run: Acquisition | None = None, brf: float = 0.5) -> np.ndarray:
    found = effect(name)
    assert isinstance(found, ReadingEffect)
    run = run or acquisition()
    return found.reading(run, np.full(len(run), brf), np.array(values))


@pytest.mark.parametrize("found", [e for e in library().values() if not e.catalogued], ids=lambda e: e.name)
def test_a_cause_beyond_the_catalogue_does_nothing_at_its_nominal_values(found):
    run = acquisition()
    nominal = np.array([p.nominal for p in found.resolve(Known(facility(), artifact(), lambertian(0.6)), run)])
    if isinstance(found, ReadingEffect):
        np.testing.assert_allclose(found.reading(run, np.full(len(run), 0.5), nominal), 0.5, rtol=1e-12)
    elif isinstance(found, ZenithEffect):
        np.testing.assert_allclose(found.zenith_error(run, nominal[None]), 0.0, atol=1e-12)
    elif isinstance(found, AzimuthEffect):
        np.testing.assert_allclose(found.azimuth_error(run, nominal[None]), 0.0, atol=1e-12)
    elif isinstance(found, TopEffect):
        np.testing.assert_allclose(found.change(np.zeros((1, 2)), nominal[None]), 0.0, atol=1e-12)
    else:
        variation = found.variation(nominal)
        assert not variation.artifact
        assert all(ratio == 1.0 for _, ratio in variation.surface_factor)


def test_response_that_falls_with_the_view_is_a_power_of_its_cosine_over_that_of_the_reference():
    # The reference was read at 60 degrees, whose cosine is a half.
    expected = 0.5 * (np.cos(np.deg2rad(ZENITH)) / 0.5) ** 0.2
    np.testing.assert_allclose(read("directional_response", 0.2), expected)


def test_twisted_fibre_loses_light_once_a_turn_and_nothing_in_the_mean_of_the_reference():
    turned = np.deg2rad(AZIMUTH)
    expected = 0.5 * (1 + 0.03 * np.cos(turned) - 0.02 * np.sin(turned))
    np.testing.assert_allclose(read("cable_torsion", 0.03, -0.02), expected)


def test_azimuth_scale_is_off_the_more_the_farther_from_the_plane_of_incidence():
    found, run = effect("azimuth_scale"), acquisition()
    assert isinstance(found, AzimuthEffect)
    signed = np.where(AZIMUTH > 180, AZIMUTH - 360.0, AZIMUTH)
    np.testing.assert_allclose(found.azimuth_error(run, np.array([[0.05]]))[0], 0.05 * signed)


def test_source_jumps_between_two_points_and_stays():
    run = acquisition(np.linspace(70.0, -70.0, 41), np.zeros(41))
    found = read("source_jump", 0.05, 0.51, run=run)
    assert run.progress is not None
    np.testing.assert_allclose(found[run.progress < 0.48], 0.5, rtol=1e-4)
    np.testing.assert_allclose(found[run.progress > 0.54], 0.525, rtol=1e-4)


def test_ghost_is_brightest_in_its_direction_and_has_fallen_to_1_e_at_its_width():
    run = acquisition(np.array([20.0, 30.0, 10.0, -20.0]), np.full(4, 90.0))
    found = read("ghost", 0.04, 20.0, 90.0, 10.0, run=run) - 0.5
    assert found[0] == pytest.approx(0.04)
    np.testing.assert_allclose(found[1:3], 0.04 / np.e, rtol=1e-9)
    assert found[3] == pytest.approx(0.04 * np.exp(-16.0))
    # The direction behind the normal is the same with the zenith negative and the azimuth half a turn on.
    behind = read("ghost", 0.04, -20.0, 90.0, 10.0, run=run) - 0.5
    assert behind[3] == pytest.approx(0.04)


def test_arm_whose_steps_are_too_long_is_off_in_proportion_to_the_angle():
    found = effect("zenith_scale")
    assert isinstance(found, ZenithEffect)
    np.testing.assert_allclose(found.zenith_error(acquisition(), np.array([[0.01]]))[0], 0.01 * ZENITH, atol=1e-12)
    assert found.reference_setup(np.array([0.01]), 60.0).sensor_zenith_deg == pytest.approx(0.6)


def test_floor_wedge_tilts_the_block_within_the_cavity():
    known = Known(facility(), artifact(), lambertian(0.6))
    found = effect("floor_wedge")
    assert isinstance(found, SceneEffect)
    (change,) = found.variation(np.array([0.5, -0.2])).artifact
    form = change.dimensions(known.artifact).form
    assert (form.block_tilt_x, form.block_tilt_y) == (0.5, -0.2)
    # At the caps of both the floor stays below the plate: dimensions that did not would be refused.
    steepest = np.array([p.cap[1] for p in found.resolve(known)])
    for signs in ((1, 1), (1, -1), (-1, -1)):
        (change,) = found.variation(steepest * signs).artifact
        change.dimensions(known.artifact)


def test_walls_alone_are_brighter_or_darker():
    found = effect("wall_reflectance")
    assert isinstance(found, SceneEffect)
    assert found.variation(np.array([0.8])).surface_factor == ((Surface.HOLE_WALL, 0.8),)


@pytest.mark.parametrize("name", ["floor_wedge", "wall_reflectance"])
def test_flat_sample_has_neither_floor_nor_walls(name: str):
    assert effect(name).not_applicable(Known(facility(), flat(), lambertian(0.6)))
