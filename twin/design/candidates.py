"""Candidate artifacts: one that is described, and variations of its dimensions and of the arrangement of its holes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, Holes
from instrument.errors import InputError


class Shape(StrEnum):
    """Arrangement of the holes."""

    SQUARE = "square"
    HEXAGONAL = "hexagonal"
    FLAT = "flat"


#: What a sweep may vary, with its unit.
PARAMETERS = {"hole_diameter": "mm", "pitch": "mm", "depth": "mm", "plate_thickness": "mm", "shape": ""}
MOST_VALUES = 50
Value = float | Shape


@dataclass(frozen=True)
class Sweep:
    """Values of one parameter."""

    parameter: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Candidate:
    """An artifact to be judged.

    Attributes
    ----------
    name
        For titles and tables.
    changes
        What was varied, by parameter; empty for the artifact as it is described.
    """

    name: str
    artifact: ArtifactDimensions
    changes: dict[str, Value]


def parse_sweep(text: str) -> Sweep:
    """Read ``parameter=start:stop:count`` or ``parameter=value,value,...``.

    Raises
    ------
    InputError
        Saying what was found and what is expected.
    """
    parameter, equals, values = text.partition("=")
    parameter = parameter.strip()
    if not equals or parameter not in PARAMETERS:
        raise InputError(
            f"--sweep {text}: found the parameter {parameter!r}; expected one of {', '.join(PARAMETERS)},"
            " as in hole_diameter=2.0:3.0:5 or shape=square,hexagonal"
        )
    if parameter == "shape":
        found: tuple[Value, ...] = tuple(_shape(text, name.strip()) for name in values.split(","))
    elif ":" in values:
        found = _range(text, values)
    else:
        found = tuple(_length(text, value) for value in values.split(","))
    if len(set(found)) < len(found):
        raise InputError(f"--sweep {text}: a value stands twice")
    if len(found) > MOST_VALUES:
        raise InputError(f"--sweep {text}: found {len(found)} values; expected at most {MOST_VALUES}")
    return Sweep(parameter, found)


def _range(text: str, values: str) -> tuple[float, ...]:
    parts = values.split(":")
    if len(parts) != 3 or not parts[2].strip().isdigit() or int(parts[2]) < 2:
        raise InputError(f"--sweep {text}: found {values!r}; expected start:stop:count with a count of at least 2")
    if int(parts[2]) > MOST_VALUES:
        raise InputError(f"--sweep {text}: found {parts[2].strip()} values; expected at most {MOST_VALUES}")
    start, stop = (_length(text, part) for part in parts[:2])
    return tuple(round(float(value), 9) for value in np.linspace(start, stop, int(parts[2])))


def _length(text: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        raise InputError(f"--sweep {text}: found {value.strip()!r}; expected a length in mm") from None
    if not (np.isfinite(number) and number > 0):
        raise InputError(f"--sweep {text}: found {value.strip()}; expected a length > 0 mm")
    return number


def _shape(text: str, name: str) -> Shape:
    try:
        return Shape(name)
    except ValueError:
        raise InputError(f"--sweep {text}: found the shape {name!r}; expected {', '.join(Shape)}") from None


def combinations(artifact: ArtifactDimensions, sweeps: list[Sweep]) -> list[Candidate]:
    """Every combination of the values of all sweeps.

    Raises
    ------
    InputError
        For a parameter swept twice, an artifact that is a mesh, or a combination that cannot be made: holes that
        overlap or leave the plate, a floor above the underside.
    """
    names = [sweep.parameter for sweep in sweeps]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"--sweep {name}: stands twice; expected one sweep a parameter")
    if not sweeps:
        return []
    if artifact.mesh is not None or not len(artifact.holes):
        what = "a mesh" if artifact.mesh is not None else "an artifact without holes"
        raise InputError(f"{artifact.source}: is {what}; expected holes and dimensions to sweep")
    result = []
    for values in itertools.product(*(sweep.values for sweep in sweeps)):
        changes = dict(zip(names, values, strict=True))
        result.append(Candidate(label(changes), vary(artifact, changes), changes))
    return result


def label(changes: dict[str, Value]) -> str:
    """The changes in words."""
    parts = [
        f"{name.replace('_', ' ')} {value}" if name == "shape" else f"{name.replace('_', ' ')} {value:g} mm"
        for name, value in changes.items()
    ]
    return ", ".join(parts)


def vary(artifact: ArtifactDimensions, changes: dict[str, Value]) -> ArtifactDimensions:
    """The artifact with other dimensions.

    A new pitch or shape rearranges the holes regularly over the area that they cover now, all with their mean diameter;
    a new diameter alone keeps places and deviations from the mean.
    """
    form, holes = artifact.form, artifact.holes
    lengths = {"depth": "cavity_depth", "plate_thickness": "plate_thickness"}
    form = form.model_copy(update={lengths[name]: value for name, value in changes.items() if name in lengths})
    if form.cavity_depth <= form.plate_thickness:
        raise InputError(
            f"--sweep {label(changes)}: the depth {form.cavity_depth:g} mm is measured from the top of the plate;"
            f" expected more than the plate's thickness, {form.plate_thickness:g} mm"
        )
    if changes.get("shape") is Shape.FLAT:
        return replace(artifact, form=form, holes=_regular(np.zeros((0, 2)), 0.0))
    if "hole_diameter" in changes:
        shift = float(changes["hole_diameter"]) - float(holes.diameter.mean())
        holes = replace(holes, diameter=holes.diameter + shift)
    if "pitch" in changes or "shape" in changes:
        pitch = float(changes.get("pitch", pitch_of(artifact.holes)))
        shape = Shape(str(changes.get("shape", Shape.SQUARE)))
        holes = _regular(_lattice(shape, pitch, artifact.holes), float(holes.diameter.mean()))
    _check(changes, holes, form.outline)
    return replace(artifact, form=form, holes=holes)


def pitch_of(holes: Holes) -> float:
    """Median distance of a hole to its nearest neighbour, mm."""
    distance = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y)
    np.fill_diagonal(distance, np.inf)
    return float(np.round(np.median(distance.min(axis=1)), 3))


def _lattice(shape: Shape, pitch: float, now: Holes) -> FloatArray:
    """Centres over the area that is covered now, shape (hole, 2); the origin stays between holes if it is now."""
    even = bool(np.hypot(now.x, now.y).min() > pitch_of(now) / 4)
    extent = [float(np.abs(axis).max()) + pitch_of(now) / 2 for axis in (now.x, now.y)]
    row_spacing = pitch if shape is Shape.SQUARE else pitch * np.sqrt(3) / 2
    x, y = _row(extent[0], pitch, even), _row(extent[1], row_spacing, even)
    centres = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    if shape is Shape.HEXAGONAL:
        centres[:, ::2, 0] += pitch / 4
        centres[:, 1::2, 0] -= pitch / 4
    return centres.reshape(-1, 2)


def _row(extent: float, spacing: float, even: bool) -> FloatArray:
    """Equally spaced places centred on 0; an even or odd number of them."""
    count = int(np.floor(2 * extent / spacing + 1e-6))
    count -= count % 2 if even else 1 - count % 2
    return np.asarray((np.arange(max(count, 1)) - (max(count, 1) - 1) / 2) * spacing, dtype=float)


def _regular(centres: FloatArray, diameter: float) -> Holes:
    zero = np.zeros(len(centres))
    return Holes(centres[:, 0], centres[:, 1], zero + diameter, zero, zero, zero)


def _check(changes: dict[str, Value], holes: Holes, outline: tuple[float, float]) -> None:
    where = f"--sweep {label(changes)}"
    if np.any(holes.diameter <= 0):
        raise InputError(f"{where}: the smallest hole would have {holes.diameter.min():g} mm; expected > 0")
    distance = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y)
    distance -= (holes.diameter[:, None] + holes.diameter) / 2
    np.fill_diagonal(distance, np.inf)
    if len(holes) > 1 and distance.min() <= 0:
        raise InputError(
            f"{where}: holes of {holes.diameter.mean():g} mm at a pitch of {pitch_of(holes):g} mm overlap by"
            f" {-distance.min():.3f} mm; expected a diameter below the pitch"
        )
    beyond = [
        float((np.abs(at) + holes.diameter / 2).max()) - side / 2
        for at, side in zip((holes.x, holes.y), outline, strict=True)
    ]
    if max(beyond) > 0:
        raise InputError(f"{where}: a hole would leave the plate by {max(beyond):.3f} mm")
