"""Measured materials in the form of Dupuy and Jakob, as Mitsuba's plugin ``measured`` reads them (``.bsdf`` files).

The file holds reflected light over warped half vectors: a half vector (its angles as numbers between 0 and 1) is moved
by the distribution of visible normals, ``vndf``, to where ``spectra`` is tabulated; the product with ``ndf`` over four
times ``sigma`` gives the BRDF times the cosine of emergence. Source: J. Dupuy and W. Jakob, An adaptive
parameterization for efficient material acquisition and rendering, ACM Trans. Graph. 37 (2018), section 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.forms import Form, parse_form
from twin.material import Material, listed
from twin.reflection_models import Origin
from twin.reflection_models.compiled import Grid, interpolate, zenith_grid
from twin.reflection_models.tensor_file import read_tensor_file

#: Dividing by the cosine of emergence makes the data useless beyond.
_LAST_DEG = 85.0
_DIMENSIONS = {"theta_i": 1, "phi_i": 1, "wavelengths": 1, "ndf": 2, "sigma": 2, "vndf": 4, "spectra": 5, "jacobian": 1}


class MeasuredSettings(Form):
    """Keys of the model ``measured``; ``wavelengths`` in nm, all of the file's by default."""

    file: str
    wavelengths: tuple[Annotated[float, Field(gt=0)], ...] | None = None


def measured_model(settings: Mapping[str, Any], origin: Origin) -> Material:
    """A measured material."""
    form = parse_form(dict(settings), MeasuredSettings, origin.where)
    return read_measured(origin.file(form.file), form.wavelengths)


def read_measured(path: Path, wavelengths: tuple[float, ...] | None = None) -> Material:
    """Read an isotropic measured material and make a table of it.

    Parameters
    ----------
    wavelengths
        nm; those of the file by default.

    Raises
    ------
    InputError
        If the file is no measured material with spectra, is anisotropic, or lacks a wavelength.
    """
    lobe = MeasuredBrdf(path)
    chosen = lobe.wavelengths if wavelengths is None else np.array(wavelengths, dtype=float)
    grid = zenith_grid([*np.arange(0, _LAST_DEG, 2.5), _LAST_DEG, 90.0], np.arange(0, 181, 5.0))
    grid = Grid(grid.cos_o[1:], grid.phi_rad, grid.cos_i[1:])
    half = len(grid.phi_rad) // 2 + 1
    o, phi, i = np.meshgrid(grid.cos_o, grid.phi_rad[:half], grid.cos_i, indexing="ij")
    values = lobe.evaluate(o, phi, i, chosen)
    values = np.concatenate([values, values[:, :, half - 2 :: -1]], axis=2)
    return Material(
        grid.cos_o,
        grid.phi_rad,
        grid.cos_i,
        values,
        wavelengths=chosen,
        name=str(path),
        gridding_error=_gridding_error(grid, values[0], lobe, chosen[:1]),
        notes=(f"beyond {_LAST_DEG:g} degrees of zenith the measured material keeps its last value",),
    )


