"""The twin that follows a scan, with the real worker process around a twin whose answers are known."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from datetime import UTC, datetime
from functools import partial

import numpy as np
import pytest
import xarray as xr
from fake_twin import expected_brf, expected_u
from rich.console import Console

from instrument.dataset import read_prediction, write_run
from instrument.errors import InputError
from instrument.events import Geometry, Message, PointAnnotated, PointMeasured, PointStarted, ScanEnded, ScanStarted
from twin.live import LiveTwin
from twin.schedule import Stage
from twin.worker import PredictionWorker, RestartLimit, Timeouts

NOW = datetime(2025, 3, 3, tzinfo=UTC)
STAGES = (Stage(0.01, 6), Stage(0.001, 3))
POINTS = tuple(
    Geometry(wavelength=500, illumination_zenith=15, sensor_zenith=zenith, sensor_azimuth=azimuth)
    for azimuth in (0.0, 105.0)
    for zenith in (-60.0, -30.0, 0.0, 30.0, 60.0, 75.0)
)


class StagedScan:
    """A bus of one listener and an engine that measures at the test's word."""

    def __init__(self, files, tmp_path, *, uncertain: bool = False, **options) -> None:
        self.files, self.run_dir = files, tmp_path / "run"
        self.run_dir.mkdir()
        self.heard: list = []
        self.news = threading.Condition()
        worker = partial(PredictionWorker, factory="fake_twin:FakeTwin.from_files", **options)
        self.workers: list[PredictionWorker] = []

        def made(*paths):
            self.workers.append(worker(*paths))
            return self.workers[-1]

        self.twin = LiveTwin(self.publish, predictor=made, assessor=made if uncertain else None, stages=STAGES)

    def publish(self, event) -> None:
        with self.news:
            self.heard.append(event)
            self.news.notify_all()

    def start(self, **changes) -> None:
        paths = {name: str(getattr(self.files, name)) for name in ("facility", "artifact", "material")}
        event = ScanStarted(
            time=NOW, run_dir=str(self.run_dir), title="test", points=POINTS, duration_s=100, **(paths | changes)
        )
        self.twin.on_event(event)

    def measure(self, index: int) -> None:
        self.twin.on_event(PointStarted(time=NOW, index=index, geometry=POINTS[index]))
        self.twin.on_event(
            PointMeasured(
                time=NOW, index=index, geometry=POINTS[index], brf=0.4, u_brf=0.005, signal=(1.0,) * 9, dark=0.0,
                gain=1e6, done=1, total=len(POINTS), time_left_s=1.0,
            )
        )  # fmt: skip

    def end(self, measured, error: float = 0.01) -> list:
        """Leave a run file that reads ``1 + error`` times the known truth, and let the twin sum up."""
        names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
        units = dict.fromkeys(names, "degree") | {"wavelength": "nm"}
        chosen = [POINTS[i] for i in measured]
        coords = {n: ("point", [float(getattr(g, n)) for g in chosen], {"units": units[n]}) for n in names}
        brf = np.array([expected_brf(g) for g in chosen]) * (1 + error)
        one = {"units": "1"}
        run = xr.Dataset({"brf": ("point", brf, one), "u_brf": ("point", 0.01 * brf, one)}, coords=coords)
        write_run(run, self.run_dir / "run.nc")
        ended = ScanEnded(time=NOW, outcome="finished", done=len(chosen), total=len(POINTS), run_file=None)
        self.twin.on_event(ended)
        return self.twin.finish(self.run_dir)

    def await_message(self, level: str, patience: float = 60.0) -> Message:
        """The one message of a level, which comes in its own time beside the predictions."""
        with self.news:
            assert self.news.wait_for(lambda: any(m.level == level for m in self.messages), patience), self.heard
        (said,) = [m for m in self.messages if m.level == level]
        return said

    def await_annotations(self, count: int, patience: float = 60.0) -> list[PointAnnotated]:
        with self.news:
            assert self.news.wait_for(lambda: len(self.annotations) >= count, patience), self.heard
        return self.annotations

    @property
    def annotations(self) -> list[PointAnnotated]:
        return [event for event in self.heard if isinstance(event, PointAnnotated)]

    @property
    def messages(self) -> list[Message]:
        return [event for event in self.heard if isinstance(event, Message)]


