"""Work of the ray tracer for many items, here, in processes or on a Dask cluster (:mod:`instrument.cluster`)."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

from instrument import cluster

Item = TypeVar("Item")
Result = TypeVar("Result")


def spread(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    address: str | None = None,
    workers: int | None = None,
    done: Callable[[int], None] | None = None,
) -> list[Result]:
    """As :func:`instrument.cluster.spread`; the ray tracer's threads share this machine with the other processes."""
    return cluster.spread(function, items, address=address, workers=workers, done=done, prepare=_share_the_machine)


def _share_the_machine(workers: int) -> None:
    from twin.llvm import import_mitsuba

    import_mitsuba()
    import drjit

    drjit.set_thread_count(max(1, (os.cpu_count() or 1) // workers))
