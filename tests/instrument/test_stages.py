"""A stage that turns the sample and a polariser: on the wire, in the physics, in journal and run file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_bench import Bench as MemoryBench
from fake_bench import FakeAxis
from scan_stage import FACILITY, QUICK, Stage, stage

from drivers.clock import Clock
from drivers.configuration import connect, read_devices
from drivers.interfaces import AxisLimits, Laboratory
from instrument.acquisition import Burst
from instrument.events import Geometry, PointMeasured
from instrument.facility import Facility
from instrument.plan import Plan, PlanForm, make_plan
from instrument.run_archive import first_difference
from instrument.run_build import rebuild_run
from instrument.run_read import read_run
from instrument.run_write import write_run
from instrument.stages import mean_of
from sim_fixtures.bench import Bench, BenchClock, lambertian_flux
from sim_fixtures.connections import write_alternative, write_devices
from sim_fixtures.polarizer import DEGREE, TRANSMISSION, USUAL_AMPLITUDE, behind_polarizer, response
from sim_fixtures.room import Room

SPEED = 500.0


def equipped(**arms: object) -> Facility:
    has = {"sample_rotation": (-180.0, 180.0), "polarizer": (-10.0, 100.0)} | arms
    quiet = FACILITY.budget.model_copy(update={"measurement_noise": 0.0})
    return FACILITY.model_copy(update={"arms": FACILITY.arms.model_copy(update=has), "budget": quiet})


def plan_of(facility: Facility, **grid: object) -> Plan:
    usual = {"wavelength": [500.0], "illumination_zenith": [0.0], "sensor_azimuth": [0.0], "sensor_zenith": [40.0]}
    return make_plan(PlanForm.model_validate({"version": 1, "grid": [usual | grid]}), facility, "plan.toml")


class SimulatedBench:
    """The simulated laboratory on its wires, in this process, as a stage for scans."""

    def __init__(self, folder: Path, facility: Facility) -> None:
        self.bench = Bench(facility, lambertian_flux, BenchClock(SPEED), seed=3)
        self.room = Room(self.bench, folder)
        ports = {name: str(path) for name, path in self.room.endpoints.ports.items()}
        for name, write in (("devices.toml", write_devices), ("esp301.toml", write_alternative)):
            write(folder / name, ports, self.room.endpoints.meter, SPEED, facility)
        self.folder, self.clock = folder, Clock(SPEED)
        self.mount = self.bench.mount

    def laboratory(self) -> Laboratory:
        return connect(self.folder / "devices.toml", self.clock)

    def close(self) -> None:
        self.room.close()


@pytest.fixture
def simulated(tmp_path: Path) -> Iterator[SimulatedBench]:
    (tmp_path / "lab").mkdir()
    bench = SimulatedBench(tmp_path / "lab", equipped())
    yield bench
    bench.close()


def scan(tmp_path: Path, bench: SimulatedBench, facility: Facility, plan: Plan) -> Stage:
    (tmp_path / "run").mkdir(exist_ok=True)
    settings = QUICK.model_copy(update={"dwell": 2.0, "keep_alive_wall": 2.0})
    return stage(tmp_path / "run", plan, bench, settings, facility)  # type: ignore[arg-type]


def test_a_scan_turns_sample_and_polariser_and_the_light_answers(tmp_path: Path, simulated: SimulatedBench) -> None:
    facility = equipped()
    plan = plan_of(facility, sample_rotation=[0.0, 45.0], polarization=["s", "p", "mean"])
    s = scan(tmp_path, simulated, facility, plan)
    end = s.run(120.0)
    assert (end.outcome, end.reason) == ("finished", end.reason)
    run = rebuild_run(tmp_path / "run")
    assert run["sample_rotation"].values.tolist() == [0.0, 45.0] * 3
    assert [run["polarization"].attrs["flag_meanings"].split()[i] for i in run["polarization"].values] == list(
        "sspp"
    ) + ["mean"] * 2
    np.testing.assert_allclose(run["readback_sample_rotation"].values, run["sample_rotation"].values, atol=0.002)
    # After "mean" the polariser stands where its second part was read.
    np.testing.assert_allclose(run["readback_polarizer"].values, [90, 90, 0, 0, 0, 0], atol=0.002)
    # By hand: turned by 45 degrees the plain sample sends 5 % sin^2(40) more; p and s see the response to polarised
    # light, less that of the reference, whose azimuths cancel it.
    turned = 1 + 0.05 * np.sin(np.deg2rad(40)) ** 2
    part = USUAL_AMPLITUDE * np.sin(np.deg2rad(40)) ** 2
    reference = USUAL_AMPLITUDE * np.sin(np.deg2rad(15)) ** 2 * np.mean(np.cos(np.deg2rad([0, 90, 180, 270])))
    brf = run["brf"].values
    np.testing.assert_allclose(brf[[1, 3, 5]] / brf[[0, 2, 4]], turned, rtol=2e-3)
    np.testing.assert_allclose(brf[2] / brf[0], (1 + part) / (1 - part) * (1 - reference) / (1 + reference), rtol=2e-3)
    events = s.events(PointMeasured)
    np.testing.assert_allclose([event.brf for event in events], brf, rtol=1e-9)
    record = s.journal().points[4]
    assert [part["polarization"] for part in record["parts"]] == ["s", "p"]
    assert record["geometry"]["polarization"] == "mean"
    assert len(s.journal().references) == 12


def test_the_run_file_keeps_the_extra_coordinates(tmp_path: Path, simulated: SimulatedBench) -> None:
    facility = equipped()
    plan = plan_of(facility, sample_rotation=[90.0], polarization=["p"], repeats=2)
    s = scan(tmp_path, simulated, facility, plan)
    assert s.run(120.0).outcome == "finished"
    run = rebuild_run(tmp_path / "run")
    write_run(run, tmp_path / "run.nc")
    stored = read_run(tmp_path / "run.nc")
    assert first_difference(stored, run) == ""
    assert stored["repetition"].values.tolist() == [0, 1]
    assert {"sample_rotation", "polarization", "repetition"} <= set(stored.coords)


def test_the_stages_are_there_beside_an_esp301_too(simulated: SimulatedBench) -> None:
    devices = read_devices(simulated.folder / "esp301.toml")
    assert {name: devices.devices[name].line for name in ("sample_rotation", "polarizer", "sensor_zenith")} == {
        "sample_rotation": "stages",
        "polarizer": "stages",
        "sensor_zenith": "esp301",
    }


def test_a_room_without_stages_has_no_line_for_them(tmp_path: Path) -> None:
    bench = SimulatedBench(tmp_path, FACILITY)
    try:
        assert "stages" not in bench.room.endpoints.ports
        assert not {"sample_rotation", "polarizer"} & read_devices(tmp_path / "devices.toml").devices.keys()
    finally:
        bench.close()


def memory_bench(**stages: tuple[float, float]) -> MemoryBench:
    bench = MemoryBench()
    extra = {name: FakeAxis(name, bench, AxisLimits(*ends, 20.0, 40.0)) for name, ends in stages.items()}
    original = bench.laboratory

    def laboratory() -> Laboratory:
        made = original()
        made.others.update(extra)
        return made

    bench.laboratory = laboratory  # type: ignore[method-assign]
    bench.stages = extra  # type: ignore[attr-defined]
    return bench


@pytest.mark.parametrize(
    ("grid", "stages", "expected"),
    [
        ({"sample_rotation": [10.0]}, {"polarizer": (0.0, 90.0)}, "asks for sample_rotation 10, but devices.toml"),
        ({}, {"sample_rotation": (-180.0, 180.0)}, "asks for polarizer 90, but devices.toml connects no such device"),
        ({}, {"polarizer": (0.0, 80.0)}, "polarizer: found 90 degrees, beyond the stage; expected 0 to 80"),
        (
            {"sample_rotation": [0.0, 100.0]},
            {"sample_rotation": (-90.0, 90.0), "polarizer": (0.0, 90.0)},
            "sample_rotation: found 100 degrees, beyond the stage; expected -90 to 90",
        ),
    ],
)
def test_what_is_not_connected_is_refused_before_anything_moves(
    tmp_path: Path, grid: dict, stages: dict, expected: str
) -> None:
    bench, facility = memory_bench(**stages), equipped()
    s = stage(tmp_path, plan_of(facility, **grid), bench, facility=facility)
    end = s.run()
    assert end.outcome == "faulted"
    assert expected in end.reason
    assert not any(entry.startswith(("home", "mount")) for entry in bench.log)
    assert not any(axis.commands for axis in bench.axes.values())


def test_a_polariser_that_the_facility_does_not_know_is_refused(tmp_path: Path) -> None:
    bench = memory_bench(polarizer=(0.0, 90.0))
    end = stage(tmp_path, plan_of(FACILITY), bench).run()
    assert end.outcome == "faulted"
    assert "nobody knows with which polarisation to measure" in end.reason


def test_a_stage_that_no_plan_asks_for_stands_at_zero(tmp_path: Path) -> None:
    bench = memory_bench(sample_rotation=(-180.0, 180.0))
    axis = bench.stages["sample_rotation"]  # type: ignore[attr-defined]
    axis._from = axis._to = 25.0
    s = stage(tmp_path, plan_of(FACILITY), bench)
    assert s.run().outcome == "finished"
    assert axis.commands == [0.0]
    assert s.journal().points[0]["readback"]["sample_rotation"] == 0.0


def test_a_stage_comes_from_its_side(tmp_path: Path) -> None:
    bench, facility = memory_bench(sample_rotation=(-180.0, 180.0)), equipped(polarizer=None)
    axis = bench.stages["sample_rotation"]  # type: ignore[attr-defined]
    axis.limits = AxisLimits(-180.0, 180.0, 20.0, 40.0, approach=1, backlash=1.0)
    s = stage(tmp_path, plan_of(facility, sample_rotation=[20.0, 10.0]), bench, facility=facility)
    assert s.run().outcome == "finished"
    assert axis.commands == [-1.0, 0.0, 20.0, 9.0, 10.0]


def test_a_resumed_run_goes_on_with_what_is_missing(tmp_path: Path) -> None:
    facility = equipped(polarizer=None)
    plan = plan_of(facility, sample_rotation=[0.0, 30.0, 60.0], repeats=2)
    bench = memory_bench(sample_rotation=(-180.0, 180.0))
    s = stage(tmp_path, plan, bench, facility=facility)
    s.when(lambda event: isinstance(event, PointMeasured) and event.index == 2, lambda: s.engine.abort("test"))
    assert s.run().outcome == "aborted"
    done = len(s.journal().points)
    assert 0 < done < 6
    later = memory_bench(sample_rotation=(-180.0, 180.0))
    later.clock = Clock(2000.0, start=s.journal().latest)
    again = stage(tmp_path, plan, later, facility=facility)
    assert again.run().outcome == "finished"
    points = again.journal().points
    assert {i: Geometry.model_validate(r["geometry"]) for i, r in points.items()} == dict(enumerate(plan.points))


def test_the_mean_is_that_of_the_photocurrents_whatever_the_gains() -> None:
    s = Burst((1.0, 1.2), 0.1, 1e6, 0, (0.1, 0.1))
    p = Burst((0.21, 0.25), 0.01, 1e5, 8, (0.01, 0.01))
    record = {"time": 1, "signal": (), "dark": 0, "gain": 0, "quality_flag": 0, "readback": {}}
    whole, kept = mean_of([("s", s, record), ("p", p, record | {"time": 2})])
    assert whole.current == pytest.approx((s.current + p.current) / 2, rel=1e-12)
    assert (whole.gain, whole.quality_flag, kept["time"]) == (1e6, 8, 1)
    assert [part["polarization"] for part in kept["parts"]] == ["s", "p"]


def test_both_halves_of_the_light_make_up_the_whole() -> None:
    amplitude = 0.03
    for zenith, azimuth in ((0.0, 0.0), (40.0, 0.0), (70.0, 30.0), (80.0, 90.0)):
        halves = sum(behind_polarizer(angle, zenith, azimuth, amplitude) for angle in (0.0, 90.0))
        assert halves == pytest.approx(TRANSMISSION * response(DEGREE * amplitude, zenith, azimuth), rel=1e-12)
