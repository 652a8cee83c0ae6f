"""Every fault that the simulated laboratory can make, in mid-scan, on real wires with the drivers of the product.

After each the truth of the bench is compared with what the scan recorded: the position of every arm at every point,
the motion commands that the devices saw, and whether the end was safe.
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

import instrument.session
from drivers.interfaces import Laboratory
from instrument.events import Event, Message, PointMeasured, PointStarted, StateChanged
from instrument.journal import read_journal
from instrument.session import ScanRequest, ScanSession
from instrument.settings import ScanSettings
from sim_fixtures.laboratory import SimulatedLaboratory, start_simulated

SPEED = 200.0
SETTINGS = ScanSettings(suspend_limit_wall=60.0, look_wall=0.5, relight="self", disk_reserve=0.0)
PLAN = """
version = 1
title = "fault trial"
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0, 30.0]
sensor_azimuth = [60.0, 90.0]
sensor_zenith = [40.0, 20.0]
"""
AXES = ("illumination_zenith", "sensor_azimuth", "sensor_zenith")
#: An arm is where the record says within this, degree: the widest tolerance, and the step of its encoder.
CLOSE = 0.031


@dataclass(frozen=True)
class Fault:
    """What happens when the second point begins, and what has to come of it.

    Attributes
    ----------
    outcomes
        How the scan may end.
    lost
        How many of the eight points it may cost at most.
    after
        What puts the laboratory right when the scan rests; where nothing does, it is started anew afterwards.
    """

    name: str
    device: str
    strike: tuple[str, dict[str, Any]]
    outcomes: tuple[str, ...] = ("finished",)
    lost: int = 0
    after: tuple[str, dict[str, Any]] | None = None
    renew: bool = False


def faults() -> list[Fault]:
    """The whole list."""
    made = []
    for device in (*AXES, "source", "selector", "detector", "amplifier", "shutter"):
        wire = {"device": device}
        made += [
            Fault("one reply lost", device, ("drop_replies", wire)),
            Fault("two replies lost", device, ("drop_replies", {**wire, "count": 2})),
            Fault("one request lost", device, ("lose_requests", wire)),
            Fault("one reply garbled", device, ("corrupt_reply", wire)),
            Fault("one reply late", device, ("late_reply", {**wire, "delay": 1.5})),
            Fault("cable out for ten seconds", device, ("disconnect", {**wire, "seconds": 10.0})),
        ]
    for axis in AXES:
        made += [
            Fault("stall half-way", axis, ("stall", {"axis": axis}), lost=1, renew=True),
            Fault("alarm of the drive", axis, ("alarm", {"axis": axis}), ("faulted",), lost=7, renew=True),
            Fault(
                "limit switch",
                axis,
                ("limit_switch", {"axis": axis, "direction": 1}),
                ("faulted", "finished"),
                7,
                renew=True,
            ),
        ]
    made += [
        Fault("interlock opened, then closed", "source", ("open_interlock", {}), after=("close_interlock", {})),
        Fault("telegrams answered with busy", "source", ("busy", {"count": 3})),
        Fault("blade sticks shut", "shutter", ("stick_shutter", {}), ("faulted", "finished"), 7, renew=True),
    ]
    return made


@dataclass
class Seen:
    """What one trial has shown."""

    wrong: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    intended: int = 0


def fault_trial(folder: Path, chosen: list[Fault], report: Callable[[str], None] = print) -> list[dict[str, Any]]:
    """Run one short scan a fault; the laboratory stays where a fault leaves nothing behind."""
    results: list[dict[str, Any]] = []
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plan.toml").write_text(PLAN)
    with ExitStack() as stack:
        laboratory: SimulatedLaboratory | None = None
        for number, fault in enumerate(chosen):
            if laboratory is None:
                place = folder / f"laboratory-{number}"
                place.mkdir()
                laboratory = stack.enter_context(start_simulated(place, speed=SPEED, flux="lambertian"))
            results.append(_trial(folder / f"run-{number}", folder / "plan.toml", laboratory, fault))
            report(f"{fault.device}: {fault.name}: {results[-1]}")
            if fault.renew or results[-1]["wrong"]:
                laboratory.close()
                laboratory = None
    return results


def _trial(run: Path, plan: Path, laboratory: SimulatedLaboratory, fault: Fault) -> dict[str, Any]:
    seen, control = Seen(), laboratory.control
    inputs = laboratory.inputs
    request = ScanRequest(plan=plan, devices=inputs.devices, facility=inputs.facility, out=run, twin=False)
    commands = sum(control("motion_commands").values())
    control("mount", what="reference")
    with ExitStack() as stack:
        stack.enter_context(_counted(seen))
        session = ScanSession(request, laboratory.operator, SETTINGS)
        stack.enter_context(session)
        _watch(session, control, fault, seen)
        began = time.monotonic()
        session.start()
        end = session.wait(400.0)
        if end is None:
            return {"device": fault.device, "fault": fault.name, "outcome": "hangs", "wrong": ["the scan hangs"]}
        wall = time.monotonic() - began
        state = control("state")
    sent = sum(control("motion_commands").values()) - commands
    if end.outcome != "finished":
        seen.told.append(end.reason)
    _judge(seen, fault, end.outcome, end.total - end.done, sent, state)
    journal = read_journal(run)
    ended = next(record for record in reversed(journal.others) if record["kind"] == "ended")
    if sorted([*journal.points, *journal.skipped, *ended["not_reached"]]) != list(range(end.total)):
        seen.wrong.append("a point is not accounted for")
    return {
        "device": fault.device,
        "fault": fault.name,
        "outcome": end.outcome,
        "lost": end.total - end.done,
        "suspended": sum(record.get("new") == "suspended" for record in journal.others),
        "intended": seen.intended,
        "on_the_wire": sent,
        "wall_s": round(wall, 1),
        "told": (seen.told[0] if seen.told else "").replace(f"{inputs.devices.parent}{os.sep}", ""),
        "of": len(faults()),
        "wrong": seen.wrong,
    }


def _judge(seen: Seen, fault: Fault, outcome: str, lost: int, sent: int, state: dict[str, Any]) -> None:
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


def _watch(session: ScanSession, control: Callable[..., Any], fault: Fault, seen: Seen) -> None:
    """Strike, put right, and compare record and truth; on the engine's thread, before it goes on."""
    publish, struck = session.bus.publish, []

    def watched(event: Event) -> None:
        publish(event)
        if isinstance(event, PointStarted) and event.index == 1 and not struck:
            struck.append(True)
            control(fault.strike[0], **fault.strike[1])
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


class _counted:
    """Counts the motion commands that the scan intends: calls of the drivers, before any byte is on a wire."""

    def __init__(self, seen: Seen) -> None:
        self._seen, self._connect = seen, instrument.session.connect

    def __enter__(self) -> None:
        def counting(*arguments: Any) -> Laboratory:
            laboratory = self._connect(*arguments)
            for axis in laboratory.axes().values():
                for method in ("start_move", "home"):
                    setattr(axis, method, partial(self._count, getattr(axis, method)))
            return laboratory

        instrument.session.connect = counting

    def __exit__(self, *_: object) -> None:
        instrument.session.connect = self._connect

    def _count(self, command: Callable[..., None], *arguments: float) -> None:
        self._seen.intended += 1
        command(*arguments)
