"""What must hold however a scan ends or rests: light off, arms at rest, devices released, no request lost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scan_stage import FACILITY, QUICK, plan_of, stage

from drivers.interfaces import AxisLimits
from instrument.errors import SafetyError
from instrument.evaluation import Evaluator
from instrument.events import Event, Geometry, PointMeasured, PointSkipped, PointStarted, StateChanged
from instrument.lambertian import lambertian_flux
from instrument.run_build import build_run


def at_point(index: int) -> Any:
    return lambda event: isinstance(event, PointStarted) and event.index == index


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), ValueError("a driver's own slip")])
@pytest.mark.parametrize("part", ["sensor_zenith", "shutter", "source"])
def test_whatever_a_device_raises_at_the_end_the_others_are_made_safe(
    tmp_path: Path, part: str, error: Exception
) -> None:
    s = stage(tmp_path)
    device = getattr(s.bench, part, None) or s.bench.axes[part]

    def fail(*_: object) -> None:
        raise error

    def break_it() -> None:
        for method in {"stop", "shut", "set_emission", "make_safe"} & set(dir(device)):
            setattr(device, method, fail)

    s.when(at_point(1), break_it)
    s.when(at_point(1), lambda: s.engine.halt("enough"))
    end = s.run()
    assert end.outcome in ("halted", "faulted")
    assert part == "source" or not s.bench.source.on
    assert part == "shutter" or not s.bench.shutter.opened
    assert s.journal().others[-2]["kind"] == "ended"
    assert all(held.closed for held in s.bench.laboratory().devices().values())


def test_a_device_that_cannot_be_closed_leaves_no_other_open(tmp_path: Path) -> None:
    s = stage(tmp_path, run_file=True)

    def stuck() -> None:
        raise OSError(5, "Input/output error")

    s.bench.axes["sensor_zenith"].close = stuck  # type: ignore[method-assign]
    end = s.run()
    assert end.outcome == "faulted"
    assert end.done == 3
    assert end.run_file is not None
    assert s.bench.detector.closed


def test_devices_are_released_where_the_instrument_cannot_be_set_up(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.bench.axes["sensor_azimuth"].limits = AxisLimits(200.0, 300.0, 20.0, 40.0)
    assert s.run().outcome == "faulted"
    assert isinstance(s.engine.error, SafetyError)
    assert all(device.closed for device in s.bench.laboratory().devices().values())


def test_an_arm_that_loses_a_stop_is_stopped_before_the_scan_is_over(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of(zenith=(80.0, -80.0), azimuth=(90.0,)))
    axis = s.bench.axes["sensor_zenith"]
    axis.limits = AxisLimits(-91.0, 91.0, 2.0, 40.0)
    honest, begin, lost = axis.stop, axis.start_move, []

    def deaf() -> None:  # some drives do not acknowledge a stop
        if axis.busy() and len(lost) < 2:
            lost.append(axis.place())
        else:
            honest()

    def halted_under_way(target: float) -> None:
        begin(target)
        if target == -80.0:
            axis.stop = deaf  # type: ignore[method-assign]
            s.engine.halt("enough")

    axis.start_move = halted_under_way  # type: ignore[method-assign]
    assert s.run().outcome == "halted"
    assert len(lost) == 2
    assert not axis.busy()
    assert -80.0 < axis.place() < 80.0


def test_a_resume_that_comes_at_once_is_not_lost(tmp_path: Path) -> None:
    """Whoever hears of a suspension may answer before the engine's thread goes on."""
    s = stage(tmp_path, settings=QUICK.model_copy(update={"suspend_limit_wall": 0.3}))
    s.when(at_point(1), lambda: s.bench.source.trip("interlock open: door"))
    publish = s.bus.publish

    def answered_at_once(event: Event) -> None:
        publish(event)
        if isinstance(event, StateChanged) and event.new == "suspended":
            s.bench.source.trouble = ""
            s.engine.resume()

    s.bus.publish = answered_at_once  # type: ignore[method-assign]
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)


