from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from traced_samples import shared_file

from instrument.errors import InputError
from twin.coupon import from_coupon
from twin.material import Material, lambertian, read_material
from twin.reflection_models.table import from_table

GRID_I, GRID_PHI, GRID_O = (0, 15, 30, 45, 60), (0, 45, 90, 135), np.arange(-80, 81, 5)


def smooth(theta_i: np.ndarray, theta_o: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """A reflectance factor, isotropic and mirror-symmetric; zenith signed, degree."""
    s = np.sin(np.deg2rad(theta_i)) * np.sin(np.deg2rad(theta_o))
    return 0.6 + 0.1 * s * np.cos(np.deg2rad(phi)) + 0.05 * s**2


def coupon(*, wavelengths: tuple[float, ...] = (500.0,), shadow: float = 5.0) -> xr.Dataset:
    rows = [(w, i, o, p) for w in wavelengths for i in GRID_I for p in GRID_PHI for o in GRID_O]
    w, i, o, p = np.array(rows, dtype=float).T
    away = np.rad2deg(
        np.arccos(
            np.clip(
                np.cos(np.deg2rad(i)) * np.cos(np.deg2rad(o))
                + np.sin(np.deg2rad(i)) * np.sin(np.deg2rad(o)) * np.cos(np.deg2rad(p)),
                -1,
                1,
            )
        )
    )
    seen = away >= shadow - 1e-6
    w, i, o, p = (a[seen] for a in (w, i, o, p))
    brf = smooth(i, o, p)
    return xr.Dataset(
        {"brf": ("point", brf), "u_brf": ("point", 0.01 * brf)},
        coords={
            "wavelength": ("point", w),
            "illumination_zenith": ("point", i),
            "illumination_azimuth": ("point", np.zeros(len(w))),
            "sensor_zenith": ("point", o),
            "sensor_azimuth": ("point", p),
        },
    )


def test_the_table_returns_the_coupons_readings() -> None:
    run = coupon()
    material = from_coupon(run, "coupon.nc", "linear")
    o, p = np.abs(run.sensor_zenith.values), run.sensor_azimuth.values + 180.0 * (run.sensor_zenith.values < 0)
    value = np.pi * material.evaluate(
        np.cos(np.deg2rad(o)), np.deg2rad(p), np.cos(np.deg2rad(run.illumination_zenith.values))
    )
    np.testing.assert_allclose(value, run.brf.values, rtol=1e-12)


def test_the_retro_gap_is_interpolated_linearly_in_zenith_and_counted() -> None:
    material = from_coupon(coupon(), "coupon.nc", "linear")
    expected = (smooth(np.array(30), np.array(25), np.array(0)) + smooth(np.array(30), np.array(35), np.array(0))) / 2
    cosine = np.cos(np.deg2rad(30.0))
    assert np.pi * material.evaluate(cosine, 0.0, cosine) == pytest.approx(float(expected))
    # Four gaps at oblique incidence; at normal incidence one for each azimuth difference 0 to 180.
    assert material.filled["retroreflection"] == 4 + 5


def test_beyond_the_last_zenith_the_nearest_value_holds_and_is_counted() -> None:
    material = from_coupon(coupon(), "coupon.nc", "linear")
    last_o, last_i = np.cos(np.deg2rad(80.0)), np.cos(np.deg2rad(60.0))
    assert material.evaluate(0.05, 1.0, last_i) == pytest.approx(float(material.evaluate(last_o, 1.0, last_i)))
    assert material.evaluate(last_o, 1.0, 0.1) == pytest.approx(float(material.evaluate(last_o, 1.0, last_i)))
    assert material.filled["grazing emergence"] == 5 * 5
    assert material.filled["grazing incidence"] == 5 * 18


def test_the_table_is_mirror_symmetric_and_periodic() -> None:
    material = from_coupon(coupon(), "coupon.nc", "linear")
    random = np.random.default_rng(0)
    o, i, phi = random.uniform(0, 1, 50), random.uniform(0, 1, 50), random.uniform(0, 2 * np.pi, 50)
    value = material.evaluate(o, phi, i)
    np.testing.assert_allclose(material.evaluate(o, 2 * np.pi - phi, i), value, rtol=1e-12)
    np.testing.assert_allclose(material.evaluate(o, phi + 2 * np.pi, i), value, rtol=1e-12)


def test_readings_on_both_sides_of_the_plane_are_averaged() -> None:
    run = coupon()
    tilted = run.brf.values * (1 + 0.01 * np.sign(np.sin(np.deg2rad(run.sensor_azimuth))) * np.sign(run.sensor_zenith))
    material = from_coupon(run.assign(brf=("point", tilted.values)), "coupon.nc", "linear")
    at = np.cos(np.deg2rad([40.0, 45.0]))
    symmetric = float(smooth(np.array(45), np.array(40), np.array(90)))
    assert np.pi * material.evaluate(at[0], np.pi / 2, at[1]) == pytest.approx(symmetric)


def test_the_azimuth_has_no_meaning_along_the_normal() -> None:
    material = from_coupon(coupon(), "coupon.nc", "linear")
    at_normal = material.evaluate(0.5, np.linspace(0, 6, 20), 1.0)
    np.testing.assert_allclose(at_normal, at_normal[0], rtol=1e-12)


def test_each_wavelength_has_its_table() -> None:
    run = coupon(wavelengths=(500.0, 700.0))
    run["brf"] = run.brf * xr.where(run.wavelength > 600, 0.5, 1.0)
    material = from_coupon(run, "coupon.nc", "linear")
    np.testing.assert_array_equal(material.table_index([700.0, 500.0]), [1, 0])
    assert material.evaluate(0.7, 1.0, 0.9, 1) == pytest.approx(0.5 * float(material.evaluate(0.7, 1.0, 0.9, 0)))
    with pytest.raises(InputError, match="measured at 500, 700 nm; a prediction at 600 nm"):
        material.table_index([600.0])


def test_a_gap_off_retroreflection_is_an_error() -> None:
    run = coupon()
    missing = (run.illumination_zenith == 30) & (run.sensor_azimuth == 0) & (run.sensor_zenith == 60)
    with pytest.raises(InputError, match=r"coupon\.nc: the table has 1 gaps.*illumination_zenith 30, sensor_zenith 60"):
        from_coupon(run.isel(point=np.flatnonzero(~missing.values)), "coupon.nc")


def test_flagged_readings_are_left_out() -> None:
    run = coupon()
    flagged = (run.illumination_zenith == 45) & (run.sensor_azimuth == 90) & (np.abs(run.sensor_zenith) == 20)
    run["quality_flag"] = ("point", np.where(flagged, 1, 0))
    run["brf"] = run.brf.where(~flagged, 5.0)
    with pytest.raises(InputError, match=r"the table has 1 gaps.*sensor_zenith 20"):
        from_coupon(run, "coupon.nc")


def test_a_coupon_without_the_plane_of_incidence_is_an_error() -> None:
    run = coupon()
    with pytest.raises(InputError, match="azimuth differences run from 45 to 135 degrees"):
        from_coupon(run.isel(point=np.flatnonzero(run.sensor_azimuth.values != 0)), "coupon.nc")


def test_the_example_coupon_is_read_and_reflects_what_it_should() -> None:
    material = read_material(shared_file("cases", "common", "material.nc"))
    assert material.method == "smooth"
    with xr.open_dataset(shared_file("cases", "common", "material.nc"), engine="h5netcdf") as run:
        paper = from_coupon(run.load(), "material.nc", "linear")
    assert paper.filled == {"retroreflection": 9, "grazing emergence": 25, "grazing incidence": 90}
    np.testing.assert_allclose(material.directional_reflectance(1.0), 0.6, atol=0.01)


def table(**changes: object) -> xr.Dataset:
    phi = np.arange(0, 360, 30.0)
    mu = np.linspace(0, 1, 6)
    brdf = np.full((6, 12, 6), 0.5 / np.pi)
    data = xr.Dataset(
        {"brdf": (("cos_theta_o", "phi_d", "cos_theta_i"), brdf, {"units": "sr^-1"})},
        coords={
            "cos_theta_o": mu,
            "phi_d": ("phi_d", phi, {"units": "degree"}),
            "cos_theta_i": mu,
        },
    )
    return data.assign(**changes)


def test_a_ready_table_is_the_same_with_and_without_the_repeated_node() -> None:
    data = table()
    random = np.random.default_rng(1)
    data["brdf"] = data.brdf.copy(data=random.uniform(0.1, 0.2, data.brdf.shape))
    repeated = xr.concat([data, data.isel(phi_d=[0]).assign_coords(phi_d=[360.0])], "phi_d")
    repeated["phi_d"].attrs["units"] = "degree"
    first, second = from_table(data, "a"), from_table(repeated, "b")
    np.testing.assert_allclose(first.phi_rad, second.phi_rad)
    np.testing.assert_allclose(first.brdf, second.brdf)


def test_a_table_is_read_whatever_the_order_of_its_dimensions() -> None:
    data = table()
    data["brdf"] = data.brdf.copy(data=np.random.default_rng(2).uniform(0.1, 0.2, data.brdf.shape))
    turned = data.transpose("phi_d", "cos_theta_i", "cos_theta_o").isel(cos_theta_o=slice(None, None, -1))
    np.testing.assert_allclose(from_table(turned, "a").brdf, from_table(data, "b").brdf)


def test_the_reference_table_is_linear_between_its_nodes() -> None:
    with xr.open_dataset(shared_file("reference", "table_brdf.nc"), engine="h5netcdf") as data:
        data = data.load()
    material = from_table(data, "table")
    random = np.random.default_rng(5)
    o, i, phi = random.uniform(0, 1, 200), random.uniform(0, 1, 200), random.uniform(0, data.phi_d.values[-1], 200)
    places = {"cos_theta_o": xr.DataArray(o), "phi_d": xr.DataArray(phi), "cos_theta_i": xr.DataArray(i)}
    np.testing.assert_allclose(material.evaluate(o, phi, i), data.brdf.interp(places).values, rtol=1e-10)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d.brdf.attrs.update(units="1"), "brdf: found the unit '1'"),
        (lambda d: d.phi_d.attrs.clear(), "phi_d: found the unit ''"),
        (lambda d: d.brdf.values.__setitem__((2, 3, 1), np.nan), "1 of 468 entries are not a number, the first at"),
        (lambda d: d.brdf.values.__setitem__((2, 3, 1), -1e-3), "entries are negative"),
        (lambda d: d.brdf.values.__imul__(7.0), "reflected 3.5 times over"),
    ],
)
def test_bad_tables_are_refused(spoil, message: str) -> None:
    data = table()
    spoil(data)
    with pytest.raises(InputError, match=message):
        from_table(data, "table.nc")


