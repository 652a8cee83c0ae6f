"""Every fault that the simulated laboratory can make, in mid-scan, on real wires with the drivers of the product.

After each the truth of the bench is compared with what the scan recorded: the position of every arm at every point,
the motion commands that the devices saw, and whether the end was safe. The list is :mod:`reliability_list`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from reliability_list import AXES, USE, Fault, faults

import instrument.session
from drivers.interfaces import Laboratory
from instrument.events import Event, Message, PointMeasured, PointStarted, StateChanged
from instrument.journal import read_journal
from instrument.session import ScanRequest, ScanSession
from instrument.settings import ScanSettings
from sim_fixtures.laboratory import SimulatedLaboratory, start_simulated

__all__ = ["Fault", "fault_trial", "faults"]
#: Laboratory seconds a second; slower where an arm has to be struck while it moves.
SPEED, SLOW = 200.0, 25.0
SETTINGS = ScanSettings(dwell=5.0, suspend_limit_wall=60.0, look_wall=0.5, relight="self", disk_reserve=0.0)
PLAN = """
version = 1
title = "fault trial"
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0, 30.0]
sensor_azimuth = [60.0, 90.0]
sensor_zenith = [40.0, 20.0]
"""
#: An arm is where the record says within this, degree: the widest tolerance, and the step of its encoder.
CLOSE = 0.031
Control = Callable[..., Any]
Row = dict[str, Any]


@dataclass
class Seen:
    """What one trial has shown.

    Attributes
    ----------
    wrong, told
        What must not be, and what a person was told.
    intended
        Motion commands that the scan has given to the drivers.
    struck
        Whether the fault has come yet; ``under_way`` whether the arm moved then.
    """

    wrong: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    intended: int = 0
    begun: bool = False
    struck: bool = False
    under_way: bool = False


def fault_trial(folder: Path, chosen: list[Fault], report: Callable[[Row], None] = print) -> list[Row]:
    """Run one short scan a fault; the laboratory stays where a fault leaves nothing behind.

    Parameters
    ----------
    report
        Gets each result at once, so that a trial that is cut short keeps what it has.
    """
    results: list[Row] = []
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plan.toml").write_text(PLAN)
    with ExitStack() as stack:
        laboratory: SimulatedLaboratory | None = None
        kind = ("", 0.0)
        for number, fault in enumerate(chosen):
            before, kind = kind, (fault.arms, SLOW if fault.moment == "moving" else SPEED)
            if laboratory is not None and kind != before:
                laboratory.close()
                laboratory = None
            if laboratory is None:
                place = folder / f"laboratory-{number}"
                place.mkdir()
                laboratory = stack.enter_context(start_simulated(place, speed=kind[1], flux="lambertian"))
            results.append(_trial(folder / f"run-{number}", folder / "plan.toml", laboratory, fault))
            report(results[-1])
            if fault.renew or results[-1]["wrong"]:
                laboratory.close()
                laboratory = None
    return results


def _trial(run: Path, plan: Path, laboratory: SimulatedLaboratory, fault: Fault) -> Row:
    seen, control = Seen(), laboratory.control
    inputs = laboratory.inputs
    name = "devices.toml" if fault.arms == "main" else "devices-esp301.toml"
    devices = inputs.devices.with_name(name)
    request = ScanRequest(plan=plan, devices=devices, facility=inputs.facility, out=run, twin=False)
    row: Row = {"device": fault.device, "family": fault.family, "fault": fault.name}
    commands = sum(control("motion_commands").values())
    control("mount", what="reference")
    with ExitStack() as stack:
        stack.enter_context(_struck(seen, control, fault))
        session = ScanSession(request, laboratory.operator, SETTINGS)
        stack.enter_context(session)
        _watch(session, control, fault, seen)
        began = time.monotonic()
        session.start()
        end = session.wait(400.0)
        if end is None:
            return row | {"outcome": "hangs", "wrong": ["the scan hangs"]}
        wall = time.monotonic() - began
        state = control("state")
    sent = sum(control("motion_commands").values()) - commands
    if end.outcome != "finished":
        seen.told.append(end.reason)
    _judge(seen, fault, end.outcome, end.total - end.done, sent, state)
    return row | {
        "outcome": end.outcome,
        "lost": end.total - end.done,
        "suspended": _suspensions(seen, run, end.total),
        "intended": seen.intended,
        "on_the_wire": sent,
        "wall_s": round(wall, 1),
        "told": (seen.told[0] if seen.told else "").replace(f"{inputs.devices.parent}{os.sep}", ""),
        "wrong": seen.wrong,
    }


def _suspensions(seen: Seen, run: Path, total: int) -> int:
    """How often the scan rested by itself; every point has to be accounted for in its journal."""
    journal = read_journal(run)
    ended = next(record for record in reversed(journal.others) if record["kind"] == "ended")
    if sorted([*journal.points, *journal.skipped, *ended["not_reached"]]) != list(range(total)):
        seen.wrong.append("a point is not accounted for")
    return sum(record.get("new") == "suspended" for record in journal.others)


def _judge(seen: Seen, fault: Fault, outcome: str, lost: int, sent: int, state: dict[str, Any]) -> None:
    if not seen.struck:
        seen.wrong.append("the fault never came")
    if fault.moment == "moving" and not seen.under_way:
        seen.wrong.append("the arm did not move when the fault came")
    if outcome not in fault.outcomes:
        seen.wrong.append(f"ended as {outcome}")
    if lost > fault.lost:
        seen.wrong.append(f"lost {lost} points")
    if sent > seen.intended:
        seen.wrong.append(f"{sent} motion commands on the wire for {seen.intended} intended")
    moving = [name for name, axis in state["axes"].items() if axis["moving"]]
    if state["emission"] or state["shutter_open"] or moving:
        seen.wrong.append(f"no safe end: emission {state['emission']}, shutter {state['shutter_open']}, {moving}")
    if outcome == "faulted" and not any(fault.device in told for told in seen.told):
        seen.wrong.append("no message names the device")


def _watch(session: ScanSession, control: Control, fault: Fault, seen: Seen) -> None:
    """Strike, put right, and compare record and truth; on the engine's thread, before it goes on."""
    publish = session.bus.publish

    def watched(event: Event) -> None:
        publish(event)
        if isinstance(event, PointStarted) and event.index == 1:
            seen.begun = True
            if fault.moment == "point":
                _strike(seen, control, fault)
        if isinstance(event, StateChanged) and event.new == "suspended" and fault.after is not None:
            control(fault.after[0], **fault.after[1])
        if isinstance(event, Message) and event.level != "info":
            seen.told.append(event.text)
        if isinstance(event, PointMeasured):
            axes = control("state")["axes"]
            for name in AXES:
                truth, wanted = axes[name]["true_position"], getattr(event.geometry, name)
                if abs(truth - wanted) > CLOSE:
                    seen.wrong.append(f"point {event.index}: {name} stood at {truth:.3f}, recorded at {wanted:g}")

    session.bus.publish = watched  # type: ignore[method-assign]


