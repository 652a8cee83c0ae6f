"""Laboratories that can be started by name: entry-point group ``goniotwin.laboratories``.

``--simulate`` starts the one called ``simulated``, which the room ``sim_fixtures`` provides as a separate
process; nothing here knows how.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol, cast

from instrument.errors import InputError
from instrument.operators import Operator


@dataclass(frozen=True)
class Inputs:
    """Files that belong to a laboratory: what a scan uses where the user names no others."""

    devices: Path
    facility: Path
    artifact: Path
    material: Path
    plan: Path


class StartedLaboratory(Protocol):
    """A running laboratory; a context manager that ends it."""

    inputs: Inputs
    operator: Operator

    def __enter__(self) -> StartedLaboratory: ...

    def __exit__(self, *_: object) -> None: ...


class LaboratoryFactory(Protocol):
    """What an entry point of the group names."""

    def __call__(
        self,
        folder: Path,
        *,
        speed: float = 1.0,
        seed: int = 1,
        artifact: Path | None = None,
        facility: Path | None = None,
    ) -> StartedLaboratory:
        """Start the laboratory's process, wait until its devices answer, write its files into ``folder``.

        Parameters
        ----------
        folder
            Exists; receives ``devices.toml`` and the files of :class:`Inputs` that are not given.
        speed
            Laboratory seconds a wall-clock second.
        seed
            Of every random draw: a laboratory started twice with one seed reads the same.
        artifact, facility
            What lies on the stage, and the instrument, where not the laboratory's own example.
        """
        ...


def laboratory_factory(name: str = "simulated") -> LaboratoryFactory:
    """The factory registered under a name.

    Raises
    ------
    InputError
        If no installed package provides it; names those that are there.
    """
    found = {point.name: point for point in entry_points(group="goniotwin.laboratories")}
    if name not in found:
        raise InputError(f"laboratory {name!r} is not installed; found: {', '.join(sorted(found)) or 'none'}")
    return cast(LaboratoryFactory, found[name].load())
