"""Many runs at once, here, in several processes or on a Dask cluster: each is read where the work is done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from instrument.catalogue.store import journals
from instrument.cluster import spread
from instrument.errors import InputError
from instrument.exchange.stores import brought, is_url, runs_of
from instrument.journal import JOURNAL_NAME
from instrument.run_archive import Check, Verification, verify


def run_folders(named: Sequence[str]) -> list[str]:
    """Run folders by what a person names: a run folder is itself, another folder stands for those in it.

    Raises
    ------
    InputError
        If one is named twice, or a store has no such thing.
    """
    found = [run for name in named for run in _runs_in(name)]
    doubled = sorted({run for run in found if found.count(run) > 1})
    if doubled:
        raise InputError(f"{doubled[0]}: named twice; expected different runs")
    return found


def _runs_in(name: str) -> list[str]:
    if is_url(name):
        return runs_of(name)
    folder = Path(name)
    runs = [] if (folder / JOURNAL_NAME).exists() else [str(path.parent) for path in journals(folder)]
    # What holds no run at all is named by whoever reads it.
    return runs or [name]


def verify_all(runs: Sequence[str], *, workers: int = 1, address: str | None = None) -> list[Verification]:
    """Check run folders, or what URLs name, against their journals; one that is none fails, the others are checked.

    Parameters
    ----------
    runs
        On a cluster, names that its workers can read: of a folder that all machines share, or of a store.
    workers, address
        As of :func:`instrument.cluster.spread`.

    Raises
    ------
    InputError
        If the only one named is no run folder, or the cluster does not answer.
    """
    if len(runs) == 1 and address is None:
        return [_verified(runs[0])]
    return spread(verify_named, runs, workers=workers, address=address)


def verify_named(run: str) -> Verification:
    """Check a run folder or what a URL names; one that cannot be read has failed."""
    try:
        return _verified(run)
    except InputError as error:
        return Verification(run, (Check("journal", False, str(error)),))


def _verified(run: str) -> Verification:
    return replace(verify(brought(run)), folder=run)
