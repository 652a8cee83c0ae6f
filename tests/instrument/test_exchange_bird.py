"""The universal BRDF data format: what is written keeps to its rules, what is read back is what was measured."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from example_runs import four_points, minimal_run, status
from hypothesis import given, settings
from hypothesis import strategies as st

from instrument.dataset import read_run, rebuild_run, write_run
from instrument.errors import InputError
from instrument.exchange.bird_read import imported, read_bird
from instrument.exchange.bird_write import bird_document, read_metadata, unstated
from instrument.run_axes import polarization_column

#: What the published schemas (version 1.0) require of a measurement, by place.
REQUIRED = {
    (): {"metadata", "data"},
    ("metadata",): {
        *("schema", "id", "type", "timestamp", "provenance", "description", "method"),
        *("instrumentation", "software", "sample", "environment"),
    },
    ("metadata", "provenance"): {"organization", "location", "email", "contact_person"},
    ("metadata", "provenance", "location"): {"country", "city", "street", "building_nr", "postal_code"},
    ("metadata", "sample"): {"name", "type", "dimensions", "shape", "zero_azimuth_location"},
    ("data",): {"theta_i", "phi_i", "theta_r", "phi_r", "BRDF"},
}
METADATA = """
form = "BiRD metadata"
version = 1
[sample]
name = "plate 3"
[instrumentation.illumination_system.source]
type = "laser"
power = { value = 0.5, unit = "W" }
"""


def run_of(rows: list[tuple[float, ...]]) -> xr.Dataset:
    """A run of wavelengths, angles (illumination, sensor), turns of the sample, brf and relative uncertainties."""
    columns = np.array(rows).T
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    units = ("nm", *["degree"] * 4)
    run = xr.Dataset(
        {name: ("point", c, {"units": u}) for name, c, u in zip(names, columns[:5], units, strict=True)}
        | {
            "sample_rotation": ("point", columns[5], {"units": "degree"}),
            "brf": ("point", columns[6], {"units": "1"}),
            "u_brf": ("point", columns[7] * columns[6], {"units": "1"}),
        }
    )
    return run.set_coords([*names, "sample_rotation"])


ANGLE = st.floats(-180.0, 180.0)
ROW = st.tuples(
    *(st.floats(300.0, 2500.0), st.floats(-89.9, 89.9), ANGLE, st.floats(-89.9, 89.9), ANGLE),
    *(st.floats(-90.0, 90.0), st.floats(0.001, 3.0), st.floats(1e-4, 0.5)),
)


@settings(max_examples=15)
@given(st.lists(ROW, min_size=1, max_size=6))
def test_geometry_values_and_uncertainties_come_back(rows: list[tuple[float, ...]]) -> None:
    run = run_of(rows)
    document = json.loads(json.dumps(bird_document(run, "run.nc"), allow_nan=False))
    back = imported(document, "run.json").run
    for name in ("wavelength", "illumination_zenith", "sensor_zenith", "sensor_azimuth", "sample_rotation"):
        np.testing.assert_array_equal(back[name], run[name])
    for name in ("brf", "u_brf"):
        np.testing.assert_allclose(back[name], run[name], rtol=1e-14)


@settings(max_examples=15)
@given(st.lists(ROW, min_size=1, max_size=6))
def test_angles_keep_to_the_ranges_of_the_format(rows: list[tuple[float, ...]]) -> None:
    data = bird_document(run_of(rows), "run.nc")["data"]
    for name in ("theta_i", "theta_r"):
        assert all(0 <= value < 90 for value in data[name]["values"])
    for name in ("phi_i", "phi_r"):
        assert all(0 <= value < 360 for value in data[name]["values"])


def test_a_negative_zenith_a_turned_sample_and_the_factor_pi() -> None:
    run = run_of([(550.0, 10.0, 0.0, -30.0, 45.0, 15.0, 0.5, 0.02)])
    data = bird_document(run, "run.nc")["data"]
    found = {name: data[name]["values"][0] for name in ("theta_i", "phi_i", "theta_r", "phi_r", "BRDF", "uBRDF")}
    # Sensor zenith -30 at azimuth 45 is 30 at 225; seen from a sample turned by 15 degrees, 210.
    assert found == pytest.approx(
        {"theta_i": 10, "phi_i": 345, "theta_r": 30, "phi_r": 210, "BRDF": 0.5 / np.pi, "uBRDF": 0.01 / np.pi}
    )
    assert data["wavelength_i"] == {"unit": "nm", "values": [550.0]}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with its run file; nothing changes it."""
    folder = four_points(tmp_path_factory.mktemp("measured") / "run", record={"sample": "plate 3", "operator": "N. N."})
    write_run(rebuild_run(folder), folder / "run.nc")
    return folder


