"""How the sample's surfaces reflect: the quasi-diffuse table of the paper, and the Lambertian surface.

A table holds the BRDF over cos(emergent zenith), azimuth difference and cos(incident zenith) and is linear between its
nodes (paper, section III and appendix A). It is made from a run over a flat witness coupon, or read ready-made.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from instrument.angles import FloatArray
from instrument.errors import InputError

TABLE_DIMS = ("cos_theta_o", "phi_d", "cos_theta_i")
_PHI_PER_UNIT = {"rad": 1.0, "radian": 1.0, "radians": 1.0, "deg": np.pi / 180, "degree": np.pi / 180}
_PHI_PER_UNIT["degrees"] = _PHI_PER_UNIT["degree"]


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
        1/sr.
    wavelengths, shape (wavelength,)
        nm; None where one table serves every wavelength.
    filled
        How many entries were filled, by rule.
    name
        Where the material comes from.
    """

    cos_o: FloatArray
    phi_rad: FloatArray
    cos_i: FloatArray
    brdf: FloatArray
    wavelengths: FloatArray | None = None
    filled: dict[str, int] = field(default_factory=dict)
    name: str = ""

    def __post_init__(self) -> None:
        tables = 1 if self.wavelengths is None else len(self.wavelengths)
        shape = (tables, len(self.cos_o), len(self.phi_rad), len(self.cos_i))
        if self.brdf.shape != shape:
            raise InputError(f"{self.name}: brdf: found shape {self.brdf.shape}; expected {shape}")
        for axis, values in (("cos_theta_o", self.cos_o), ("phi_d", self.phi_rad), ("cos_theta_i", self.cos_i)):
            if len(values) < 2 or np.any(np.diff(values) <= 0):
                raise InputError(f"{self.name}: {axis}: found {values}; expected at least two ascending values")
        _check_values(self)

    def table_index(self, wavelengths: ArrayLike) -> np.ndarray:
        """Index of the table of each wavelength in nm.

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
                f"{self.name}: wavelength: the material was measured at {_listed(self.wavelengths)} nm;"
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

    def describe(self) -> str:
        """One line on what the tables hold and how much of them was filled."""
        text = f"material {self.name}: {' x '.join(map(str, self.brdf.shape[1:]))} entries"
        if self.wavelengths is not None:
            text += f" at {_listed(self.wavelengths)} nm"
        if self.filled:
            text += "; filled: " + ", ".join(f"{count} for {rule}" for rule, count in self.filled.items())
        return text

    def scaled(self, factor: float) -> Material:
        """The same material, its reflectance multiplied."""
        return Material(
            self.cos_o, self.phi_rad, self.cos_i, self.brdf * factor, self.wavelengths, self.filled, self.name
        )

    def directional_reflectance(self, cos_i: ArrayLike, table: int = 0) -> FloatArray:
        """Directional-hemispherical reflectance for incidence at the given cosines, by quadrature."""
        mu, weight = np.polynomial.legendre.leggauss(48)
        mu, weight = (mu + 1) / 2, weight / 2
        phi = (np.arange(96) + 0.5) * (2 * np.pi / 96)
        values = self.evaluate(
            mu[:, None, None], phi[None, :, None], np.atleast_1d(np.asarray(cos_i, float))[None, None, :], table
        )
        return np.asarray(np.einsum("opi,o->i", values, weight * mu) * (2 * np.pi / 96))


def lambertian(reflectance: float) -> Material:
    """A surface of constant BRDF reflectance/pi."""
    end = np.array([0.0, 1.0])
    brdf = np.full((1, 2, 2, 2), reflectance / np.pi)
    return Material(end, np.array([0.0, 2 * np.pi]), end, brdf, name=f"Lambertian, reflectance {reflectance:g}")


def read_material(path: Path) -> Material:
    """Read a run of the witness coupon or a ready table, whichever the file holds.

    Raises
    ------
    InputError
        Naming file and variable of whatever is wrong: no such file, gaps, negative values, wrong units.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file (the material: a coupon run or a BRDF table)")
    if path.suffix.lower() != ".csv":
        dataset = open_netcdf(path)
        if "brdf" in dataset:
            return from_table(dataset, str(path))
        if "brf" not in dataset:
            raise InputError(
                f"{path}: found the variables {', '.join(map(str, dataset.data_vars)) or '(none)'}; expected 'brf'"
                " (a run of the witness coupon) or 'brdf' (a table)"
            )
    from instrument.dataset import read_run
    from twin.coupon import from_coupon

    return from_coupon(read_run(path), str(path))


