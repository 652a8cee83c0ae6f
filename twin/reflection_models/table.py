"""Ready tables: ``brdf(cos_theta_o, phi_d, cos_theta_i)`` in 1/sr, optionally over wavelength and surface."""

from __future__ import annotations

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.artifact import Surface
from twin.material import Material, listed

TABLE_DIMS = ("cos_theta_o", "phi_d", "cos_theta_i")
_RADIAN = dict.fromkeys(("rad", "radian", "radians"), 1.0)
_PHI_PER_UNIT = _RADIAN | dict.fromkeys(("deg", "degree", "degrees"), float(np.pi / 180))
_SURFACES = tuple(surface.name.lower() for surface in Surface)


def from_table(dataset: xr.Dataset, name: str) -> Material:
    """Make a material from a ready table.

    Parameters
    ----------
    dataset
        Holds ``brdf`` over ``cos_theta_o``, ``phi_d`` and ``cos_theta_i`` in 1/sr, each with its values; beside
        them ``wavelength`` in nm and ``surface`` (the names of :class:`~twin.artifact.Surface`), where there are many.
    name
        Names the file in errors.

    Raises
    ------
    InputError
        For wrong dimensions, units, axes or values.
    """
    table = dataset["brdf"]
    if not set(TABLE_DIMS) <= set(table.dims) or set(table.dims) - {*TABLE_DIMS, "wavelength", "surface"}:
        raise InputError(
            f"{name}: brdf: found the dimensions {table.dims}; expected {TABLE_DIMS}, with 'wavelength' or 'surface'"
            " where there are several"
        )
    _check_unit(name, "brdf", str(table.attrs.get("units", "")), {"sr^-1", "sr-1", "1/sr"})
    for axis in table.dims:
        if axis not in table.coords:
            raise InputError(f"{name}: {axis}: found no coordinate values; expected one for every node")
    extra = [axis for axis in ("surface", "wavelength") if axis in table.dims]
    values = np.asarray(table.transpose(*extra, *TABLE_DIMS).values, dtype=float)
    values = values.reshape(-1, *values.shape[-3:])
    unit = str(table["phi_d"].attrs.get("units", ""))
    _check_unit(name, "phi_d", unit, set(_PHI_PER_UNIT))
    phi = np.asarray(table["phi_d"].values, dtype=float) * _PHI_PER_UNIT[unit]
    cos_o, values = _ascending(name, table, "cos_theta_o", values)
    cos_i, values = _ascending(name, table, "cos_theta_i", values)
    phi, values = _periodic(name, phi, values)
    return Material(
        cos_o,
        phi,
        cos_i,
        values,
        wavelengths=_wavelengths(name, table),
        name=name,
        surfaces=_surfaces(name, table),
    )


def to_table(material: Material) -> xr.Dataset:
    """Write a material as a ready table, self-contained; :func:`from_table` reads it back."""
    values = material.brdf
    coords: dict[str, object] = {
        "cos_theta_o": ("cos_theta_o", material.cos_o, {"units": "1"}),
        "phi_d": ("phi_d", np.rad2deg(material.phi_rad), {"units": "degree"}),
        "cos_theta_i": ("cos_theta_i", material.cos_i, {"units": "1"}),
    }
    wavelengths = material.wavelengths
    count = 1 if wavelengths is None else len(wavelengths)
    values = values.reshape(material.materials, count, *values.shape[1:])
    values = values[list(material.surfaces or (0,))]
    extra = []
    if material.surfaces:
        extra.append("surface")
        coords["surface"] = ("surface", list(_SURFACES))
    else:
        values = values[0]
    if wavelengths is not None:
        extra.append("wavelength")
        coords["wavelength"] = ("wavelength", wavelengths, {"units": "nm"})
    else:
        values = values[..., 0, :, :, :]
    dims = (*extra, *TABLE_DIMS)
    return xr.Dataset(
        {"brdf": (dims, values, {"units": "sr-1", "long_name": "bidirectional reflectance distribution function"})},
        coords=coords,
        attrs={"Conventions": "CF-1.11", "title": "reflection table", "source": material.describe()},
    )


def _ascending(name: str, table: xr.DataArray, axis: str, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Order an axis of cosines; ``values`` in the order (..., o, phi, i)."""
    cosines = np.asarray(table[axis].values, dtype=float)
    if not np.all((cosines >= 0) & (cosines <= 1)):
        raise InputError(f"{name}: {axis}: found {cosines.min():g} to {cosines.max():g}; expected cosines, 0 to 1")
    step = np.diff(cosines)
    if not (np.all(step > 0) or np.all(step < 0)):
        raise InputError(f"{name}: {axis}: found {listed(cosines)}; expected values that ascend or descend throughout")
    order = np.argsort(cosines)
    return cosines[order], np.take(values, order, axis=-3 if axis == "cos_theta_o" else -1)


def _periodic(name: str, phi: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Close the table in azimuth: repeat its first node at 2 pi where the file does not."""
    bad = len(phi) < 1 or not abs(phi[0]) < 1e-9 or not np.all(np.diff(phi) > 0) or phi[-1] > 2 * np.pi * (1 + 1e-6)
    if bad:
        raise InputError(f"{name}: phi_d: found {listed(phi)} rad; expected ascending values from 0 up to 2 pi")
    if phi[-1] > 2 * np.pi * (1 - 1e-6):
        return np.concatenate([phi[:-1], [2 * np.pi]]), values
    if 2 * np.pi - phi[-1] > 2 * np.max(np.diff(phi), initial=2 * np.pi - phi[-1] if len(phi) == 1 else 0):
        raise InputError(f"{name}: phi_d: ends at {phi[-1]:g} rad; expected the whole circle, the table is periodic")
    return np.concatenate([phi, [2 * np.pi]]), np.concatenate([values, values[..., :1, :]], axis=-2)


def _wavelengths(name: str, table: xr.DataArray) -> FloatArray | None:
    if "wavelength" not in table.dims:
        return None
    _check_unit(name, "wavelength", str(table["wavelength"].attrs.get("units", "")), {"nm"})
    wavelengths = np.asarray(table["wavelength"].values, dtype=float)
    if not np.all(np.diff(wavelengths) > 0) or not np.all(wavelengths > 0):
        raise InputError(f"{name}: wavelength: found {listed(wavelengths)} nm; expected ascending positive values")
    return wavelengths


def _surfaces(name: str, table: xr.DataArray) -> tuple[int, ...]:
    if "surface" not in table.dims:
        return ()
    names = [str(value) for value in table["surface"].values]
    if sorted(names) != sorted(_SURFACES):
        raise InputError(f"{name}: surface: found {', '.join(names)}; expected each of {', '.join(_SURFACES)} once")
    return tuple(names.index(surface) for surface in _SURFACES)


def _check_unit(name: str, variable: str, found: str, accepted: set[str]) -> None:
    if found not in accepted:
        raise InputError(f"{name}: {variable}: found the unit {found!r}; expected one of {', '.join(sorted(accepted))}")
