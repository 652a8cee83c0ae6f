"""A material as a file that Mitsuba's own plugin ``measured`` loads, and a scene that shows it with the sample's solid.

The plugin's form (J. Dupuy and W. Jakob, ACM Trans. Graph. 37 (2018), section 4) tabulates reflected light over half
vectors moved by a distribution of normals. Here that distribution is uniform, which moves nothing, and the table holds
the BRDF times the cosine of emergence directly: exact at the nodes for any material, smooth or not. What is lost is the
interpolation between them, which :func:`bsdf_error` measures.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.output import write_result
from twin.material import Material
from twin.reflection_models.measured import MeasuredBrdf
from twin.reflection_models.tensor_file import MAGIC

#: Incident zeniths (degree): close where light grazes. The plugin keeps its last beyond.
THETA_I_DEG = np.array([*np.arange(0.0, 85.0, 2.5), 85.0, 87.0, 88.5, 89.5])
#: Nodes of half vectors along zenith and azimuth; the plugin wants them square.
NODES = 129
_CODES = {"u1": 1, "f4": 10}
_ALIGNMENT = 8


def bsdf_fields(material: Material, wavelengths: Sequence[float], surface: int = 0) -> dict[str, NDArray[Any]]:
    """The arrays of a measured material.

    Parameters
    ----------
    wavelengths
        nm, ascending, at which the material has a table.
    surface
        Which of the materials of a sample with several.

    Returns
    -------
    dict
        ``spectra`` of shape (azimuth of incidence 1, incidence, wavelength, azimuth of half vector, its zenith), in
        1/sr times the cosine of emergence, and what the plugin needs besides.
    """
    per_material = len(material.brdf) // material.materials
    tables = [surface * per_material + int(index) for index in material.table_index(list(wavelengths))]
    theta_i_rad = np.deg2rad(THETA_I_DEG)
    u = np.linspace(0.0, 1.0, NODES)
    spectra = np.stack([_slice(material, tables, float(theta), u) for theta in theta_i_rad])
    count = len(theta_i_rad)
    text = f"goniotwin: {material.name}"
    return {
        "description": np.frombuffer(text.encode(), np.uint8),
        "theta_i": theta_i_rad.astype(np.float32),
        "phi_i": np.zeros(1, np.float32),
        "wavelengths": np.asarray(wavelengths, np.float32),
        "ndf": np.ones((2, 2), np.float32),
        "sigma": np.ones((2, 2), np.float32),
        "vndf": np.ones((1, count, 2, 2), np.float32),
        "luminance": _density(spectra, theta_i_rad, u)[None].astype(np.float32),
        "spectra": spectra[None].astype(np.float32),
        "jacobian": np.zeros(1, np.uint8),
    }


def write_bsdf(material: Material, path: Path, wavelengths: Sequence[float] | None = None, surface: int = 0) -> None:
    """Write a material for the plugin ``measured`` of a spectral variant of Mitsuba.

    Parameters
    ----------
    wavelengths
        nm; the material's by default. A material that states none is written at 400 and 800 nm.

    Raises
    ------
    InputError
        If the material has no table at a wavelength.
    """
    chosen = material.wavelengths if wavelengths is None else np.sort(np.asarray(wavelengths, dtype=float))
    nodes = [400.0, 800.0] if chosen is None else [float(value) for value in chosen]
    write_result(path, _tensor_file(bsdf_fields(material, nodes, surface)))


def bsdf_error(material: Material, path: Path, samples: int = 4000) -> tuple[float, float]:
    """Relative difference of the file, as our own reader of the form sees it, from the material.

    Returns
    -------
    float, float
        Root mean square over directions up to 75 degrees of zenith, weighted with both cosines; the largest there.
    """
    random = np.random.default_rng(0)
    cos_o, cos_i = np.sqrt(random.uniform(np.cos(np.deg2rad(75.0)) ** 2, 1.0, (2, samples)))
    phi = random.uniform(0.0, 2 * np.pi, samples)
    lobe = MeasuredBrdf(path)
    first = float(lobe.wavelengths[0])
    written = lobe.evaluate(cos_o, phi, cos_i, np.array([first]))[0]
    table = 0 if material.wavelengths is None else int(material.table_index([first])[0])
    exact = material.evaluate(cos_o, phi, cos_i, table)
    difference = np.abs(written / np.maximum(exact, 1e-300) - 1)
    return float(np.sqrt(np.mean(difference**2))), float(difference.max())


def scene_text(bsdf: str, mesh: str | None, wavelength: float) -> str:
    """A scene of Mitsuba (XML) that lights the material and looks at it; names are relative to the scene's file."""
    shape = f'<string name="filename" value="{mesh}"/>' if mesh else ""
    kind = "ply" if mesh else "rectangle"
    scale = "" if mesh else '<transform name="to_world"><scale value="25"/></transform>'
    return _SCENE.format(
        bsdf=bsdf, kind=kind, shape=shape, scale=scale, low=f"{wavelength - 0.5:g}", high=f"{wavelength + 0.5:g}"
    )


