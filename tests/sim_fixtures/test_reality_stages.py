"""The photon tracer with a turned sample and behind a polariser."""

from __future__ import annotations

import pytest

from instrument.artifact import read_artifact
from instrument.facility import Facility
from sim_fixtures.examples import example_files
from sim_fixtures.polarizer import DEGREE, TRANSMISSION
from sim_fixtures.reality import Imperfections, Reality


def reality(facility: Facility, **wrong: float) -> Reality:
    return Reality(facility, read_artifact(example_files().artifact), Imperfections(**wrong), seed=1, rays=8192)


def test_a_turned_sample_is_one_whose_azimuth_is_off(facility: Facility) -> None:
    turned = reality(facility).flux("sample", 15.0, 40.0, 45.0, 500.0, sample_rotation=30.0)
    assert turned == reality(facility, sample_azimuth_deg=30.0).flux("sample", 15.0, 40.0, 45.0, 500.0)
    assert turned != reality(facility).flux("sample", 15.0, 40.0, 45.0, 500.0)


def test_the_reference_does_not_care_how_it_is_turned(facility: Facility) -> None:
    known = reality(facility)
    assert known.flux("reference", 0.0, 15.0, 0.0, 500.0, sample_rotation=30.0) == known.flux(
        "reference", 0.0, 15.0, 0.0
    )


def test_the_means_of_s_and_p_lose_the_effect_of_polarisation(facility: Facility) -> None:
    sound, wrong = reality(facility), reality(facility, polarization=0.004)
    at = ("sample", 15.0, 60.0, 0.0, 500.0)
    without = wrong.flux(*at) / sound.flux(*at)
    assert without == pytest.approx(1 + 0.004 * 0.75, rel=1e-9)  # sin^2 60
    p, s = (wrong.flux(*at, polarizer=angle) / sound.flux(*at) for angle in (0.0, 90.0))
    assert p + s == pytest.approx(TRANSMISSION * without, rel=1e-9)
    # Each weighed with the light that passes: what is left has no effect of polarisation.
    assert p / (1 + DEGREE) + s / (1 - DEGREE) == pytest.approx(TRANSMISSION, rel=1e-9)
