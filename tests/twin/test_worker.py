"""The prediction process: answers, crashes, hangs, restarts, and its end with its parent."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest
from fake_twin import expected_brf

from instrument.errors import InputError
from instrument.events import Geometry
from sim_fixtures.examples import example_files
from twin.prediction import Twin
from twin.worker import (
    PredictionWorker,
    RestartLimit,
    Timeouts,
    TwinUnusable,
    WorkerCrashed,
    WorkerError,
    WorkerUnavailable,
)

FACTORY = "fake_twin:FakeTwin.from_files"
PATIENCE = 60.0


def geometry(zenith: float, azimuth: float = 0.0) -> Geometry:
    return Geometry(wavelength=500.0, illumination_zenith=0.0, sensor_zenith=zenith, sensor_azimuth=azimuth)


@pytest.fixture
def worker_of(fake_files):
    """Makes workers for the fake twin and closes them."""
    made = []

    def make(**options) -> PredictionWorker:
        paths = (fake_files.facility, fake_files.artifact, fake_files.material)
        made.append(PredictionWorker(*paths, factory=FACTORY, **options))
        return made[-1]

    yield make
    for worker in made:
        worker.close()


def gone(pid: int, within_s: float = 10.0) -> bool:
    """Whether a process ends (or is a zombie that only its parent has to collect) in time."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        try:
            with open(f"/proc/{pid}/stat") as stat:
                if stat.read().rsplit(")", 1)[1].split()[0] == "Z":
                    return True
        except FileNotFoundError:
            return True
        time.sleep(0.02)
    return False


def test_predictions_come_back_in_the_order_of_the_request(worker_of):
    worker = worker_of()
    points = [geometry(40.0), geometry(-20.0, 45.0), geometry(0.1 + 0.2)]
    prediction = worker.predict([7, 3, 11], points, 0.002).result(PATIENCE)
    assert prediction.indices == (7, 3, 11)
    assert prediction.brf == tuple(expected_brf(point) for point in points)  # to the last bit, through the pipe
    assert prediction.u_brf_monte_carlo == tuple(0.002 * value for value in prediction.brf)


def test_nothing_is_started_before_the_first_request(worker_of):
    worker = worker_of()
    time.sleep(0.2)
    assert worker.pid is None
    worker.predict([0], [geometry(1.0)], 0.01).result(PATIENCE)
    assert worker.pid is not None


def test_the_process_gives_way_to_the_scan(worker_of):
    attributes = worker_of(niceness=7).predict([0], [geometry(1.0)], 0.01).result(PATIENCE).attributes
    assert attributes["nice"] == os.nice(0) + 7


def test_output_of_libraries_does_not_disturb_the_replies(worker_of, fake_files):
    fake_files.order(print=True)
    worker = worker_of()
    for index in range(3):
        assert worker.predict([index], [geometry(float(index))], 0.01).result(PATIENCE).indices == (index,)


def test_every_request_carries_the_seed_that_was_asked_for(worker_of, fake_files):
    worker = worker_of(seed=5)
    for index in range(2):
        worker.predict([index], [geometry(float(index))], 0.01).result(PATIENCE)
    assert [request["seed"] for request in fake_files.requests] == [5, 5]


def test_a_request_names_its_sight_lines_or_its_error(worker_of, fake_files):
    worker = worker_of()
    for sight_lines in (64, None):
        worker.predict([0], [geometry(0.0)], 0.01, sight_lines).result(PATIENCE)
    assert [request["samples"] for request in fake_files.requests] == [64, None]
    assert [request["standard_error"] for request in fake_files.requests] == [0.01, 0.01]


def test_a_crash_fails_its_request_and_the_next_one_succeeds(worker_of, fake_files):
    fake_files.order(die_at=13.0)
    worker = worker_of()
    doomed = worker.predict([0], [geometry(13.0)], 0.01)
    fine = worker.predict([1], [geometry(14.0)], 0.01)
    with pytest.raises(WorkerCrashed, match=r"ended by signal 6: LLVM ERROR: out of luck"):
        doomed.result(PATIENCE)
    assert fine.result(PATIENCE).indices == (1,)


