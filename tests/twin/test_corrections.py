"""Corrections of the twin: what is added to the nominal configuration, on scene and on reading, from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from traced_samples import artifact, facility, flat

from instrument.errors import InputError
from instrument.events import Geometry
from twin.corrections import (
    CorrectedTwin,
    Correction,
    Corrections,
    plan_acquisition,
    read_corrections,
    resolve,
    write_corrections,
)
from twin.diagnosis.effects import Known
from twin.material import lambertian
from twin.optics import Setup, reference_change
from twin.prediction import Twin

REAL = facility(profile="gaussian", mirror=10.8)
KNOWN = Known(REAL, artifact(), lambertian(0.6))
SAMPLES = 2048


def columns(*zenith: float, light: float = 15.0) -> dict[str, np.ndarray]:
    values = np.array(zenith)
    same = np.zeros_like(values)
    return {
        "wavelength": same + 500.0,
        "illumination_zenith": same + light,
        "illumination_azimuth": same,
        "sensor_zenith": values,
        "sensor_azimuth": same + 50.0,
    }


def corrections(**effects: dict[str, float]) -> Corrections:
    entries = tuple(Correction(effect=name, parameters=values) for name, values in effects.items())
    return Corrections(form="corrections", version=1, effects=entries)


def brf(given: dict[str, np.ndarray], *, ordered: bool = True, **effects: dict[str, float]) -> np.ndarray:
    twin = CorrectedTwin(
        KNOWN.facility, KNOWN.artifact, KNOWN.material, resolve(corrections(**effects), KNOWN, ordered=ordered)
    )
    return twin.estimate(given, samples=SAMPLES, seed=3).brf


@pytest.fixture(scope="module")
def nominal() -> Twin:
    return Twin(KNOWN.facility, KNOWN.artifact, KNOWN.material)


POINTS = columns(-60.0, -20.0, 40.0, 70.0)


def test_a_scene_effect_is_the_nominal_twin_in_another_setup(nominal):
    """The same random numbers: equal but for rounding."""
    expected = nominal.estimate(POINTS, samples=SAMPLES, seed=3, setup=Setup(tilt_x_deg=0.7, height_mm=1.0)).brf
    found = brf(POINTS, sample_tilt={"x_deg": 0.7}, sample_height={"height_mm": 1.0})
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_an_arm_that_is_off_is_off_during_the_reference_too(nominal):
    off = Setup(sensor_zenith_deg=0.5)
    found = brf(POINTS, sensor_zenith_offset={"angle_deg": 0.5})
    np.testing.assert_allclose(found, nominal.estimate(POINTS, samples=SAMPLES, seed=3, setup=off).brf, rtol=1e-6)


def test_backlash_moves_points_by_half_of_it_either_way_and_leaves_the_reference(nominal):
    rising, falling = columns(20.0, 40.0, 60.0), columns(60.0, 40.0, 20.0)
    up, down = (brf(c, backlash={"angle_deg": 1.0})[1] for c in (rising, falling))
    for found, angle in ((up, 0.5), (down, -0.5)):
        setup = Setup(sensor_zenith_deg=angle)
        alone = nominal.estimate(rising, samples=SAMPLES, seed=3, setup=setup).brf[1]
        assert found == pytest.approx(alone * reference_change(REAL, setup), rel=1e-9)


def test_effects_on_the_reading_follow_their_definition(nominal):
    plain = nominal.estimate(POINTS, samples=SAMPLES, seed=3).brf
    np.testing.assert_allclose(brf(POINTS, reference_scale={"ratio": 1.02}), plain / 1.02, rtol=1e-12)
    signal = plan_acquisition(POINTS, REAL).signal_per_brf
    np.testing.assert_allclose(brf(POINTS, stray_light={"fraction": 0.01}), plain + 0.01 / signal, rtol=1e-12)


def test_dimensions_are_those_of_a_changed_artifact():
    changed = Twin(REAL, KNOWN.artifact.changed(hole_diameter=0.1), KNOWN.material)
    expected = changed.estimate(POINTS, samples=SAMPLES, seed=3).brf
    np.testing.assert_allclose(brf(POINTS, hole_diameter={"delta_mm": 0.1}), expected, rtol=1e-12)


@pytest.mark.parametrize("name", ["dark_offset", "gain_step", "source_drift", "session_scale"])
def test_what_only_a_run_tells_is_left_out_and_said(name):
    applied = resolve(corrections(**{name: {}}), KNOWN, ordered=True)
    assert name in applied.left_out
    assert not applied.effects


def test_the_order_of_points_counts_for_plans_alone():
    given = corrections(backlash={"angle_deg": 1.0})
    assert not resolve(given, KNOWN, ordered=True).left_out
    assert "order" in resolve(given, KNOWN, ordered=False).left_out["backlash"]


def test_a_file_is_read_as_it_was_written(tmp_path: Path):
    given = corrections(sample_tilt={"x_deg": 0.25, "y_deg": -0.1})
    write_corrections(given, tmp_path / "c.toml")
    assert read_corrections(tmp_path / "c.toml") == given


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ('effect = "tilt"\nparameters = {}', "effects.0: effect: found 'tilt'"),
        ('effect = "sample_tilt"', "effects.0.parameters: missing"),
        ('effect = "sample_tilt"\nparameters = {}\ncolour = 1', "unknown key"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(tmp_path, entry, said):
    file = tmp_path / "c.toml"
    file.write_text(f'form = "corrections"\nversion = 1\n[[effects]]\n{entry}\n')
    with pytest.raises(InputError, match=said):
        read_corrections(file)


@pytest.mark.parametrize(
    ("values", "said"),
    [({"z_deg": 1.0}, "unknown z_deg; expected x_deg, y_deg"), ({"x_deg": 30.0}, "found 30; expected -3.5 to 3.5")],
)
def test_parameters_must_exist_and_be_possible(values, said):
    with pytest.raises(InputError, match=said):
        resolve(corrections(sample_tilt=values), KNOWN, ordered=True)


def test_the_twin_of_a_scan_takes_the_corrections_beside_the_artifact(tmp_path, monkeypatch):
    """Files of a run folder; what is made of them is told apart without tracing."""
    from twin import corrections as module
    from twin import scan_twin

    made = []
    monkeypatch.setattr(scan_twin.Twin, "from_files", classmethod(lambda cls, *files: made.append("nominal")))
    monkeypatch.setattr(module, "corrected_twin", lambda *files, ordered: made.append(("corrected", ordered)))
    files = (tmp_path / "facility.toml", tmp_path / "artifact.toml", tmp_path / "material.nc")
    scan_twin.scan_twin(*files)
    write_corrections(corrections(), tmp_path / "corrections.toml")
    scan_twin.scan_twin(*files)
    assert made == ["nominal", ("corrected", False)]


def test_a_scan_keeps_its_corrections_and_predicts_with_them(tmp_path):
    """From the request to the twin of the run folder."""
    from instrument.request import ScanRequest, complete, inputs_of
    from instrument.run_folder import keep_inputs
    from twin.scan_twin import scan_twin

    root = Path(__file__).parents[2]
    examples = root / "sim_fixtures" / "examples"
    material, found = tmp_path / "material.toml", tmp_path / "found.toml"
    material.write_text('[default]\nmodel = "lambertian"\nreflectance = 0.6\n')
    write_corrections(corrections(sample_tilt={"x_deg": 0.7}), found)
    request = ScanRequest(
        plan=examples / "table_iv.toml",
        facility=examples / "facility.toml",
        artifact=examples / "artifact.toml",
        material=material,
        devices=root / "docs" / "devices.example.toml",
        corrections=found,
    )
    (folder := tmp_path / "run").mkdir()
    kept = keep_inputs(complete(inputs_of(request)), folder)
    assert kept.corrections == folder / "corrections.toml"
    twin = scan_twin(kept.facility_path, kept.artifact, kept.material)
    assert isinstance(twin, CorrectedTwin)
    assert twin.applied.variation.setup.tilt_x_deg == 0.7


def test_corrections_that_are_not_there_keep_a_scan_from_starting(tmp_path):
    from instrument.request import ScanRequest, inputs_of

    missing = tmp_path / "none.toml"
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        inputs_of(ScanRequest(simulate=True, corrections=missing))


def quarter_turned(still: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arms in the same place, the sample turned by 90 degrees: stated from the other side of the normal."""
    return still | {
        "illumination_azimuth": np.full(len(still["wavelength"]), -90.0),
        "sensor_azimuth": still["sensor_azimuth"] + 90.0,
        "sensor_zenith": -still["sensor_zenith"],
    }


