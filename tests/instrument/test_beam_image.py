"""Pictures of the beam: the four forms say the same, and what is wrong with one is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
import xarray as xr

from instrument.beam_image import BeamImage, read_beam_image
from instrument.errors import InputError
from instrument.facility import Beam, Facility, read_facility
from instrument.forms import read_toml
from instrument.run_folder import copy_facility

EXAMPLES = Path(__file__).parents[2] / "sim_fixtures" / "examples"
#: Rows from the top, as a picture shows them: brightest on the right, darkest row at the bottom.
VALUES = np.array([[1.0, 2.0, 4.0], [1.0, 2.0, 3.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])


def save(folder: Path, kind: str) -> Path:
    path = folder / f"beam{kind}"
    if kind == ".npy":
        np.save(path, VALUES)
    elif kind == ".csv":
        np.savetxt(path, VALUES, delimiter=",")
    elif kind == ".png":
        from matplotlib.image import imsave

        imsave(path, VALUES, cmap="gray", vmin=0.0, vmax=4.0)
    else:
        x, y = 0.5 * (np.arange(3) - 1), 0.5 * (np.arange(4) - 1.5)
        axes = {"x": ("x", x, {"units": "mm"}), "y": ("y", y, {"units": "mm"})}
        xr.Dataset({"irradiance": (("y", "x"), VALUES[::-1])}, axes).to_netcdf(path, engine="h5netcdf")
    return path


def read(path: Path, *, about_centroid: bool = False) -> BeamImage:
    return read_beam_image(path, None if path.suffix == ".nc" else 0.5, about_centroid=about_centroid)


@pytest.mark.parametrize("kind", [".png", ".npy", ".csv", ".nc"])
def test_every_form_says_the_same(kind: str, tmp_path: Path) -> None:
    image = read(save(tmp_path, kind))
    accuracy = 0.01 if kind == ".png" else 1e-12  # eight bits
    assert image.at(np.array([0.5]), np.array([0.75]))[0] == 1.0  # right, on top
    assert image.at(np.array([0.5]), np.array([0.25]))[0] == pytest.approx(0.75, abs=accuracy)
    assert image.at(np.array([0.0]), np.array([0.5]))[0] == pytest.approx(0.5, abs=accuracy)
    between = image.at(np.array([0.25]), np.array([0.5]))[0]
    assert between == pytest.approx((2 + 2 + 4 + 3) / 16, abs=accuracy)
    np.testing.assert_array_equal(image.at(np.array([0.51, 0.0]), np.array([0.0, -0.76])), 0.0)


def test_the_axis_may_go_through_the_centroid(tmp_path: Path) -> None:
    image = read(save(tmp_path, ".npy"), about_centroid=True)
    rows, columns = np.indices(image.values.shape)
    u, v = image.first[0] + columns * image.pitch[0], image.first[1] + rows * image.pitch[1]
    assert np.sum(u * image.values) == pytest.approx(0.0, abs=1e-12)
    assert np.sum(v * image.values) == pytest.approx(0.0, abs=1e-12)
    assert image.values.max() == 1.0


def test_equal_pictures_are_equal(tmp_path: Path) -> None:
    first, second = read(save(tmp_path, ".npy")), read(save(tmp_path, ".csv"))
    assert first == second
    assert hash(first) == hash(second)
    assert first.digest == second.digest
    other = BeamImage(first.values, first.pitch, (0.0, 0.0))
    assert other != first
    assert other.digest != first.digest


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        (-VALUES, "subtract the dark"),
        (VALUES * np.nan, "finite"),
        (VALUES * 0, "some light"),
        (VALUES[0], r"shape \(3,\)"),
        (VALUES[:1], "rows and columns"),
    ],
)
def test_bad_pictures_are_refused(values: Any, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "beam.npy"
    np.save(path, values)
    with pytest.raises(InputError, match=complaint):
        read(path)


def test_bad_files_are_refused(tmp_path: Path) -> None:
    for name, content in (("a.npy", b"text"), ("a.csv", b"1,2\n3,x"), ("a.png", b"no picture"), ("a.nc", b"no netcdf")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            read(tmp_path / name)
    (tmp_path / "a.bmp").write_bytes(b"")
    with pytest.raises(InputError, match=r"expected \.png, \.npy, \.csv or \.nc"):
        read(tmp_path / "a.bmp")
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "b.png")
    path = save(tmp_path, ".npy")
    with pytest.raises(InputError, match="pixel_pitch"):
        read_beam_image(path, None, about_centroid=False)


def test_a_picture_in_colours_is_refused(tmp_path: Path) -> None:
    from matplotlib.image import imsave

    imsave(tmp_path / "beam.png", VALUES, cmap="viridis")
    with pytest.raises(InputError, match="shades of grey"):
        read(tmp_path / "beam.png")


def test_netcdf_needs_coordinates_in_mm(tmp_path: Path) -> None:
    path = tmp_path / "beam.nc"
    xr.Dataset({"irradiance": (("y", "x"), VALUES)}, {"x": [0, 1, 2], "y": [0, 1, 2, 3]}).to_netcdf(
        path, engine="h5netcdf"
    )
    with pytest.raises(InputError, match="x: found unit None"):
        read(path)
    path.unlink()
    uneven = {"x": ("x", [0.0, 1.0, 3.0], {"units": "mm"}), "y": ("y", np.arange(4.0), {"units": "mm"})}
    xr.Dataset({"irradiance": (("y", "x"), VALUES)}, uneven).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match="equidistant"):
        read(path)


def facility_with(folder: Path, image: str, **beam: Any) -> Path:
    form = read_toml(EXAMPLES / "facility.toml")
    keys = {"diameter": 10.8, "profile": "image", "image": image, "pixel_pitch": 0.5} | beam
    path = folder / "facility.toml"
    path.write_text(tomli_w.dumps(form | {"beam": keys}))
    return path


def test_a_facility_reads_the_picture_beside_it(tmp_path: Path) -> None:
    save(tmp_path, ".npy")
    beam = read_facility(facility_with(tmp_path, "beam.npy", image_axis="centroid")).beam
    assert beam.picture is not None
    assert beam.picture == read(tmp_path / "beam.npy", about_centroid=True)
    wider = beam.model_copy(update={"diameter": 12.0})
    assert wider.picture is beam.picture


def test_a_picture_that_was_not_read_is_no_uniform_beam() -> None:
    beam = Beam(diameter=5.0, profile="image", image="beam.npy", pixel_pitch=0.1)
    with pytest.raises(ValueError, match="was not read"):
        _ = beam.picture


def test_a_run_folder_keeps_the_picture(tmp_path: Path) -> None:
    (tmp_path / "lab" / "pictures").mkdir(parents=True)
    (tmp_path / "run").mkdir()
    save(tmp_path / "lab" / "pictures", ".npy")
    source = facility_with(tmp_path / "lab", "pictures/beam.npy")
    copy = copy_facility(source, tmp_path / "run")
    kept: Facility = read_facility(copy)
    assert kept.beam.image == "beam.npy"
    assert kept.beam.picture == read_facility(source).beam.picture


@pytest.mark.parametrize(
    ("section", "keys", "complaint"),
    [
        ("beam", {"profile": "tophat", "radius_1_e2_across": 3.0}, "radius_1_e2_across"),
        ("beam", {"diameter": "unbounded", "diameter_across": 3.0}, "diameter_across"),
        ("beam", {"profile": "image"}, "image"),
        ("beam", {"image": "beam.png"}, "image"),
        ("sensor", {"field_stop_edge": 1.0}, "field_stop_diameter"),
        ("sensor", {"field_stop_diameter": 5.0, "target_shape": "horizontal_disc"}, "disc"),
        ("sensor", {"field_stop_diameter": 5.0, "field_stop_edge": 6.0}, "field_stop_edge"),
        ("sensor", {"field_stop_diameter": 5.0, "field_stop_distance": 150.0}, "mirror_distance"),
    ],
)
def test_impossible_optics_are_refused(section: str, keys: dict[str, Any], complaint: str, tmp_path: Path) -> None:
    form = read_toml(EXAMPLES / "facility.toml")
    path = tmp_path / "facility.toml"
    path.write_text(tomli_w.dumps(form | {section: form[section] | keys}))
    with pytest.raises(InputError, match=complaint):
        read_facility(path)