def test_a_measured_run_keeps_times_flags_components_and_their_correlation(measured: Path, tmp_path: Path) -> None:
    folder = measured
    assert status("exchange", "bird", folder, tmp_path / "run.json") == 0
    assert status("exchange", "import", tmp_path / "run.json", tmp_path / "back.nc") == 0
    run, back = read_run(folder / "run.nc"), read_run(tmp_path / "back.nc")
    for name in ("time", "quality_flag", "u_brf_noise", "u_brf_reference", "u_brf_sensor_zenith"):
        np.testing.assert_array_equal(back[name], run[name])
    assert list(back["brf"].attrs["unc_comps"]) == list(run["brf"].attrs["unc_comps"])
    for name in run["brf"].attrs["unc_comps"]:
        assert back[name].attrs.get("err_corr_1_form") == run[name].attrs.get("err_corr_1_form")
        assert back[name].attrs["degrees_of_freedom"] == run[name].attrs["degrees_of_freedom"]
    assert back.attrs["journal_digest"] == run.attrs["journal_digest"]
    assert "signal" not in back


def test_everything_that_the_schema_requires_is_there(measured: Path, tmp_path: Path) -> None:
    run = read_run(measured / "run.nc")
    (tmp_path / "metadata.toml").write_text(METADATA)
    document = bird_document(run, "run.nc", metadata=read_metadata(tmp_path / "metadata.toml"))
    for place, names in REQUIRED.items():
        part: Any = document
        for key in place:
            part = part[key]
        assert names <= set(part), place
    instrument = document["metadata"]["instrumentation"]
    # The mirror of the facility, 10.8 mm wide at 204.7 mm: a small disc over the distance squared, to 0.1 %.
    solid_angle = instrument["detection_system"]["solid_angle"]["value"]
    assert solid_angle == pytest.approx(np.pi / 4 * (10.8 / 204.7) ** 2, rel=1e-3)
    assert instrument["operator_name"] == "N. N."
    assert document["metadata"]["environment"]["temperature"] == {"value": pytest.approx(23.1), "unit": "°C"}
    assert document["metadata"]["timestamp"] == "2026-03-02T08:01:00+00:00"


def test_what_nobody_stated_is_named_and_an_instrument_without_its_source_is_left_out(measured: Path) -> None:
    run = read_run(measured / "run.nc")
    document = bird_document(run, "run.nc")
    assert document["metadata"]["instrumentation"] == "NA"
    missing = unstated(document)
    assert "provenance.organization" in missing
    assert "instrumentation.illumination_system.source.power" in missing
    assert "sample.name" not in missing


def test_the_same_measurement_has_the_same_name(measured: Path) -> None:
    run = read_run(measured / "run.nc")
    first, again = (bird_document(run, source)["metadata"]["id"] for source in ("a", "b"))
    other = bird_document(run_of([(550.0, 0, 0, 10.0, 0, 0, 0.5, 0.1)]), "c")["metadata"]["id"]
    assert first == again != other
    assert first.startswith("urn:uuid:")


def test_a_prediction_is_a_simulation() -> None:
    head = bird_document(minimal_run(), "prediction.nc", simulated=True)["metadata"]
    assert head["method"] == "simulation"
    assert head["software"]["simulation_model"]["name"] == "ray-traced twin"
    assert "instrumentation.illumination_system.source.power" not in unstated({"metadata": head})


def test_polarised_light_as_letters_and_back() -> None:
    words = ["s", "p", "mean"]
    run = minimal_run().assign_coords(
        polarization_column([{"geometry": {"polarization": word}} for word in words], "point", "polarization")
    )
    document = bird_document(run, "run.nc")
    assert document["data"]["polarization_i"]["values"] == ["s", "p", "u"]
    np.testing.assert_array_equal(imported(document, "run.json").run["polarization"], run["polarization"])


def foreign() -> dict[str, Any]:
    """A file of another program: radians, micrometres, Stokes vectors, percent, nothing of our own."""
    document = bird_document(minimal_run(), "run.nc")
    del document["metadata"]["adhoc_section"]
    data = document["data"]
    for name in ("theta_i", "phi_i", "theta_r", "phi_r"):
        data[name] = {"unit": "rad", "values": np.deg2rad(data[name]["values"]).tolist()}
    data["wavelength_i"] = {"unit": "μm", "values": [0.5, 0.5, 0.5]}
    data["polarization_i"] = {"notation": "inStokes", "values": [[1, 1, 0, 0], [1, -1, 0, 0], [1, 0, 0, 0]]}
    data["uBRDF"] = {"unit": "%", "values": [1.0, 2.0, 3.0]}
    return document


def test_units_and_notations_of_others() -> None:
    run = imported(foreign(), "theirs.brdf").run
    expected = minimal_run()
    for name in ("wavelength", "sensor_zenith", "sensor_azimuth", "brf"):
        np.testing.assert_allclose(run[name], expected[name], rtol=1e-12)
    np.testing.assert_allclose(run["u_brf"], expected["brf"] * [0.01, 0.02, 0.03])
    assert run["polarization"].values.tolist() == [1, 2, 0]


