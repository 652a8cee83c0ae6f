"""Reflection models behind one interface: each makes a table (:class:`~twin.material.Material`) of its settings.

A model is a function of the entry-point group ``goniotwin.reflection_models``; an outside package adds one by naming
its own there. ``material.toml`` chooses models by these names (:mod:`twin.reflection_models.assignment`); files of a
known form need no such choice (:func:`read_file`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from instrument.errors import InputError
from instrument.files import beside
from twin.material import Material, open_netcdf

GROUP = "goniotwin.reflection_models"
_TENSOR_MAGIC, _HDF_MAGIC = b"tensor_file\0", b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Origin:
    """Where a model's settings stand.

    Attributes
    ----------
    folder
        File names in the settings are relative to it.
    where
        Names file and table in errors.
    """

    folder: Path
    where: str

    def file(self, name: str) -> Path:
        """A file that the settings name."""
        path = beside(self.folder / "material.toml", name, "file")
        if not path.is_file():
            raise InputError(f"{self.where}: file: found {name!r}; expected a file, there is no {path}")
        return path


class ReflectionModel(Protocol):
    """What an entry point of the group names."""

    def __call__(self, settings: Mapping[str, Any], origin: Origin) -> Material:
        """Make the table of a model.

        Parameters
        ----------
        settings
            The keys of the model's table in ``material.toml``, apart from ``model`` and ``scale``.
        origin
            Where they stand.

        Raises
        ------
        InputError
            For a wrong key or file, naming ``origin.where``.
        """
        ...


def model_names() -> list[str]:
    """Names of the models that are installed."""
    return sorted({point.name for point in entry_points(group=GROUP)})


def find_model(name: str, where: str) -> ReflectionModel:
    """The model of a name.

    Raises
    ------
    InputError
        If none of that name is installed.
    """
    points = [point for point in entry_points(group=GROUP) if point.name == name]
    if not points:
        raise InputError(f"{where}: model: found {name!r}; expected one of {', '.join(model_names())}")
    model: ReflectionModel = points[0].load()
    return model


def read_file(path: Path) -> Material:
    """Read a coupon run, a ready table, a measured material or a ``material.toml``, whichever the file holds.

    Raises
    ------
    InputError
        Naming file and variable of whatever is wrong.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file (the material: a coupon run, a BRDF table or a material.toml)")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected a coupon run, a BRDF table or a material.toml")
    kind = file_kind(path)
    if kind == "assignment":
        from twin.reflection_models.assignment import read_assignment

        return read_assignment(path)
    if kind == "measured":
        from twin.reflection_models.measured import read_measured

        return read_measured(path)
    if kind == "netcdf":
        dataset = open_netcdf(path)
        if "brdf" in dataset:
            from twin.reflection_models.table import from_table

            return from_table(dataset, str(path))
        if "brf" not in dataset:
            raise InputError(
                f"{path}: found the variables {', '.join(map(str, dataset.data_vars)) or '(none)'}; expected 'brf'"
                " (a run of the witness coupon) or 'brdf' (a table)"
            )
    from instrument.dataset import read_run
    from twin.coupon import from_coupon

    return from_coupon(read_run(path), str(path))


def file_kind(path: Path) -> str:
    """What a material file is: ``csv``, ``measured``, ``assignment`` or ``netcdf`` (by default)."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return "csv"
    with path.open("rb") as file:
        head = file.read(len(_TENSOR_MAGIC))
    if head == _TENSOR_MAGIC or suffix == ".bsdf":
        return "measured"
    return "assignment" if suffix == ".toml" else "netcdf"
