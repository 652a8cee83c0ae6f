"""A material as a file of Mitsuba's plugin ``measured``: what the plugin itself makes of it is the material."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from instrument.errors import InputError
from sim_fixtures.examples import example_files
from twin.exchange_commands import mitsuba
from twin.exchange_mitsuba import bsdf_error, write_bsdf
from twin.material import Material
from twin.reflection_models.table import to_table

#: Evaluates and samples with Mitsuba's own plugin: in a process of its own, because it needs another variant.
PLUGIN = """
import sys
import numpy as np
import mitsuba as mi
mi.set_variant("scalar_spectral")
plugin = mi.load_dict({"type": "measured", "filename": sys.argv[1]})
si = mi.SurfaceInteraction3f()
si.wavelengths = [500.0, 600.0, 550.0, 500.0]
for row in np.load(sys.argv[2]):
    si.wi, wo = mi.Vector3f(*row[:3]), mi.Vector3f(*row[3:])
    print(*plugin.eval(mi.BSDFContext(), si, wo))
random = np.random.default_rng(1)
weights = [plugin.sample(mi.BSDFContext(), si, 0.5, mi.Point2f(*u))[1] for u in random.random((3000, 2))]
print(*np.mean(np.array(weights), axis=0))
"""


def glossy(cos_o: np.ndarray, phi: np.ndarray, cos_i: np.ndarray) -> np.ndarray:
    """A BRDF in 1/sr, stronger towards the light and its mirror's direction; smooth at the normal too."""
    across = np.sqrt((1 - cos_o**2) * (1 - cos_i**2)) * np.cos(phi)
    return (0.5 + 0.15 * across + 0.3 * across**2) / np.pi


@pytest.fixture(scope="module")
def material() -> Material:
    """At two wavelengths, the second one darker."""
    cosines, phi = np.linspace(0.02, 1.0, 40), np.linspace(0, 2 * np.pi, 73)
    table = glossy(cosines[:, None, None], phi[None, :, None], cosines[None, None, :])
    wavelengths = np.array([500.0, 600.0])
    return Material(cosines, phi, cosines, np.stack([table, 0.5 * table]), wavelengths=wavelengths, name="glossy")


def test_mitsuba_itself_finds_the_material_in_the_file(material: Material, tmp_path: Path) -> None:
    path, count = tmp_path / "glossy.bsdf", 200
    write_bsdf(material, path)
    random = np.random.default_rng(2)
    cos_i, cos_o = random.uniform(np.cos(np.deg2rad(75.0)), 1.0, (2, count))
    cos_i[-1] = np.cos(np.deg2rad(40.0))  # of the samples that follow
    phi = random.uniform(0, 2 * np.pi, count)
    sin_i, sin_o = np.sqrt(1 - cos_i**2), np.sqrt(1 - cos_o**2)
    # Never quite at azimuth 0: there and beyond, the plugin may turn the directions by a member it leaves unset.
    rows = np.stack([sin_i, np.full(count, -1e-9), cos_i, sin_o * np.cos(phi), sin_o * np.sin(phi), cos_o], axis=1)
    np.save(tmp_path / "directions.npy", rows)
    command = [sys.executable, "-c", PLUGIN, str(path), str(tmp_path / "directions.npy")]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    *evaluated, albedo = np.array([line.split() for line in output.splitlines()], dtype=float)
    expected = glossy(cos_o, phi, cos_i) * cos_o
    for column, factor in ((0, 1.0), (1, 0.5), (2, 0.75)):
        np.testing.assert_allclose(np.array(evaluated)[:, column], factor * expected, rtol=0.01)
    # Light that the plugin's samples carry is the albedo: drawn by the right density, or it would not be.
    mu, azimuth = np.meshgrid(np.linspace(0.005, 0.995, 100), np.linspace(0, 2 * np.pi, 72, endpoint=False))
    exact = 2 * np.pi * np.mean(glossy(mu, azimuth, np.full_like(mu, cos_i[-1])) * mu)
    assert albedo[0] == pytest.approx(exact, rel=0.02)


def test_the_file_says_how_far_it_is_from_the_material(material: Material, tmp_path: Path) -> None:
    path = tmp_path / "glossy.bsdf"
    write_bsdf(material, path, [600.0])
    mean, worst = bsdf_error(material, path)
    assert mean < worst < 0.01
    other = Material(material.cos_o, material.phi_rad, material.cos_i, 0.9 * material.brdf, material.wavelengths)
    assert bsdf_error(other, path)[0] == pytest.approx(1 / 0.9 - 1, rel=0.01)
    with pytest.raises(InputError, match="measured at 500, 600 nm"):
        write_bsdf(material, path, [700.0])


def test_the_command_writes_material_solid_and_a_scene_that_loads(material: Material, tmp_path: Path) -> None:
    table, out = tmp_path / "table.nc", tmp_path / "coat.bsdf"
    to_table(material).to_netcdf(table, engine="h5netcdf")
    mitsuba(table, out, artifact=example_files().artifact)
    code = (
        "import sys, mitsuba as mi; mi.set_variant('scalar_spectral'); print(len(mi.load_file(sys.argv[1]).shapes()))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "coat.xml")]
    assert subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout.strip() == "1"
    with pytest.raises(InputError, match="exists already; choose another name, or replace it with --force"):
        mitsuba(table, out)
    with pytest.raises(InputError, match=r"expected a name that ends in .bsdf"):
        mitsuba(table, tmp_path / "coat.nc")