class MeasuredBrdf:
    """Evaluates a measured material.

    Parameters
    ----------
    path
        The file.
    """

    def __init__(self, path: Path) -> None:
        fields = read_tensor_file(path)
        _check(fields, path)
        self.path = path
        self._theta_i = np.asarray(fields["theta_i"], dtype=float)
        self.wavelengths = np.asarray(fields["wavelengths"], dtype=float)
        self._ndf, self._sigma = (np.asarray(fields[name], dtype=float) for name in ("ndf", "sigma"))
        # An isotropic material is the same for its one or two azimuths of incidence.
        self._vndf, self._spectra = (np.asarray(fields[name][0], dtype=float) for name in ("vndf", "spectra"))
        self._jacobian = bool(fields["jacobian"][0])
        norm = np.array([_integral(slice_) for slice_ in self._vndf])
        self._vndf = self._vndf / norm[:, None, None]

    def evaluate(
        self, cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray, wavelengths: FloatArray
    ) -> FloatArray:
        """BRDF in 1/sr, shape (wavelength, ...); ``phi_rad`` is 0 for backscatter."""
        shape = np.broadcast_shapes(np.shape(cos_o), np.shape(phi_rad), np.shape(cos_i))
        o, phi, i = (np.broadcast_to(a, shape).ravel() for a in (cos_o, phi_rad, cos_i))
        theta_i = np.arccos(np.clip(i, 0.0, 1.0))
        theta_m, phi_m = _half_vector(i, o, phi)
        u = np.stack([np.sqrt(theta_m * 2 / np.pi), np.mod((phi_m + np.pi) / (2 * np.pi), 1.0)])
        below, fraction = _bracket(self._theta_i, theta_i)
        warped = self._invert(u, below, fraction)
        values = np.zeros((len(wavelengths), len(o)))
        for number, wavelength in enumerate(wavelengths):
            low, part = self._wavelength(float(wavelength))
            for weight, index in ((1 - part, low), (part, low + 1)):
                if weight > 0:
                    for share, step in ((1 - fraction, 0), (fraction, 1)):
                        row = np.minimum(below + step, len(self._theta_i) - 1)
                        values[number] += weight * share * _bilinear(self._spectra[:, index], row, warped)
        if self._jacobian:
            zero = np.zeros(len(o), dtype=int)
            incidence = np.stack([np.sqrt(theta_i * 2 / np.pi), np.full(len(o), 0.5)])
            values *= _bilinear(self._ndf[None], zero, u) / (4 * _bilinear(self._sigma[None], zero, incidence))
        return np.asarray(np.maximum(values, 0.0) / o).reshape(len(wavelengths), *shape)

    def _invert(self, u: FloatArray, below: NDArray[np.int64], fraction: FloatArray) -> FloatArray:
        """Where the distribution of visible normals moves uniform points from, shape (2, point)."""
        along = np.zeros((2, len(below)))
        sides = np.zeros((2, 2, len(below)))
        for share, step in ((1 - fraction, 0), (fraction, 1)):
            row = np.minimum(below + step, len(self._theta_i) - 1)
            part, total = _cumulative(self._vndf, row, u)
            along += share * np.stack([part, total])
            sides[step] = share * _marginal(self._vndf, row, u[1])
        marginal = sides.sum(axis=0)
        return np.stack([along[0] / np.maximum(along[1], 1e-300), marginal[0] / np.maximum(marginal[1], 1e-300)])

    def _wavelength(self, wavelength: float) -> tuple[int, float]:
        if not self.wavelengths[0] - 0.05 <= wavelength <= self.wavelengths[-1] + 0.05:
            raise InputError(
                f"{self.path}: wavelengths: found {listed(self.wavelengths)} nm; expected {wavelength:g} nm among them"
            )
        if len(self.wavelengths) == 1:
            return 0, 0.0
        low, fraction = _bracket(self.wavelengths, np.array([wavelength]))
        return int(low[0]), float(fraction[0])


