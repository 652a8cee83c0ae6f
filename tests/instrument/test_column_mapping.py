"""Tables with columns of their own become runs; what is wrong with them is named."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from instrument.column_mapping import read_mapped
from instrument.errors import InputError

MAPPING = """
form = "column mapping"
version = 1
arm_on_other_side_above = 90

[table]
delimiter = ";"
header = 2

[columns]
wavelength = { column = "lambda", unit = "um" }
illumination_zenith = { column = "i", unit = "rad" }
illumination_azimuth = { column = "azimuth" }
sensor_zenith = { column = "e" }
sensor_azimuth = { constant = 0 }
brf = { column = "r", unit = "%" }
u_brf_noise = { column = "sd", unit = "%", relative = true, least = 0.1 }
u_brf_stability = { constant = 0.3, unit = "%", relative = true }

[time]
column = "t"
since = "2020-03-13T00:00:00Z"

[[rows]]
column = "ok"
one_of = [1]
"""
TABLE = """# made by hand
# 'lambda'; 'i'; 'azimuth'; 'e'; 'r'; 'sd'; 't'; 'ok'
0.55; 0.5; 120; 30; 98; 0.4; 20; 1
# a remark
0.55; 0.5; 60; 40; 99; 0; 10; 1
0.55; 0.5; 60; 45; 10; 0; 15; 0
"""


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    table, mapping = tmp_path / "other.csv", tmp_path / "mapping.toml"
    table.write_text(TABLE)
    mapping.write_text(MAPPING)
    return table, mapping


def test_units_rows_constants_and_time_order(files):
    run = read_mapped(*files)
    assert run.sizes["point"] == 2
    np.testing.assert_allclose(run["wavelength"], 550.0)
    np.testing.assert_allclose(run["illumination_zenith"], np.rad2deg(0.5))
    np.testing.assert_allclose(run["brf"], [0.99, 0.98])
    np.testing.assert_allclose(run["u_brf_noise"], [0.99 * 0.001, 0.98 * 0.004])
    np.testing.assert_allclose(run["u_brf"], [0.99 * np.hypot(0.001, 0.003), 0.98 * 0.005])
    assert run["time"].values[0] == np.datetime64("2020-03-13T00:00:10")


def test_an_arm_on_its_other_side_names_the_same_direction_otherwise(files):
    from instrument.angles import direction

    run = read_mapped(*files)
    np.testing.assert_allclose(run["illumination_azimuth"], [60, -60])
    np.testing.assert_allclose(run["sensor_zenith"], [40, -30])
    relative = -run["illumination_azimuth"].values
    np.testing.assert_allclose(
        direction(run["sensor_zenith"].values, relative),
        direction(np.array([40, 30]), np.array([-60, -120])),
        atol=1e-12,
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('column = "r"', 'column = "reflectance"', "'reflectance'.*found lambda, i, azimuth"),
        ('unit = "rad"', 'unit = "gon"', "columns.illumination_zenith: unit 'gon'; expected one of degree, rad"),
        ("sensor_zenith =", "sensor_elevation =", "sensor_zenith missing"),
        ("constant = 0 }", 'constant = 0, column = "e" }', "expected either column or constant"),
        ("one_of = [1]", "one_of = [7]", "no row is left"),
        ("version = 1", "version = 2", "version"),
        ("2020-03-13T00:00:00Z", "yesterday", "time.since: found 'yesterday'"),
        ('delimiter = ";"', 'delimiter = ","', "column 't'|found 1 columns|not in"),
    ],
)
def test_what_is_wrong_with_a_mapping_is_named(files, old, new, said):
    table, mapping = files
    assert old in MAPPING
    mapping.write_text(MAPPING.replace(old, new))
    with pytest.raises(InputError, match=said):
        read_mapped(table, mapping)


def test_text_where_a_number_is_expected_and_short_rows_are_named(files):
    table, mapping = files
    table.write_text(TABLE.replace("; 98;", "; bright;"))
    with pytest.raises(InputError, match="row 1: r: found 'bright'; expected a number"):
        read_mapped(table, mapping)
    table.write_text(TABLE.replace("; 20; 1", "; 20"))
    with pytest.raises(InputError, match="line 3: found 7 columns; expected 8"):
        read_mapped(table, mapping)


SHARED = Path(__file__).parents[2].parent / "shared"
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
GRID = """
form = "column mapping"
version = 1
[columns]
wavelength = { column = "w", unit = "um" }
illumination_zenith = { column = "theta_ill" }
illumination_azimuth = { constant = 0 }
sensor_zenith = { column = "theta_sen", unit = "rad" }
sensor_azimuth = { constant = 90 }
brf = { column = "f", unit = "1/sr" }
u_brf = { column = "u", unit = "%", relative = true }
"""


@pytest.fixture
def grid(tmp_path: Path) -> tuple[Path, Path]:
    """A grid of two illuminations and three sensor zeniths, one of which was not measured, at one wavelength."""
    brdf = np.array([[0.1, 0.2, np.nan], [0.3, 0.25, 0.2]])
    dataset = xr.Dataset(
        {"f": (("theta_ill", "theta_sen"), brdf, {"units": "sr-1"}), "u": ("theta_sen", [1.0, 2.0, 3.0]), "w": 0.5},
        coords={"theta_ill": ("theta_ill", [0.0, 15.0], {"units": "degrees"}), "theta_sen": [0.0, 0.5, 1.0]},
    )
    path, mapping = tmp_path / "theirs.nc", tmp_path / "mapping.toml"
    dataset.to_netcdf(path, engine="h5netcdf")
    mapping.write_text(GRID)
    return path, mapping


def test_variables_of_a_netcdf_file_on_a_grid_become_points(grid):
    run = read_mapped(*grid)
    assert run.sizes["point"] == 5
    np.testing.assert_allclose(run["wavelength"], 500.0)
    np.testing.assert_allclose(run["illumination_zenith"], [0, 0, 15, 15, 15])
    np.testing.assert_allclose(run["sensor_zenith"], np.rad2deg([0, 0.5, 0, 0.5, 1.0]))
    np.testing.assert_allclose(run["brf"], np.pi * np.array([0.1, 0.2, 0.3, 0.25, 0.2]))
    np.testing.assert_allclose(run["u_brf"] / run["brf"], [0.01, 0.02, 0.01, 0.02, 0.03])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('column = "f"', 'column = "R"', "column 'R': not in .*theirs.nc; found f, u, w"),
        ('"f", unit = "1/sr"', '"f"', "column 'f': taken for 1; .*theirs.nc says 'sr-1'"),
        ('"theta_ill" }', '"theta_ill", unit = "rad" }', "column 'theta_ill': taken for rad; .* says 'degrees'"),
        ('"u", unit = "%"', '"u", unit = "1/sr"', r"relative to brf, and in 1/sr; expected 1 or %"),
    ],
)
def test_what_a_netcdf_file_does_not_say_is_named(grid, old, new, said):
    path, mapping = grid
    assert old in GRID
    mapping.write_text(GRID.replace(old, new))
    with pytest.raises(InputError, match=said):
        read_mapped(path, mapping)


def test_a_netcdf_file_that_is_cut_short_or_holds_no_point_is_named(grid):
    path, mapping = grid
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="cannot be read as netCDF-4"):
        read_mapped(path, mapping)
    path.unlink()
    with pytest.raises(InputError, match="no such file"):
        read_mapped(path, mapping)


def test_the_template_for_the_files_of_the_paper_reads_files_with_those_names(tmp_path):
    angles = {"illumination_zenith": [0.0, 15.0], "sensor_zenith": [30.0, 40.0], "sensor_azimuth": [0.0, 45.0]}
    columns = angles | {"wavelength": [500.0, 500.0], "brf": [0.5, 0.6], "u_brf": [0.01, 0.02]}
    path = tmp_path / "artefact_measurements.nc"
    xr.Dataset({name: ("m", values) for name, values in columns.items()}).to_netcdf(path, engine="h5netcdf")
    run = read_mapped(path, EXAMPLES / "leroy2025_columns.toml")
    for name, values in columns.items():
        np.testing.assert_array_equal(run[name], values)


needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="needs ../shared, the measurements of others")


@needs_shared
def test_the_mastcamz_table_is_read_by_its_mapping():
    table = SHARED / "data" / "mastcamz_spectralon" / "20200313_mastcamz_spectralon.csv"
    run = read_mapped(table, EXAMPLES / "mastcamz_columns.toml")
    # Its first row: incidence 0, emission 80 at azimuth 90, 0.79146 with 0.134 and 1.949 per cent.
    assert run["time"].values[0] == np.datetime64("2020-03-13T08:47:09")
    first = run.isel(point=0)
    assert float(first["brf"]) == 0.79146
    assert float(first["u_brf"]) == pytest.approx(0.79146e-2 * np.hypot(0.1338897162, 1.94936))
    assert sorted(set(np.abs(run["illumination_zenith"].values))) == [0, 15, 30, 45, 58, 70]


@needs_shared
def test_the_ptfe_tables_are_read_by_their_mapping():
    folder = SHARED / "data" / "nist_ptfe"
    run = read_mapped(folder / "PTFE.data.csv", EXAMPLES / "nist_ptfe_columns.toml")
    assert run.sizes["point"] == 4 * 1824
    assert sorted(set(run["wavelength"].values)) == [351, 532, 633, 1064]
    assert float(run["brf"][0]) == pytest.approx(0.262 * np.pi)
    scattered = read_mapped(folder / "PTFE.data.random.csv", EXAMPLES / "nist_ptfe_columns.toml")
    # White PTFE: near a perfect diffuser wherever neither direction is oblique, at every wavelength.
    for table in (run, scattered):
        steep = np.maximum(np.abs(table["illumination_zenith"]), np.abs(table["sensor_zenith"])) < 45
        assert 0.9 < float(table["brf"].where(steep).min()) < float(table["brf"].where(steep).max()) < 1.15
