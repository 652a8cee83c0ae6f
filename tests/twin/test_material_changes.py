from __future__ import annotations

import numpy as np
import pytest

from instrument.errors import InputError
from twin.material import Material, lambertian
from twin.material_changes import (
    microfacet,
    normal_facets,
    retro_angle_rad,
    retroreflection_lobe,
    specular_lobe,
    with_retroreflection,
    with_specular_lobe,
)
from twin.reflection_models.compiled import zenith_grid


def directions(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return (
        np.sqrt(random.uniform(0, 1, count)),
        random.uniform(0, 2 * np.pi, count),
        np.sqrt(random.uniform(0, 1, count)),
    )


def uneven() -> Material:
    """A coarse table whose values differ from node to node."""
    grid = zenith_grid([0, 20, 50, 90], [0, 60, 180])
    random = np.random.default_rng(3)
    half = random.uniform(0.1, 0.2, (4, 3, 4))
    return Material(
        grid.cos_o, grid.phi_rad, grid.cos_i, np.concatenate([half, half[:, 1::-1]], axis=1)[None], name="m"
    )


def test_the_retro_angle_is_the_angle_between_the_two_directions() -> None:
    cos_o, phi, cos_i = directions(500)
    sin_o, sin_i = np.sqrt(1 - cos_o**2), np.sqrt(1 - cos_i**2)
    expected = np.arccos(np.clip(cos_o * cos_i + sin_o * sin_i * np.cos(phi), -1, 1))
    np.testing.assert_allclose(retro_angle_rad(cos_o, phi, cos_i), expected, atol=1e-7)
    assert retro_angle_rad(np.array(0.7), np.array(1e-9), np.array(0.7)) == pytest.approx(1e-9 * np.sqrt(1 - 0.49))


@pytest.mark.parametrize("width", [3.0, 10.0])
def test_a_retro_peak_has_its_amplitude_and_falls_to_1_e_at_its_width(width: float) -> None:
    material = with_retroreflection(lambertian(0.5), 0.1, width)
    zenith = material.cos_i[np.argmin(np.abs(material.cos_i - np.cos(np.deg2rad(40))))]
    at_peak = np.pi * material.evaluate(zenith, 0.0, zenith) - 0.5
    at_width = np.pi * material.evaluate(np.cos(np.arccos(zenith) + np.deg2rad(width)), 0.0, zenith) - 0.5
    assert at_peak == pytest.approx(0.1, rel=1e-9)
    assert at_width == pytest.approx(0.1 / np.e, rel=0.02)


@pytest.mark.parametrize("width", [3.0, 6.0, 10.0, 25.0])
def test_the_stated_gridding_error_of_a_retro_peak_holds_at_other_directions(width: float) -> None:
    lobe = retroreflection_lobe(lambertian(0.5), width)
    material = lobe.added(0.2)
    cos_o, phi, cos_i = directions(100_000, seed=9)
    exact = np.exp(-retro_angle_rad(cos_o, phi, cos_i) / np.deg2rad(width))
    difference = (np.pi * material.evaluate(cos_o, phi, cos_i) - 0.5) / 0.2 - exact
    assert np.sqrt(np.mean(difference**2) / np.mean(exact**2)) == pytest.approx(lobe.error.relative_rms, rel=0.25)
    assert np.max(np.abs(difference)) < 1.5 * lobe.error.largest
    assert lobe.error.relative_rms < 0.05
    assert "the grid changes the lobe by" in material.notes[-1]


def test_away_from_a_lobe_the_material_is_unchanged() -> None:
    base = uneven()
    cos_o, phi, cos_i = directions(2000)
    far = retro_angle_rad(cos_o, phi, cos_i) > np.deg2rad(60)
    changed = with_retroreflection(base, 0.1, 3.0)
    np.testing.assert_allclose(
        changed.evaluate(cos_o, phi, cos_i)[far], base.evaluate(cos_o, phi, cos_i)[far], atol=1e-8
    )
    np.testing.assert_allclose(
        with_retroreflection(base, 0.0, 5.0).evaluate(cos_o, phi, cos_i), base.evaluate(cos_o, phi, cos_i), rtol=1e-12
    )


@pytest.mark.parametrize("normal", [0.0, 0.4, 1.0])
def test_a_specular_lobe_peaks_about_the_mirror_direction(normal: float) -> None:
    material = with_specular_lobe(lambertian(0.4), 0.02, 0.2, normal)
    cosine = np.cos(np.deg2rad(30))
    others = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    mirror = material.evaluate(cosine, np.pi, cosine)
    assert np.all(mirror > material.evaluate(cosine, np.delete(others, 25), cosine))
    # At normal incidence: D = 1/(pi alpha^2) for both laws of the slopes, no masking.
    at_normal = material.evaluate(1.0, 0.0, 1.0) - 0.4 / np.pi
    assert at_normal == pytest.approx(0.02 / (4 * np.pi * 0.2**2), rel=1e-6)


@pytest.mark.parametrize(
    ("facets", "steeper_than_45"),
    [(microfacet, lambda a: a**2 / (1 + a**2)), (normal_facets, lambda a: np.exp(-1 / a**2))],
)
def test_the_microfacet_lobe_is_reciprocal_and_keeps_the_energy(facets, steeper_than_45) -> None:
    cos_o, phi, cos_i = directions(300)
    np.testing.assert_allclose(facets(cos_o, phi, cos_i, 0.3), facets(cos_i, phi, cos_o, 0.3), rtol=1e-12)
    mu, weight = np.polynomial.legendre.leggauss(400)
    mu, weight = (mu + 1) / 2, weight / 2
    azimuth = (np.arange(400) + 0.5) * 2 * np.pi / 400
    # Lost at normal incidence: what facets steeper than 45 degrees send downwards, and what is hidden.
    for incidence, roughness in ((1.0, 0.1), (0.7, 0.1), (1.0, 0.3)):
        values = facets(mu[:, None], azimuth[None, :], np.array(incidence), roughness)
        total = np.sum(values * (weight * mu)[:, None]) * 2 * np.pi / 400
        sent_up = 1 - steeper_than_45(roughness)
        assert sent_up - 0.06 < total < (sent_up if incidence == 1.0 else 1.0)


def test_masking_leaves_the_projected_area_that_is_seen() -> None:
    """What a view sees of the facets is the area of the plane: the integral of D over them, hidden ones left out."""
    mu, weight = np.polynomial.legendre.leggauss(600)
    mu, weight = (mu + 1) / 2, weight / 2
    azimuth = (np.arange(600) + 0.5) * 2 * np.pi / 600
    roughness = 0.4
    density = np.exp(-(1 / mu**2 - 1) / roughness**2) / (np.pi * roughness**2 * mu**4)
    for view in np.deg2rad([20.0, 60.0, 80.0]):
        towards = np.cos(view) * mu[:, None] + np.sin(view) * np.sqrt(1 - mu[:, None] ** 2) * np.cos(azimuth)
        facing = np.sum(np.maximum(towards, 0) * (density * weight)[:, None]) * 2 * np.pi / 600
        seen = np.cos(view) / facing
        # Light from 1e-3 off the view: facets that face it send it back, seen twice through the masking.
        cosine, off = np.array(np.cos(view)), np.array(1e-3)
        at_view = np.exp(-(np.tan(view) ** 2) / roughness**2) / (np.pi * roughness**2 * np.cos(view) ** 4)
        found = float(normal_facets(cosine, off, cosine, roughness)) * 4 * np.cos(view) ** 2 / at_view
        assert found == pytest.approx(seen**2, rel=1e-3)


def test_the_stated_gridding_error_of_a_specular_lobe_holds_at_other_directions() -> None:
    lobe = specular_lobe(lambertian(0.5), 0.3)
    cos_o, phi, cos_i = directions(100_000, seed=9)
    exact = np.pi * microfacet(cos_o, phi, cos_i, 0.3)
    got = (np.pi * lobe.added(0.01).evaluate(cos_o, phi, cos_i) - 0.5) / 0.01
    assert np.sqrt(np.mean((got - exact) ** 2) / np.mean(exact**2)) < 2 * lobe.error.relative_rms


def test_a_scaled_material_is_scaled_in_every_direction() -> None:
    cos_o, phi, cos_i = directions(50)
    base = uneven()
    np.testing.assert_allclose(base.scaled(0.84).evaluate(cos_o, phi, cos_i), 0.84 * base.evaluate(cos_o, phi, cos_i))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: with_retroreflection(m, 0.1, 0.0), "width: found 0 degrees"),
        (lambda m: with_retroreflection(m, 20.0, 20.0), "times over"),
        (lambda m: with_retroreflection(m, -2.0, 5.0), "entries are negative"),
        (lambda m: with_specular_lobe(m, 0.1, 0.0), "roughness: found 0"),
        (lambda m: with_specular_lobe(m, 0.1, 0.3, 1.2), "share of normal slopes: found 1.2; expected 0 to 1"),
        (lambda m: m.scaled(-0.1), "entries are negative"),
        (lambda m: m.scaled(3.0), "times over"),
    ],
)
def test_changes_that_no_surface_can_have_are_refused(change, message: str) -> None:
    with pytest.raises(InputError, match=message):
        change(lambertian(0.5))