def _half_vector(cos_i: FloatArray, cos_o: FloatArray, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Zenith of the half vector, and its azimuth from that of the incidence."""
    sin_i, sin_o = (np.sqrt(np.maximum(0.0, 1 - c * c)) for c in (cos_i, cos_o))
    x, y, z = sin_i + sin_o * np.cos(phi), sin_o * np.sin(phi), cos_i + cos_o
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def _bracket(nodes: FloatArray, x: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    if len(nodes) == 1:
        return np.zeros(len(x), dtype=np.int64), np.zeros(len(x))
    low = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    return low, np.clip((x - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)


def _cell(count: int, u: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Cell of evenly spaced nodes over 0 to 1, and the place within it."""
    place = np.clip(u, 0.0, 1.0) * (count - 1)
    low = np.minimum(place.astype(np.int64), count - 2)
    return low, place - low


def _bilinear(tables: FloatArray, which: NDArray[np.int64], u: FloatArray) -> FloatArray:
    """Values of tables (table, y, x) at points u = (x, y) between 0 and 1."""
    (x, fx), (y, fy) = _cell(tables.shape[2], u[0]), _cell(tables.shape[1], u[1])
    near = tables[which, y, x] * (1 - fx) + tables[which, y, x + 1] * fx
    far = tables[which, y + 1, x] * (1 - fx) + tables[which, y + 1, x + 1] * fx
    return np.asarray(near * (1 - fy) + far * fy)


def _rows(tables: FloatArray) -> FloatArray:
    """Integral of each row from its start to each node, shape of the tables; nodes evenly spaced over 0 to 1."""
    cells = (tables[..., 1:] + tables[..., :-1]) / (2 * (tables.shape[-1] - 1))
    return np.concatenate([np.zeros((*tables.shape[:-1], 1)), np.cumsum(cells, axis=-1)], axis=-1)


def _integral(table: FloatArray) -> float:
    return float(_rows(_rows(table)[:, -1])[-1])


def _cumulative(tables: FloatArray, which: NDArray[np.int64], u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Integral along x up to u at its y, and along the whole row."""
    width = tables.shape[2]
    (x, fx), (y, fy) = _cell(width, u[0]), _cell(tables.shape[1], u[1])
    sums = _rows(tables)

    def up_to(row: NDArray[np.int64]) -> FloatArray:
        a, b = tables[which, row, x], tables[which, row, x + 1]
        return np.asarray(sums[which, row, x] + fx * (a + fx * (b - a) / 2) / (width - 1))

    part = up_to(y) * (1 - fy) + up_to(y + 1) * fy
    return part, sums[which, y, -1] * (1 - fy) + sums[which, y + 1, -1] * fy


def _marginal(tables: FloatArray, which: NDArray[np.int64], v: FloatArray) -> FloatArray:
    """Integral over the rows up to v, and over all of them; shape (2, point)."""
    height = tables.shape[1]
    totals = _rows(tables)[..., -1]
    sums = _rows(totals)
    y, fy = _cell(height, v)
    a, b = totals[which, y], totals[which, y + 1]
    return np.stack([sums[which, y] + fy * (a + fy * (b - a) / 2) / (height - 1), sums[which, -1]])


def _check(fields: dict[str, NDArray[Any]], path: Path) -> None:
    for name, dimensions in _DIMENSIONS.items():
        if name not in fields:
            raise InputError(
                f"{path}: {name}: not in the file, which holds {', '.join(fields)}; expected a measured material with"
                " spectra"
            )
        found = fields[name]
        if found.ndim != dimensions or 0 in found.shape or (dimensions > 1 and min(found.shape[-2:]) < 2):
            raise InputError(f"{path}: {name}: found shape {found.shape}; expected {dimensions} dimensions of values")
        if not np.all(np.isfinite(found)):
            raise InputError(f"{path}: {name}: found values that are no numbers")
    angles = fields["theta_i"]
    expected = (len(fields["phi_i"]), len(angles))
    for name, lead in (("vndf", expected), ("spectra", (*expected, len(fields["wavelengths"])))):
        if fields[name].shape[: len(lead)] != lead:
            raise InputError(f"{path}: {name}: found shape {fields[name].shape}; expected it to begin with {lead}")
    if len(fields["phi_i"]) > 2:
        raise InputError(f"{path}: phi_i: found {len(fields['phi_i'])} azimuths; expected an isotropic material")
    for name in ("theta_i", "wavelengths"):
        if not np.all(np.diff(fields[name].astype(float)) > 0):
            raise InputError(f"{path}: {name}: found {listed(fields[name])}; expected ascending values")


def _gridding_error(grid: Grid, values: FloatArray, lobe: MeasuredBrdf, wavelengths: FloatArray) -> float:
    """Relative root mean square difference of the table from the measured material, up to its last zenith."""
    random = np.random.default_rng(0)
    cos_o, cos_i = np.sqrt(random.uniform(np.cos(np.deg2rad(_LAST_DEG)) ** 2, 1, (2, 4000)))
    phi = random.uniform(0, np.pi, 4000)
    exact = lobe.evaluate(cos_o, phi, cos_i, wavelengths)[0]
    difference = interpolate(grid, values, cos_o, phi, cos_i) - exact
    return float(np.sqrt(np.mean(difference**2) / max(np.mean(exact**2), 1e-300)))
