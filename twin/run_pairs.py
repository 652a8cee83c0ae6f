"""Many runs against one, here, in several processes or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from instrument.cluster import spread
from instrument.errors import InputError
from instrument.exchange.stores import brought
from instrument.quality.run_files import named_runs
from twin.run_pair import PairComparison, compare_runs


@dataclass(frozen=True)
class AgainstFirst:
    """A run beside the first one; ``problem`` says why there is no comparison."""

    run: str
    found: PairComparison | None
    problem: str = ""

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"run": self.run} | ({"problem": self.problem} if self.found is None else self.found.as_dict())


def compare_named(first: str, other: str, *, shared: Sequence[str], independent: Sequence[str]) -> PairComparison:
    """Two runs by folder, file or URL; errors as :func:`twin.run_pair.compare_runs`."""
    a, b = named_runs([brought(first), brought(other)]).values()
    return compare_runs(a, b, shared=shared, independent=independent)


def compare_all(
    first: str,
    others: Sequence[str],
    *,
    shared: Sequence[str] = (),
    independent: Sequence[str] = (),
    workers: int = 1,
    address: str | None = None,
) -> list[AgainstFirst]:
    """Compare every run with the first; one that cannot be compared says why, the others are compared.

    Parameters
    ----------
    first, others
        On a cluster, names that its workers can read: of a folder that all machines share, or of a store.
    shared, independent
        As of :func:`twin.run_pair.compare_runs`.
    workers, address
        As of :func:`instrument.cluster.spread`.

    Raises
    ------
    InputError
        If the cluster does not answer.
    """
    work = partial(_against, first, shared=tuple(shared), independent=tuple(independent))
    return spread(work, others, workers=workers, address=address)


def _against(first: str, other: str, shared: Sequence[str], independent: Sequence[str]) -> AgainstFirst:
    try:
        return AgainstFirst(other, compare_named(first, other, shared=shared, independent=independent))
    except InputError as error:
        return AgainstFirst(other, None, str(error))
