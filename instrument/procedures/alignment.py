"""The guided alignment: the steps of the paper (section III-B), each confirmed by a person and recorded.

The surface is levelled with a self-levelling laser that points at the optical centre, mirrors show by their back
reflection whether beam and stage are parallel, and the micrometer of the sample holder sets the height. Arms go where a
step needs them; the beam is on, at low power, only for steps that look at it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from instrument.procedures.reading import Reader, beyond
from instrument.procedures.results import Finding, Quantity
from instrument.procedures.room import Room
from instrument.prompts import Prompt

#: Power for eyes on a card, fraction of full power.
FAINT = 0.02


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes
    ----------
    prompt
        What a person does and answers.
    pose
        Illumination zenith, sensor zenith, sensor azimuth (degree) to be reached before; None leaves the arms alone.
    beam
        Whether the shutter is open while the person works.
    """

    prompt: Prompt
    pose: tuple[float, float, float] | None = None
    beam: bool = False


STEPS = (
    Step(
        Prompt(
            key="align:laser",
            title="Set up the self-levelling laser",
            text="Beside the instrument, its beam at the mark of the optical centre. Wait until it is level.",
        ),
        pose=(45.0, 60.0, 90.0),
    ),
    Step(
        Prompt(
            key="align:level",
            title="Bring the sample's surface into the laser's plane",
            text="Turn the micrometer of the sample holder until the laser grazes the surface. Read the micrometer.",
            kind="number",
            unit="mm",
            lower=0.0,
            upper=50.0,
        )
    ),
    Step(
        Prompt(
            key="align:height",
            title="How far is the laser's line from the surface now?",
            text="Positive where the surface lies above the line.",
            kind="number",
            unit="mm",
            lower=-5.0,
            upper=5.0,
        )
    ),
    Step(
        Prompt(
            key="align:mirror",
            title="Lay the flat mirror on the stage and a card with a hole around the iris",
            text="The beam comes on next, at low power: eyewear on.",
        )
    ),
    Step(
        Prompt(
            key="align:distance",
            title="How far is the card from the mirror?",
            kind="number",
            unit="mm",
            lower=50.0,
            upper=5000.0,
        )
    ),
    Step(
        Prompt(
            key="align:back-x",
            title="Where does the back reflection meet the card, in the plane of the arms?",
            text="Distance from the hole towards growing illumination zenith. Adjust the stage to bring it to 0.",
            kind="number",
            unit="mm",
            lower=-200.0,
            upper=200.0,
        ),
        pose=(0.0, 60.0, 90.0),
        beam=True,
    ),
    Step(
        Prompt(
            key="align:back-y",
            title="And across that plane?",
            text="Distance from the hole towards growing azimuth.",
            kind="number",
            unit="mm",
            lower=-200.0,
            upper=200.0,
        ),
        beam=True,
    ),
    Step(
        Prompt(
            key="align:centre",
            title="Put the cross-hair card on the stage: does the beam stay on the cross?",
            text="It was moved to 60 degrees; at a wrong height the spot walks along the plane of the arms.",
            kind="choice",
            choices=("yes", "no"),
        ),
        pose=(60.0, 0.0, 90.0),
        beam=True,
    ),
    Step(Prompt(key="align:tidy", title="Take mirror and cards away", text="Nothing shiny stays on the stage.")),
)


def alignment(room: Room, wavelength: float = 500.0) -> Finding:
    """Lead a person through the alignment; fails where what is left exceeds what the facility states.

    Between two steps the shutter is closed; arms never move while it is open.
    """
    room.home()
    answers: dict[str, float | str | None] = {}
    for number, step in enumerate(STEPS, start=1):
        room.say(f"step {number} of {len(STEPS)}")
        if step.beam:
            room.light()
            Reader(room).set_power(FAINT)
        if step.pose is not None:
            room.go(*step.pose, wavelength)
        prompt = step.prompt.model_copy(update={"title": f"{number}/{len(STEPS)} {step.prompt.title}"})
        if not step.beam:
            room.station.light.off()
            answers[prompt.key] = room.ask(prompt).value
            continue
        with room.beam():
            answers[prompt.key] = room.ask(prompt).value
    return _finding(room, answers)


def _finding(room: Room, answers: dict[str, float | str | None]) -> Finding:
    number = {key.removeprefix("align:"): value for key, value in answers.items() if isinstance(value, float)}
    # The mirror doubles the angle.
    tilt = {axis: math.degrees(math.atan2(number[f"back-{axis}"], number["distance"])) / 2 for axis in ("x", "y")}
    values = {
        "micrometer": Quantity(value=number["level"], unit="mm"),
        "height": Quantity(value=number["height"], unit="mm"),
        "tilt in the plane": Quantity(value=tilt["x"], unit="degree"),
        "tilt across": Quantity(value=tilt["y"], unit="degree"),
    }
    sample = room.facility.sample
    limits = {"height": sample.u_height, "tilt in the plane": sample.u_tilt, "tilt across": sample.u_tilt}
    wrong = [f"{name} {values[name]}" for name, limit in limits.items() if beyond(values[name].value, 0.0, limit)]
    if answers["align:centre"] == "no":
        wrong.append("the beam leaves the centre as its arm moves")
    return Finding(
        verdict="failed" if wrong else "passed",
        summary="more than stated is left: " + "; ".join(wrong) if wrong else "aligned within what the facility states",
        values=values,
        advice=("align again, then check: goniotwin calibrate intersection",) if wrong else (),
    )
