"""A scan on the hand-written devices: plan, facility, engine, and what happened."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fake_bench import Bench

from instrument.bus import EventBus
from instrument.dataset import run_of_journal, write_run
from instrument.engine import ScanEngine
from instrument.events import Event, ScanEnded
from instrument.facility import Arms, Beam, Budget, Facility, Reference, SamplePlacement, Sensor
from instrument.job import ScanFiles, ScanJob
from instrument.journal import Journal, JournalContent, read_journal
from instrument.plan import Plan, PlanForm, make_plan
from instrument.settings import AcquisitionSettings, MotionSettings, ScanSettings

FACILITY = Facility(
    name="bench in memory",
    beam=Beam(diameter=10.8, profile="tophat"),
    sensor=Sensor(target_diameter=10.8, mirror_diameter=10.8),
    arms=Arms(),
    sample=SamplePlacement(),
    reference=Reference(reflectance_factor=0.99, u_relative=0.005),
    budget=Budget(measurement_noise=(0.005, 0.007), instrument_stability=0.008, reference_material=0.005),
)
QUICK = ScanSettings(
    dwell=5.0,
    keep_alive_wall=0.005,
    heartbeat_wall=5.0,
    suspend_limit_wall=5.0,
    look_wall=0.01,
    disk_reserve=0.0,
    motion=MotionSettings(wire_wall=0.02, poll_wall=0.0005),
    acquisition=AcquisitionSettings(settling=0.2),
)


def plan_of(
    illumination: tuple[float, ...] = (0.0,),
    azimuth: tuple[float, ...] = (0.0,),
    zenith: tuple[float, ...] = (30.0, 20.0, 10.0),
    wavelength: tuple[float, ...] = (500.0,),
) -> Plan:
    grid = {
        "wavelength": wavelength,
        "illumination_zenith": illumination,
        "sensor_azimuth": azimuth,
        "sensor_zenith": zenith,
    }
    return make_plan(PlanForm.model_validate({"version": 1, "title": "test", "grid": (grid,)}), FACILITY, "plan.toml")


class BenchOperator:
    """Changes the sample at once, unless told to wait or to give up."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.ready = threading.Event()
        self.ready.set()
        self.gives_up = False

    def mount(self, what: str) -> None:
        self.ready.wait(10.0)
        if self.gives_up:
            raise KeyboardInterrupt
        self.bench.mount(what)


@dataclass
class Stage:
    """An engine on a bench, and everything it said."""

    bench: Bench
    engine: ScanEngine
    bus: EventBus
    operator: BenchOperator
    run_dir: Path

    def run(self, timeout: float = 30.0) -> ScanEnded:
        self.engine.start()
        return self.ended(timeout)

    def ended(self, timeout: float = 30.0) -> ScanEnded:
        end = self.engine.wait(timeout)
        assert end is not None, f"the scan hangs in state {self.engine.state}"
        assert self.bus.drain(10.0)
        self.bus.close()
        return end

    def events(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.bus.history if isinstance(event, kind)]

    def journal(self) -> JournalContent:
        return read_journal(self.run_dir)

    def when(self, matches: Any, act: Any) -> None:
        """Do something, once, when an event comes, before the engine goes on: no busy machine changes what happens."""
        publish, done = self.bus.publish, threading.Event()

        def watched(event: Event) -> None:
            publish(event)
            if not done.is_set() and matches(event):
                done.set()
                act()

        self.bus.publish = watched  # type: ignore[method-assign]


def stage(
    tmp_path: Path,
    plan: Plan | None = None,
    bench: Bench | None = None,
    settings: ScanSettings = QUICK,
    facility: Facility = FACILITY,
    run_file: bool = False,
) -> Stage:
    """Set up a scan; one that goes on where ``tmp_path`` holds a journal already.

    A run file takes longer to write than everything else, so it is made where a test asks for one.
    """
    plan, bench, bus = plan or plan_of(), bench or Bench(), EventBus()
    previous = None
    if (tmp_path / "journal.jsonl").exists():
        previous = read_journal(tmp_path)
        journal = Journal.reopen(tmp_path)
    else:
        journal = Journal.create(tmp_path, _header(plan, facility, bench))

    def derive() -> Path | None:
        content = read_journal(tmp_path)
        if not run_file or not content.points:
            return None
        write_run(run_of_journal(content), tmp_path / "run.nc")
        return tmp_path / "run.nc"

    operator = BenchOperator(bench)
    job = ScanJob(
        plan,
        facility,
        bench.laboratory,
        bench.clock,
        journal,
        operator,
        ScanFiles(tmp_path),
        previous,
        derive,
        settings,
    )
    return Stage(bench, ScanEngine(job, bus), bus, operator, tmp_path)


def _header(plan: Plan, facility: Facility, bench: Bench) -> dict[str, Any]:
    import tomli_w

    return {
        "created": bench.clock.now(),
        "title": plan.title,
        "plan": "version = 1",
        "facility": tomli_w.dumps(facility.model_dump(exclude_none=True)),
        "samples": plan.samples,
        "scan_direction": plan.direction,
        "points": len(plan),
        "software_version": "test",
    }