def test_an_axis_turns_with_the_sample_and_the_detector_does_not():
    still = columns(-60.0, 40.0, light=0.0)
    quarter = quarter_turned(still)
    plain = brf(quarter)
    sine = np.sin(np.deg2rad(still["sensor_zenith"])) ** 2
    grained = brf(quarter, anisotropy={"amplitude": 0.1, "axis_deg": 50.0}) / plain - 1
    np.testing.assert_allclose(grained, -0.1 * sine, rtol=1e-6)
    lying, turned = (brf(c, polarization={"fraction": 0.1}) / brf(c) for c in (still, quarter))
    assert np.abs(lying - 1).max() > 0.01
    np.testing.assert_allclose(turned, lying, rtol=1e-9)


@pytest.mark.parametrize(
    ("effect", "values"), [("beam_offset", {"x_mm": 1.4, "y_mm": -0.3}), ("arm_sag", {"angle_deg": 2.0})]
)
def test_arm_and_beam_that_are_off_stay_so_when_a_flat_sample_turns(effect: str, values: dict[str, float]):
    known = Known(facility(4.0, target=5.0), flat(), lambertian(0.6))
    still = columns(20.0, 60.0, light=30.0)
    applied = resolve(corrections(**{effect: values}), known, ordered=True)
    nominal = Twin(known.facility, known.artifact, known.material)
    twin = CorrectedTwin(known.facility, known.artifact, known.material, applied)
    looks = ((nominal, still), (twin, still), (twin, quarter_turned(still)))
    plain, one, other = (each.estimate(where, samples=2**15, seed=3).brf for each, where in looks)
    assert np.abs(one / plain - 1).max() > 0.03
    np.testing.assert_allclose(other, one, rtol=2e-3)


def test_an_arm_beside_a_turned_stage_is_off_on_the_side_where_it_stands():
    """Azimuth 225 and zenith 60 is not azimuth 45 and zenith -60 for an arm whose zero is off."""
    known = Known(facility(4.0, target=5.0), flat(), lambertian(0.6))
    applied = resolve(corrections(sensor_zenith_offset={"angle_deg": 1.0}), known, ordered=False)
    twin = CorrectedTwin(known.facility, known.artifact, known.material, applied)
    angles = {"wavelength": 500.0, "illumination_zenith": 30.0, "sensor_zenith": 60.0, "illumination_azimuth": 0.0}
    lying, turned, opposite = (
        twin.predict([Geometry(**angles, sensor_azimuth=azimuth, sample_rotation=stage)], samples=2**14)["brf"].item()
        for azimuth, stage in ((225.0, 0.0), (225.0, 90.0), (225.0, -120.0))
    )
    assert (
        abs(
            lying
            / Twin(known.facility, known.artifact, known.material)
            .predict([Geometry(**angles, sensor_azimuth=225.0)], samples=2**14)["brf"]
            .item()
            - 1
        )
        > 0.02
    )
    np.testing.assert_allclose([turned, opposite], lying, rtol=2e-3)
