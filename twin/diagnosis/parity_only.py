"""The diagnosis of a run without a twin: its symmetries alone, on any table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from instrument.errors import InputError
from twin.diagnosis.observation import Observation, observe, read_observation
from twin.diagnosis.parity import Parity, Symmetry, parities

SYMMETRIES = ("isotropic", "fourfold", "twofold", "mirror")


def read_table(path: Path, columns: Path | None) -> Observation:
    """A run, or a table of another laboratory whose columns a mapping names."""
    if columns is None:
        return read_observation(path)
    from instrument.column_mapping import read_mapped

    return observe(read_mapped(path, columns), str(path), foreign=True)


def symmetries_of(run: Observation, symmetry: str, wavelength: float | None) -> tuple[Parity, ...]:
    """The parity test at each wavelength, or at one.

    Raises
    ------
    InputError
        For a symmetry that does not exist, or a wavelength that was not measured.
    """
    if symmetry not in SYMMETRIES:
        raise InputError(f"--symmetry: found {symmetry!r}; expected one of {', '.join(SYMMETRIES)}")
    if wavelength is not None:
        measured = np.unique(run.columns["wavelength"])
        rows = np.flatnonzero(np.abs(run.columns["wavelength"] - wavelength) < 0.5)
        if not len(rows):
            found = ", ".join(f"{w:g}" for w in measured)
            raise InputError(f"--wavelength: found {wavelength:g}; {run.name} was measured at {found} nm")
        run = run.take(rows)
    chosen: Symmetry = symmetry  # type: ignore[assignment]
    return parities(run, symmetry=chosen)


def in_words(found: tuple[Parity, ...]) -> list[str]:
    """All that one wavelength says; of several, the first sentence of each and the clearest one in full."""
    if len(found) == 1:
        return found[0].in_words()
    clearest = min(found, key=lambda one: (one.least_p, one.wavelength))
    lines = [one.in_words()[0] for one in found]
    if not clearest.broken:
        return lines
    return [*lines, f"In full at {clearest.wavelength:g} nm (any other with --wavelength):", *clearest.in_words()[1:]]


def to_dict(found: tuple[Parity, ...]) -> list[dict[str, Any]]:
    """As JSON, one entry a wavelength."""
    return [one.to_dict() for one in found]
