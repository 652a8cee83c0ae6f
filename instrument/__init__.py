"""What a scan is: plan, states, safety, calibration, uncertainty, records.

The names of ``__all__`` are the surface for programs of others (docs/library.md); each is loaded when it is first
asked for, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from instrument.surface import surface

if TYPE_CHECKING:
    from instrument.artifact import ArtifactDimensions, read_artifact
    from instrument.dataset import capabilities, read_prediction, read_run, rebuild_run, write_prediction, write_run
    from instrument.errors import InputError, SafetyError
    from instrument.events import Event, Geometry
    from instrument.facility import Facility, read_facility
    from instrument.operators import Operator
    from instrument.plan import Plan, make_plan, read_plan
    from instrument.request import ScanRequest
    from instrument.session import ScanSession
    from instrument.settings import ScanSettings

#: Where each name lives.
_HOMES = {
    "artifact": ("ArtifactDimensions", "read_artifact"),
    "dataset": ("capabilities", "read_prediction", "read_run", "rebuild_run", "write_prediction", "write_run"),
    "errors": ("InputError", "SafetyError"),
    "events": ("Event", "Geometry"),
    "facility": ("Facility", "read_facility"),
    "operators": ("Operator",),
    "plan": ("Plan", "make_plan", "read_plan"),
    "request": ("ScanRequest",),
    "session": ("ScanSession",),
    "settings": ("ScanSettings",),
}

__all__ = [
    "ArtifactDimensions",
    "Event",
    "Facility",
    "Geometry",
    "InputError",
    "Operator",
    "Plan",
    "SafetyError",
    "ScanRequest",
    "ScanSession",
    "ScanSettings",
    "capabilities",
    "make_plan",
    "read_artifact",
    "read_facility",
    "read_plan",
    "read_prediction",
    "read_run",
    "rebuild_run",
    "write_prediction",
    "write_run",
]

__getattr__, __dir__ = surface(globals(), _HOMES)
