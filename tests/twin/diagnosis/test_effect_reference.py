"""Responses against another laboratory's ray tracer, which shares neither code nor mesh: the example cases' changes.

The cases say what was changed and the relative change of every point without noise (``delta``). They check the physics
of an effect, at an amplitude of their choice; nothing is fitted to them.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from traced_samples import shared_file

from instrument.artifact import read_artifact
from instrument.facility import read_facility
from twin.diagnosis.acquisition import acquisition_of
from twin.diagnosis.effects import ReadingEffect, SceneEffect, ZenithEffect, effect
from twin.diagnosis.observation import read_observation
from twin.diagnosis.renders import RenderStore
from twin.diagnosis.variation import Variation
from twin.diagnosis.workbench import Workbench
from twin.material import read_material
from twin.optics import Setup

DEG = 180 / np.pi
#: Case, effect, and its parameters from the case's components.
#: How far the size may be off: the other laboratory's source settles, ours here drifts steadily.
READINGS = [
    ("dev09", "stray_light", lambda a: [a[0]], 0.02),
    ("dev10", "detector_nonlinearity", lambda a: [a[0], 1.0], 0.02),
    ("dev12", "source_drift", lambda a: [a[0], 0.0], 0.3),
    ("dev13", "stale_sample", lambda a: [a[0]], 0.1),
]
SCENES = [
    ("dev04", "sample_tilt", lambda a: [a[0] * DEG, a[1] * DEG, 0.0]),
    ("dev05", "sensor_zenith_offset", lambda a: [a[0] * DEG]),
    ("dev06", "beam_offset", lambda a: [0.0, a[0]]),
    ("dev07", "cavity_reflectance", lambda a: [1 + a[0]]),
    ("dev08", "edge_chamfer", lambda a: [a[0]]),
    ("dev14", "hole_diameter", lambda a: [a[0]]),
]


def case(name: str):
    truth = json.loads(shared_file("cases", "dev", "truth.json").read_text())[name]
    observation = read_observation(shared_file("cases", "dev", f"{name}.nc"))
    delta = np.array(truth["delta"])[observation.rows]
    nominal = np.array(truth["brf_true"])[observation.rows] / (1 + delta)
    return observation, [component[1] for component in truth["components"]], delta, nominal


def agreement(found: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Cosine between two changes, and the size of the first along the second."""
    size = np.linalg.norm(found) * np.linalg.norm(expected)
    return float(found @ expected / size), float(found @ expected / (expected @ expected))


@pytest.mark.parametrize(("name", "which", "values", "tolerance"), READINGS)
def test_effect_on_the_reading_agrees_with_the_other_laboratory(name: str, which: str, values, tolerance: float):
    observation, amplitudes, delta, nominal = case(name)
    run = acquisition_of(observation, read_facility(shared_file("cases", "common", "facility.toml")))
    reading = effect(which)
    assert isinstance(reading, ReadingEffect)
    found = reading.reading(run, nominal, np.array(values(amplitudes))) / nominal - 1
    cosine, size = agreement(found, delta)
    assert cosine > 0.97
    assert size == pytest.approx(1, abs=tolerance)


def test_backlash_has_the_sign_of_the_other_laboratory():
    observation, amplitudes, delta, _ = case("dev17")
    run = acquisition_of(observation, read_facility(shared_file("cases", "common", "facility.toml")))
    play = effect("backlash")
    assert isinstance(play, ZenithEffect)
    error = play.zenith_error(run, np.array([[amplitudes[0] * DEG]]))[0] / DEG
    # What a flat sample would read: the rest of the change is the artifact's own.
    cosine, _ = agreement(-np.tan(np.deg2rad(run.columns["sensor_zenith"])) * error, delta)
    assert cosine > 0.9


@pytest.mark.slow
def test_rendered_effects_agree_with_the_other_laboratory(tmp_path: Path):
    common = shared_file("cases", "common", "facility.toml").parent
    facility = read_facility(common / "facility.toml")
    bench = Workbench(
        facility, read_artifact(common / "artifact.toml"), read_material(common / "material.nc"), samples=64
    )
    store = RenderStore(bench, None)
    for name, which, values in SCENES:
        observation, amplitudes, delta, _ = case(name)
        # Every third point: some 110 tell the size to 5 %.
        columns, delta = {name: column[::3] for name, column in observation.columns.items()}, delta[::3]
        scene = effect(which)
        variation = (
            scene.variation(np.array(values(amplitudes)))
            if isinstance(scene, SceneEffect)
            else Variation(Setup(sensor_zenith_deg=values(amplitudes)[0]))
        )
        found = store.get([[variation]], columns)[0].log_ratio(columns)[0]
        cosine, size = agreement(found - np.log(bench.reference_change(variation.reference_setup())), np.log1p(delta))
        assert cosine > 0.98, (name, which, cosine)
        assert size == pytest.approx(1, abs=0.06), (name, which, size)