@pytest.fixture
def scan_of(fake_files, tmp_path):
    scans = []

    def make(**options) -> StagedScan:
        scans.append(StagedScan(fake_files, tmp_path, **options))
        return scans[-1]

    yield make
    for scan in scans:
        scan.twin.close()


def check_results(scan: StagedScan, measured, error: float = 0.01) -> None:
    prediction = read_prediction(scan.run_dir / "prediction.nc")
    assert prediction["brf"].values.tolist() == [expected_brf(POINTS[i]) for i in measured]
    assert prediction["u_brf_monte_carlo"].values == pytest.approx(0.001 * prediction["brf"].values)
    found = json.loads((scan.run_dir / "comparison.json").read_text())
    assert found["global"]["points"] == len(measured)
    assert found["global"]["relative_rmse"] == pytest.approx(error / (1 + error))


def test_every_point_is_predicted_coarse_then_fine_and_summed_up(scan_of):
    scan = scan_of()
    scan.start()
    scan.await_annotations(2 * len(POINTS))
    first, second = scan.annotations[: len(POINTS)], scan.annotations[len(POINTS) :]
    for half, error in ((first, 0.01), (second, 0.001)):
        assert sorted(a.index for a in half) == list(range(len(POINTS)))
        for annotation in half:
            brf = expected_brf(POINTS[annotation.index])
            assert annotation.source == "twin"
            assert annotation.values == {"brf": brf, "u_brf": error * brf, "u_brf_monte_carlo": error * brf}
    for index in range(len(POINTS)):
        scan.measure(index)
    tables = scan.end(range(len(POINTS)))
    check_results(scan, range(len(POINTS)))
    assert len(list((scan.run_dir / "figures").glob("*.png"))) == 3  # two planes and the overview
    console = Console(width=100, record=True, file=open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    with console.file:
        console.print(*tables)
    text = console.export_text()
    assert "Beside the paper's Table VI" in text
    assert "Monte Carlo error of the ray tracer alone" in text


def test_the_bus_never_waits_for_the_worker(scan_of, fake_files):
    fake_files.order(delay_s=5.0, slow_start_s=2.0)
    scan = scan_of()
    began = time.monotonic()
    scan.start()
    for index in range(len(POINTS)):
        scan.measure(index)
    assert time.monotonic() - began < 0.5


def test_predictions_follow_the_scan(scan_of, fake_files):
    fake_files.order(delay_s=0.3)
    scan = scan_of()
    scan.start(done=(0, 1, 2, 3, 4, 5))
    scan.await_annotations(6)
    assert sorted(a.index for a in scan.annotations[:6]) == [6, 7, 8, 9, 10, 11]


def test_a_worker_killed_in_mid_scan_costs_nothing_but_time(scan_of, fake_files):
    fake_files.order(**fake_files.let_answer(1))
    scan = scan_of()
    scan.start()
    for index, (held, answered) in enumerate(((2, 3), (4, 1000))):
        patience = time.monotonic() + 60
        while len(fake_files.requests) < held or scan.workers[0].pid is None:
            assert time.monotonic() < patience
            time.sleep(0.01)
        os.kill(scan.workers[0].pid, signal.SIGKILL)  # while it holds a request
        fake_files.let_answer(answered)
        scan.measure(index)
    for index in range(2, len(POINTS)):
        scan.measure(index)
    assert scan.end(range(len(POINTS)))
    check_results(scan, range(len(POINTS)))
    lost = [m for m in scan.messages if m.level == "warning"]
    assert len(lost) == 2
    assert all("signal 9" in m.text and "the scan is not affected" in m.advice for m in lost)


def test_a_point_that_always_crashes_is_left_out_and_the_rest_is_kept(scan_of, fake_files):
    fake_files.order(die_at=75.0)
    scan = scan_of(restarts=RestartLimit(starts=50, window_s=1.0))
    scan.start()
    measured = list(range(len(POINTS)))
    for index in measured:
        scan.measure(index)
    scan.end(measured)
    check_results(scan, [i for i in measured if POINTS[i].sensor_zenith != 75.0])
    assert any("2 points could not be predicted" in m.text for m in scan.messages)


def test_a_point_that_the_twin_refuses_is_asked_for_no_more_and_said_once(scan_of, fake_files):
    fake_files.order(refuse_at=75.0)
    scan = scan_of()
    scan.start()
    measured = list(range(len(POINTS)))
    for index in measured:
        scan.measure(index)
    scan.end(measured)
    check_results(scan, [i for i in measured if POINTS[i].sensor_zenith != 75.0])
    said = [m.text for m in scan.messages if m.level == "warning"]
    assert said[0] == "the twin cannot predict some points: sensor zenith 75: not with this material"
    assert len(said) == 2
    assert said[1].startswith("2 points could not be predicted")
    assert [request["zeniths"] for request in fake_files.requests].count([75.0]) == 2  # once for each such point


def test_a_material_that_is_no_table_is_refused_before_a_scan(tmp_path):
    (tmp_path / "material.nc").write_text("a note")
    LiveTwin.check(None, None, None)
    with pytest.raises(InputError, match=r"material.nc: not a"):
        LiveTwin.check(None, None, tmp_path / "material.nc")


def test_a_process_that_never_lives_ends_in_a_report_and_not_in_a_wait(scan_of, fake_files):
    fake_files.order(slow_start_s=100.0)
    scan = scan_of(restarts=RestartLimit(starts=50, window_s=1.0), timeouts=Timeouts(start_s=0.3))
    scan.start()
    scan.measure(0)
    assert scan.end([0]) == []
    assert any(m.text.startswith("no comparison: none of the 1 measured points") for m in scan.messages)
    assert not (scan.run_dir / "comparison.json").exists()


def test_too_many_crashes_pause_the_twin_which_goes_on_by_itself(scan_of, fake_files):
    fake_files.order(die_at=-60.0, die_times=2)
    # Longer than two starts of the process take on a busy machine: outside the window they would not count together.
    scan = scan_of(restarts=RestartLimit(starts=2, window_s=15.0))
    scan.start()
    scan.await_annotations(2 * len(POINTS))
    assert any("the twin pauses" in m.text for m in scan.messages)


def test_wrong_files_are_said_once_and_the_scan_goes_on(scan_of, fake_files):
    fake_files.order(broken="material.nc: brf missing")
    scan = scan_of()
    scan.start()
    for index in range(len(POINTS)):
        scan.measure(index)
    assert scan.end(range(len(POINTS))) == []
    errors = [m.text for m in scan.messages if m.level == "error"]
    assert errors == ["the twin cannot predict: material.nc: brf missing"]


def test_without_a_material_there_is_nothing_to_do_and_it_says_so(scan_of):
    scan = scan_of()
    scan.start(material=None)
    scan.measure(0)
    assert scan.end([0]) == []
    assert [m.text for m in scan.messages] == ["the twin predicts nothing: the scan names no material"]
    assert scan.workers == []


def test_only_what_was_measured_is_completed_after_an_abort(scan_of, fake_files):
    fake_files.order(delay_s=0.2)
    scan = scan_of()
    scan.start()
    scan.measure(0)
    scan.measure(1)
    scan.end([0, 1])
    check_results(scan, [0, 1])
    fine = [z for request in fake_files.requests if request["standard_error"] == 0.001 for z in request["zeniths"]]
    assert set(fine) == {POINTS[0].sensor_zenith, POINTS[1].sensor_zenith}


def test_an_aborted_scan_without_a_run_file_is_no_error(scan_of):
    scan = scan_of()
    scan.start()
    assert scan.twin.finish(scan.run_dir) == []
    assert any("no comparison" in m.text and "no such file" in m.text for m in scan.messages)


def test_closing_in_the_middle_ends_the_process_at_once(scan_of, fake_files):
    fake_files.order(hang_at=-60.0)
    scan = scan_of()
    scan.start()
    while not fake_files.requests:
        time.sleep(0.01)
    began = time.monotonic()
    scan.twin.close()
    assert time.monotonic() - began < 5
    assert scan.workers[0].pid is None
    assert scan.messages == []


def test_its_events_are_stamped_with_laboratory_time(scan_of):
    scan = scan_of()
    scan.start(clock_speed=1000.0)
    annotation = scan.await_annotations(1)[0]
    assert (annotation.time - NOW).total_seconds() > 100  # at least a tenth of a second passed to start the process


def check_combined(annotations) -> None:
    for annotation in annotations:
        u, values = expected_u(POINTS[annotation.index]), annotation.values
        assert values["u_brf_inputs"] == u
        assert values["u_brf"] == pytest.approx(np.hypot(u, values["u_brf_monte_carlo"]))


def test_the_uncertainty_of_the_inputs_is_added_once_it_is_known(scan_of, fake_files, tmp_path):
    fake_files.order(wait_for=str(tmp_path / "ready"))
    scan = scan_of(uncertain=True)
    scan.start()
    before = list(scan.await_annotations(2 * len(POINTS)))
    assert all("u_brf_inputs" not in annotation.values for annotation in before)
    (tmp_path / "ready").touch()
    after = scan.await_annotations(3 * len(POINTS))[2 * len(POINTS) :]
    assert sorted(annotation.index for annotation in after) == list(range(len(POINTS)))
    check_combined(after)
    for index in range(len(POINTS)):
        scan.measure(index)
    scan.end(range(len(POINTS)))
    check_results(scan, range(len(POINTS)))
    prediction = read_prediction(scan.run_dir / "prediction.nc")
    assert prediction["u_brf_inputs"].values.tolist() == [expected_u(point) for point in POINTS]
    assert prediction.attrs["u_brf_contains"] == "7 uncertain inputs and the ray tracer's standard error"
    assert prediction.attrs["u_brf_notes"] == "a; b"
    assert scan.messages == []


def test_a_known_uncertainty_comes_with_the_first_prediction(scan_of, fake_files):
    fake_files.order(delay_s=1.0)  # of a prediction, so that the uncertainty is there first
    scan = scan_of(uncertain=True)
    scan.start()
    check_combined(scan.await_annotations(6)[:6])


def test_a_scan_that_ends_early_says_what_its_uncertainty_lacks(scan_of, fake_files, tmp_path):
    fake_files.order(wait_for=str(tmp_path / "never"))
    scan = scan_of(uncertain=True)
    scan.start()
    scan.measure(0)
    scan.end([0])
    prediction = read_prediction(scan.run_dir / "prediction.nc")
    assert "u_brf_inputs" not in prediction
    assert prediction.attrs["u_brf_contains"] == "the ray tracer's standard error alone"
    assert any("was not ready when the scan ended" in m.text and "predict --uncertainty" in m.advice
               for m in scan.messages)  # fmt: skip
    began = time.monotonic()
    scan.twin.close()
    assert time.monotonic() - began < 5
    assert all(worker.pid is None for worker in scan.workers)


def test_an_uncertainty_that_cannot_be_told_is_said_and_the_predictions_go_on(scan_of, fake_files):
    fake_files.order(no_uncertainty="material.nc: u_brf missing")
    scan = scan_of(uncertain=True)
    scan.start()
    for index in range(len(POINTS)):
        scan.measure(index)
    scan.await_annotations(2 * len(POINTS))
    said = scan.await_message("warning")  # a scan that ends first would not wait for it
    scan.end(range(len(POINTS)))
    check_results(scan, range(len(POINTS)))
    assert said.text == "the uncertainty of the twin's inputs cannot be told: material.nc: u_brf missing"
    assert "ray tracer's error alone" in said.advice
