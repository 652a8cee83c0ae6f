from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from traced_samples import artifact, facility, flat

from instrument.errors import InputError
from instrument.facility import Facility
from twin.coupon import from_coupon
from twin.coupon_errors import coupon_components
from twin.input_uncertainty import inputs_digest
from twin.material import lambertian
from twin.optics import Setup
from twin.state_vector import state_vector, state_vector_from_files

EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"


def uncertain(base: Facility | None = None, **tables: dict[str, float]) -> Facility:
    """The facility with uncertainties in some of its tables."""
    content = (base or facility(profile="gaussian", mirror=10.8)).model_dump()
    for table, values in tables.items():
        content[table] |= values
    return Facility.model_validate(content)


def coupon(**components: tuple[float, dict]) -> xr.Dataset:
    """A coupon run of reflectance factor 0.6, with relative uncertainties and their attributes."""
    zenith, azimuth, illumination = (
        a.ravel() for a in np.meshgrid(np.arange(-75.0, 80, 25), [0.0, 90.0, 180.0], [0.0, 30.0], indexing="ij")
    )
    keep = ~((np.abs(zenith - illumination) < 5) & ((azimuth == 0) | (illumination == 0)))
    coords = {"illumination_zenith": illumination, "sensor_zenith": zenith, "sensor_azimuth": azimuth}
    coords = {name: ("point", values[keep], {"units": "degree"}) for name, values in coords.items()}
    count = int(keep.sum())
    coords["illumination_azimuth"] = ("point", np.zeros(count), {"units": "degree"})
    coords["wavelength"] = ("point", np.full(count, 500.0), {"units": "nm"})
    brf = np.full(count, 0.6)
    total = np.sqrt(sum(u**2 for u, _ in components.values())) * brf
    data = {
        "brf": ("point", brf, {"units": "1", "unc_comps": [f"u_brf_{name}" for name in components]}),
        "u_brf": ("point", np.maximum(total, 1e-6), {"units": "1"}),
    }
    data |= {f"u_brf_{name}": ("point", u * brf, attributes) for name, (u, attributes) in components.items()}
    return xr.Dataset(data, coords=coords)


RANDOM = {"err_corr_1_dim": "point", "err_corr_1_form": "random"}
SYSTEMATIC = {"err_corr_1_dim": "point", "err_corr_1_form": "systematic"}


def test_every_stated_uncertainty_is_a_parameter_and_nothing_else() -> None:
    state = state_vector_from_files(*(EXAMPLES / name for name in ("facility.toml", "artifact.toml", "material.nc")))
    assert {f"hole {n} {key}" for n in range(144) for key in ("x", "y", "diameter")} < set(state.labels)
    assert {"plate thickness", "cavity depth", "sensor zenith", "sample height", "beam divergence"} < set(state.labels)
    assert len(set(state.labels)) == len(state.labels) == len(state)
    assert np.all(state.standard_uncertainty >= 0)
    assert state.coupon is not None
    assert sum("noise" in label for label in state.labels) == state.coupon.sizes["point"]
    assert "beam radius" not in state.labels  # the facility states none
    assert any("stability" in note for note in state.notes)


def test_the_nominal_vector_is_the_nominal_twin() -> None:
    state = state_vector(uncertain(arms={"u_sensor_zenith": 0.3}), artifact(), lambertian(0.5))
    assert state.inputs(state.nominal) is state.nominal_inputs
    assert state.material(None) is state.nominal_material


