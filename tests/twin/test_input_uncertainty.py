"""What the inputs add to the uncertainty of a point: the value, and what is kept of it for later."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from traced_samples import artifact, columns, facility, flat

import twin.input_uncertainty as module
from instrument.beam_image import BeamImage
from instrument.events import Geometry
from instrument.facility import Beam, Facility, SamplePlacement
from instrument.lambertian import lambertian_flux, reference_change
from instrument.plane_flux import plane_flux
from twin.content import cache_folder, content_digest
from twin.input_uncertainty import find_input_uncertainty, inputs_digest, with_inputs
from twin.material import lambertian
from twin.optics import Setup, geometry_columns, lay_out
from twin.propagation import Propagation
from twin.propagation_dataset import propagate
from twin.state_vector import StateVector, state_vector


def known_facility() -> Facility:
    known = facility(profile="gaussian", mirror=10.8)
    arms = known.arms.model_copy(update={"u_illumination_zenith": 0.25, "u_sensor_zenith": 0.25})
    sample = SamplePlacement(u_height=0.1, u_offset=0.25, u_tilt=0.1)
    return known.model_copy(update={"arms": arms, "sample": sample})


def points(*zeniths: float) -> list[Geometry]:
    return [
        Geometry(wavelength=500.0, illumination_zenith=20.0, sensor_zenith=zenith, sensor_azimuth=60.0)
        for zenith in zeniths
    ]


def nominal_state() -> StateVector:
    return state_vector(known_facility(), flat(), lambertian(0.95))


def test_on_a_flat_lambertian_sample_it_is_that_of_the_quadrature(tmp_path: Path) -> None:
    plan = points(-60.0, 10.0, 70.0)
    found = find_input_uncertainty(nominal_state(), plan, folder=tmp_path, tolerance=0.02)
    of, commanded = known_facility(), geometry_columns(plan)
    flux = lambertian_flux(
        of, *(commanded[name] for name in ("illumination_zenith", "sensor_zenith", "sensor_azimuth"))
    )

    def brf(**off: float) -> np.ndarray:
        setup = Setup(**off)
        return 0.95 * plane_flux(lay_out(of, commanded, setup)) / flux / reference_change(of, setup)

    steps = {"illumination_zenith_deg": 0.25, "sensor_zenith_deg": 0.25, "height_mm": 0.1}
    steps |= {"tilt_x_deg": 0.1, "tilt_y_deg": 0.1}
    # One standard uncertainty to either side: the linear part, which is nearly all of it.
    variance = sum(((brf(**{name: u}) - brf(**{name: -u})) / 2) ** 2 for name, u in steps.items())
    expected = np.sqrt(variance)
    np.testing.assert_array_less(np.abs(found.u - expected), 4 * found.u_error * found.u + 0.01 * expected)
    assert found.u_error[2] < 0.02
    assert expected[2] > 0.008
    assert "uncertain inputs" in found.contains


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Takes the place of ray tracing; holds the number of points of every computation."""
    computed: list[int] = []

    def by_sensitivities(renderer: np.ndarray, **_: object) -> Propagation:
        zenith = renderer
        computed.append(len(zenith))
        zero = np.zeros(len(zenith))
        return Propagation(
            {name: (1 + k) * 1e-6 * zenith**2 for k, name in enumerate(nominal_state().sources)},
            np.outer(zenith, [1.0, 2.0]),
            zero,
            np.full(len(zenith), 0.1),
            zero,
            brf=zenith / 100,
            sensitivity={"sensor zenith": zenith},
            sensitivity_error={"sensor zenith": zero},
            units={"sensor zenith": "degree"},
            component_sources=("sensor zenith", "sample height"),
            factor_error=np.zeros((len(zenith), 2)),
            evaluations=9,
        )

    monkeypatch.setattr(module, "PlanRenderer", lambda state, columns, seed: columns["sensor_zenith"])
    monkeypatch.setattr(module, "by_sensitivities", by_sensitivities)
    return computed


def u_of(zenith: float) -> float:
    count = len(nominal_state().sources)
    return float(np.sqrt(count * (count + 1) / 2) * 1e-3 * abs(zenith))


def test_it_is_computed_once_for_a_plan(counted: list[int], tmp_path: Path) -> None:
    plan = points(10.0, 20.0, 30.0, 20.0)
    announced: list[str] = []
    for _ in range(2):
        found = find_input_uncertainty(nominal_state(), plan, folder=tmp_path, begin=lambda: announced.append("now"))
        assert found.u == pytest.approx([u_of(z) for z in (10.0, 20.0, 30.0, 20.0)])
    assert counted == [3]
    assert announced == ["now"]


def test_a_part_of_a_known_plan_is_known(counted: list[int], tmp_path: Path) -> None:
    find_input_uncertainty(nominal_state(), points(10.0, 20.0, 30.0), folder=tmp_path)
    part = xr.Dataset(coords={name: ("point", values) for name, values in columns(20.0, [30.0, 10.0], 60.0).items()})
    assert find_input_uncertainty(nominal_state(), part, folder=tmp_path).u == pytest.approx([u_of(30.0), u_of(10.0)])
    assert counted == [3]
    find_input_uncertainty(nominal_state(), points(10.0, 40.0), folder=tmp_path)
    assert counted == [3, 2]


