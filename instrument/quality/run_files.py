"""Runs by what a person names: a run folder or a run file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from instrument.errors import InputError
from instrument.run_folder import RUN_NAME
from instrument.run_read import read_run


def run_of(path: Path) -> xr.Dataset:
    """The run of a folder or a file.

    Raises
    ------
    InputError
        If there is none.
    """
    if not path.is_dir():
        return read_run(path)
    if not (path / RUN_NAME).exists():
        raise InputError(f"{path}: holds no {RUN_NAME}; expected a run folder with a measured point, or a run file")
    return read_run(path / RUN_NAME)


def named_runs(paths: Sequence[Path]) -> dict[str, xr.Dataset]:
    """Runs by name, as :func:`run_of`.

    Raises
    ------
    InputError
        If one is named twice, or two hold the same measurement.
    """
    runs: dict[str, xr.Dataset] = {}
    seen: dict[str, str] = {}
    resolved: dict[Path, Path] = {}
    for path in paths:
        file = (path / RUN_NAME if path.is_dir() else path).resolve()
        if file in resolved:
            raise InputError(f"{path}: is the same run as {resolved[file]}; expected different ones")
        resolved[file] = path
        run = run_of(path)
        digest = str(run.attrs.get("journal_digest", ""))
        if digest and digest in seen:
            raise InputError(f"{path}: holds the same measurement as {seen[digest]}; expected different ones")
        seen[digest] = str(path)
        runs[str(path)] = run
    return runs
