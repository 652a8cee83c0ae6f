"""What the side of the window that runs the session tells the model, beside the engine's own events."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from instrument.operators import Mounted
from instrument.prompts import Prompt


@dataclass(frozen=True)
class ControllerStarting:
    """The session is being set up: processes start, devices are connected."""


@dataclass(frozen=True)
class ControllerFailed:
    """The session could not start, or ended with an error that is none of the engine's states."""

    time: datetime
    text: str
    advice: str = ""


@dataclass(frozen=True)
class ControllerClosed:
    """Every device is released; another scan may start."""


@dataclass(frozen=True)
class OperatorAsked:
    """The engine waits until a person has put something on the stage, or has done another step."""

    what: Mounted | Prompt


@dataclass(frozen=True)
class OperatorAnswered:
    """The person has answered; the engine goes on."""


@dataclass(frozen=True)
class ProcedureStarted:
    """A procedure has the instrument: a calibration, the alignment."""

    title: str


@dataclass(frozen=True)
class ProcedureEnded:
    """The procedure is over, the instrument is free."""


Notice = (
    ControllerStarting
    | ControllerFailed
    | ControllerClosed
    | OperatorAsked
    | OperatorAnswered
    | ProcedureStarted
    | ProcedureEnded
)
