"""How the sample's surfaces reflect: tables of the BRDF, whatever model they come from.

A table holds the BRDF over cos(emergent zenith), azimuth difference and cos(incident zenith) and is linear between its
nodes (paper, section III and appendix A). Every reflection model (:mod:`twin.reflection_models`) is compiled to this
form, so that the ray tracer knows one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from instrument.angles import FloatArray
from instrument.errors import InputError

#: A table that reflects more than this is refused; between 1 and this a calibration error may be the reason.
ENERGY_LIMIT = 1.02


@dataclass(frozen=True)
class Material:
    """A table of the BRDF.

    Attributes
    ----------
    cos_o, shape (o,), cos_i, shape (i,)
        Ascending cosines of the emergent and the incident zenith; values beyond the ends are the end's.
    phi_rad, shape (phi,)
        Ascending azimuth differences, the first 0 (backscatter) and the last 2 pi.
    brdf, shape (wavelength, o, phi, i)
        1/sr. With several materials one after the other along the first axis, every wavelength of each.
    wavelengths, shape (wavelength,)
        nm; None where one table serves every wavelength.
    filled
        How many entries were filled, by rule.
    name
        Where the material comes from.
    surfaces
        Number of the material of every :class:`~twin.artifact.Surface`; empty where all have the same.
    entries
        Independent entries that ``filled`` counts of, of all wavelengths; 0 for all of ``brdf``.
    fill_error
        Relative standard uncertainty of filled entries, by rule, from held-out readings.
    gridding_error
        Relative difference (root mean square) of the table from the model it was compiled from; 0 where the table
        is the model.
    notes
        What else a person should know, a sentence each.
    method
        How a coupon's readings became the table (:data:`twin.coupon.Method`); empty for other materials.
    """

    cos_o: FloatArray
    phi_rad: FloatArray
    cos_i: FloatArray
    brdf: FloatArray
    wavelengths: FloatArray | None = None
    filled: dict[str, int] = field(default_factory=dict)
    name: str = ""
    surfaces: tuple[int, ...] = ()
    entries: int = 0
    fill_error: dict[str, float] = field(default_factory=dict)
    gridding_error: float = 0.0
    notes: tuple[str, ...] = ()
    method: Literal["", "auto", "linear", "filled", "smooth"] = ""

    def __post_init__(self) -> None:
        tables = self.materials * (1 if self.wavelengths is None else len(self.wavelengths))
        shape = (tables, len(self.cos_o), len(self.phi_rad), len(self.cos_i))
        if self.brdf.shape != shape:
            raise InputError(f"{self.name}: brdf: found shape {self.brdf.shape}; expected {shape}")
        for axis, values in (("cos_theta_o", self.cos_o), ("phi_d", self.phi_rad), ("cos_theta_i", self.cos_i)):
            if len(values) < 2 or not np.all(np.diff(values) > 0):
                raise InputError(f"{self.name}: {axis}: found {listed(values)}; expected at least two ascending values")
        _check_values(self)

    @property
    def materials(self) -> int:
        """How many materials the surfaces are made of."""
        return max(self.surfaces, default=0) + 1

    def table_index(self, wavelengths: ArrayLike) -> np.ndarray:
        """Index of the (first material's) table of each wavelength in nm.

        Raises
        ------
        InputError
            If the material was not measured at a wavelength.
        """
        wanted = np.atleast_1d(np.asarray(wavelengths, dtype=float))
        if self.wavelengths is None:
            return np.zeros(len(wanted), dtype=np.int64)
        nearest = np.argmin(np.abs(wanted[:, None] - self.wavelengths), axis=1)
        missing = np.abs(self.wavelengths[nearest] - wanted) > 0.05
        if np.any(missing):
            raise InputError(
                f"{self.name}: wavelength: the material was measured at {listed(self.wavelengths)} nm;"
                f" a prediction at {wanted[missing][0]:g} nm needs it there too"
            )
        return nearest.astype(np.int64)

    def evaluate(self, cos_o: ArrayLike, phi_rad: ArrayLike, cos_i: ArrayLike, table: int = 0) -> FloatArray:
        """BRDF in 1/sr, linear in the three coordinates; arguments broadcast."""
        o, phi, i = np.broadcast_arrays(
            np.asarray(cos_o, float), np.mod(np.asarray(phi_rad, float), 2 * np.pi), np.asarray(cos_i, float)
        )
        result = np.zeros(o.shape)
        places = [_bracket(axis, x) for axis, x in ((self.cos_o, o), (self.phi_rad, phi), (self.cos_i, i))]
        for corner in range(8):
            take = [(corner >> bit) & 1 for bit in range(3)]
            weight = np.ones(o.shape)
            for (_, fraction), upper in zip(places, take, strict=True):
                weight = weight * (fraction if upper else 1 - fraction)
            index = tuple(low + upper for (low, _), upper in zip(places, take, strict=True))
            result += weight * self.brdf[table][index]
        return result

    def on_grid(self, cos_o: FloatArray, phi_rad: FloatArray, cos_i: FloatArray) -> FloatArray:
        """Every table at the nodes of another grid, shape (table, o, phi, i); exact, where the grid holds ours."""
        values = np.einsum("ao,topi->tapi", _interpolation(self.cos_o, cos_o), self.brdf, optimize=True)
        values = np.einsum("bp,tapi->tabi", _interpolation(self.phi_rad, phi_rad), values, optimize=True)
        return np.asarray(np.einsum("ci,tabi->tabc", _interpolation(self.cos_i, cos_i), values, optimize=True))

    def describe(self) -> str:
        """One line on what the tables hold and how much of them was filled."""
        text = f"material {self.name}: {' x '.join(map(str, self.brdf.shape[1:]))} entries"
        if self.materials > 1:
            text += f", {self.materials} materials"
        if self.wavelengths is not None:
            text += f" at {listed(self.wavelengths)} nm"
        if self.method:
            text += f", {self.method}"
        if self.filled:
            text += "; filled: " + ", ".join(f"{count} for {rule}" for rule, count in self.filled.items())
        return text

    def scaled(self, factor: float) -> Material:
        """The same material, its reflectance multiplied."""
        return replace(self, brdf=self.brdf * factor)

    def directional_reflectance(self, cos_i: ArrayLike, table: int = 0) -> FloatArray:
        """Directional-hemispherical reflectance for incidence at the given cosines, exact for the table."""
        at_nodes = np.einsum("opi,o,p->i", self.brdf[table], _moments(self.cos_o), _spans(self.phi_rad), optimize=True)
        return np.interp(np.asarray(cos_i, dtype=float), self.cos_i, at_nodes)


def lambertian(reflectance: float) -> Material:
    """A surface of constant BRDF reflectance/pi."""
    end = np.array([0.0, 1.0])
    brdf = np.full((1, 2, 2, 2), reflectance / np.pi)
    return Material(end, np.array([0.0, 2 * np.pi]), end, brdf, name=f"Lambertian, reflectance {reflectance:g}")


def read_material(path: Path) -> Material:
    """Read a material, whatever the file holds: see :func:`twin.reflection_models.read_file`.

    Raises
    ------
    InputError
        Naming file and variable of whatever is wrong: no such file, gaps, negative values, wrong units.
    """
    from twin.reflection_models import read_file

    return read_file(path)


def open_netcdf(path: Path) -> xr.Dataset:
    """Load a netCDF file whole."""
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            return dataset.load()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable netCDF-4 file ({error})") from None


def listed(values: FloatArray) -> str:
    """The first few values, for a message."""
    shown = [f"{value:g}" for value in values[:6]]
    return ", ".join([*shown, "..."] if len(values) > 6 else shown)


def _bracket(nodes: FloatArray, x: FloatArray) -> tuple[np.ndarray, FloatArray]:
    """Index of the node below and the fraction of the way to the next; beyond the ends the end's value."""
    low = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    fraction = np.clip((x - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)
    return low, fraction


def _interpolation(nodes: FloatArray, x: FloatArray) -> FloatArray:
    """Weights of the nodes in the values at x, shape (x, node)."""
    low, fraction = _bracket(nodes, x)
    weights = np.zeros((len(x), len(nodes)))
    row = np.arange(len(x))
    weights[row, low] = 1 - fraction
    weights[row, low + 1] += fraction
    return weights


def _spans(nodes: FloatArray) -> FloatArray:
    """Weights of the integral over a function that is linear between the nodes."""
    step = np.diff(nodes)
    return (np.append(step, 0.0) + np.insert(step, 0, 0.0)) / 2


def _moments(cosines: FloatArray) -> FloatArray:
    """Weights of the integral of cosine times a function, linear between nodes and constant beyond, over 0 to 1."""
    a, b = cosines[:-1], cosines[1:]
    weights = np.zeros(len(cosines))
    weights[:-1] += (b - a) * (2 * a + b) / 6
    weights[1:] += (b - a) * (a + 2 * b) / 6
    weights[0] += cosines[0] ** 2 / 2
    weights[-1] += (1 - cosines[-1] ** 2) / 2
    return weights


def _check_values(material: Material) -> None:
    """Every entry finite and not negative; no incidence reflects more than it receives."""
    for what, bad in (("not a number", ~np.isfinite(material.brdf)), ("negative", material.brdf < 0)):
        if np.any(bad):
            place = np.unravel_index(int(np.argmax(bad)), bad.shape)
            raise InputError(
                f"{material.name}: brdf: {int(bad.sum())} of {bad.size} entries are {what}, the first at"
                f" cos_theta_o {material.cos_o[place[1]]:.4g}, phi_d {np.rad2deg(material.phi_rad[place[2]]):.4g}"
                f" degrees, cos_theta_i {material.cos_i[place[3]]:.4g}; expected finite values >= 0 in 1/sr"
            )
    for table in range(len(material.brdf)):
        total = material.directional_reflectance(material.cos_i, table)
        if np.any(total > ENERGY_LIMIT):
            worst = int(np.argmax(total))
            raise InputError(
                f"{material.name}: brdf: light incident at cosine {material.cos_i[worst]:.4g} would be reflected"
                f" {total[worst]:.3g} times over; expected at most 1 (is the table a reflectance factor, not 1/sr?)"
            )
