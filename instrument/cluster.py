"""The same function for many items: in this process, in several, or on a Dask cluster that somebody else runs.

Nothing of a cluster is needed, or imported, unless its address is named.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from threading import Thread
from typing import Any, TypeVar

from instrument.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")
#: How long a scheduler has to answer, seconds.
_CONNECT_S = 15.0


def spread(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    address: str | None = None,
    workers: int | None = None,
    done: Callable[[int], None] | None = None,
    prepare: Callable[[int], None] | None = None,
) -> list[Result]:
    """Call a function for every item.

    Parameters
    ----------
    function
        Must survive pickling if work leaves this process: a function of a module, or a ``functools.partial`` of one.
        It is sent once to every worker, the items one by one.
    items
        Independent of each other.
    address
        Of a Dask scheduler, such as ``tcp://host:8786``; its workers need this program installed.
    workers
        Processes on this machine when no address is given; None or 1: in this process.
    done
        Told after each item how many are finished.
    prepare
        Called first in every process on this machine, with their number; a function of a module.

    Returns
    -------
    list
        Results in the order of the items, wherever they were computed.

    Raises
    ------
    InputError
        If Dask is not installed or no scheduler answers at the address.

    Examples
    --------
    >>> spread(abs, [-1, 2, -3])
    [1, 2, 3]
    """
    items = list(items)
    if address is not None:
        return _on_dask(function, items, address, done)
    if workers is not None and workers > 1 and len(items) > 1:
        return _in_processes(function, items, min(workers, len(items)), done, prepare)
    results = []
    for item in items:
        results.append(function(item))
        if done is not None:
            done(len(results))
    return results


def _in_processes(
    function: Callable[[Item], Result],
    items: list[Item],
    workers: int,
    done: Callable[[int], None] | None,
    prepare: Callable[[int], None] | None,
) -> list[Result]:
    # Fresh processes: a fork would copy the ray tracer's threads in the middle of their work.
    context = multiprocessing.get_context("spawn")
    start = (function, workers, prepare)
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=start) as pool:
        futures = {pool.submit(_call, item): number for number, item in enumerate(items)}
        try:
            return _gather(futures, as_completed(futures), done)
        except BrokenProcessPool:
            raise RuntimeError("a worker process ended before its work was done (out of memory?)") from None
        finally:
            for future in futures:
                future.cancel()


#: The function that this worker process calls.
_function: list[Callable[[Any], Any]] = []


def _begin(function: Callable[[Any], Any], workers: int, prepare: Callable[[int], None] | None) -> None:
    Thread(target=_end_with_parent, daemon=True).start()
    _function[:] = [function]
    if prepare is not None:
        prepare(workers)


def _end_with_parent() -> None:
    """End this worker when the process that feeds it is gone, killed perhaps: nobody waits for its work."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _call(item: Any) -> Any:
    return _function[0](item)


def _on_dask(
    function: Callable[[Item], Result], items: list[Item], address: str, done: Callable[[int], None] | None
) -> list[Result]:
    with connected(address) as client:
        from distributed import as_completed as finished

        sent = client.scatter(function, broadcast=True)
        futures = {client.submit(_apply, sent, item, pure=False): number for number, item in enumerate(items)}
        try:
            return _gather(futures, finished(futures, loop=client.loop), done)
        finally:
            client.cancel(list(futures))


def _apply(function: Callable[[Any], Any], item: Any) -> Any:
    return function(item)


def _gather(futures: dict[Any, int], finished: Any, done: Callable[[int], None] | None) -> list[Any]:
    """Results in the order of the items; the first error of any ends the wait."""
    results: list[Any] = [None] * len(futures)
    for count, future in enumerate(finished, 1):
        results[futures[future]] = future.result()
        if done is not None:
            done(count)
    return results


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """A client of the Dask scheduler at an address.

    Raises
    ------
    InputError
        If Dask is not installed, the address is none, or no scheduler with workers answers there.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            f"Dask cluster {address}: the package distributed is not installed here; expected"
            " pip install 'goniotwin[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise InputError(
            f"Dask cluster {address}: no scheduler answers ({reason}); expected an address such as tcp://host:8786"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError(f"Dask cluster {address}: found no workers; expected at least one")
        yield client
