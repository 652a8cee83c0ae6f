"""The scan engine on hand-written devices: what is measured, how it is told, and what is refused at the start."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import pytest
from fake_bench import Bench
from scan_stage import FACILITY, QUICK, plan_of, stage

from drivers.clock import Clock
from drivers.interfaces import AxisLimits
from instrument.dataset import read_run
from instrument.errors import InputError, SafetyError
from instrument.events import Message, PointMeasured, PointSkipped, PointStarted, StateChanged
from instrument.lambertian import lambertian_flux
from instrument.states import TRANSITIONS, State


def measured(s) -> list[int]:
    return [event.index for event in s.events(PointMeasured)]


def test_a_scan_measures_every_point_once_and_leaves_the_instrument_safe(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of(illumination=(0.0, 15.0), azimuth=(0.0, 90.0), zenith=(20.0, 10.0, -10.0)))
    end = s.run()
    assert (end.outcome, end.done, end.total) == ("finished", 12, 12)
    assert measured(s) == list(range(12))
    assert s.engine.error is None
    assert s.bench.wrong == []
    assert s.bench.safe
    assert all(device.closed for device in s.bench.laboratory().devices().values())
    assert s.bench.log == [
        "home illumination_zenith",
        "home sensor_azimuth",
        "home sensor_zenith",
        "mount reference",
        "mount sample",
    ]


def test_the_reflectance_factor_is_that_of_the_sample(tmp_path: Path) -> None:
    """The bench reflects 0.4 of what a perfect diffuser would, times the cosine of the illumination."""
    s = stage(tmp_path, plan_of(illumination=(0.0, 15.0), zenith=(30.0,)))
    s.run()
    points = {event.geometry.illumination_zenith: event for event in s.events(PointMeasured)}
    reference = lambertian_flux(FACILITY, 0.0, 15.0, 0.0)
    for zenith, event in points.items():
        flux = lambertian_flux(FACILITY, zenith, 30.0, 0.0) / reference
        cosine = float(lambertian_flux(FACILITY, zenith, 15.0, 90.0) / reference) if zenith else 1.0
        assert event.brf * float(flux) == pytest.approx(0.4 * cosine, rel=2e-2 if zenith else 1e-3)
        assert event.brf * 0.0105 < event.u_brf < event.brf * 0.0120


def test_the_run_file_says_what_the_events_said(tmp_path: Path) -> None:
    s = stage(tmp_path, run_file=True)
    end = s.run()
    run = read_run(Path(end.run_file or ""))
    events = s.events(PointMeasured)
    assert run["brf"].values.tolist() == pytest.approx([event.brf for event in events], rel=1e-12)
    assert run["u_brf"].values.tolist() == pytest.approx([event.u_brf for event in events], rel=1e-12)
    assert run["signal"].shape == (3, 9)
    assert run["readback_sensor_zenith"].values.tolist() == pytest.approx([30.0, 20.0, 10.0], abs=0.01)


def test_every_change_of_state_is_legal_and_in_the_journal_before_it_is_announced(tmp_path: Path) -> None:
    s = stage(tmp_path)
    recorded_first = []

    def check(event) -> None:
        if isinstance(event, StateChanged):
            lines = (tmp_path / "journal.jsonl").read_text().splitlines()
            states = [json.loads(line) for line in lines if '"kind":"state"' in line]
            recorded_first.append(any(r["old"] == event.old and r["new"] == event.new for r in states))

    s.bus.subscribe(check, "test")
    s.run()
    changes = [(State(event.old), State(event.new)) for event in s.events(StateChanged)]
    assert all(new in TRANSITIONS[old] for old, new in changes)
    assert changes[0][0] is State.IDLE
    assert changes[-1][1] is State.FINISHED
    assert all(a[1] is b[0] for a, b in pairwise(changes))
    assert recorded_first
    assert all(recorded_first)
    journal = [(r["old"], r["new"]) for r in s.journal().others if r["kind"] == "state"]
    assert journal == [(str(old), str(new)) for old, new in changes]


def test_a_point_is_in_the_journal_before_it_is_announced(tmp_path: Path) -> None:
    s = stage(tmp_path)
    found = []
    s.bus.subscribe(
        lambda event: found.append(event.index in s.journal().points) if isinstance(event, PointMeasured) else None,
        "test",
    )
    s.run()
    assert found == [True, True, True]


def test_resuming_a_complete_run_touches_no_device(tmp_path: Path) -> None:
    stage(tmp_path).run()
    again = stage(tmp_path, run_file=True)
    end = again.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert (tmp_path / "run.nc").exists()
    assert again.bench.log == []
    assert again.bench.detector.bursts == 0


def test_points_beyond_the_drive_are_refused_before_anything_moves(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of(zenith=(30.0, 85.0)))
    s.bench.axes["sensor_zenith"].limits = AxisLimits(-60.0, 60.0, 20.0, 40.0)
    end = s.run()
    assert end.outcome == "faulted"
    assert isinstance(s.engine.error, InputError)
    assert "sensor_zenith" in end.reason
    assert "85" in end.reason
    assert s.bench.log == []
    assert all(axis.commands == [] for axis in s.bench.axes.values())


def test_a_plan_without_a_safe_way_is_refused_before_anything_moves(tmp_path: Path) -> None:
    """With azimuth and illumination fixed, the sensor cannot pass the beam."""
    bench = Bench()
    for name in ("illumination_zenith", "sensor_azimuth"):
        bench.axes[name].limits = AxisLimits(0.0, 0.0, 20.0, 40.0)
    reference = FACILITY.reference.model_copy(update={"sensor_azimuth": (0.0,)})
    facility = FACILITY.model_copy(update={"reference": reference})
    s = stage(tmp_path, plan_of(zenith=(30.0, -30.0)), bench, facility=facility)
    end = s.run()
    assert isinstance(s.engine.error, SafetyError)
    assert "point 2 of 2" in end.reason
    assert s.bench.log == []


def test_too_much_light_for_the_lowest_gain_is_marked_not_averaged(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.when(
        lambda e: isinstance(e, PointStarted) and e.index == 1,
        lambda: s.bench.reflectance.update(sample=1e5),
    )
    s.when(lambda e: isinstance(e, PointSkipped), lambda: s.bench.reflectance.update(sample=0.4))
    end = s.run()
    assert end.done == 2
    assert "overload at the lowest gain" in s.events(PointSkipped)[0].reason


def test_several_wavelengths_have_a_reference_each(tmp_path: Path) -> None:
    s = stage(tmp_path, plan_of(zenith=(30.0,), wavelength=(500.0, 600.0)))
    end = s.run()
    assert end.done == 2
    found = [(r["geometry"]["wavelength"], r["wavelength_readback"]) for r in s.journal().references]
    assert found == [(500.0, 500.0)] * 4 + [(600.0, 600.0)] * 4


def test_the_watchdog_of_the_source_is_fed_while_it_emits(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.run()
    assert s.bench.source.fed > 5


def test_an_observer_that_fails_or_lags_does_not_touch_the_scan(tmp_path: Path) -> None:
    s = stage(tmp_path)

    def fail(event) -> None:
        raise ZeroDivisionError("twin")

    failing = s.bus.subscribe(fail, "the twin")
    end = s.run()
    assert end.done == 3
    assert isinstance(failing.failure, ZeroDivisionError)
    assert any("the twin failed" in e.text for e in s.events(Message))


@pytest.mark.parametrize(("hours", "readings"), [(1e-9, 8), (12.0, 4)])
def test_a_resumed_run_measures_the_reference_anew_where_it_is_too_old(
    tmp_path: Path, hours: float, readings: int
) -> None:
    s = stage(tmp_path)
    s.when(lambda e: isinstance(e, PointMeasured) and e.index == 0, lambda: s.engine.abort("over night"))
    s.run()
    bench = Bench(clock=Clock(2000.0, start=s.bench.clock.now()))
    again = stage(tmp_path, bench=bench, settings=QUICK.model_copy(update={"reference_age": hours}))
    end = again.run()
    assert (end.outcome, end.done) == ("finished", 3)
    assert len(again.journal().references) == readings
    assert again.bench.log.count("mount reference") == readings // 8


def test_the_preflight_is_in_the_journal_and_a_bright_dark_level_moves_nothing(tmp_path: Path) -> None:
    s = stage(tmp_path)
    s.bench.detector.offset = 3.0
    end = s.run()
    assert end.outcome == "faulted"
    assert "dark level: 3 V at the lowest gain" in end.reason
    (found,) = [record for record in s.journal().others if record["kind"] == "preflight"]
    assert {check["name"]: check["passed"] for check in found["checks"]} == dict.fromkeys(
        ("shutter", "illumination_zenith", "sensor_azimuth", "sensor_zenith", "source", "disk", "reference", "warm-up"),
        True,
    ) | {"dark level": False}
    assert s.bench.log == []
