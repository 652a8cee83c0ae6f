from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from test_coupon_smooth import rough, run_of
from traced_samples import artifact, columns, facility
from typer.testing import CliRunner

from instrument.__main__ import build, main
from instrument.errors import InputError
from instrument.run_folder import copy_material
from twin.artifact import Surface, build_mesh
from twin.coupon import coupon_readings
from twin.coupon_heldout import fill_errors, predict
from twin.material import Material, lambertian, read_material
from twin.material_check import check_file, check_material
from twin.optics import lay_out
from twin.reflection_models import Origin, find_model, model_names
from twin.reflection_models.table import from_table, to_table
from twin.tracer import Tracer


def written(folder: Path, text: str) -> Path:
    path = folder / "material.toml"
    path.write_text(text, encoding="utf-8")
    return path


def coupon_file(folder: Path) -> Path:
    path = folder / "coupon.nc"
    run_of(rough, 0.004).to_netcdf(path, engine="h5netcdf")
    return path


THREE = """
[default]
model = "lambertian"
reflectance = 0.6

[floor]
model = "lambertian"
reflectance = 0.3

[wall]
model = "lambertian"
reflectance = 0.5
scale = 0.8
"""


def test_each_surface_gets_the_model_of_its_table(tmp_path: Path) -> None:
    material = read_material(written(tmp_path, THREE))
    reflectance = {
        surface: float(material.directional_reflectance(0.5, material.surfaces[surface])) for surface in Surface
    }
    assert reflectance[Surface.FLOOR] == pytest.approx(0.3)
    assert reflectance[Surface.HOLE_WALL] == pytest.approx(0.4)
    assert reflectance[Surface.SPACER] == pytest.approx(0.4)
    assert reflectance[Surface.PLATE_TOP] == pytest.approx(0.6)
    assert reflectance[Surface.UNDERSIDE] == pytest.approx(0.6)


def test_the_ray_tracer_takes_each_surface_at_its_own_reflectance(tmp_path: Path) -> None:
    material = read_material(written(tmp_path, THREE))
    mesh = build_mesh(artifact([(0.0, 0.0, 2.55)]))
    layout = lay_out(facility("unbounded", shape="horizontal_disc", target=3.0), columns([0.0, 30.0], 20.0, 45.0))
    index = np.zeros(len(layout), int)
    mixed = Tracer(mesh, material).radiance(layout, index, 1024, seed=3)
    factor = {Surface.FLOOR: 0.5, Surface.HOLE_WALL: 2 / 3, Surface.SPACER: 2 / 3}
    scaled = Tracer(mesh, lambertian(0.6), surface_factor=factor).radiance(layout, index, 1024, seed=3)
    np.testing.assert_allclose(mixed, scaled, rtol=1e-5)
    plain = Tracer(mesh, lambertian(0.6)).radiance(layout, index, 1024, seed=3)
    assert np.all(np.abs(mixed.mean(axis=1) / plain.mean(axis=1) - 1) > 0.01)