def test_a_table_over_half_the_circle_is_refused() -> None:
    with pytest.raises(InputError, match="expected the whole circle"):
        from_table(table().isel(phi_d=slice(0, 7)), "table.nc")


def test_a_table_in_radians_that_says_degrees_is_refused() -> None:
    data = table()
    data = data.assign_coords(phi_d=("phi_d", np.deg2rad(data.phi_d.values), {"units": "degree"}))
    with pytest.raises(InputError, match="phi_d: ends at"):
        from_table(data, "table.nc")


def test_a_lambertian_surface_is_constant() -> None:
    material = lambertian(0.5)
    assert material.evaluate(0.3, 2.0, 0.9) == pytest.approx(0.5 / np.pi)
    np.testing.assert_allclose(material.directional_reflectance([0.2, 1.0]), 0.5)


def test_missing_and_foreign_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.nc: no such file"):
        read_material(tmp_path / "absent.nc")
    text = tmp_path / "text.nc"
    text.write_text("hello")
    with pytest.raises(InputError, match=r"text\.nc: not a readable netCDF-4 file"):
        read_material(text)
    other = tmp_path / "other.nc"
    xr.Dataset({"temperature": ("x", [1.0])}).to_netcdf(other, engine="h5netcdf")
    with pytest.raises(InputError, match="found the variables temperature; expected 'brf'"):
        read_material(other)


def test_a_table_of_another_shape_is_refused() -> None:
    end = np.array([0.0, 1.0])
    with pytest.raises(InputError, match=r"brdf: found shape \(1, 2, 3, 2\); expected \(1, 2, 2, 2\)"):
        Material(end, np.array([0.0, 2 * np.pi]), end, np.zeros((1, 2, 3, 2)), name="odd")