@pytest.mark.parametrize(
    ("tables", "label", "field"),
    [
        ({"arms": {"u_illumination_zenith": 0.3}}, "illumination zenith", "illumination_zenith_deg"),
        ({"arms": {"u_sensor_azimuth": 0.3}}, "sensor azimuth", "sensor_azimuth_deg"),
        ({"sample": {"u_tilt": 0.3}}, "sample tilt y", "tilt_y_deg"),
        ({"sample": {"u_offset": 0.3}}, "sample offset x", "offset_x_mm"),
        ({"beam": {"u_diameter": 0.6}}, "beam radius", "beam_radius_mm"),
        ({"sensor": {"u_target_diameter": 0.6}}, "target radius", "target_radius_mm"),
    ],
)
def test_a_parameter_of_the_instrument_is_added_to_its_field(tables: dict, label: str, field: str) -> None:
    one: dict[str, Any] = {field: 1.0}
    more: dict[str, Any] = {field: 1.2}
    state = state_vector(uncertain(**tables), flat(), lambertian(0.5), setup=Setup(**one))
    values = state.nominal.copy()
    at = state.labels.index(label)
    assert (values[at], state.standard_uncertainty[at]) == (1.0, 0.3)
    values[at] = 1.2
    assert state.inputs(values).setup == Setup(**more)


def test_a_divergence_beyond_zero_folds_back() -> None:
    base = facility(profile="gaussian", divergence=0.1)
    state = state_vector(uncertain(base, beam={"u_divergence": 0.2}), flat(), lambertian(0.5))
    assert list(state.nominal) == [0.1]
    assert state.inputs(np.array([-0.3])).setup.divergence_deg == pytest.approx(0.2)


def test_dimensions_of_the_artifact_move_alone() -> None:
    plate = artifact()
    holes = replace(plate.holes, u_x=np.full(144, 0.01), u_diameter=np.full(144, 0.02))
    form = plate.form.model_copy(update={"u_plate_thickness": 0.04})
    state = state_vector(facility(), replace(plate, form=form, holes=holes), lambertian(0.5))
    assert state.sources == ("plate thickness", "hole dimensions")
    values = state.nominal.copy()
    values[state.labels.index("plate thickness")] = 1.2
    values[state.labels.index("hole 7 diameter")] += 0.05
    moved = state.inputs(values).artifact
    assert moved.form.plate_thickness == 1.2
    assert moved.form.cavity_depth == form.cavity_depth
    np.testing.assert_array_equal(np.flatnonzero(moved.holes.diameter != holes.diameter), [7])
    np.testing.assert_array_equal(moved.holes.x, holes.x)


def test_chamfers_and_the_tilt_of_the_block_are_parameters() -> None:
    """Holes without a chamfer of their own share one; a width that would be negative folds back."""
    plate = artifact([(0.0, 0.0, 3.0), (5.0, 0.0, 3.0), (10.0, 0.0, 3.0), (15.0, 0.0, 3.0)])
    own, u_own = np.array([np.nan, 0.2, np.nan, 0.3]), np.array([np.nan, 0.02, 0.03, np.nan])
    form = plate.form.model_copy(
        update={"edge_chamfer": 0.1, "u_edge_chamfer": 0.05, "u_block_tilt_x": 0.2, "u_block_tilt_y": 0.3}
    )
    holes = replace(plate.holes, chamfer=own, u_chamfer=u_own)
    state = state_vector(facility(), replace(plate, form=form, holes=holes), lambertian(0.5))
    assert state.sources == ("block tilt", "edge chamfer", "hole dimensions")
    stated = dict(zip(state.labels, state.standard_uncertainty, strict=True))
    assert [stated[f"hole {n} chamfer"] for n in (1, 2, 3)] == [0.02, 0.03, 0.05]
    assert "hole 0 chamfer" not in stated
    assert all(block.changes_shape for block in state.blocks)
    values = state.nominal.copy()
    values[state.labels.index("edge chamfer")] = -0.15
    values[state.labels.index("hole 3 chamfer")] = 0.4
    values[state.labels.index("block tilt y")] = 0.5
    moved = state.inputs(values).artifact
    np.testing.assert_allclose(moved.chamfers, [0.15, 0.2, 0.1, 0.4])
    assert (moved.form.block_tilt_x, moved.form.block_tilt_y) == (0.0, 0.5)
    np.testing.assert_array_equal(state.nominal_inputs.artifact.holes.chamfer, own)
    values[state.labels.index("hole 3 chamfer")] = 1.2
    with pytest.raises(InputError, match="hole 3: chamfer_mm"):
        state.inputs(values)


