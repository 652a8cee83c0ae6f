from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from instrument.errors import InputError
from twin.material import read_material
from twin.reflection_models.measured import MeasuredBrdf
from twin.reflection_models.tensor_file import read_tensor_file

CODES = {"u1": 1, "f4": 10}


def write_tensor_file(path: Path, fields: dict[str, np.ndarray]) -> Path:
    """A writer of its own, so that the reader does not agree with itself."""
    head = b"tensor_file\0" + struct.pack("<BBI", 1, 0, len(fields))
    size = len(head) + sum(2 + len(name) + 2 + 1 + 8 + 8 * a.ndim for name, a in fields.items())
    body = b""
    for name, array in fields.items():
        code = CODES[array.dtype.str[1:]]
        head += struct.pack("<H", len(name)) + name.encode() + struct.pack("<HB", array.ndim, code)
        head += struct.pack("<Q", size + len(body)) + struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.tobytes()
    return _write(path, head + body)


def _write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def uneven_material() -> dict[str, np.ndarray]:
    """Every array different from node to node; two wavelengths, no physics."""
    random = np.random.default_rng(5)

    def values(*shape: int) -> np.ndarray:
        return random.uniform(0.2, 1.0, shape).astype(np.float32)

    return {
        "description": np.frombuffer(b"synthetic", np.uint8),
        "theta_i": np.array([0.0, 0.3, 0.8, 1.2, 1.5], np.float32),
        "phi_i": np.array([0.0], np.float32),
        "wavelengths": np.array([450.0, 550.0], np.float32),
        "ndf": values(6, 9),
        "sigma": values(3, 7),
        "vndf": values(1, 5, 8, 11),
        "luminance": values(1, 5, 6, 6),
        "spectra": values(1, 5, 2, 6, 6),
        "jacobian": np.array([1], np.uint8),
    }


def lambertian_material(reflectance: float) -> dict[str, np.ndarray]:
    """A Lambertian surface of the known BRDF in this form: no warp, ``spectra`` = BRDF x cosine over u, no Jacobian."""
    theta_i = np.deg2rad(np.linspace(0, 88, 24)).astype(np.float32)
    u = np.linspace(0, 1, 65)
    theta_m, phi_m = u**2 * np.pi / 2, (2 * u - 1) * np.pi
    i, p, t = np.meshgrid(theta_i, phi_m, theta_m, indexing="ij")
    along = np.cos(i) * np.cos(t) + np.sin(i) * np.sin(t) * np.cos(p)
    cos_o = 2 * along * np.cos(t) - np.cos(i)
    spectra = (reflectance / np.pi * np.maximum(cos_o, 0))[None, :, None].astype(np.float32)
    count = len(theta_i)
    flat = np.ones((1, count, 2, 2), np.float32)
    return {
        "description": np.frombuffer(b"Lambertian", np.uint8),
        "theta_i": theta_i,
        "phi_i": np.array([0.0], np.float32),
        "wavelengths": np.array([500.0], np.float32),
        "ndf": np.ones((2, 2), np.float32),
        "sigma": np.ones((2, 2), np.float32),
        "vndf": flat,
        "luminance": np.ones((1, count, 65, 65), np.float32),
        "spectra": np.ascontiguousarray(spectra),
        "jacobian": np.array([0], np.uint8),
    }


#: Evaluates a file with Mitsuba's own plugin: in a process of its own, because it needs another variant.
PLUGIN = """
import sys
import numpy as np
import mitsuba as mi
mi.set_variant("scalar_spectral")
plugin = mi.load_dict({"type": "measured", "filename": sys.argv[1]})
si = mi.SurfaceInteraction3f()
si.wavelengths = [500.0, 450.0, 550.0, 500.0]
for row in np.load(sys.argv[2]):
    si.wi, wo = mi.Vector3f(*row[:3]), mi.Vector3f(*row[3:])
    print(*plugin.eval(mi.BSDFContext(), si, wo))
"""


