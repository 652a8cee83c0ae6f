"""Dimensions of an artifact as a dimensional laboratory reports them: ``artifact.toml`` and its table of holes.

Only the data form lives here; the twin makes a solid of it.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.files import beside
from instrument.forms import Form, parse_form, read_form

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Tilt = Annotated[float, Field(gt=-45, lt=45)]

HOLE_COLUMNS = ("hole", "x_mm", "y_mm", "diameter_mm", "u_x_mm", "u_y_mm", "u_diameter_mm")
#: Columns that a table may have besides; an empty field means the artifact's ``edge_chamfer``.
CHAMFER_COLUMNS = ("chamfer_mm", "u_chamfer_mm")


class ArtifactForm(Form):
    """Keys of ``artifact.toml``; lengths in mm, angles in degrees, ``u_`` standard uncertainties (k = 1).

    ``mesh`` names a closed triangle mesh (PLY, STL, OBJ) that takes the place of the dimensions. ``edge_chamfer`` is
    the width of a 45 degree chamfer at the upper edges of the holes. ``block_tilt_x`` and ``block_tilt_y`` turn the
    block (the floor of the cavity) against the plate, right-handed about the axes of the artifact frame, about the
    floor's centre.
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
    edge_chamfer: NonNegative = 0.0
    u_edge_chamfer: NonNegative = 0.0
    block_tilt_x: Tilt = 0.0
    u_block_tilt_x: NonNegative = 0.0
    block_tilt_y: Tilt = 0.0
    u_block_tilt_y: NonNegative = 0.0

    @property
    def floor_slope(self) -> tuple[float, float]:
        """Rise of the cavity's floor along x and y, mm a mm."""
        angle = math.hypot(self.block_tilt_x, self.block_tilt_y)
        rise = math.tan(math.radians(angle)) / angle if angle else 0.0
        return -self.block_tilt_y * rise, self.block_tilt_x * rise


@dataclass(frozen=True)
class Holes:
    """Centres and diameters of the holes in mm, artifact frame; every array has shape (hole,).

    ``chamfer`` and ``u_chamfer`` are nan for a hole that has the artifact's ``edge_chamfer``, and None where all have;
    ``names`` are those of the table, empty where the holes are merely counted from 0.
    """

    x: FloatArray
    y: FloatArray
    diameter: FloatArray
    u_x: FloatArray
    u_y: FloatArray
    u_diameter: FloatArray
    chamfer: FloatArray | None = None
    u_chamfer: FloatArray | None = None
    names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.x)

    def name(self, index: int) -> str:
        """What a message calls a hole."""
        return self.names[index] if self.names else str(index)


@dataclass(frozen=True)
class ArtifactDimensions:
    """Everything ``artifact.toml`` says, with the holes read and the paths resolved."""

    form: ArtifactForm
    holes: Holes
    mesh: Path | None
    source: Path

    @property
    def chamfers(self) -> FloatArray:
        """Width of every hole's chamfer in mm, shape (hole,)."""
        return _own_or(self.holes.chamfer, self.form.edge_chamfer, len(self.holes))

    @property
    def u_chamfers(self) -> FloatArray:
        """Standard uncertainty of every hole's chamfer in mm, shape (hole,)."""
        return _own_or(self.holes.u_chamfer, self.form.u_edge_chamfer, len(self.holes))

    def changed(
        self,
        *,
        hole_diameter: float = 0.0,
        plate_thickness: float = 0.0,
        cavity_depth: float = 0.0,
        edge_chamfer: float = 0.0,
        block_tilt_x: float = 0.0,
        block_tilt_y: float = 0.0,
    ) -> ArtifactDimensions:
        """Dimensions with something added to them: lengths in mm, angles in degrees.

        Diameter and chamfer change for every hole.

        Raises
        ------
        InputError
            If the result is no solid: holes that meet, a chamfer below 0, a plate thicker than the cavity is deep.
        """
        added = {
            "plate_thickness": plate_thickness,
            "cavity_depth": cavity_depth,
            "edge_chamfer": edge_chamfer,
            "block_tilt_x": block_tilt_x,
            "block_tilt_y": block_tilt_y,
        }
        values = {name: getattr(self.form, name) + delta for name, delta in added.items() if delta}
        form = parse_form(self.form.model_dump() | values, ArtifactForm, str(self.source)) if values else self.form
        holes = replace(self.holes, diameter=self.holes.diameter + hole_diameter)
        if holes.chamfer is not None:
            holes = replace(holes, chamfer=holes.chamfer + edge_chamfer)
        result = replace(self, form=form, holes=holes)
        check_dimensions(result)
        return result