def test_a_killed_process_is_replaced(worker_of):
    worker = worker_of()
    worker.predict([0], [geometry(1.0)], 0.01).result(PATIENCE)
    first = worker.pid
    os.kill(first, signal.SIGKILL)
    while worker.pid is not None:
        time.sleep(0.01)
    assert worker.predict([1], [geometry(2.0)], 0.01).result(PATIENCE).indices == (1,)
    assert worker.pid != first


def test_killed_while_it_computes(worker_of, fake_files):
    fake_files.order(hang_at=50.0)
    worker = worker_of()
    worker.predict([0], [geometry(1.0)], 0.01).result(PATIENCE)
    future = worker.predict([1], [geometry(50.0)], 0.01)
    while len(fake_files.requests) < 2:
        time.sleep(0.01)
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(WorkerCrashed, match="signal 9"):
        future.result(PATIENCE)


def test_restarts_are_bounded(worker_of, fake_files):
    fake_files.order(die_at=13.0)
    worker = worker_of(restarts=RestartLimit(starts=2, window_s=500.0))
    for _ in range(2):
        with pytest.raises(WorkerCrashed):
            worker.predict([0], [geometry(13.0)], 0.01).result(PATIENCE)
    with pytest.raises(WorkerUnavailable, match=r"started 2 times in 500 s") as error:
        worker.predict([1], [geometry(1.0)], 0.01).result(PATIENCE)
    assert 400 < error.value.retry_after_s <= 500


def test_restarts_are_allowed_again_later(worker_of, fake_files):
    fake_files.order(die_at=13.0)
    worker = worker_of(restarts=RestartLimit(starts=1, window_s=0.3))
    with pytest.raises(WorkerCrashed):
        worker.predict([0], [geometry(13.0)], 0.01).result(PATIENCE)
    time.sleep(0.35)
    assert worker.predict([1], [geometry(1.0)], 0.01).result(PATIENCE).indices == (1,)


def test_a_process_that_does_not_answer_is_ended(worker_of, fake_files):
    fake_files.order(hang_at=50.0)
    worker = worker_of(timeouts=Timeouts(request_s=2.0))
    with pytest.raises(WorkerCrashed, match=r"did not answer within 2 s"):
        worker.predict([0], [geometry(50.0)], 0.01).result(PATIENCE)
    assert worker.predict([1], [geometry(1.0)], 0.01).result(PATIENCE).indices == (1,)


def test_a_process_that_does_not_start_is_ended(worker_of, fake_files):
    fake_files.order(slow_start_s=30.0)
    with pytest.raises(WorkerCrashed, match=r"did not answer within 2 s"):
        worker_of(timeouts=Timeouts(start_s=2.0)).predict([0], [geometry(1.0)], 0.01).result(PATIENCE)


def test_a_process_that_cannot_be_started_fails_its_request_and_no_more(worker_of, monkeypatch):
    def exhausted(*_, **__):
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    worker = worker_of()
    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "Popen", exhausted)
        with pytest.raises(WorkerCrashed, match="cannot be started: Resource temporarily unavailable"):
            worker.predict([0], [geometry(1.0)], 0.01).result(PATIENCE)
    assert worker.predict([1], [geometry(1.0)], 0.01).result(PATIENCE).indices == (1,)


def test_wrong_files_are_an_input_error(worker_of, fake_files):
    fake_files.order(broken="material.nc: variable brf missing")
    with pytest.raises(InputError, match=r"material.nc: variable brf missing"):
        worker_of().predict([0], [geometry(1.0)], 0.01).result(PATIENCE)


