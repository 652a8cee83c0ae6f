"""The table of holes of the example artifact, drawn with the scatter of the paper's Table I."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from instrument.artifact import HOLE_COLUMNS

_SIDE = 12
_PITCH, _SPACING_SCATTER = 3.6, 0.012  # mm; the scatter is that of the distance between neighbours
_DIAMETER, _DIAMETER_SCATTER = 2.55, 0.02
_UNCERTAINTIES = ("0.005", "0.005", "0.006")  # the paper: below 7 micrometres


def write_holes(path: Path, seed: int = 20250101) -> None:
    """Write ``artifact_holes.csv``: 12 x 12 holes about the origin."""
    generator = np.random.default_rng(seed)
    nominal = (np.arange(_SIDE) - (_SIDE - 1) / 2) * _PITCH
    x, y = (axis.ravel() for axis in np.meshgrid(nominal, nominal, indexing="ij"))
    x, y = (axis + _SPACING_SCATTER / np.sqrt(2) * generator.standard_normal(axis.size) for axis in (x, y))
    diameter = _DIAMETER + _DIAMETER_SCATTER * generator.standard_normal(x.size)
    with path.open("w", encoding="utf-8", newline="") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(HOLE_COLUMNS)
        for hole, values in enumerate(zip(x, y, diameter, strict=True)):
            writer.writerow([hole, *(f"{value:.4f}" for value in values), *_UNCERTAINTIES])