def test_draws_have_the_stated_mean_and_uncertainty_and_follow_the_seed() -> None:
    state = state_vector(uncertain(arms={"u_sensor_zenith": 0.3}, sample={"u_tilt": 0.1}), flat(), lambertian(0.5))
    drawn = state.draw(5, 4000)
    np.testing.assert_allclose(drawn.mean(axis=0) / state.standard_uncertainty, 0, atol=0.08)
    np.testing.assert_allclose(drawn.std(axis=0), state.standard_uncertainty, rtol=0.06)
    np.testing.assert_array_equal(drawn, state.draw(5, 4000))
    assert np.any(drawn != state.draw(6, 4000))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"plate thickness": 3.3}, "plate_thickness"),
        ({"hole 3 diameter": -0.1}, "hole's diameter"),
        ({"hole 3 x": -14.0}, "overlap"),
    ],
)
def test_impossible_dimensions_are_named(change: dict[str, float], message: str) -> None:
    plate = artifact()
    one = np.ones(144)
    holes = replace(plate.holes, u_x=one, u_diameter=one)
    form = plate.form.model_copy(update={"u_plate_thickness": 1.0})
    state = state_vector(facility(), replace(plate, form=form, holes=holes), lambertian(0.5))
    values = state.nominal.copy()
    for label, value in change.items():
        values[state.labels.index(label)] = value
    with pytest.raises(InputError, match=message):
        state.inputs(values)


