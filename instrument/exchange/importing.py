"""Reads a measurement in whichever form it comes."""

from __future__ import annotations

from pathlib import Path

from instrument.column_mapping import read_mapped
from instrument.errors import InputError
from instrument.exchange.bird_read import Imported, read_bird
from instrument.run_read import read_run

#: How files of the universal BRDF data format are called.
BIRD_SUFFIXES = (".json", ".brdf")


def import_any(
    path: Path, columns: Path | None = None, *, wavelength: float | None = None, u_relative: float | None = None
) -> Imported:
    """A run of a file: by a mapping of its columns where one is named, otherwise by its suffix.

    Raises
    ------
    InputError
        As the reader of the form; for an option that has no meaning there.
    """
    is_bird = path.suffix.lower() in BIRD_SUFFIXES
    if is_bird and columns is not None:
        raise InputError(f"{path}: the universal BRDF format names its own columns; expected no --columns")
    if is_bird:
        return read_bird(path, wavelength=wavelength, u_relative=u_relative)
    if wavelength is not None or u_relative is not None:
        raise InputError(
            "--wavelength, --u-relative: for the universal BRDF format; a mapping states them as constants"
        )
    return Imported(read_run(path) if columns is None else read_mapped(path, columns))
