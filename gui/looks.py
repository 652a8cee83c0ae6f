"""How each state of a scan is shown, in plain language: name, what happens, what a person can do, and a sign.

A sign is a shape and a tone; the tone is never the only difference between two states that need different actions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from instrument.states import FINAL, TRANSITIONS, State

Tone = Literal["quiet", "busy", "hold", "good", "bad"]
Sign = Literal["ring", "play", "pause", "hand", "gear", "check", "square", "cross", "warning"]


@dataclass(frozen=True)
class Look:
    """What the state indicator says."""

    title: str
    text: str
    sign: Sign
    tone: Tone


LOOKS: dict[State, Look] = {
    State.IDLE: Look("Ready", "No scan is running. Press Start to run the plan.", "ring", "quiet"),
    State.CONNECTING: Look("Connecting", "Opening the devices and asking each who it is.", "gear", "busy"),
    State.PREFLIGHT: Look("Checking", "The whole plan is checked against limits, cone and interlocks.", "gear", "busy"),
    State.HOMING: Look("Homing", "The arms search their zero. Keep clear of them.", "gear", "busy"),
    State.MOUNTING: Look("Sample change", "Emission off, shutter closed, arms at rest: hands allowed.", "hand", "hold"),
    State.REFERENCING: Look("Reference", "The reference sample is being measured.", "play", "busy"),
    State.MOVING: Look("Moving", "The arms are on their way to the next point. Keep clear of them.", "play", "busy"),
    State.MEASURING: Look("Measuring", "The detector is being read. Keep light and vibration away.", "play", "busy"),
    State.PAUSING: Look("Pausing", "The scan comes to rest after the point in hand.", "pause", "hold"),
    State.PAUSED: Look("Paused", "At rest, shutter closed. Press Resume to go on.", "pause", "hold"),
    State.SUSPENDED: Look(
        "Suspended",
        "The laboratory cannot measure now. Remove the cause; the scan goes on by itself or with Resume.",
        "warning",
        "hold",
    ),
    State.FINISHING: Look("Finishing", "Arms return, light goes off, the run file is written.", "gear", "busy"),
    State.FINISHED: Look("Finished", "The run file is written. Another scan can start.", "check", "good"),
    State.ABORTING: Look("Aborting", "The scan ends in an orderly way; measured points are kept.", "square", "hold"),
    State.ABORTED: Look(
        "Aborted", "Ended before the last point; what was measured is kept and can be resumed.", "square", "quiet"
    ),
    State.HALTED: Look(
        "Halted",
        "Everything was stopped at once. Look at the instrument before you start again; the run can be resumed.",
        "cross",
        "bad",
    ),
    State.FAULTING: Look("Fault", "The laboratory is brought into its safe state.", "warning", "bad"),
    State.FAULTED: Look(
        "Fault",
        "The scan ended with a fault. Read the last message before you start again.",
        "cross",
        "bad",
    ),
}


@dataclass(frozen=True)
class Actions:
    """What a person may ask for now."""

    start: bool
    pause: bool
    resume: bool
    abort: bool
    halt: bool


#: While a calibration or the alignment has the instrument.
PROCEDURE = Look("Procedure", "It can be given up on its page, or stopped at once with HALT.", "gear", "busy")


def actions(state: State, connected: bool, procedure: bool = False) -> Actions:
    """What may be asked in a state, by the engine's own table.

    Parameters
    ----------
    connected
        Whether a controller holds the instrument: only then is there anything to steer.
    procedure
        Whether a calibration or the alignment has it; it can be halted.
    """
    ways = TRANSITIONS[state] if connected else frozenset()
    return Actions(
        start=not connected and not procedure and (state is State.IDLE or state in FINAL),
        pause=State.PAUSING in ways,
        resume=connected and state in (State.PAUSED, State.SUSPENDED),
        abort=State.ABORTING in ways,
        halt=procedure or State.HALTED in ways,
    )