def test_what_a_budget_needs_is_kept_too(counted: list[int], tmp_path: Path) -> None:
    first = find_input_uncertainty(nominal_state(), points(10.0, 20.0, 30.0), folder=tmp_path).result
    kept = find_input_uncertainty(nominal_state(), points(30.0, 10.0), folder=tmp_path).result
    assert counted == [3]
    expected = first.take(np.array([2, 0]))
    np.testing.assert_array_equal(kept.factor, expected.factor)
    np.testing.assert_array_equal(kept.factor_error, expected.factor_error)
    np.testing.assert_array_equal(kept.sensitivity["sensor zenith"], [30.0, 10.0])
    assert (kept.units, kept.component_sources) == (first.units, first.component_sources)
    assert kept.evaluations == 9


def test_a_budget_uses_what_a_scan_has_worked_out(
    counted: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    find_input_uncertainty(nominal_state(), points(10.0, 20.0))
    prediction = propagate(nominal_state(), points(20.0), standard_error=0.01, keep=True)
    assert counted == [2]
    assert prediction["u_brf_inputs"].values == pytest.approx([u_of(20.0)])
    assert prediction["sensitivity"].values.tolist() == [[20.0]]


def test_another_twin_is_computed_again(counted: list[int], tmp_path: Path) -> None:
    state = nominal_state()
    wider = state.facility.model_copy(update={"arms": state.facility.arms.model_copy(update={"u_sensor_zenith": 0.5})})
    others = [
        state_vector(wider, flat(), lambertian(0.95)),
        state_vector(known_facility(), flat(), lambertian(0.94)),
        state_vector(known_facility(), artifact([(0.0, 0.0, 2.0)]), lambertian(0.95)),
        state_vector(known_facility(), flat(), lambertian(0.95), setup=Setup(height_mm=0.2)),
    ]
    digests = {inputs_digest(one, 0.1) for one in (state, *others)}
    assert len(digests) == 5
    assert inputs_digest(state, 0.05) not in digests
    find_input_uncertainty(state, points(10.0), folder=tmp_path)
    find_input_uncertainty(others[0], points(10.0), folder=tmp_path)
    assert counted == [1, 1]


def test_names_and_places_of_files_do_not_count() -> None:
    state = nominal_state()
    moved = replace(flat(), source=Path("elsewhere/artifact.toml"))
    renamed = replace(lambertian(0.95), name="copy")
    other = state_vector(known_facility().model_copy(update={"name": "again"}), moved, renamed)
    assert inputs_digest(other, 0.1) == inputs_digest(state, 0.1)


def test_the_picture_of_a_beam_counts() -> None:
    def of(last: float) -> str:
        image = BeamImage(np.array([[1.0, 0.5], [0.5, last]]), (1.0, 1.0), (-0.5, -0.5))
        beam = Beam(diameter=5.0, profile="image", image="beam.npy", pixel_pitch=1.0).with_picture(image)
        return content_digest(known_facility().model_copy(update={"beam": beam}))

    assert of(0.2) == of(0.2)
    assert of(0.2) != of(0.3)


@pytest.mark.parametrize("damage", [b"", b"no archive", None])
def test_a_damaged_file_is_computed_again(counted: list[int], tmp_path: Path, damage: bytes | None) -> None:
    find_input_uncertainty(nominal_state(), points(10.0), folder=tmp_path)
    (kept,) = tmp_path.rglob("*.npz")
    if damage is None:
        with np.load(kept) as data:
            changed = dict(data) | {"u_error": np.zeros(7)}
        np.savez_compressed(kept, **changed)
    else:
        kept.write_bytes(damage)
    assert find_input_uncertainty(nominal_state(), points(10.0), folder=tmp_path).u == pytest.approx([u_of(10.0)])
    assert counted == [1, 1]


def test_a_cache_that_cannot_be_written_costs_nothing_but_the_next_computation(
    counted: list[int], tmp_path: Path
) -> None:
    (tmp_path / "input-uncertainty").write_text("in the way")
    assert find_input_uncertainty(nominal_state(), points(10.0), folder=tmp_path).u == pytest.approx([u_of(10.0)])


def test_the_cache_lies_where_the_user_wants_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "goniotwin"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "goniotwin"


def test_a_prediction_holds_both_parts(counted: list[int], tmp_path: Path) -> None:
    known = find_input_uncertainty(nominal_state(), points(10.0, 20.0), folder=tmp_path)
    one = {"units": "1"}
    tracing = np.array([0.001, 0.05])
    prediction = xr.Dataset(dict.fromkeys(("brf", "u_brf", "u_brf_monte_carlo"), ("point", tracing, one)))
    full = with_inputs(prediction, known)
    assert full["u_brf"].values == pytest.approx(np.hypot(tracing, known.u))
    assert full["u_brf_inputs"].values == pytest.approx(known.u)
    assert full["u_brf_monte_carlo"].values == pytest.approx(tracing)
    assert full.attrs["u_brf_contains"] == known.contains
    assert "u_brf_inputs" not in prediction


def test_content_without_a_digest_is_refused() -> None:
    with pytest.raises(TypeError, match="Event"):
        content_digest(threading.Event())
