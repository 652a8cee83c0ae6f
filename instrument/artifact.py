"""Dimensions of an artifact as a dimensional laboratory reports them: ``artifact.toml`` and its table of holes.

Only the data form lives here; the twin makes a solid of it.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.forms import Form, read_form

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]

HOLE_COLUMNS = ("hole", "x_mm", "y_mm", "diameter_mm", "u_x_mm", "u_y_mm", "u_diameter_mm")


class ArtifactForm(Form):
    """Keys of ``artifact.toml``; lengths in mm, ``u_`` standard uncertainties (k = 1).

    ``mesh`` names a closed triangle mesh (PLY, STL, OBJ) that takes the place of the dimensions.
    """

    holes: str | None = None
    mesh: str | None = None
    outline: tuple[Positive, Positive] = (50.0, 50.0)
    plate_thickness: Positive = 1.0
    u_plate_thickness: NonNegative = 0.0
    cavity_depth: Positive = 3.0
    u_cavity_depth: NonNegative = 0.0
    spacer_edge: NonNegative = 4.0
    block_thickness: Positive = 5.0


@dataclass(frozen=True)
class Holes:
    """Centres and diameters of the holes in mm, artifact frame; every array has shape (hole,)."""

    x: FloatArray
    y: FloatArray
    diameter: FloatArray
    u_x: FloatArray
    u_y: FloatArray
    u_diameter: FloatArray

    def __len__(self) -> int:
        return len(self.x)


@dataclass(frozen=True)
class ArtifactDimensions:
    """Everything ``artifact.toml`` says, with the holes read and the paths resolved."""

    form: ArtifactForm
    holes: Holes
    mesh: Path | None
    source: Path


def read_artifact(path: Path) -> ArtifactDimensions:
    """Read ``artifact.toml`` and the table of holes beside it.

    Raises
    ------
    InputError
        Naming file, row and column of whatever is wrong: unknown keys, missing columns, text where a number
        is expected, holes that leave the plate or touch each other.
    """
    form = read_form(path, ArtifactForm)
    if form.cavity_depth < form.plate_thickness and form.holes is not None:
        raise InputError(
            f"{path}: cavity_depth: found {form.cavity_depth} mm; expected at least the plate_thickness"
            f" ({form.plate_thickness} mm), it is measured from the top of the plate"
        )
    holes = read_holes(path.parent / form.holes) if form.holes is not None else _no_holes()
    mesh = path.parent / form.mesh if form.mesh is not None else None
    if mesh is not None and not mesh.exists():
        raise InputError(f"{path}: mesh: {mesh}: no such file")
    _check_layout(path, form, holes)
    return ArtifactDimensions(form, holes, mesh, path)


def read_holes(path: Path) -> Holes:
    """Read the table of holes (CSV with the header of :data:`HOLE_COLUMNS`)."""
    try:
        with path.open(encoding="utf-8", newline="") as handle:
            reader = csv.DictReader(handle)
            found = tuple(reader.fieldnames or ())
            missing = [name for name in HOLE_COLUMNS[1:4] if name not in found]
            unknown = [name for name in found if name not in HOLE_COLUMNS]
            if missing or unknown:
                raise InputError(f"{path}: header: found {','.join(found)}; expected {','.join(HOLE_COLUMNS)}")
            rows = [_numbers(path, number, row) for number, row in enumerate(reader, start=2)]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file (the table of holes)") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; expected a CSV table of holes") from None
    columns = {name: np.array([row[name] for row in rows], dtype=float) for name in HOLE_COLUMNS[1:]}
    if np.any(columns["diameter_mm"] <= 0):
        row = int(np.argmax(columns["diameter_mm"] <= 0))
        raise InputError(f"{path}: line {row + 2}: diameter_mm: found {columns['diameter_mm'][row]}; expected > 0")
    return Holes(*columns.values())


def _numbers(path: Path, line: int, row: dict[str, str]) -> dict[str, float]:
    result = {}
    for name in HOLE_COLUMNS[1:]:
        text = row.get(name)
        try:
            value = float(text if text not in (None, "") else 0.0) if name.startswith("u_") else float(text or "")
        except ValueError:
            raise InputError(f"{path}: line {line}: {name}: found {text!r}; expected a number in mm") from None
        if not np.isfinite(value) or (name.startswith("u_") and value < 0):
            raise InputError(f"{path}: line {line}: {name}: found {text!r}; expected a finite length in mm")
        result[name] = value
    return result


def _no_holes() -> Holes:
    return Holes(*(np.zeros(0) for _ in range(6)))


def _check_layout(path: Path, form: ArtifactForm, holes: Holes) -> None:
    if not len(holes):
        return
    half_x, half_y = (side / 2 for side in form.outline)
    radius = holes.diameter / 2
    outside = (np.abs(holes.x) + radius > half_x) | (np.abs(holes.y) + radius > half_y)
    if np.any(outside):
        hole = int(np.argmax(outside))
        raise InputError(
            f"{path}: hole {hole} at ({holes.x[hole]}, {holes.y[hole]}) mm leaves the plate, whose edges are at"
            f" +-{half_x}, +-{half_y} mm; are the lengths in mm?"
        )
    distance = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y)
    gap = distance - radius[:, None] - radius
    np.fill_diagonal(gap, np.inf)
    if np.any(gap <= 0):
        first, second = np.unravel_index(int(np.argmin(gap)), gap.shape)
        raise InputError(f"{path}: holes {first} and {second} overlap by {-gap[first, second]:.3f} mm")