def read_artifact(path: Path) -> ArtifactDimensions:
    """Read ``artifact.toml`` and the table of holes beside it.

    Raises
    ------
    InputError
        Naming file, row and column of whatever is wrong: unknown keys, missing columns, text where a number
        is expected, and what :func:`check_dimensions` finds.
    """
    form = read_form(path, ArtifactForm)
    holes = read_holes(beside(path, form.holes, "holes")) if form.holes is not None else _no_holes()
    mesh = beside(path, form.mesh, "mesh") if form.mesh is not None else None
    if mesh is not None and not mesh.exists():
        raise InputError(f"{path}: mesh: {mesh}: no such file")
    dimensions = ArtifactDimensions(form, holes, mesh, path)
    check_dimensions(dimensions)
    return dimensions


def without_holes(dimensions: ArtifactDimensions) -> ArtifactDimensions:
    """A flat sample of the same outline: the coupon of an artifact."""
    return replace(
        dimensions, form=dimensions.form.model_copy(update={"holes": None, "mesh": None}), holes=_no_holes(), mesh=None
    )


def read_holes(path: Path) -> Holes:
    """Read the table of holes (CSV with the header of :data:`HOLE_COLUMNS`, perhaps :data:`CHAMFER_COLUMNS`)."""
    try:
        with path.open(encoding="utf-8", newline="") as handle:
            reader = csv.DictReader(handle)
            found = tuple(reader.fieldnames or ())
            missing = [name for name in HOLE_COLUMNS[1:4] if name not in found]
            unknown = [name for name in found if name not in HOLE_COLUMNS + CHAMFER_COLUMNS]
            if missing or unknown:
                raise InputError(f"{path}: header: found {','.join(found)}; expected {','.join(HOLE_COLUMNS)}")
            rows = list(reader)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file (the table of holes)") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; expected a CSV table of holes") from None
    names = HOLE_COLUMNS[1:] + CHAMFER_COLUMNS
    table = np.array([[_number(path, line, row, name) for name in names] for line, row in enumerate(rows, start=2)])
    columns = dict(zip(names, table.reshape(-1, len(names)).T, strict=True))
    if np.any(columns["diameter_mm"] <= 0):
        row = int(np.argmax(columns["diameter_mm"] <= 0))
        raise InputError(f"{path}: line {row + 2}: diameter_mm: found {columns['diameter_mm'][row]}; expected > 0")
    x, y, diameter, u_x, u_y, u_diameter = (columns[name] for name in HOLE_COLUMNS[1:])
    chamfer, u_chamfer = (columns[name] if name in found else None for name in CHAMFER_COLUMNS)
    own = _names(path, [row["hole"] or "" for row in rows]) if "hole" in found else ()
    return Holes(x, y, diameter, u_x, u_y, u_diameter, chamfer, u_chamfer, own)


def _number(path: Path, line: int, row: dict[str, str], name: str) -> float:
    """A field of the table; an empty uncertainty is 0, an empty chamfer that of the artifact (nan)."""
    text = row.get(name)
    if text in (None, "") and name in CHAMFER_COLUMNS:
        return math.nan
    try:
        value = float(text if text not in (None, "") else 0.0) if name.startswith("u_") else float(text or "")
    except ValueError:
        raise InputError(f"{path}: line {line}: {name}: found {text!r}; expected a number in mm") from None
    if not math.isfinite(value):
        raise InputError(f"{path}: line {line}: {name}: found {text!r}; expected a finite length in mm")
    if value < 0 and (name.startswith("u_") or name in CHAMFER_COLUMNS):
        raise InputError(f"{path}: line {line}: {name}: found {text!r}; expected a length in mm, 0 or more")
    return value


def _names(path: Path, names: list[str]) -> tuple[str, ...]:
    for line, name in enumerate(names, start=2):
        first = names.index(name) + 2
        if name and first != line:
            raise InputError(f"{path}: line {line}: hole: found {name!r} again, as on line {first}; expected each once")
    return tuple(name or f"on line {line}" for line, name in enumerate(names, start=2))


def _no_holes() -> Holes:
    none = np.zeros(0)
    return Holes(none, none, none, none, none, none)


