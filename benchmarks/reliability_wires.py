"""Scans of a laboratory on real wires that are killed (SIGKILL) at random moments and resumed.

The laboratory, its source's watchdog included, lives in a process of its own and goes on while nobody drives it; the
scan speaks to it over pseudo-terminals and TCP, as to hardware.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from reliability_alike import Uninterrupted, farthest_allowed, together_wrong, uninterrupted
from reliability_crash import forked, killed, status_of
from reliability_faults import CLOSE, PLAN
from reliability_list import AXES

from drivers.configuration import planned, read_devices
from instrument.budget import point_budget
from instrument.events import Event, PointMeasured
from instrument.facility import read_facility
from instrument.journal import JOURNAL_NAME, read_journal
from instrument.session import ScanRequest, ScanSession
from instrument.settings import ScanSettings
from sim_fixtures.control import ControlClient
from sim_fixtures.laboratory import SimulatedLaboratory, SimulatedOperator, start_simulated

#: Slow enough that some kills meet an arm under way.
SPEED = 50.0
#: Wall-clock s after which the source goes dark by itself, and the extra that a busy machine gets.
WATCHDOG, PATIENCE = 2, 1.0
SETTINGS = ScanSettings(dwell=5.0, keep_alive_wall=0.5, look_wall=0.5, relight="self", disk_reserve=0.0)
#: Exit status of a scan that recorded an arm where it was not.
LIED = 5


def wire_trial(
    folder: Path,
    runs: int,
    before: dict[str, Any] | None = None,
    keep: Callable[[dict[str, Any]], None] = lambda _: None,
    most_kills: int = 2,
    whole: int = 12,
) -> dict[str, Any]:
    """Kill scans, look at the laboratory that is left alone, and let them finish.

    Parameters
    ----------
    runs, most_kills
        Scans, and how often each is killed at most.
    before
        What earlier scans have shown: these are added.
    keep
        Gets what is known after each scan, so that a trial that is cut short keeps it.
    whole
        Uninterrupted scans, with whose mean every point of a resumed one is compared.
    """
    found: dict[str, Any] = before or {"trials": 0, "watchdog_s": WATCHDOG, "wrong": [], "off": []}
    found = {"kills": 0, "emitting": 0, "moving": 0, "dark_after_s": 0.0, **found}
    draw = random.Random(3 + found["trials"])
    folder.mkdir(parents=True)
    (folder / "plan.toml").write_text(PLAN)
    (folder / "laboratory").mkdir()
    seed = 1 + found["trials"]
    with start_simulated(folder / "laboratory", speed=SPEED, seed=seed, flux="lambertian") as laboratory:
        _quicken(laboratory)
        planned(read_devices(laboratory.inputs.devices))  # loads the drivers once, for every child
        began = time.monotonic()
        for number in range(whole):
            if status := _end(folder / f"whole-{number}", folder, laboratory):
                return found | {"wrong": [f"an uninterrupted scan ended with {status}"]}
        took = (time.monotonic() - began) / whole
        currents = [_currents(folder / f"whole-{number}") for number in range(whole)]
        expected = uninterrupted(currents, _stated(folder / "whole-0", laboratory))
        found |= {"whole": whole, "scatter": round(expected.scatter, 3), "freedom": expected.freedom}
        found["wrong"] += expected.wrong()
        found["allowed"] = round(farthest_allowed((found["trials"] + runs) * len(expected.mean)), 2)
        for number in range(runs):
            run = folder / f"run-{number}"
            for _ in range(draw.randint(1, most_kills)):
                if not _kill(run, folder, laboratory, draw.uniform(0.3, took), found):
                    break
            _finish(run, folder, laboratory, expected, found)
            found["trials"] += 1
            keep(found)
        if found["off"]:
            found["wrong"] += together_wrong(found["off"], whole, len(expected.mean))
    return found


def _kill(run: Path, folder: Path, laboratory: SimulatedLaboratory, moment: float, found: dict[str, Any]) -> bool:
    """Kill a scan after so many seconds; False where it ended before. Then the laboratory has to end safe by itself."""
    process = forked(lambda: _scan(run, folder, laboratory))
    time.sleep(moment)
    under_way = _moving(laboratory.control("state"))
    if found["kills"] % 2:  # every other kill waits for an arm to be under way
        until = time.monotonic() + 3.0
        while time.monotonic() < until and not under_way:
            time.sleep(0.002)
            under_way = _moving(laboratory.control("state"))
    if not killed(process, time.monotonic()):
        return False
    state, began = laboratory.control("state"), time.monotonic()
    found["kills"] += 1
    found["emitting"] += state["emission"]
    found["moving"] += bool(under_way)
    while state["emission"] and time.monotonic() - began < WATCHDOG + PATIENCE:
        time.sleep(0.02)
        state = laboratory.control("state")
    found["dark_after_s"] = round(max(found["dark_after_s"], time.monotonic() - began), 2)
    if state["emission"]:
        found["wrong"].append(f"{run.name}: the source still emits after {WATCHDOG + PATIENCE:g} s")
    if _moving(state):
        # A motion command already on its way is carried out; it leads along a checked path and then ends.
        time.sleep(20.0 / SPEED)
        if _moving(laboratory.control("state")):
            found["wrong"].append(f"{run.name}: an arm still moves")
    return True


def _moving(state: dict[str, Any]) -> list[str]:
    return [name for name, axis in state["axes"].items() if axis["moving"]]


def _finish(
    run: Path, folder: Path, laboratory: SimulatedLaboratory, expected: Uninterrupted, found: dict[str, Any]
) -> None:
    wrong = found["wrong"]
    if status := _end(run, folder, laboratory):
        lied = status == LIED
        wrong.append(f"{run.name}: " + ("an arm was not where it was recorded" if lied else _reason(run).read_text()))
        return
    state = laboratory.control("state")
    if state["emission"] or state["shutter_open"] or _moving(state):
        wrong.append(f"{run.name}: no safe end")
    lines = (run / JOURNAL_NAME).read_bytes().splitlines()
    indices = sorted(record["index"] for record in map(json.loads, lines) if record["kind"] == "point")
    if indices != sorted(expected.mean):
        wrong.append(f"{run.name}: points {indices}")
    off = expected.off(_currents(run))
    found["off"] += [round(value, 2) for value in off.values()]
    wrong += [
        f"{run.name}: point {index} lies {value:+.2f} standard deviations off, allowed {found['allowed']:.2f}"
        for index, value in off.items()
        if abs(value) > found["allowed"]
    ]


def _quicken(laboratory: SimulatedLaboratory) -> None:
    """A watchdog that does not keep the trial waiting."""
    devices = laboratory.inputs.devices
    text = devices.read_text()
    if "watchdog = 20" not in text:
        raise RuntimeError(f"{devices}: no watchdog to be set")
    devices.write_text(text.replace("watchdog = 20", f"watchdog = {WATCHDOG}"))


def _end(run: Path, folder: Path, laboratory: SimulatedLaboratory) -> int:
    return status_of(forked(lambda: _scan(run, folder, laboratory)))


def _scan(run: Path, folder: Path, laboratory: SimulatedLaboratory) -> None:
    """Begin a scan or go on with it; every point is compared with where the arms truly stand."""
    try:
        _scanned(run, folder, laboratory)
    except BaseException as error:
        _reason(run).write_text(f"{type(error).__name__}: {error}")
        raise


def _reason(run: Path) -> Path:
    """Where a scan leaves why it ended early."""
    return run.with_suffix(".txt")


def _scanned(run: Path, folder: Path, laboratory: SimulatedLaboratory) -> None:
    control = ControlClient(laboratory.endpoints["control"])
    devices, facility = laboratory.inputs.devices, laboratory.inputs.facility
    # A folder that was made without a single line of a journal holds no run yet.
    begun = (run / JOURNAL_NAME).exists() and b"\n" in (run / JOURNAL_NAME).read_bytes()
    request = (
        ScanRequest(resume=run, devices=devices, twin=False)
        if begun
        else ScanRequest(plan=folder / "plan.toml", devices=devices, facility=facility, out=_free(run), twin=False)
    )
    with ExitStack() as stack:
        session = ScanSession(request, SimulatedOperator(control), SETTINGS)
        stack.enter_context(session)
        lies = _watch(session, control)
        session.start()
        end = session.wait(300.0)
    if lies:
        os._exit(LIED)
    if end is None or end.outcome != "finished":
        raise RuntimeError(f"{end}")


def _free(run: Path) -> Path:
    if run.exists() and not (run / JOURNAL_NAME).exists():
        return run
    if run.exists():
        (run / JOURNAL_NAME).unlink()
    return run


def _watch(session: ScanSession, control: ControlClient) -> list[str]:
    publish, lies = session.bus.publish, []

    def watched(event: Event) -> None:
        publish(event)
        if isinstance(event, PointMeasured):
            axes = control("state")["axes"]
            off = {name: axes[name]["true_position"] - getattr(event.geometry, name) for name in AXES}
            lies.extend(f"{name}: {by:+.3f}" for name, by in off.items() if abs(by) > CLOSE)

    session.bus.publish = watched  # type: ignore[method-assign]
    return lies


def _currents(run: Path) -> dict[int, float]:
    """Photocurrent (A) of every point at the source's full power."""
    return {
        index: (sum(point["signal"]) / len(point["signal"]) - point["dark"]) / point["gain"] / point["source_power"]
        for index, point in read_journal(run).points.items()
    }


def _stated(run: Path, laboratory: SimulatedLaboratory) -> dict[int, float]:
    """Relative standard deviation of a reading of every point, as the facility states it."""
    budget = read_facility(laboratory.inputs.facility).budget
    geometries = {index: point["geometry"] for index, point in read_journal(run).points.items()}
    return {
        index: float(point_budget(budget, at["illumination_zenith"], at["sensor_zenith"], 1.0)["u_brf_noise"])
        for index, at in geometries.items()
    }
