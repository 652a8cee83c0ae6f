"""What a scan could tell apart: arithmetic on made-up signatures, and the twin's signatures against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from traced_samples import artifact, facility, flat

from instrument.facility import Arms, Budget, Facility
from twin.design.separation import (
    EFFECTS,
    Information,
    Signatures,
    candidate_points,
    information,
    separation,
    signatures,
)
from twin.material import lambertian

NOISE = Budget(measurement_noise=0.01)


def bench(budget: Budget = NOISE, **arms: object) -> Facility:
    return facility(10.8, profile="gaussian", mirror=10.8).model_copy(update={"budget": budget, "arms": Arms(**arms)})


def made_up(shapes: list[np.ndarray], plane: np.ndarray | None = None) -> Signatures:
    """Signatures without noise on points of reflectance factor 1."""
    count = len(shapes[0])
    zero = np.zeros(count)
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    change = np.repeat(np.array(shapes, dtype=float)[:, :, None], 8, axis=2)
    plane = np.zeros(count, dtype=int) if plane is None else plane
    return Signatures(dict.fromkeys(names, zero), plane, zero + 1, change, EFFECTS[: len(shapes)])


def judged(shapes: list[np.ndarray], budget: Budget = NOISE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    found = separation(information(made_up(shapes), bench(budget)), [0])
    return found.detectable, found.distinct, found.angle


def test_an_effect_alone_stands_out_by_its_length_over_the_noise() -> None:
    detectable, distinct, _ = judged([np.full(25, 0.02)])
    assert detectable[0] == pytest.approx(10.0, rel=1e-3)  # 0.02/0.01 * sqrt(25)
    assert distinct[0] == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize("degrees", [90.0, 30.0, 5.0])
def test_the_angle_between_signatures_decides_what_is_left(degrees: float) -> None:
    angle = np.deg2rad(degrees)
    first, second = np.array([0.1, 0.0]), 0.1 * np.array([np.cos(angle), np.sin(angle)])
    detectable, distinct, found = judged([first, second])
    assert found[0, 1] == pytest.approx(degrees, abs=0.02)
    assert distinct[0] == pytest.approx(10 * np.sin(angle), rel=2e-3)
    assert detectable[0] == pytest.approx(10.0, rel=1e-3)


def test_equal_signatures_are_not_told_apart() -> None:
    _, distinct, angle = judged([np.full(4, 0.1), np.full(4, 0.1)])
    assert np.all(distinct < 0.05)
    assert angle[0, 1] == pytest.approx(0.0, abs=1.0)


def test_a_common_scale_hides_what_looks_like_it() -> None:
    even, odd = np.full(100, 0.01), np.tile([0.01, -0.01], 50)
    budget = Budget(measurement_noise=0.01, reference_material=0.01)
    detectable, *_ = judged([even, odd], budget)
    # Variance of a mean of 100: 0.01^2/100, and of the scale, 0.01^2.
    assert detectable[0] == pytest.approx(1 / np.sqrt(1 + 1 / 100), rel=1e-3)
    assert detectable[1] == pytest.approx(10.0, rel=1e-3)


def test_instability_hides_an_offset_of_a_plane_and_not_of_a_point() -> None:
    even, odd = np.full(100, 0.01), np.tile([0.01, -0.01], 50)
    detectable, *_ = judged([even, odd], Budget(instrument_stability=0.01))
    half = 0.01**2 / 2
    assert detectable[0] == pytest.approx(0.01 / np.sqrt(half + half / 100), rel=1e-3)
    assert detectable[1] == pytest.approx(0.01 * 10 / np.sqrt(half), rel=1e-3)


def test_noise_of_signatures_does_not_pass_for_signal() -> None:
    pure = made_up([np.zeros(400)])
    noisy = np.random.default_rng(3).normal(0.0, 0.05, pure.change.shape)
    found = information(Signatures(pure.columns, pure.plane, pure.brf, noisy, pure.effects), bench())
    biased = (noisy.mean(axis=2) ** 2).sum() / 0.01**2
    assert biased > 1000
    assert found.matrices[0, 0, 0] < 0.3 * biased


def test_planes_are_chosen_for_what_is_not_known_yet() -> None:
    def knows(*amounts: float) -> np.ndarray:
        return np.diag(np.array(amounts, dtype=float))

    known = Information(np.array([knows(50, 0), knows(100, 0), knows(0, 30), knows(40, 0)]), ("a", "b"))
    assert known.choose([0], 3) == [0, 2, 1]
    assert known.choose([0], 9) == [0, 2, 1, 3]


def test_candidate_planes_respect_the_arms_and_the_shadow() -> None:
    arms = {"sensor_zenith": (-40.0, 70.0), "sensor_azimuth": (20.0, 100.0)}
    columns, plane = candidate_points(bench(**arms), np.array([0.0, 15.0]), 500.0, 10.0, 15.0)
    assert set(columns["sensor_azimuth"]) == {30.0, 45.0, 60.0, 75.0, 90.0}
    assert columns["sensor_zenith"].min() == -40.0
    assert columns["sensor_zenith"].max() == 70.0
    assert not np.any((columns["illumination_zenith"] == 0) & (columns["sensor_zenith"] == 0))
    assert plane.max() == 9


def test_half_a_turn_of_planes_is_enough() -> None:
    columns, _ = candidate_points(bench(), np.array([15.0]), 500.0, 20.0, 30.0)
    assert sorted(set(columns["sensor_azimuth"])) == [0.0, 30.0, 60.0, 90.0, 120.0, 150.0]


def test_signatures_of_a_flat_lambertian_sample_have_a_closed_form() -> None:
    """Radiance follows cos(incidence), the commanded cosine of the view no longer cancels that of the footprint."""
    beam = bench().beam.model_copy(update={"diameter": "unbounded", "profile": "tophat"})
    wide = bench(sensor_zenith=(-60.0, 60.0)).model_copy(update={"beam": beam})  # where it sees nothing but the sample
    columns, plane = candidate_points(wide, np.array([20.0]), 500.0, 40.0, 90.0)
    found = signatures(wide, flat(), lambertian(0.5), columns, plane)
    names = [effect.name for effect in found.effects]
    assert "hole_diameter" not in names
    np.testing.assert_allclose(found.brf, 0.5, rtol=1e-4)
    # Tilted about y towards the light, the surface receives cos(20 - 0.25 degrees).
    tilt = found.change[names.index("sample_tilt y")].mean(axis=-1)
    expected = 0.5 * np.tan(np.deg2rad(20.0)) * np.deg2rad(0.25)
    np.testing.assert_allclose(tilt, expected, rtol=2e-2)
    for unseen in ("sample_height", "beam_offset x", "sensor_zenith_offset"):
        np.testing.assert_allclose(found.change[names.index(unseen)], 0.0, atol=2e-5)


def test_a_lattice_tells_a_tilt_from_a_height() -> None:
    columns, plane = candidate_points(bench(), np.array([15.0]), 500.0, 40.0, 60.0)
    found = signatures(bench(), artifact(), lambertian(0.5), columns, plane, samples=64)
    assert [effect.name for effect in found.effects] == [effect.name for effect in EFFECTS]
    wider = found.change[[e.name for e in found.effects].index("hole_diameter")].mean(axis=-1)
    # Wider holes swallow light: 2 delta/d of the open fraction, about 0.39, half of which comes out again.
    assert np.all(wider < 0)
    judged = separation(information(found, bench()), list(range(int(plane.max()) + 1)))
    assert np.all(judged.distinct <= judged.detectable * (1 + 1e-9))
    assert judged.score > 0