def test_a_twin_that_cannot_be_built_is_told_apart_from_a_crash(fake_files):
    paths = (fake_files.facility, fake_files.artifact, fake_files.material)
    with PredictionWorker(*paths, factory="fake_twin:Missing") as worker, pytest.raises(TwinUnusable, match="Missing"):
        worker.predict([0], [geometry(1.0)], 0.01).result(PATIENCE)


def test_an_exception_in_the_twin_keeps_the_process(worker_of, fake_files):
    fake_files.order(raise_at=13.0)
    worker = worker_of()
    with pytest.raises(WorkerError, match="ZeroDivisionError: no samples"):
        worker.predict([0], [geometry(13.0)], 0.01).result(PATIENCE)
    pid = worker.pid
    worker.predict([1], [geometry(1.0)], 0.01).result(PATIENCE)
    assert worker.pid == pid


def test_closing_ends_the_process_at_once_and_fails_what_is_waiting(worker_of, fake_files):
    fake_files.order(hang_at=50.0)
    worker = worker_of()
    worker.predict([0], [geometry(1.0)], 0.01).result(PATIENCE)
    pid = worker.pid
    under_way, waiting = (worker.predict([i], [geometry(50.0)], 0.01) for i in (1, 2))
    worker.close()
    assert gone(pid)
    for future in (under_way, waiting):
        with pytest.raises(WorkerError):
            future.result(PATIENCE)
    with pytest.raises(WorkerError, match="closed"):
        worker.predict([3], [geometry(1.0)], 0.01)


@pytest.mark.slow
def test_the_real_twin_gives_the_same_values_in_the_worker_as_here(tmp_path):
    material = tmp_path / "material.toml"
    material.write_text('[default]\nmodel = "lambertian"\nreflectance = 0.6\n')
    files = (example_files().facility, example_files().artifact, material)
    points = [geometry(zenith, azimuth) for zenith in (-60.0, 20.0) for azimuth in (0.0, 90.0)]
    with PredictionWorker(*files, seed=3) as worker:
        remote = worker.predict(range(4), points, 0.01).result(120)
        os.kill(worker.pid, signal.SIGKILL)
        while worker.pid is not None:
            time.sleep(0.01)
        again = worker.predict(range(4), points, 0.01).result(120)
    local = Twin.from_files(*files, seed=3).predict(points, standard_error=0.01)
    assert again == remote
    assert remote.brf == pytest.approx(local["brf"].values, rel=1e-6)
    assert remote.u_brf_monte_carlo == pytest.approx(local["u_brf_monte_carlo"].values, rel=1e-3)
    assert max(np.divide(remote.u_brf_monte_carlo, remote.brf)) <= 0.01


def test_indices_and_geometries_must_be_as_many(worker_of):
    with pytest.raises(ValueError, match="2 indices and 1 geometries"):
        worker_of().predict([0, 1], [geometry(1.0)], 0.01)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks processes up in /proc")
def test_the_process_ends_when_its_parent_is_killed_in_the_middle_of_a_computation(fake_files):
    fake_files.order(hang_at=50.0)
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            textwrap.dedent(
                f"""
                import sys, time
                from pathlib import Path
                from instrument.events import Geometry
                from twin.worker import PredictionWorker
                worker = PredictionWorker(*map(Path, sys.argv[1:]), factory={FACTORY!r})
                angles = dict(illumination_zenith=0, sensor_azimuth=0)
                near, far = (Geometry(wavelength=500, sensor_zenith=z, **angles) for z in (1, 50))
                worker.predict([0], [near], 0.01).result(60)
                worker.predict([0], [far], 0.01)
                print(worker.pid, flush=True)
                time.sleep(1000)
                """
            ),
            *map(str, (fake_files.facility, fake_files.artifact, fake_files.material)),
        ],
        stdout=subprocess.PIPE,
    )
    with parent:
        pid = int(parent.stdout.readline())
        while len(fake_files.requests) < 2:
            time.sleep(0.01)
        parent.kill()
    assert gone(pid)
