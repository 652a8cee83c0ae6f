"""Spreading work over processes and over a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from instrument.errors import InputError
from instrument.exchange.many import verify_all
from twin.cluster import spread
from twin.run_pairs import compare_all


def scaled(factor: int, item: int) -> tuple[int, int]:
    if item < 0:
        raise ValueError(f"found {item}; expected at least 0")
    return factor * item, os.getpid()


def test_results_come_in_the_order_of_the_items() -> None:
    seen: list[int] = []
    assert spread(partial(scaled, 3), range(4), done=seen.append) == [(3 * n, os.getpid()) for n in range(4)]
    assert seen == [1, 2, 3, 4]


@pytest.mark.slow
def test_other_processes_do_the_work_and_keep_the_order() -> None:
    found = spread(partial(scaled, 3), range(6), workers=2)
    assert [value for value, _ in found] == [0, 3, 6, 9, 12, 15]
    assert os.getpid() not in {process for _, process in found}
    with pytest.raises(ValueError, match="expected at least 0"):
        spread(partial(scaled, 3), [1, -1], workers=2)


def wait_long(folder: str, item: int) -> None:
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(600)


def spread_over_two(folder: str) -> None:
    spread(partial(wait_long, folder), range(4), workers=2)


def eventually(true: Callable[[], bool], seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.05)
    return true()


@pytest.mark.slow
def test_workers_end_when_the_process_that_feeds_them_is_killed(tmp_path: Path) -> None:
    feeding = multiprocessing.get_context("spawn").Process(target=spread_over_two, args=(str(tmp_path),))
    feeding.start()
    assert eventually(lambda: len(list(tmp_path.iterdir())) == 2)
    feeding.kill()
    feeding.join()
    workers = [int(file.name) for file in tmp_path.iterdir()]
    assert eventually(lambda: not any(is_running(worker) for worker in workers))


def is_running(process: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{process}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False


def test_without_dask_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"tcp://a:1: the package distributed .* 'goniotwin\[cluster\]'"):
        spread(abs, [1], address="tcp://a:1")


class FakeClient:
    """What is used of a Dask client, with futures that finish in the opposite order."""

    made: list[FakeClient]
    workers: dict[str, Any]

    def __init__(self, address: str, **_: Any) -> None:
        if address == "tcp://nowhere:1":
            raise OSError("Timed out trying to connect")
        self.address, self.loop = address, object()
        self.sent, self.cancelled, self.closed = 0, 0, False
        self.made.append(self)

    def __enter__(self) -> FakeClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.closed = True

    def scheduler_info(self) -> dict[str, Any]:
        return {"workers": self.workers}

    def scatter(self, thing: Any, broadcast: bool) -> Any:
        assert broadcast
        self.sent += 1
        return SimpleNamespace(thing=thing)

    def submit(self, function: Any, sent: Any, item: Any, pure: bool) -> Any:
        assert not pure
        return FakeFuture(partial(function, sent.thing, item))

    def cancel(self, futures: list[Any]) -> None:
        self.cancelled += len(futures)


class FakeFuture:
    def __init__(self, call: Any) -> None:
        self.result = call


@pytest.fixture
def fake_dask(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[FakeClient]]:
    module = ModuleType("distributed")

    class Client(FakeClient):
        made: list[FakeClient] = []  # noqa: RUF012 - fresh for every test
        workers = {"tcp://w:1": {}}  # noqa: RUF012

    module.Client = Client  # type: ignore[attr-defined]
    module.as_completed = lambda futures, loop: reversed(list(futures))  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "distributed", module)
    return Client


def test_a_cluster_gets_the_function_once_and_every_item(fake_dask: type[FakeClient]) -> None:
    seen: list[int] = []
    found = spread(partial(scaled, 2), [5, 6, 7], address="tcp://host:8786", done=seen.append)
    assert [value for value, _ in found] == [10, 12, 14]
    assert seen == [1, 2, 3]
    (client,) = fake_dask.made
    assert (client.address, client.sent, client.cancelled, client.closed) == ("tcp://host:8786", 1, 3, True)


def test_an_error_on_the_cluster_is_raised_here_and_the_rest_is_cancelled(fake_dask: type[FakeClient]) -> None:
    with pytest.raises(ValueError, match="expected at least 0"):
        spread(partial(scaled, 2), [5, -6], address="tcp://host:8786")
    assert fake_dask.made[0].cancelled == 2
    assert fake_dask.made[0].closed


def test_a_scheduler_that_does_not_answer_or_has_no_workers_is_named(fake_dask: type[FakeClient]) -> None:
    with pytest.raises(InputError, match="tcp://nowhere:1: no scheduler answers"):
        spread(abs, [1], address="tcp://nowhere:1")
    fake_dask.workers = {}
    with pytest.raises(InputError, match="found no workers"):
        spread(abs, [1], address="tcp://host:8786")


def test_many_runs_are_read_on_the_cluster(fake_dask: type[FakeClient], tmp_path: Path) -> None:
    names = [str(tmp_path / name) for name in ("a.nc", "b.nc")]
    verified = verify_all(names, address="tcp://host:8786")
    compared = compare_all("first.nc", names, address="tcp://host:8786")
    assert [result.folder for result in verified] == [one.run for one in compared] == names
    assert not any(result.passed for result in verified)
    assert all("first.nc: no such file" in one.problem for one in compared)
    assert [client.cancelled for client in fake_dask.made] == [2, 2]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_real_cluster_gives_the_same() -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra: pip install 'goniotwin[cluster]'")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        found = spread(partial(scaled, 2), [5, 6, 7], address=cluster.scheduler_address)
    assert [value for value, _ in found] == [10, 12, 14]
