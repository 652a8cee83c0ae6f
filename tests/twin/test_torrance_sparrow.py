from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_coupon_smooth import rough, run_of

from instrument.errors import InputError
from twin.coupon import coupon_readings
from twin.reflection_models import Origin
from twin.reflection_models.smooth import left_out
from twin.reflection_models.torrance_sparrow import (
    TorranceSparrow,
    fit_torrance_sparrow,
    fresnel,
    torrance_sparrow,
    torrance_sparrow_model,
)


def test_fresnels_reflectance_has_its_known_values() -> None:
    assert fresnel(np.array(1.0), 1.5) == pytest.approx(0.04)
    assert fresnel(np.array(0.0), 1.5) == pytest.approx(1.0)
    # At Brewster's angle one polarisation vanishes: half of the other is left.
    brewster = np.cos(np.arctan(1.5))
    assert fresnel(np.array(brewster), 1.5) == pytest.approx(((1.5**2 - 1) / (1.5**2 + 1)) ** 2 / 2)


def test_a_fit_finds_the_numbers_that_made_the_readings() -> None:
    truth = TorranceSparrow(0.5, 0.35, 1.45)
    run = run_of(
        lambda i, o, p: np.pi * truth.brdf(np.cos(np.deg2rad(o)), np.deg2rad(p), np.cos(np.deg2rad(i))), noise=0.002
    )
    (readings,) = coupon_readings(run, "c").values()
    fit = fit_torrance_sparrow(readings.directions(), readings.brf)
    assert fit.model.base == pytest.approx(0.5, rel=0.01)
    assert fit.model.roughness == pytest.approx(0.35, rel=0.02)
    assert fit.model.refractive_index == pytest.approx(1.45, rel=0.01)
    assert fit.rms == pytest.approx(0.002, rel=0.15)


def test_a_rough_coating_is_described_worse_than_by_its_own_readings() -> None:
    (readings,) = coupon_readings(run_of(rough, 0.004), "c").values()
    fit = fit_torrance_sparrow(readings.directions(), readings.brf)
    others = left_out(readings.directions(), readings.brf) / readings.brf - 1
    assert fit.rms > 2 * np.sqrt(np.mean(others**2))


def test_the_table_follows_the_model_within_the_stated_error() -> None:
    model = TorranceSparrow(0.4, 0.3, 1.4)
    material = torrance_sparrow([model], None, "ts")
    random = np.random.default_rng(8)
    cos_o, cos_i = np.sqrt(random.uniform(0.03, 1, (2, 20000)))
    phi = random.uniform(0, 2 * np.pi, 20000)
    exact = model.brdf(cos_o, phi, cos_i)
    error = np.sqrt(np.mean((material.evaluate(cos_o, phi, cos_i) - exact) ** 2) / np.mean(exact**2))
    assert error < 2 * material.gridding_error
    assert material.gridding_error < 0.03


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "expected base, roughness and refractive_index, or file alone"),
        ({"base": 0.5, "roughness": 0.3}, "expected base, roughness and refractive_index"),
        ({"base": 0.5, "roughness": -0.3, "refractive_index": 1.5}, "roughness: found -0.3"),
        ({"file": "absent.nc"}, "file: found 'absent.nc'; expected a file"),
        ({"base": 0.9, "roughness": 0.1, "refractive_index": 1.5}, "times over"),
    ],
)
def test_wrong_settings_are_named(settings: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        torrance_sparrow_model(settings, Origin(tmp_path, "material.toml: [floor]"))
