"""Tables with columns of their own become runs; what is wrong with them is named."""

from pathlib import Path

import numpy as np
import pytest

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