def _strike(seen: Seen, control: Control, fault: Fault) -> None:
    if seen.struck:
        return
    seen.struck = True
    if fault.moment == "moving":
        seen.under_way = control("state")["axes"][fault.device]["moving"]
    control(fault.action, **fault.arguments)


class _struck:
    """Counts the motion commands that the scan gives to the drivers, and strikes at the call that a fault names."""

    def __init__(self, seen: Seen, control: Control, fault: Fault) -> None:
        self._seen, self._control, self._fault = seen, control, fault
        self._connect = instrument.session.connect

    def __enter__(self) -> None:
        def connecting(*arguments: Any) -> Laboratory:
            laboratory = self._connect(*arguments)
            for axis in laboratory.axes().values():
                for method in ("start_move", "home"):
                    setattr(axis, method, partial(self._count, getattr(axis, method)))
            if self._fault.moment in ("use", "moving"):
                device, method = laboratory.devices()[self._fault.device], USE[self._fault.device]
                setattr(device, method, partial(self._call, getattr(device, method)))
            return laboratory

        instrument.session.connect = connecting

    def __exit__(self, *_: object) -> None:
        instrument.session.connect = self._connect

    def _count(self, command: Callable[..., None], *arguments: float) -> None:
        self._seen.intended += 1
        command(*arguments)

    def _call(self, call: Callable[..., Any], *arguments: Any) -> Any:
        if self._seen.begun and self._fault.moment == "use":
            _strike(self._seen, self._control, self._fault)
        result = call(*arguments)
        if self._seen.begun and self._fault.moment == "moving":
            _strike(self._seen, self._control, self._fault)
        return result