def test_surfaces_of_different_grids_and_wavelengths_are_joined_exactly(tmp_path: Path) -> None:
    coupon_file(tmp_path)
    floor = '[default]\nmodel = "coupon"\nfile = "coupon.nc"\nmethod = "linear"\n[floor]\nfile = "floor.nc"\n'
    random = np.random.default_rng(4)
    end = np.array([0.0, 0.3, 1.0])
    other = Material(end, np.array([0, 2.0, 2 * np.pi]), end, random.uniform(0.05, 0.1, (1, 3, 3, 3)), name="floor")
    to_table(other).to_netcdf(tmp_path / "floor.nc", engine="h5netcdf")
    material = read_material(written(tmp_path, floor))
    settings = {"file": "coupon.nc", "method": "linear"}
    coupon = find_model("coupon", "here")(settings, Origin(tmp_path, "here"))
    o, i, phi = random.uniform(0, 1, 300), random.uniform(0, 1, 300), random.uniform(0, 2 * np.pi, 300)
    for surface, single in ((Surface.PLATE_TOP, coupon), (Surface.FLOOR, other)):
        table = material.surfaces[surface] + int(material.table_index([500.0])[0])
        np.testing.assert_allclose(material.evaluate(o, phi, i, table), single.evaluate(o, phi, i), rtol=2e-6)
    again = from_table(to_table(material), "again")
    for surface in Surface:
        np.testing.assert_allclose(
            again.brdf[again.surfaces[surface]], material.brdf[material.surfaces[surface]], rtol=1e-12
        )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[floor]\nmodel = 'lambertian'\nreflectance = 0.5", "no material for plate_top, hole_wall"),
        ("[roof]\nmodel = 'lambertian'", "roof: unknown; expected tables out of"),
        ("[default]\nmodel = 'velvet'", "model: found 'velvet'; expected one of coupon, lambertian, measured"),
        ("[default]\nmodel = 'lambertian'\nreflectance = 1.5", "reflectance: found 1.5"),
        ("[default]\nmodel = 'lambertian'\nreflectance = 0.5\nscale = -1", "scale: found -1"),
        ("[default]\nfile = 'absent.nc'", "file: found 'absent.nc'; expected a file"),
        ("[default]\nreflectance = 0.5", "expected 'model' or 'file' alone"),
    ],
)
def test_wrong_assignments_are_named(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read_material(written(tmp_path, text))


def test_the_models_of_the_project_are_found() -> None:
    assert {"coupon", "lambertian", "measured", "table", "torrance-sparrow"} <= set(model_names())
    for name in model_names():
        assert callable(find_model(name, "here"))


def test_a_report_says_what_a_coupons_table_rests_on(tmp_path: Path) -> None:
    report = check_file(coupon_file(tmp_path))
    assert report.reciprocity_rms < 1e-9
    assert report.energy_largest < 0.75
    assert 0.2 < report.filled_share["grazing incidence"] < 0.4
    assert set(report.fill_error) == {"retroreflection", "grazing emergence", "grazing incidence"}
    assert 0.003 < report.interpolation_error < 0.008
    assert report.problems == ()
    assert "uncertain by" in "\n".join(report.lines())


def test_held_out_readings_are_predicted_as_entries_are_filled() -> None:
    run = run_of(rough)
    assert fill_errors(run, "c", "filled")["grazing incidence"] < fill_errors(run, "c", "linear")["grazing incidence"]
    (readings,) = coupon_readings(run, "c").values()
    last = readings.theta_i > 59
    nearest = predict("grazing incidence", readings.take(~last), readings.take(last), "linear")
    i, o, phi = 45.0, readings.theta_o[last], readings.phi[last]
    known = np.isfinite(nearest) & (np.abs(o - 45) > 6) & (o > 0)
    np.testing.assert_allclose(nearest[known], rough(i, o, phi)[known], rtol=1e-9)


def lopsided() -> Material:
    axis = np.array([0.0, 0.5, 1.0])
    brdf = np.broadcast_to(np.array([0.1, 0.2, 0.3])[:, None, None], (3, 2, 3))[None].copy()
    return Material(axis, np.array([0.0, 2 * np.pi]), axis, brdf, name="lopsided")


@pytest.mark.parametrize(
    ("material", "problem"),
    [
        (lopsided(), "not reciprocal"),
        (lambertian(1.01), "more light leaves than arrives: 1.01"),
        (
            Material(
                np.array([0.5, 1.0]), np.array([0.0, 2 * np.pi]), np.array([0.0, 1.0]), np.full((1, 2, 2, 2), 0.1)
            ),
            "emergence ends at 60 degrees",
        ),
    ],
)
def test_a_report_names_what_is_wrong(material: Material, problem: str) -> None:
    assert any(problem in text for text in check_material(material).problems)


def test_the_interpolation_error_of_a_parabola_is_known() -> None:
    axis = np.linspace(0, 1, 11)
    brdf = np.broadcast_to(0.1 + 0.1 * axis[:, None, None] ** 2, (11, 2, 2))[None].copy()
    material = Material(axis, np.array([0.0, 2 * np.pi]), np.array([0.0, 1.0]), brdf, name="parabola")
    # Between nodes h apart a parabola a x^2 is missed by a h^2/4 at most; with every second node by a h^2, a quarter
    # of which the report takes; the mean is 0.135.
    assert check_material(material).interpolation_error == pytest.approx(0.1 * 0.01 / 4 / 0.135, rel=1e-6)


def run_command(*arguments: Any) -> Any:
    words = [str(a) for a in arguments]
    return CliRunner().invoke(build(words), words)


def test_the_commands_check_and_write_a_table(tmp_path: Path) -> None:
    source = coupon_file(tmp_path)
    checked = run_command("material", "check", source, "--json", tmp_path / "report.json")
    assert checked.exit_code == 0
    assert "reciprocity: " in checked.stdout
    assert (tmp_path / "report.json").exists()
    table = run_command("material", "table", source, "--out", tmp_path / "table.nc")
    assert table.exit_code == 0
    np.testing.assert_allclose(read_material(tmp_path / "table.nc").brdf, read_material(source).brdf, rtol=1e-12)
    assert main(["material", "check", str(tmp_path / "absent.nc")]) == 2


def test_a_table_with_a_problem_is_told_by_the_status(tmp_path: Path) -> None:
    to_table(lopsided()).to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "t.nc", engine="h5netcdf") as data:
        assert data.brdf.attrs["units"] == "sr-1"
    result = run_command("material", "check", tmp_path / "t.nc")
    assert result.exit_code == 1
    assert "PROBLEM: not reciprocal" in result.stdout


def test_a_run_folder_holds_all_that_a_material_is_made_of(tmp_path: Path) -> None:
    """Its copy reads the same when the original is gone, and takes no other file's name."""
    coupon, source, run = tmp_path / "coupon", tmp_path / "source", tmp_path / "run"
    for folder in (coupon, source, run):
        folder.mkdir()
    name = coupon_file(coupon).rename(coupon / "run.nc").name
    path = written(source, f'[default]\nfile = "../coupon/{name}"\n[wall]\nfile = "../coupon/{name}"\nscale = 0.9\n')
    before = read_material(path)
    copy = copy_material(path, run)
    assert sorted(p.name for p in run.iterdir()) == ["material-default-run.nc", "material.toml"]
    (coupon / name).unlink()
    after = read_material(copy)
    np.testing.assert_array_equal(after.brdf, before.brdf)
    assert after.surfaces == before.surfaces
    with pytest.raises(InputError, match=r"run\.nc"):
        copy_material(path, tmp_path / "source")