def test_a_measured_material_has_the_values_that_mitsuba_gives_it(tmp_path: Path) -> None:
    path = write_tensor_file(tmp_path / "uneven.bsdf", uneven_material())
    random = np.random.default_rng(1)
    cos_i, cos_o = random.uniform(0.15, 1.0, (2, 300))
    phi = random.uniform(-np.pi, np.pi, 300)
    sin_i, sin_o = np.sqrt(1 - cos_i**2), np.sqrt(1 - cos_o**2)
    # Never quite at azimuth 0: there and beyond, the plugin may turn the directions by a member it leaves unset.
    rows = np.stack([sin_i, np.full(300, -1e-9), cos_i, sin_o * np.cos(phi), sin_o * np.sin(phi), cos_o], axis=1)
    np.save(tmp_path / "directions.npy", rows)
    command = [sys.executable, "-c", PLUGIN, str(path), str(tmp_path / "directions.npy")]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    expected = np.array([line.split() for line in output.splitlines()], dtype=float)[:, :3].T
    got = MeasuredBrdf(path).evaluate(cos_o, phi, cos_i, np.array([500.0, 450.0, 550.0])) * cos_o
    np.testing.assert_allclose(got, expected, rtol=2e-4)


def test_a_known_brdf_comes_back_as_a_table(tmp_path: Path) -> None:
    path = write_tensor_file(tmp_path / "lambertian.bsdf", lambertian_material(0.5))
    material = read_material(path)
    random = np.random.default_rng(3)
    cos_o, cos_i = random.uniform(np.cos(np.deg2rad(70)), 1.0, (2, 500))
    value = material.evaluate(cos_o, random.uniform(0, 2 * np.pi, 500), cos_i)
    np.testing.assert_allclose(np.pi * value, 0.5, rtol=0.02)
    np.testing.assert_array_equal(material.table_index([500.0]), [0])
    assert 0 < material.gridding_error < 0.03
    assert "85 degrees" in material.notes[0]


def spoilt(**changes: Any) -> dict[str, np.ndarray]:
    return {name: value for name, value in (uneven_material() | changes).items() if value is not None}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (spoilt(spectra=None, rgb=np.zeros(3, np.float32)), "spectra: not in the file"),
        (spoilt(ndf=np.zeros(4, np.float32)), r"ndf: found shape \(4,\); expected 2 dimensions"),
        (spoilt(vndf=np.ones((1, 4, 8, 11), np.float32)), r"vndf: found shape \(1, 4, 8, 11\); expected it to begin"),
        (spoilt(sigma=np.full((3, 7), np.nan, np.float32)), "sigma: found values that are no numbers"),
        (spoilt(wavelengths=np.array([550.0, 450.0], np.float32)), "wavelengths: found 550, 450; expected ascending"),
        (
            spoilt(
                phi_i=np.array([0, 1, 2], np.float32),
                vndf=np.ones((3, 5, 8, 11), np.float32),
                spectra=np.ones((3, 5, 2, 6, 6), np.float32),
            ),
            "phi_i: found 3 azimuths; expected an isotropic material",
        ),
    ],
)
def test_files_that_are_no_isotropic_measured_material_are_refused(fields: Any, message: str, tmp_path: Path) -> None:
    path = write_tensor_file(tmp_path / "bad.bsdf", fields)
    with pytest.raises(InputError, match=message):
        read_material(path)


def test_a_file_cut_short_or_of_another_kind_is_named(tmp_path: Path) -> None:
    whole = write_tensor_file(tmp_path / "whole.bsdf", uneven_material()).read_bytes()
    for size, message in (
        (40, "ends within its header"),
        (len(whole) - 9, "the file ends at byte"),
        (5, "not a tensor"),
    ):
        with pytest.raises(InputError, match=message):
            read_tensor_file(_write(tmp_path / "cut.bsdf", whole[:size]))
    newer = whole[:12] + b"\2\0" + whole[14:]
    with pytest.raises(InputError, match=r"version: found 2\.0"):
        read_tensor_file(_write(tmp_path / "newer.bsdf", newer))