class TestCoupon:
    def test_a_systematic_component_is_one_error_and_a_random_one_an_error_a_point(self) -> None:
        run = coupon(noise=(0.01, RANDOM), reference=(0.005, SYSTEMATIC))
        noise, reference = coupon_components(run, "coupon")
        count = run.sizes["point"]
        np.testing.assert_allclose(noise.modes, 0.006 * np.eye(count))
        np.testing.assert_allclose(reference.modes, np.full((count, 1), 0.003))

    @pytest.mark.parametrize(("unstated", "columns"), [("common", 1), ("slice", 6), ("independent", None)])
    def test_a_component_without_correlation_follows_the_choice(self, unstated: Any, columns: int | None) -> None:
        run = coupon(stability=(0.008, {}))
        (component,) = coupon_components(run, "coupon", unstated)
        assert component.modes.shape[1] == (columns or run.sizes["point"])
        np.testing.assert_allclose(np.sum(component.modes**2, axis=1), 0.0048**2)
        assert unstated in component.assumed

    def test_a_stated_matrix_is_followed(self) -> None:
        run = coupon(drift=(0.01, {"err_corr_1_form": "err_corr_matrix", "err_corr_1_params": ["err_corr_drift"]}))
        place = np.arange(run.sizes["point"])
        matrix = np.exp(-np.abs(place[:, None] - place) / 5.0)
        run["err_corr_drift"] = (("point", "other"), matrix)
        (component,) = coupon_components(run, "coupon")
        np.testing.assert_allclose(component.modes @ component.modes.T, 0.006**2 * matrix, atol=1e-12)
        run["err_corr_drift"] = (("point", "other"), matrix - 0.9 * np.eye(len(place)))
        with pytest.raises(InputError, match="eigenvalue"):
            coupon_components(run, "coupon")

    @pytest.mark.parametrize(
        ("name", "expected"),
        [
            # An arm that is off by an angle reads more on one side of the normal and less on the other.
            ("sensor_zenith", {(30, 0): [1], (-30, 0): [-1], (0, 90): [0], (60, 250): [1]}),
            # A surface that reflects alike left and right of the plane of incidence changes oppositely there.
            ("sensor_azimuth", {(30, 0): [0], (30, 180): [0], (30, 90): [1], (-30, 90): [-1], (30, 270): [-1]}),
            # Tilts about two axes; the same direction, shown as (-30, 90) or (30, 270), has the same error.
            ("placement", {(30, 0): [1, 0], (-30, 0): [-1, 0], (-30, 90): [0, -1], (30, 270): [0, -1]}),
            ("polarization", {(30, 0): [1], (30, 90): [-1], (-30, 45): [0], (30, 180): [1]}),
            ("reference", {(30, 0): [1], (-30, 0): [1], (30, 90): [1]}),
        ],
    )
    @pytest.mark.parametrize("illumination_azimuth", [0.0, 70.0])
    def test_systematic_errors_of_angles_have_the_sign_of_their_direction(
        self, name: str, expected: dict[tuple[float, float], list[float]], illumination_azimuth: float
    ) -> None:
        run = coupon(**{name: (0.002, SYSTEMATIC)}).isel(point=slice(0, len(expected)))
        zenith, azimuth = np.array(list(expected), dtype=float).T
        light = np.full(len(expected), illumination_azimuth)
        shown = {"sensor_zenith": zenith, "sensor_azimuth": azimuth + light, "illumination_azimuth": light}
        run = run.assign_coords({axis: ("point", values) for axis, values in shown.items()})
        (component,) = coupon_components(run, "coupon", by_direction=True)
        np.testing.assert_allclose(component.modes / 0.0012, list(expected.values()), atol=1e-12)
        (stated,) = coupon_components(run, "coupon")
        np.testing.assert_allclose(stated.modes, 0.0012)

    def test_errors_that_change_their_sign_are_not_looked_up_as_those_that_do_not(self) -> None:
        run = coupon(sensor_zenith=(0.002, SYSTEMATIC))
        states = [
            state_vector(facility(), flat(), lambertian(0.5), run, by_direction=choice) for choice in (True, False)
        ]
        assert len({inputs_digest(state, 0.1) for state in states}) == 2

    def test_a_component_whose_correlation_was_assumed_keeps_it_in_all_directions(self) -> None:
        run = coupon(sensor_zenith=(0.002, {}))
        one, other = (coupon_components(run, "coupon", "common", by_direction=choice) for choice in (True, False))
        np.testing.assert_array_equal(one[0].modes, other[0].modes)

    def test_an_unknown_form_and_a_missing_matrix_are_named(self) -> None:
        with pytest.raises(InputError, match="triangle"):
            coupon_components(coupon(noise=(0.01, {"err_corr_1_form": "triangle"})), "coupon")
        with pytest.raises(InputError, match="err_corr_1_params"):
            coupon_components(coupon(noise=(0.01, {"err_corr_1_form": "err_corr_matrix"})), "coupon")
        with pytest.raises(InputError, match="expected common, slice, independent"):
            coupon_components(coupon(noise=(0.01, {})), "coupon", "global")  # type: ignore[arg-type]

    def test_errors_of_the_run_become_errors_of_the_table(self) -> None:
        run = coupon(noise=(0.01, RANDOM), reference=(0.005, SYSTEMATIC))
        state = state_vector(facility(), flat(), from_coupon(run, "coupon"), run)
        values = state.nominal.copy()
        values[state.labels.index("material reference")] = 2.0
        material = state.material(state.inputs(values).coupon_error)
        np.testing.assert_allclose(material.brdf, state.nominal_material.brdf + 0.006 / np.pi, rtol=1e-9)
        values[state.labels.index("material noise 4")] = 1.0
        further = state.material(state.inputs(values).coupon_error)
        assert 0 < np.mean(further.brdf != material.brdf) < 0.2

    def test_a_table_says_that_its_uncertainty_is_missing(self) -> None:
        state = state_vector(facility(), flat(), lambertian(0.5))
        assert len(state) == 0
        assert any("not propagated" in note for note in state.notes)