def open_netcdf(path: Path) -> xr.Dataset:
    """Load a netCDF file whole."""
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            return dataset.load()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable netCDF-4 file ({error})") from None


def from_table(dataset: xr.Dataset, name: str) -> Material:
    """Make a material from a ready table ``brdf(cos_theta_o, phi_d, cos_theta_i)`` in 1/sr."""
    table = dataset["brdf"]
    if set(table.dims) != set(TABLE_DIMS):
        raise InputError(f"{name}: brdf: found the dimensions {table.dims}; expected {TABLE_DIMS}")
    _check_unit(name, "brdf", str(table.attrs.get("units", "")), {"sr^-1", "sr-1", "1/sr"})
    for axis in TABLE_DIMS:
        if axis not in table.coords:
            raise InputError(f"{name}: {axis}: found no coordinate values; expected one for every node")
    values = np.asarray(table.transpose(*TABLE_DIMS).values, dtype=float)
    unit = str(table["phi_d"].attrs.get("units", ""))
    _check_unit(name, "phi_d", unit, set(_PHI_PER_UNIT))
    phi = np.asarray(table["phi_d"].values, dtype=float) * _PHI_PER_UNIT[unit]
    cosines = [np.asarray(table[axis].values, dtype=float) for axis in ("cos_theta_o", "cos_theta_i")]
    for axis, cosine in zip(("cos_theta_o", "cos_theta_i"), cosines, strict=True):
        if np.any(cosine < 0) or np.any(cosine > 1):
            raise InputError(f"{name}: {axis}: found {cosine.min():g} to {cosine.max():g}; expected cosines, 0 to 1")
    cosines, values = _ascending(cosines, values)
    phi, values = _periodic(name, phi, values)
    return Material(cosines[0], phi, cosines[1], values[None], name=name)


def _ascending(cosines: list[FloatArray], values: FloatArray) -> tuple[list[FloatArray], FloatArray]:
    order_o, order_i = (np.argsort(cosine) for cosine in cosines)
    return [cosines[0][order_o], cosines[1][order_i]], values[order_o][:, :, order_i]


def _periodic(name: str, phi: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Close the table in azimuth: repeat its first node at 2 pi where the file does not."""
    if len(phi) < 1 or abs(phi[0]) > 1e-9 or np.any(np.diff(phi) <= 0) or phi[-1] > 2 * np.pi * (1 + 1e-6):
        raise InputError(f"{name}: phi_d: found {_listed(phi)} rad; expected ascending values from 0 up to 2 pi")
    if phi[-1] > 2 * np.pi * (1 - 1e-6):
        phi = np.concatenate([phi[:-1], [2 * np.pi]])
        return phi, values
    if 2 * np.pi - phi[-1] > 2 * np.max(np.diff(phi), initial=2 * np.pi - phi[-1] if len(phi) == 1 else 0):
        raise InputError(f"{name}: phi_d: ends at {phi[-1]:g} rad; expected the whole circle, the table is periodic")
    return np.concatenate([phi, [2 * np.pi]]), np.concatenate([values, values[:, :1]], axis=1)


def _bracket(nodes: FloatArray, x: FloatArray) -> tuple[np.ndarray, FloatArray]:
    """Index of the node below and the fraction of the way to the next; beyond the ends the end's value."""
    low = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    fraction = np.clip((x - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)
    return low, fraction


def _check_unit(name: str, variable: str, found: str, accepted: set[str]) -> None:
    if found not in accepted:
        raise InputError(f"{name}: {variable}: found the unit {found!r}; expected one of {', '.join(sorted(accepted))}")


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
        if np.any(total > 1.02):
            worst = int(np.argmax(total))
            raise InputError(
                f"{material.name}: brdf: light incident at cosine {material.cos_i[worst]:.4g} would be reflected"
                f" {total[worst]:.3g} times over; expected at most 1 (is the table a reflectance factor, not 1/sr?)"
            )


def _listed(values: FloatArray) -> str:
    shown = [f"{value:g}" for value in values[:6]]
    return ", ".join([*shown, "..."] if len(values) > 6 else shown)
