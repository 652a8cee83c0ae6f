"""Comparison of a run with a prediction: a case computed by hand, matching by geometry, honest refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

from instrument.errors import InputError
from twin.comparison import MONTE_CARLO_ONLY, compare
from twin.matching import match_points

GEOMETRIES = [(500, 0, 0, -30, 0), (500, 0, 0, 40, 0), (500, 15, 0, 10, 105), (500, 15, 0, 60, 105)]


def table(geometries=GEOMETRIES, **columns) -> xr.Dataset:
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    values = np.asarray(geometries, dtype=float).reshape(-1, 5)
    coordinates = {name: ("point", values[:, i]) for i, name in enumerate(names)}
    return xr.Dataset({name: ("point", np.asarray(v)) for name, v in columns.items()}, coords=coordinates)


def measurement(**extra) -> xr.Dataset:
    return table(brf=[0.5, 0.5, 0.6, 0.6], u_brf=[0.004, 0.005, 0.006, 0.006], **extra)


def prediction() -> xr.Dataset:
    return table(
        brf=[0.508, 0.495, 0.63, 0.6],
        u_brf=[0.003, 0.0, 0.008, 0.008],
        u_brf_monte_carlo=[0.00254, 0.0, 0.0126, 0.003],
    )


def test_a_case_computed_by_hand():
    # dR*: 0.016, -0.01, 0.05, 0; t': 1.6, -1, 3, 0; k: 0.6, 0, 0.8, 0.8;
    # n': Phi(2/3) = 0.747507, 1, Phi(-1.25) = 0.105650, 1 - 2 Phi(-2.5) = 0.987581.
    result = compare(measurement(), prediction()).to_dict()
    assert result["global"] == {
        "points": 4,
        "relative_rmse": pytest.approx(0.0267208, abs=1e-7),
        "mean_absolute_relative_difference": pytest.approx(0.019),
        "rms_t": pytest.approx(1.772005, abs=1e-6),
        "level_of_agreement": pytest.approx(0.7101845, abs=1e-6),
        "shares": {
            "relative_difference": {"good": 0.75, "acceptable": 0.0, "poor": 0.25},
            "t": {"good": 0.25, "acceptable": 0.5, "poor": 0.25},
            "level_of_agreement": {"good": 0.5, "acceptable": 0.25, "poor": 0.25},
        },
    }
    assert result["in_plane"]["points"] == 2
    assert result["in_plane"]["mean_absolute_relative_difference"] == pytest.approx(0.013)
    assert result["in_plane"]["level_of_agreement"] == pytest.approx((0.747507 + 1) / 2, abs=1e-6)
    assert result["out_of_plane"]["rms_t"] == pytest.approx(np.sqrt(4.5))
    # relative standard errors 0.005, 0, 0.02, 0.005
    assert result["monte_carlo"]["median_relative_standard_error"] == pytest.approx(0.005)


def test_json_has_exactly_the_form_of_the_data_contract():
    found = compare(measurement(), prediction()).to_dict()
    assert list(found) == ["global", "in_plane", "out_of_plane", "planes", "monte_carlo"]
    group = {"points", "relative_rmse", "mean_absolute_relative_difference", "rms_t", "level_of_agreement", "shares"}
    for name in ("global", "in_plane", "out_of_plane"):
        assert set(found[name]) == group
        assert set(found[name]["shares"]) == {"relative_difference", "t", "level_of_agreement"}
    assert [(p["wavelength"], p["illumination_zenith"], p["sensor_azimuth"]) for p in found["planes"]] == [
        (500.0, 0.0, 0.0),
        (500.0, 15.0, 105.0),
    ]
    assert set(found["planes"][0]) == group | {"wavelength", "illumination_zenith", "sensor_azimuth"}
    assert sum(p["points"] for p in found["planes"]) == found["global"]["points"]


def test_an_empty_group_is_null_and_not_an_invented_number():
    rows = [2, 3]
    found = json.loads(json.dumps(compare(measurement().isel(point=rows), prediction()).to_dict(), allow_nan=False))
    assert found["in_plane"]["points"] == 0
    assert found["in_plane"]["relative_rmse"] is None
    assert found["in_plane"]["shares"]["t"]["good"] is None


def test_the_order_of_the_prediction_and_its_extra_points_do_not_matter():
    extra = table([(500, 30, 0, 5, 60)], brf=[0.4], u_brf=[0.1], u_brf_monte_carlo=[0.1])
    shuffled = xr.concat([extra, prediction()], dim="point").isel(point=[3, 0, 2, 4, 1])
    assert compare(measurement(), shuffled).to_dict() == compare(measurement(), prediction()).to_dict()


def test_directions_are_matched_and_not_numbers():
    offered = table([(500, 0, 0, 40, 0), (500, 0, 0, 30, 180)])
    assert match_points(table([(500, 0, 0, -30, 0)]), offered).tolist() == [1]


def test_among_equal_directions_the_same_angles_win():
    plan = [(500, 15, 0, 0, azimuth) for azimuth in (0, 50, 75)]
    assert match_points(table(plan[::-1]), table([*plan, (500, 15, 0, 60, 0)])).tolist() == [2, 1, 0]


def test_a_point_without_prediction_is_named():
    with pytest.raises(InputError) as error:
        compare(measurement(), prediction().isel(point=[0, 1, 3]))
    assert "point 2 has no prediction: measured at 500 nm, illumination zenith 15" in str(error.value)
    assert "sensor zenith 10 azimuth 105" in str(error.value)
    assert "the nearest predicted point, 0, is at" in str(error.value)


def test_a_point_is_named_by_its_row_in_the_file():
    run = measurement(quality_flag=np.array([1, 0, 0, 0], dtype=np.int8))
    with pytest.raises(InputError, match="point 2 has no prediction"):
        compare(run, prediction().isel(point=[0, 1, 3]))


@pytest.mark.parametrize("shift", [(2, 0, 0, 0, 0), (0, 0.1, 0, 0, 0), (0, 0, 0, 0.01, 0), (0, 0, 0, 0, 0.01)])
def test_a_slightly_different_geometry_is_not_the_same_point(shift):
    moved = np.asarray(GEOMETRIES, dtype=float) + shift
    other = table(moved, **{name: prediction()[name].values for name in prediction().data_vars})
    with pytest.raises(InputError, match="no prediction"):
        compare(measurement(), other)


def test_rounding_of_angles_is_tolerated():
    rounded = np.asarray(GEOMETRIES, dtype=np.float32).astype(float) + 2e-4
    other = table(rounded[::-1], **{name: prediction()[name].values[::-1] for name in prediction().data_vars})
    assert compare(measurement(), other).overall == compare(measurement(), prediction()).overall


def test_flagged_and_missing_points_are_left_out_and_said_so():
    run = measurement(quality_flag=np.array([1, 8, 0, 0], dtype=np.int8))
    run["brf"][3] = np.nan
    result = compare(run, prediction())
    assert result.points["row"].values.tolist() == [1, 2]
    assert any("1 points flagged" in note for note in result.notes)
    assert any("1 points without" in note for note in result.notes)


@pytest.mark.parametrize(("flag", "left"), [(1, 3), (2, 3), (4, 3), (12, 3), (8, 4)])
def test_only_flags_that_spoil_a_reading_leave_it_out(flag, left):
    run = measurement(quality_flag=np.array([0, flag, 0, 0], dtype=np.int8))
    assert compare(run, prediction()).overall.points == left


def test_nothing_left_to_compare_is_an_error():
    with pytest.raises(InputError, match="no point that can be compared"):
        compare(measurement(quality_flag=np.full(4, 2, dtype=np.int8)), prediction())


@pytest.mark.parametrize(
    ("variable", "value", "said"),
    [("u_brf", 0.0, "found 0 for both sides"), ("u_brf", -0.1, "negative"), ("brf", 0.0, "found 0")],
)
def test_values_that_allow_no_comparison_are_named(variable, value, said):
    run = measurement()
    run[variable][1] = value
    with pytest.raises(InputError, match=f"point 1 .*{said}"):
        compare(run, prediction())


def test_missing_variable_of_the_prediction_is_named():
    with pytest.raises(InputError, match="u_brf_monte_carlo missing"):
        compare(measurement(), prediction().drop_vars("u_brf_monte_carlo"))


def test_a_prediction_with_nothing_but_monte_carlo_error_says_so():
    alone = prediction()
    alone["u_brf"] = alone["u_brf_monte_carlo"]
    assert MONTE_CARLO_ONLY in compare(measurement(), alone).notes
    assert MONTE_CARLO_ONLY not in compare(measurement(), prediction()).notes


def test_planes_are_told_apart_by_a_turned_illumination():
    geometries = [(500, 15, 0, 20, 90), (500, 15, 90, 20, 90), (500, 15, 90, 30, 0)]
    run = table(geometries, brf=[0.5] * 3, u_brf=[0.01] * 3)
    twin = table(geometries, brf=[0.5] * 3, u_brf=[0.01] * 3, u_brf_monte_carlo=[0.001] * 3)
    result = compare(run, twin).to_dict()
    assert [plane["illumination_azimuth"] for plane in result["planes"]] == [0.0, 90.0, 90.0]
    assert result["in_plane"]["points"] == 1