def test_a_pause_while_the_light_comes_back_is_no_fault(tmp_path: Path) -> None:
    s = stage(tmp_path, settings=QUICK.model_copy(update={"warm_up": 100.0}))
    s.when(at_point(1), lambda: s.bench.source.trip("interlock open: door"))
    emitted = s.bench.source.set_emission
    rests: list[bool] = []

    def interrupted(on: bool) -> None:
        emitted(on)
        if on and s.engine.state == "suspended" and not rests:
            rests.append(True)
            s.engine.pause(now=True)

    s.bench.source.set_emission = interrupted  # type: ignore[method-assign]

    def back(event: Event) -> None:
        if isinstance(event, StateChanged) and event.new == "suspended":
            s.bench.source.trouble = ""
            s.engine.resume()

    s.bus.subscribe(back, "person")
    end = s.run()
    assert rests == [True]
    assert (end.outcome, end.done) == ("finished", 3)
    assert [event.new for event in s.events(StateChanged)].count("suspended") == 2


def test_a_dead_detector_is_no_measurement_and_ends_the_scan(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of(zenith=tuple(float(z) for z in range(70, 9, -10))))

    def unplug() -> None:
        s.bench.detector.noise = 0.0
        s.bench.reflectance["sample"] = 0.0

    s.when(lambda event: isinstance(event, PointMeasured) and event.index == 1, unplug)
    end = s.run()
    assert end.outcome == "faulted"
    assert 2 <= end.done <= 3
    assert all("no light" in event.reason for event in s.events(PointSkipped))
    assert len(s.events(PointSkipped)) == 3


def test_live_values_are_those_of_the_run_file_after_a_second_calibration() -> None:
    """The lamp has lost a tenth between two calibrations: each point counts against the one before it."""
    plan = plan_of()

    def record(index: int, geometry: Geometry, volts: float, minute: int) -> dict[str, Any]:
        return {
            "index": index,
            "geometry": geometry.model_dump(),
            "time": f"2026-03-02T08:{minute:02d}:00Z",
            "signal": [volts, 1.01 * volts],
            "dark": 0.0,
            "gain": 1e6,
        }

    evaluator = Evaluator(FACILITY, plan.points)
    points, references, live = [], [], []
    for step, level in enumerate((1.0, 0.9)):
        for index, azimuth in enumerate((0.0, 90.0)):
            geometry = Geometry(wavelength=500.0, illumination_zenith=0.0, sensor_zenith=15.0, sensor_azimuth=azimuth)
            references.append(record(index, geometry, level * (1 + 0.01 * index), 10 * step + index))
            evaluator.add_reference(index, geometry, references[-1])
        points.append(record(step, plan.points[step], 0.4 * level, 10 * step + 5))
        live.append(evaluator.brf(plan.points[step], points[-1]))
    header = {"scan_direction": "unidirectional", "points": 3, "plan": "", "facility": "", "software_version": "0"}
    run = build_run(header, points, references, FACILITY)
    assert [brf for brf, _ in live] == pytest.approx(run["brf"].values.tolist(), rel=1e-12)
    assert [u for _, u in live] == pytest.approx(run["u_brf"].values.tolist(), rel=1e-12)
    flux = lambertian_flux(FACILITY, 0.0, [point.sensor_zenith for point in plan.points[:2]], 0.0)
    assert live[0][0] * flux[0] == pytest.approx(live[1][0] * flux[1], rel=1e-6)


@pytest.mark.parametrize("shutter_open", [True, False])
def test_light_that_goes_out_during_a_reading_costs_the_reading_not_the_point(
    tmp_path: Path, shutter_open: bool
) -> None:
    """In the midst of the burst, or after it: nobody knows how much light a reading had whose source went out."""
    s = stage(tmp_path)
    bench = s.bench

    def trip() -> None:
        if bench.shutter.opened is shutter_open and len(measured) == 1 and not bench.source.trouble:
            bench.detector.noise = 0.0
            bench.detector.on_read = lambda: None
            bench.source.trip("interlock open: door")

    measured: list[int] = []
    s.when(lambda event: isinstance(event, PointMeasured), lambda: measured.append(1))
    s.when(at_point(1), lambda: setattr(bench.detector, "on_read", trip))

    def back(event: Event) -> None:
        if isinstance(event, StateChanged) and event.new == "suspended":
            bench.source.trouble = ""
            s.engine.resume()

    s.bus.subscribe(back, "person")
    end = s.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert "suspended" in [event.new for event in s.events(StateChanged)]
    assert s.events(PointSkipped) == []
    assert [event.quality_flag for event in s.events(PointMeasured)] == [0, 8, 0]
    assert [event.brf for event in s.events(PointMeasured)][1] == pytest.approx(0.4, rel=0.2)
