"""The library of effects: names of the data contract, and readings against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from traced_samples import artifact, columns, facility, flat

from instrument.errors import InputError
from twin.diagnosis import effects
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.effects import Known, ReadingEffect, SceneEffect, ZenithEffect, effect, library
from twin.material import lambertian

CONTRACT = set(
    """sample_tilt sample_azimuth sample_height sample_offset illumination_zenith_offset sensor_zenith_offset
    sensor_azimuth_offset sensor_arm_runout backlash beam_offset beam_radius field_of_view acceptance_angle
    beam_divergence retroreflection specular_lobe anisotropy translucency cavity_reflectance reflectance_scale
    reference_scale hole_diameter plate_thickness cavity_depth edge_chamfer stray_light dark_offset
    detector_nonlinearity gain_step source_drift session_scale stale_sample polarization arm_shadow arm_sag
    encoder_eccentricity""".split()  # noqa: SIM905
)


def acquisition(**changes) -> Acquisition:
    zenith = np.array([60.0, 30.0, 0.0, -30.0, -60.0, -60.0, -30.0, 0.0, 30.0, 60.0])
    where = columns(np.repeat([0.0, 30.0], 5), zenith, np.repeat([0.0, 90.0], 5))
    order = np.arange(10)
    values = {
        "columns": where,
        "signal_per_brf": np.full(10, 0.8),
        "reference_zenith": 15.0,
        "reference_azimuth": np.array([0.0, 45.0, 90.0, 135.0]),
        "previous": np.concatenate([[0], order[:-1]]),
        "travel": travel_direction(where, order),
        "progress": np.linspace(0, 1, 10),
        "gain": np.where(np.abs(zenith) > 45, 1e7, 1e6),
        "reference_gain": 1e6,
        "reference_current": 1e-6,
    }
    return Acquisition(**(values | changes))


def read(name: str, *values: float, brf: float = 0.5, run: Acquisition | None = None) -> np.ndarray:
    found = effect(name)
    assert isinstance(found, ReadingEffect)
    run = run or acquisition()
    return found.reading(run, np.full(len(run), brf), np.array(values))


def test_library_has_every_effect_of_the_contract():
    assert set(library()) >= CONTRACT


def test_effects_confused_with_each_other_exist():
    for found in library().values():
        assert set(found.confused_with) <= set(library()), found.name
        assert found.name not in found.confused_with


def test_every_axis_has_a_node_without_effect_and_stays_within_the_cap():
    known = Known(facility(mirror=10.8), artifact(), lambertian(0.6))
    for found in library().values():
        if not isinstance(found, SceneEffect):
            continue
        parameters = found.resolve(known)
        for parameter, axis in zip(parameters, found.axes(parameters), strict=True):
            assert np.all(np.diff(axis) > 0), found.name
            assert parameter.cap[0] - 1e-9 <= axis[0] <= axis[-1] <= parameter.cap[1] + 1e-9, found.name
            if not parameter.shape:
                assert np.any(np.isclose(axis, parameter.nominal, atol=1e-12)), found.name


def test_budgets_come_from_facility_and_artifact():
    bench = facility()
    bench = bench.model_copy(update={"arms": bench.arms.model_copy(update={"u_sensor_zenith": 0.3})})
    plate = artifact()
    known = Known(bench, plate, lambertian(0.5))
    assert effect("sensor_zenith_offset").resolve(known)[0].budget == 0.3
    assert effect("plate_thickness").resolve(known)[0].budget == plate.form.u_plate_thickness


@pytest.mark.parametrize(
    "name", ["hole_diameter", "plate_thickness", "cavity_depth", "edge_chamfer", "cavity_reflectance"]
)
def test_flat_sample_has_no_effect_of_holes(name: str):
    assert effect(name).not_applicable(Known(facility(), flat(), lambertian(0.5)))


def test_a_tilt_about_a_leg_raises_the_spot_whichever_way_it_goes():
    tilt = effect("sample_tilt")
    assert isinstance(tilt, SceneEffect)
    # 20 mm from the axis: 20 sin(1 degree) = 0.349 mm.
    for x, y in ((1.0, 0.0), (0.0, -1.0), (0.6, 0.8)):
        setup = tilt.variation(np.array([x, y, 20.0])).setup
        assert (setup.tilt_x_deg, setup.tilt_y_deg) == (x, y)
        assert setup.height_mm == pytest.approx(0.34905, abs=1e-5)
    assert tilt.variation(np.array([1.0, 0.5, 0.0])).setup.height_mm == 0
    # No leg is farther away than a corner of the 50 mm plate.
    assert tilt.resolve(Known(facility(), artifact(), lambertian(0.5)))[2].cap == pytest.approx(
        (-35.355, 35.355), abs=1e-3
    )


def test_lobe_leaves_no_more_light_than_there_is():
    amplitude, *_ = effect("specular_lobe").resolve(Known(facility(), flat(), lambertian(0.95)))
    assert 0 < amplitude.cap[1] < 0.05


def test_run_without_times_cannot_show_drift():
    assert effect("source_drift").missing(acquisition(progress=None)) == ("progress",)
    assert effect("dark_offset").missing(acquisition(gain=None, reference_current=None)) == (
        "gain",
        "reference_current",
    )


def test_stray_light_adds_to_every_signal():
    np.testing.assert_allclose(read("stray_light", 0.01), (0.4 + 0.01) / 0.8, rtol=1e-12)


def test_dark_offset_counts_by_the_gain():
    changed = read("dark_offset", 0.01)
    # Reference 1 V at 1e6 V/A; a signal of 0.4 is 0.4 V there, and 4 V at 1e7 V/A.
    low, high = 0.41 / 1.01 / 0.8, (4.01 / 10) / 1.01 / 0.8
    np.testing.assert_allclose(changed, np.where(acquisition().gain > 5e6, high, low), rtol=1e-12)


def test_nonlinearity_leaves_the_reference_alone():
    np.testing.assert_allclose(read("detector_nonlinearity", 0.1, 1.0), 0.5 * (1 + 0.1 * (0.4 - 1)))
    np.testing.assert_allclose(read("detector_nonlinearity", 0.1, 2.0), 0.5 * (1 + 0.1 * (0.16 - 1) / 2))
    np.testing.assert_allclose(read("detector_nonlinearity", 0.1, 1.0, brf=1 / 0.8), 1 / 0.8)


def test_gain_step_is_relative_to_the_range_of_the_reference():
    run = acquisition()
    np.testing.assert_allclose(read("gain_step", 0.02), np.where(run.gain > 5e6, 0.51, 0.5))
    swapped = acquisition(reference_gain=1e7)
    np.testing.assert_allclose(read("gain_step", 0.02, run=swapped), np.where(run.gain > 5e6, 0.5, 0.5 / 1.02))


def test_stale_sample_mixes_in_the_previous_signal():
    run = acquisition(signal_per_brf=np.linspace(0.5, 1.0, 10))
    brf = np.linspace(0.4, 0.6, 10)
    changed = effect("stale_sample").reading(run, brf, np.array([0.25]))
    signal = brf * run.signal_per_brf
    assert changed[0] == pytest.approx(brf[0])
    assert changed[3] * run.signal_per_brf[3] == pytest.approx(0.75 * signal[3] + 0.25 * signal[2])


def test_drift_grows_with_time():
    np.testing.assert_allclose(read("source_drift", 0.1, 0.0), 0.5 * (1 + 0.1 * np.linspace(0, 1, 10)), rtol=1e-6)


def test_bent_drift_begins_and_ends_where_the_straight_one_does():
    settling, late = read("source_drift", 0.1, 3.0), read("source_drift", 0.1, -3.0)
    for changed in (settling, late):
        np.testing.assert_allclose(changed[[0, -1]], [0.5, 0.55])
    # A time constant of a third of the run: after it 1 - 1/e of what remains at the end, 1 - exp(-3).
    np.testing.assert_allclose(settling[3], 0.5 * (1 + 0.1 * (1 - np.exp(-1)) / (1 - np.exp(-3))))
    assert np.all(late[1:-1] < settling[1:-1])


def test_session_scale_has_a_ratio_for_each_illumination():
    known = Known(facility(), flat(), lambertian(0.5))
    assert [p.name for p in effect("session_scale").resolve(known, acquisition())] == ["ratio_0", "ratio_30"]
    np.testing.assert_allclose(read("session_scale", 1.0, 1.1), np.repeat([0.5, 0.55], 5))


def test_reference_reading_too_high_lowers_every_value():
    np.testing.assert_allclose(read("reference_scale", 1.25), 0.4)


def test_polarization_cancels_over_the_azimuths_of_the_reference():
    changed = read("polarization", 0.1, 0.0)
    np.testing.assert_allclose(changed[:5], 0.5 * (1 + 0.1 * np.sin(np.deg2rad([60, 30, 0, -30, -60])) ** 2))
    np.testing.assert_allclose(changed[5:], 0.5 * (1 - 0.1 * np.sin(np.deg2rad([-60, -30, 0, 30, 60])) ** 2))


def test_anisotropy_along_x_equals_polarization_and_turns_with_its_axis():
    # Without the part of the light's direction, and without the reference that a detector reads as well.
    np.testing.assert_allclose(read("anisotropy", 0.1, 0.0, 2.0, 0.0), read("polarization", 0.1, 0.0))
    np.testing.assert_allclose(read("anisotropy", 0.1, 90.0, 2.0, 0.0), read("polarization", -0.1, 0.0))


def test_anisotropy_is_the_same_with_light_and_view_exchanged():
    zenith = np.array([10.0, 40.0, 70.0])
    forth = acquisition(columns=columns(np.full(3, 30.0), zenith, 60.0), signal_per_brf=np.ones(3))
    back = columns(zenith, np.full(3, 30.0), 0.0) | {"illumination_azimuth": np.full(3, 60.0)}
    exchanged = acquisition(columns=back, signal_per_brf=np.ones(3))
    one, other = (read("anisotropy", 0.1, 25.0, 2.0, 1.0, run=run) for run in (forth, exchanged))
    assert np.ptp(one) > 0.01
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_polarization_of_refracted_light_follows_fresnel():
    changed = read("polarization", 0.1, 1.0) / 0.5 - 1

    def degree(outside: float) -> float:
        # Transmittances of both polarisations of a body of index 1.5, from the amplitudes.
        n, cosine = 1.5, np.cos(np.deg2rad(outside))
        inside = np.sqrt(1 - (np.sin(np.deg2rad(outside)) / n) ** 2)
        across = 2 * n * inside / (n * inside + cosine)
        along = 2 * n * inside / (inside + n * cosine)
        return float((along**2 - across**2) / (along**2 + across**2))

    expected = 0.1 * np.sin(np.deg2rad(80)) ** 2 / degree(80) * np.array([degree(60), degree(30), 0])
    np.testing.assert_allclose(changed[:5], expected[[0, 1, 2, 1, 0]], rtol=1e-9, atol=1e-15)


def test_arm_shadow_fades_away_from_retroreflection():
    # The reference is read 60 degrees from the light, where nothing is lost.
    where = columns(30.0, np.array([25.0, 20.0, 15.0, 0.0, -30.0]), 0.0)
    run = acquisition(columns=where, signal_per_brf=np.ones(5), reference_zenith=60.0)
    lost = 1 - read("arm_shadow", 0.2, 8.0, brf=1.0, run=run)
    assert lost[0] == pytest.approx(0.2)
    assert np.all(np.diff(lost) < 0)
    assert lost[2] < 0.2 * 0.06
    wide = 1 - read("arm_shadow", 0.2, 14.0, brf=1.0, run=run)
    assert wide[2] == pytest.approx(0.2 * np.exp(-(15.0**2 - 5.0**2) / 14.0**2))


def test_arm_shadow_on_the_reference_raises_all_points():
    # View 15 degrees from the light at every azimuth of the reference: the same share is lost there and here.
    lost = 0.2 * np.exp(-(15.0**2 - 5.0**2) / 14.0**2)
    where = columns(30.0, np.array([15.0, 45.0, -60.0]), 0.0)
    run = acquisition(columns=where, signal_per_brf=np.ones(3), reference_zenith=15.0)
    np.testing.assert_allclose(
        read("arm_shadow", 0.2, 14.0, brf=0.5, run=run), [0.5, 0.5, 0.5 / (1 - lost)], rtol=1e-12
    )
    # Light from 30 degrees: the reference is read farther from it at azimuths other than 0.
    oblique = acquisition(
        columns=where, signal_per_brf=np.ones(3), reference_zenith=15.0, reference_azimuth=np.array([0.0, 180.0]),
        reference_illumination=30.0,
    )  # fmt: skip
    there = (1 - lost) / 2 + (1 - 0.2 * np.exp(-(45.0**2 - 5.0**2) / 14.0**2)) / 2
    assert read("arm_shadow", 0.2, 14.0, brf=0.5, run=oblique)[2] == pytest.approx(0.5 / there)


def test_backlash_follows_the_direction_of_travel():
    found, run = effect("backlash"), acquisition()
    assert isinstance(found, ZenithEffect)
    error = found.zenith_error(run, np.array([[0.8]]))[0]
    # First slice downwards, second upwards; a slice's first point counts as the slice.
    np.testing.assert_allclose(error, np.repeat([-0.4, 0.4], 5))


def test_errors_of_scale_and_arm_vanish_where_the_arm_was_zeroed():
    run = acquisition()
    for name, values in (("arm_sag", [1.0]), ("encoder_eccentricity", [1.0, 2.0]), ("encoder_ellipticity", [1.0, 2.0])):
        found = effect(name)
        assert isinstance(found, ZenithEffect)
        error = found.zenith_error(run, np.array([values]))[0]
        np.testing.assert_allclose(error[[2, 7]], 0, atol=1e-12)
        assert found.reference_setup(np.array(values), 15.0).sensor_zenith_deg != 0


def test_lone_point_of_a_slice_has_no_direction_of_travel():
    where = columns(0.0, np.array([10.0, 20.0, 30.0]), np.array([0.0, 0.0, 45.0]))
    np.testing.assert_allclose(travel_direction(where, np.arange(3)), [1, 1, 0])


def test_unknown_effect_is_named_with_the_known_ones():
    with pytest.raises(InputError, match="found 'tilt'; expected one of"):
        effect("tilt")


def test_package_that_offers_something_else_is_named(monkeypatch: pytest.MonkeyPatch):
    entry = SimpleNamespace(name="x", value="other:thing", load=lambda: 3)
    monkeypatch.setattr(effects, "entry_points", lambda group: [entry])
    with pytest.raises(InputError, match="other:thing: found 3"):
        library.__wrapped__()


def test_installed_package_adds_an_effect(monkeypatch: pytest.MonkeyPatch):
    class Fatigue(ReadingEffect):
        name, title, parameters = "fatigue", "detector tired", ()

        def reading(self, run, brf, values):
            return brf

    entry = SimpleNamespace(name="fatigue", value="other:Fatigue", load=lambda: Fatigue)
    monkeypatch.setattr(effects, "entry_points", lambda group: [entry])
    assert isinstance(library.__wrapped__()["fatigue"], Fatigue)