def test_an_uncertainty_that_is_the_same_for_all_or_stated_by_the_reader() -> None:
    document = foreign()
    del document["data"]["uBRDF"]
    with pytest.raises(InputError, match=r"no uBRDF and no uncertainty of BRDF; say the relative one \(--u-relative\)"):
        imported(document, "theirs.brdf")
    run = imported(document, "theirs.brdf", u_relative=0.04).run
    np.testing.assert_allclose(run["u_brf"], 0.04 * run["brf"])
    document["data"]["BRDF"]["uncertainty"] = {"value": 0.002, "unit": "1/sr"}
    np.testing.assert_allclose(imported(document, "theirs.brdf").run["u_brf"], 0.002 * np.pi)


def broken(change: str) -> dict[str, Any]:
    document = foreign()
    head, data = document["metadata"], document["data"]
    if change == "version":
        head["schema"] = head["schema"].replace("v1.0", "v2.0")
    elif change == "type":
        head["type"] = "BTDF"
    elif change == "array":
        del data["phi_r"]
    elif change == "length":
        data["phi_r"]["values"].pop()
    elif change == "unit":
        data["theta_i"]["unit"] = "gon"
    elif change == "text":
        data["BRDF"]["values"][1] = "0.2"
    elif change == "negative":
        data["BRDF"]["values"][1] = -0.2
    elif change == "range":
        data["phi_r"] = {"unit": "deg", "values": [0, 0, 360]}
    elif change == "stokes":
        data["polarization_i"]["values"][2] = [1, 0, 1, 0]
    elif change == "analyser":
        data["polarization_r"] = data["polarization_i"]
    elif change == "foreign":
        document = {"theta_i": [1, 2]}
    return document


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("version", r"metadata.schema: found '.*v2.0.json'; this program reads version 1.0"),
        ("type", "metadata.type: found 'BTDF'; expected 'BRDF'"),
        ("array", "data: phi_r missing; found"),
        ("length", "data.phi_r: found 2 values; expected 3 as in BRDF"),
        ("unit", "data.theta_i.unit: found 'gon'; expected deg or ° or rad"),
        ("text", "data.BRDF: found '0.2' at point 1; expected a number"),
        ("negative", "data.BRDF: found -0.2 at point 1; expected 0 or more"),
        ("range", "data.phi_r: found 360 at point 2; expected less than 360"),
        ("stokes", r"data.polarization_i: found \[1, 0, 1, 0\] at point 2"),
        ("analyser", "data.polarization_r: a run has no place"),
        ("foreign", "metadata: missing; expected a file of the universal BRDF format"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(change: str, said: str) -> None:
    with pytest.raises(InputError, match=f"theirs.brdf: {said}"):
        imported(broken(change), "theirs.brdf")


def test_a_file_cut_short_or_of_no_numbers_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cut.json"
    text = json.dumps(foreign())
    for content in (text[: len(text) // 2], text.replace("0.5, 0.5", "NaN, 0.5", 1)):
        path.write_text(content)
        with pytest.raises(InputError, match="not JSON, or cut short"):
            read_bird(path)


def test_data_that_were_edited_beside_our_own_section_are_refused() -> None:
    document = bird_document(minimal_run(), "run.nc")
    document["data"]["theta_r"]["values"][1] += 1.0
    with pytest.raises(InputError, match="says another geometry than data at point 1"):
        imported(document, "edited.json")
    document["metadata"]["adhoc_section"]["goniotwin"]["version"] = 2
    found = imported(document, "edited.json")
    assert found.run["sensor_zenith"].values[1] == pytest.approx(41.0)
    assert any("another version than 1" in note for note in found.notes)


def test_values_that_the_format_has_no_room_for_are_refused() -> None:
    with pytest.raises(InputError, match="sensor_zenith: found 90 at point 0; expected less than 90"):
        bird_document(run_of([(550.0, 0, 0, 90.0, 0, 0, 0.5, 0.1)]), "run.nc")
    negative = run_of([(550.0, 0, 0, 9.0, 0, 0, 0.5, 0.1)]) * 1.0
    negative["brf"] = -negative["brf"]
    with pytest.raises(InputError, match=r"brf: found -0.5 at point 0; .*no negative BRDF"):
        bird_document(negative, "run.nc")


def test_nothing_is_replaced_without_force(measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, out = measured / "run.nc", tmp_path / "out.csv"
    out.write_text("mine")
    assert status("exchange", "csv", run, out) == 2
    assert "exists already; choose another name, or replace it with --force" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert status("exchange", "csv", run, out, "--force") == 0
    np.testing.assert_array_equal(read_run(out)["brf"], read_run(run)["brf"])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("version = 1", "version = 2", 'expected form = "BiRD metadata"'),
        ("[sample]", "[specimen]", "specimen: unknown"),
    ],
)
def test_a_metadata_file_of_another_form_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "metadata.toml"
    path.write_text(METADATA.replace(old, new))
    with pytest.raises(InputError, match=said):
        read_metadata(path)
