"""Example inputs of the simulated laboratory: facility, artifact, plans, and a run over the witness coupon."""

from __future__ import annotations

import shutil
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from instrument.facility import Facility, read_facility

if TYPE_CHECKING:
    import xarray as xr

#: Where the committed files lie, and the seed of the committed ``material.nc``.
HOME = Path(__file__).parent
COMMITTED_SEED = 1

_FACILITY, _ARTIFACT, _HOLES, _MATERIAL = "facility.toml", "artifact.toml", "artifact_holes.csv", "material.nc"
_COUPON_PLAN, _ARTIFACT_PLAN = "table_iii.toml", "table_iv.toml"


@dataclass(frozen=True)
class ExampleFiles:
    """Paths of the written files; ``plan`` is the artifact's (Table IV), ``coupon_plan`` the coupon's (Table III)."""

    facility: Path
    artifact: Path
    material: Path
    plan: Path
    coupon_plan: Path


def example_files(folder: Path = HOME) -> ExampleFiles:
    """The paths of the example files in a folder; the committed ones where none is given."""
    return ExampleFiles(*(folder / name for name in (_FACILITY, _ARTIFACT, _MATERIAL, _ARTIFACT_PLAN, _COUPON_PLAN)))


def write_examples(folder: Path, seed: int = COMMITTED_SEED, facility: Path | None = None) -> ExampleFiles:
    """Write the example files of a laboratory.

    Parameters
    ----------
    folder
        Exists; files of the same names are replaced.
    seed
        Of the instrument that measured the coupon; another one than the committed costs a few seconds.
    facility
        In place of the example one: the coupon is then measured with that instrument.

    Raises
    ------
    instrument.errors.InputError
        If ``facility`` is wrong.
    """
    for name in (_ARTIFACT, _HOLES, _COUPON_PLAN, _ARTIFACT_PLAN):
        shutil.copyfile(HOME / name, folder / name)
    files = example_files(folder)
    shutil.copyfile(facility or HOME / _FACILITY, files.facility)
    if seed == COMMITTED_SEED and read_facility(files.facility) == read_facility(HOME / _FACILITY):
        shutil.copyfile(HOME / _MATERIAL, files.material)
    else:
        write_material(files, seed)
    return files


def write_material(files: ExampleFiles, seed: int) -> None:
    """Measure the coupon by simulation and write ``material.nc``."""
    from instrument.plan import read_plan
    from sim_fixtures.examples.coupon import coupon_run

    instrument: Facility = read_facility(files.facility)
    data = coupon_run(instrument, read_plan(files.coupon_plan, instrument), seed)
    write_packed(data, files.material)


def write_packed(data: xr.Dataset, path: Path) -> None:
    """Write a run small: times in ms, components of the uncertainty in single precision, readings deflated."""
    times = {"units": "milliseconds since 2026-03-02 08:00:00", "dtype": "int64"}
    packed: dict[Hashable, dict[str, object]] = {"time": {**times}, "reference_time": {**times}}
    packed["signal"] = {"zlib": True, "complevel": 9, "shuffle": True, "chunksizes": data["signal"].shape}
    packed |= {name: {"dtype": "float32"} for name in data.variables if str(name).startswith("u_brf_")}
    data.to_netcdf(path, engine="h5netcdf", encoding=packed)