_SCENE = """<!-- Lengths in mm, top of the sample at z = 0. Render it with: mitsuba -m scalar_spectral -->
<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="8"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="28"/>
        <transform name="to_world"><lookat origin="60, -110, 120" target="0, 0, -1" up="0, 0, 1"/></transform>
        <sampler type="independent"><integer name="sample_count" value="64"/></sampler>
        <film type="specfilm">
            <integer name="width" value="320"/><integer name="height" value="240"/>
            <spectrum name="band" value="{low}:1, {high}:1"/>
        </film>
    </sensor>
    <emitter type="directional">
        <vector name="direction" x="-0.5" y="0" z="-0.866"/>
        <spectrum name="irradiance" value="1"/>
    </emitter>
    <shape type="{kind}">
        {shape}{scale}
        <boolean name="face_normals" value="true"/>
        <bsdf type="measured"><string name="filename" value="{bsdf}"/></bsdf>
    </shape>
</scene>
"""


def _slice(material: Material, tables: Sequence[int], theta_i_rad: float, u: FloatArray) -> FloatArray:
    """BRDF times cosine over half vectors at one incidence, shape (table, azimuth, zenith); 0 below the surface."""
    theta_m, phi_m = u**2 * np.pi / 2, (2 * u - 1) * np.pi
    phi, theta = np.meshgrid(phi_m, theta_m, indexing="ij")
    sin_i, cos_i = np.sin(theta_i_rad), np.cos(theta_i_rad)
    half = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    along = sin_i * half[0] + cos_i * half[2]
    out = 2 * along * half - np.array([sin_i, 0.0, cos_i])[:, None, None]
    cos_o = out[2]
    # The light stands at azimuth 0, where the difference of azimuths is 0: backscatter.
    difference = np.arctan2(out[1], out[0])
    seen = (cos_o > 0) & (along > 0)
    up = np.where(seen, cos_o, 1.0)
    values = [material.evaluate(up, difference, np.full_like(up, cos_i), table) * up for table in tables]
    return np.where(seen, np.stack(values), 0.0)


def _density(spectra: FloatArray, theta_i_rad: FloatArray, u: FloatArray) -> FloatArray:
    """What the plugin draws half vectors by, shape (incidence, azimuth, zenith): light over the measure of u.

    A cell of u stands for a solid angle of emergence of 2 pi^2 u sin(theta_m) times 4 cos(half angle), as the plugin
    has it; a little everywhere keeps every direction possible.
    """
    theta_m = u**2 * np.pi / 2
    measure = u * np.sin(theta_m)
    light = spectra.mean(axis=1) * measure[None, None, :]
    floor = 1e-3 * light.mean(axis=(1, 2), keepdims=True)
    return np.asarray(light + np.maximum(floor, 1e-9))


def _tensor_file(fields: Mapping[str, NDArray[Any]]) -> bytes:
    """The container's bytes (:mod:`twin.reflection_models.tensor_file`)."""
    head = MAGIC + struct.pack("<BBI", 1, 0, len(fields))
    size = len(head) + sum(2 + len(name.encode()) + 2 + 1 + 8 + 8 * a.ndim for name, a in fields.items())
    body = b""
    for name, array in fields.items():
        body += b"\0" * (-(size + len(body)) % _ALIGNMENT)
        code = _CODES[array.dtype.str[1:]]
        head += struct.pack("<H", len(name.encode())) + name.encode() + struct.pack("<HB", array.ndim, code)
        head += struct.pack("<Q", size + len(body)) + struct.pack(f"<{array.ndim}Q", *array.shape)
        body += np.ascontiguousarray(array).tobytes()
    return head + body


def check_suffix(path: Path) -> None:
    """Mitsuba's users call such files ``.bsdf``, and so do our own readers."""
    if path.suffix.lower() != ".bsdf":
        raise InputError(f"{path}: expected a name that ends in .bsdf")
