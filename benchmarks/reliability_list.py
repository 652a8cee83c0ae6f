"""The list of faults that the fault trial goes through: every kind of device, everything that a wire can do."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

AXES = ("illumination_zenith", "sensor_azimuth", "sensor_zenith")
#: The call in which each device is struck: one that every point makes.
USE = {
    **dict.fromkeys(AXES, "start_move"),
    "source": "fault",
    "selector": "wavelength",
    "detector": "read",
    "amplifier": "overload",
    "shutter": "open",
}
#: What the motion command of each family looks like on its wire.
MOTION = {
    ("main", "sensor_azimuth"): "1PA",
    ("main", "sensor_zenith"): "2PA",
    ("main", "illumination_zenith"): "\x10\x00\x58",
    ("esp301", "sensor_azimuth"): "1PA",
    ("esp301", "sensor_zenith"): "2PA",
    ("esp301", "illumination_zenith"): "3PA",
}
DRIVERS = {
    ("main", "illumination_zenith"): "AZ",
    ("main", "sensor_azimuth"): "SMC100",
    ("main", "sensor_zenith"): "SMC100",
    **{("esp301", axis): "ESP301" for axis in AXES},
    ("main", "source"): "SuperK",
    ("main", "selector"): "SELECT",
    ("main", "detector"): "34465A",
    ("main", "amplifier"): "FEMTO",
    ("main", "shutter"): "Modbus I/O",
}


@dataclass(frozen=True)
class Fault:
    """What happens after the second point has begun, and what has to come of it.

    Attributes
    ----------
    moment
        ``point`` strikes as the point begins, ``use`` as the device is next used (:data:`USE`), ``moving`` once the
        arm has begun its next move.
    outcomes
        How the scan may end.
    lost
        How many of the eight points it may cost at most.
    after
        What puts the laboratory right when the scan rests; where nothing does, it is started anew afterwards.
    arms
        Which controllers drive the arms: ``main`` (SMC100 and AZ) or ``esp301``.
    """

    name: str
    device: str
    action: str
    arguments: dict[str, Any] = field(default_factory=dict)
    moment: str = "point"
    outcomes: tuple[str, ...] = ("finished",)
    lost: int = 0
    after: tuple[str, dict[str, Any]] | None = None
    renew: bool = False
    arms: str = "main"

    @property
    def family(self) -> str:
        """The kind of device."""
        return DRIVERS[self.arms, self.device]

    @property
    def line(self) -> str:
        """Role or line whose wire is struck."""
        return self.arms if self.arms == "esp301" else self.device


def faults() -> list[Fault]:
    """The whole list."""
    made = [fault for device in USE for fault in wire_faults(device)]
    for axis in AXES:
        made += motion_faults(axis, "main")
    made += wire_faults("sensor_zenith", "esp301")
    for axis in AXES:
        made += motion_faults(axis, "esp301")
    made += [
        Fault("interlock opened, then closed", "source", "open_interlock", after=("close_interlock", {})),
        Fault("telegrams answered with busy", "source", "busy", {"count": 3}, "use"),
        Fault("blade sticks shut", "shutter", "stick_shutter", {}, "point", ("faulted", "finished"), 7, renew=True),
    ]
    return made


def wire_faults(device: str, arms: str = "main") -> list[Fault]:
    """What any wire can do, to one device."""
    line = {"device": "esp301" if arms == "esp301" else device}
    made = [
        ("one reply lost", "drop_replies", line),
        ("two replies lost", "drop_replies", {**line, "count": 2}),
        ("one request lost", "lose_requests", line),
        ("one reply garbled", "corrupt_reply", line),
        ("one reply late", "late_reply", {**line, "delay": 1.5}),
        ("one reply in two pieces", "split_reply", {**line, "delay": 0.1}),
        ("two replies in one", "merge_replies", line),
        ("cable out for ten seconds", "disconnect", {**line, "seconds": 10.0}),
    ]
    if DRIVERS[arms, device] in ("AZ", "FEMTO", "Modbus I/O"):
        made.append(("answered by the exception busy", "refuse_requests", line))
        made.append(("answered by the exception device failure", "deny_requests", line))
    if DRIVERS[arms, device] not in ("ESP301", "34465A"):  # nothing but their wire tells whose reply it is
        made.append(("another unit answers", "stray_reply", line))
    # A device that says that it has failed is believed: the point is given up.
    lost = {"deny_requests": 1}
    return [
        Fault(name, device, action, given, "use", lost=lost.get(action, 0), arms=arms) for name, action, given in made
    ]


def motion_faults(axis: str, arms: str) -> list[Fault]:
    """What can befall a move of one arm."""
    line = {"device": "esp301" if arms == "esp301" else axis}
    command = {**line, "only": MOTION[arms, axis]}
    made = [
        Fault("motion command lost on its way", axis, "lose_requests", command, "use"),
        Fault("reply lost in mid-move", axis, "drop_replies", line, "moving"),
        Fault("cable out for ten seconds in mid-move", axis, "disconnect", {**line, "seconds": 10.0}, "moving"),
        Fault("stall half-way", axis, "stall", {"axis": axis}, lost=1, renew=True),
        Fault("alarm of the drive", axis, "alarm", {"axis": axis}, "point", ("faulted",), 7, renew=True),
        Fault("alarm of the drive in mid-move", axis, "alarm", {"axis": axis}, "moving", ("faulted",), 7, renew=True),
        Fault(
            "limit switch in mid-move",
            axis,
            "limit_switch",
            {"axis": axis, "direction": 1},
            "moving",
            ("faulted", "finished"),
            7,
            renew=True,
        ),
    ]
    if DRIVERS[arms, axis] == "AZ":
        made.append(Fault("motion command answered by the exception busy", axis, "refuse_requests", command, "use"))
        failure = "motion command answered by the exception device failure"
        made.append(Fault(failure, axis, "deny_requests", command, "use", lost=1))
    else:
        made.append(
            Fault("motion command arrives with another number", axis, "mislead_requests", command, "use", lost=1)
        )
    return [replace(fault, arms=arms) for fault in made]
