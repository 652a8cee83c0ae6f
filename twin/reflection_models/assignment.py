"""``material.toml``: which model describes which surface of the sample.

.. code-block:: toml

    [default]              # every surface not named below
    model = "coupon"
    file = "material.nc"

    [floor]
    model = "lambertian"
    reflectance = 0.45

    [wall]
    file = "walls.nc"      # without a model: whatever the file holds
    scale = 0.95           # times the model's reflectance
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.forms import read_toml
from twin.artifact import Surface
from twin.material import Material
from twin.reflection_models import Origin, find_model, read_file

#: Tables that stand for several surfaces; one for a single surface, under its own name, goes before them.
GROUPS = {
    "plate": (Surface.PLATE_TOP, Surface.UNDERSIDE, Surface.OUTSIDE),
    "wall": (Surface.HOLE_WALL, Surface.SPACER),
}
_SINGLE = {surface.name.lower(): surface for surface in Surface}


def read_assignment(path: Path) -> Material:
    """Read ``material.toml``.

    Raises
    ------
    InputError
        Naming file, table and key: a surface without a model or of an unknown name, a wrong setting.
    """
    data = read_toml(path)
    chosen = _choose(data, str(path))
    tables = list(dict.fromkeys(chosen.values()))
    materials = [_material(data[table], Origin(path.parent, f"{path}: [{table}]")) for table in tables]
    if len(materials) == 1:
        return replace(materials[0], name=str(path))
    return assemble(materials, tuple(tables.index(chosen[surface]) for surface in Surface), str(path))


def assemble(materials: list[Material], surfaces: tuple[int, ...], name: str) -> Material:
    """Several materials as one: exact, for a grid that holds every node of theirs.

    Parameters
    ----------
    materials
        Each for all surfaces.
    surfaces
        Number of the material of every :class:`~twin.artifact.Surface`.
    name
        Of the whole.

    Raises
    ------
    InputError
        If the materials have no wavelength in common.
    """
    cos_o, phi_rad, cos_i = (_union([getattr(m, axis) for m in materials]) for axis in ("cos_o", "phi_rad", "cos_i"))
    wavelengths = _common_wavelengths(materials, name)
    values = []
    for material in materials:
        index = np.zeros(1, int) if wavelengths is None else material.table_index(wavelengths)
        values.append(material.on_grid(cos_o, phi_rad, cos_i)[index])
    filled: dict[str, int] = {}
    for number, material in enumerate(materials, 1):
        filled |= {f"{rule} (material {number})": count for rule, count in material.filled.items()}
    return Material(
        cos_o,
        phi_rad,
        cos_i,
        np.concatenate(values),
        wavelengths=wavelengths,
        filled=filled,
        name=name,
        surfaces=surfaces,
        entries=sum(material.entries or material.brdf.size for material in materials),
        fill_error={
            f"{rule} (material {number})": error
            for number, material in enumerate(materials, 1)
            for rule, error in material.fill_error.items()
        },
        gridding_error=max(material.gridding_error for material in materials),
        notes=tuple(dict.fromkeys(note for material in materials for note in material.notes)),
    )


def _choose(data: Mapping[str, Any], where: str) -> dict[Surface, str]:
    """Name of the table of each surface."""
    known = ("default", *GROUPS, *_SINGLE)
    for key, value in data.items():
        if key not in known or not isinstance(value, dict):
            raise InputError(f"{where}: {key}: unknown; expected tables out of {', '.join(f'[{k}]' for k in known)}")
    chosen = dict.fromkeys(Surface, "default") if "default" in data else {}
    for group, surfaces in GROUPS.items():
        if group in data:
            chosen |= dict.fromkeys(surfaces, group)
    chosen |= {surface: key for key, surface in _SINGLE.items() if key in data}
    missing = [surface.name.lower() for surface in Surface if surface not in chosen]
    if missing:
        raise InputError(f"{where}: no material for {', '.join(missing)}; expected their tables, or [default]")
    return chosen


def _material(settings: Mapping[str, Any], origin: Origin) -> Material:
    given = dict(settings)
    scale = given.pop("scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 <= scale < np.inf:
        raise InputError(f"{origin.where}: scale: found {scale!r}; expected a number >= 0")
    name = given.pop("model", None)
    if name is None:
        if list(given) != ["file"] or not isinstance(given["file"], str):
            raise InputError(f"{origin.where}: found {', '.join(given) or 'nothing'}; expected 'model' or 'file' alone")
        if Path(given["file"]).suffix.lower() == ".toml":
            raise InputError(f"{origin.where}: file: found {given['file']!r}; expected a run or a table, no TOML file")
        material = read_file(origin.file(given["file"]))
    else:
        material = find_model(str(name), origin.where)(given, origin)
    return material if scale == 1 else material.scaled(float(scale))


def _union(axes: list[FloatArray]) -> FloatArray:
    """All nodes of several axes; those closer than single precision tells apart are one."""
    nodes = reduce(np.union1d, axes)
    return np.asarray(nodes[np.insert(np.diff(nodes) > 1e-6, 0, True)])


def _common_wavelengths(materials: list[Material], name: str) -> FloatArray | None:
    given = [material.wavelengths for material in materials if material.wavelengths is not None]
    if not given:
        return None
    common = np.array([w for w in given[0] if all(np.min(np.abs(other - w)) <= 0.05 for other in given)])
    if len(common) == 0:
        raise InputError(f"{name}: the surfaces' materials have no wavelength in common; expected at least one")
    return common