def _own_or(own: FloatArray | None, common: float, count: int) -> FloatArray:
    return np.full(count, common) if own is None else np.where(np.isnan(own), common, own)


def check_dimensions(dimensions: ArtifactDimensions) -> None:
    """Check that the dimensions are those of a solid.

    Raises
    ------
    InputError
        Naming the file and the key or the holes: holes that leave the plate or overlap, chamfers that meet or cut
        through the plate, a cavity less deep than the plate is thick, a spacer without an inside, a floor that meets
        the plate.
    """
    if not len(dimensions.holes):
        return
    _check_cavity(dimensions.source, dimensions.form)
    _check_chamfers(dimensions)
    _check_layout(dimensions.source, dimensions.form, dimensions.holes, np.zeros(len(dimensions.holes)))
    if np.any(dimensions.chamfers > 0):
        _check_layout(dimensions.source, dimensions.form, dimensions.holes, dimensions.chamfers)


def _check_cavity(path: Path, form: ArtifactForm) -> None:
    if form.cavity_depth <= form.plate_thickness:
        raise InputError(
            f"{path}: cavity_depth: found {form.cavity_depth:g} mm; expected more than the plate_thickness"
            f" ({form.plate_thickness:g} mm), it is measured from the top of the plate"
        )
    if 2 * form.spacer_edge >= min(form.outline):
        raise InputError(
            f"{path}: spacer_edge: found {form.spacer_edge:g} mm; expected less than half the outline"
            f" ({form.outline[0]:g} x {form.outline[1]:g} mm)"
        )
    inner = [side - 2 * form.spacer_edge for side in form.outline]
    rise = sum(abs(slope) * side / 2 for slope, side in zip(form.floor_slope, inner, strict=True))
    tilt = f"block_tilt_x, block_tilt_y: found {form.block_tilt_x:g} and {form.block_tilt_y:g} degrees"
    if rise >= form.cavity_depth - form.plate_thickness:
        raise InputError(f"{path}: {tilt}; expected a floor below the plate: it rises by {rise:.3f} mm at the side")
    if rise >= form.block_thickness:
        raise InputError(f"{path}: {tilt}; expected a floor above the block's bottom: it falls by {rise:.3f} mm")


def _check_chamfers(dimensions: ArtifactDimensions) -> None:
    path, form, holes, chamfers = dimensions.source, dimensions.form, dimensions.holes, dimensions.chamfers
    bad = (chamfers < 0) | (chamfers >= form.plate_thickness)
    if np.any(bad):
        hole = int(np.argmax(bad))
        own = holes.chamfer is not None and not np.isnan(holes.chamfer[hole])
        key = f"hole {holes.name(hole)}: chamfer_mm" if own else "edge_chamfer"
        raise InputError(
            f"{path}: {key}: found {chamfers[hole]:g} mm; expected from 0 to less than the plate_thickness"
            f" ({form.plate_thickness:g} mm)"
        )


def _check_layout(path: Path, form: ArtifactForm, holes: Holes, chamfers: FloatArray) -> None:
    """Whether the holes, each widened by its chamfer, lie apart from each other on the plate."""
    half_x, half_y = (side / 2 for side in form.outline)
    radius = holes.diameter / 2 + chamfers
    if np.any(holes.diameter <= 0):
        hole = int(np.argmax(holes.diameter <= 0))
        raise InputError(f"{path}: hole {holes.name(hole)}: diameter: found {holes.diameter[hole]:g} mm; expected > 0")
    what = "the chamfer of hole" if np.any(chamfers) else "hole"
    outside = (np.abs(holes.x) + radius > half_x) | (np.abs(holes.y) + radius > half_y)
    if np.any(outside):
        hole = int(np.argmax(outside))
        raise InputError(
            f"{path}: {what} {holes.name(hole)} at ({holes.x[hole]:g}, {holes.y[hole]:g}) mm leaves the plate, whose"
            f" edges are at +-{half_x:g}, +-{half_y:g} mm; are the lengths in mm?"
        )
    distance = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y)
    gap = distance - radius[:, None] - radius
    np.fill_diagonal(gap, np.inf)
    if np.any(gap <= 0):
        first, second = np.unravel_index(int(np.argmin(gap)), gap.shape)
        pair = f"{holes.name(int(first))} and {holes.name(int(second))}"
        what = "the chamfers of holes" if np.any(chamfers) else "holes"
        raise InputError(f"{path}: {what} {pair} overlap by {-gap[first, second]:.3f} mm")
