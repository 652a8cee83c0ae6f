"""A proposed scan as a plan file, and how long the instrument takes over it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from instrument.angles import FloatArray
from instrument.forms import parse_form, parse_toml
from instrument.plan import PlanForm, make_plan
from instrument.plan_summary import Speeds, go_through, pace_on_paper
from instrument.settings import ScanSettings
from twin.diagnosis.turned import ROTATION, rotation
from twin.optics import COORDINATES

if TYPE_CHECKING:
    from instrument.facility import Arms, Facility

#: Axes of a plane, in the order of a plan.
_PLANE = ("wavelength", ROTATION, "illumination_zenith", "illumination_azimuth", "sensor_azimuth")
#: Those that a plan leaves out where they are 0, and whether it has a list of them.
_LEFT_OUT = {ROTATION: True, "illumination_azimuth": False}
#: Detector readings a point.
SAMPLES = 9
#: Speeds that ``goniotwin plan`` takes for axes that nobody describes, degree/s and degree/s^2.
_SPEEDS = Speeds(20.0, 10.0)
_SOURCE = "the proposed plan"


def plan_text(title: str, columns: dict[str, FloatArray], remarks: str = "") -> str:
    """A plan (TOML) of points in their order: a grid for each sweep through a plane.

    Parameters
    ----------
    columns, shape (point,)
        Geometries as a plan states them: of an instrument (:func:`plan_columns`).
    remarks
        What whoever measures has to do besides; kept in the run's record.
    """
    sweeps = _sweeps(columns)
    keys = [tuple(sweep[name] for name in _PLANE) for sweep in sweeps]
    head: dict[str, Any] = {"version": 1, "title": title, "samples": SAMPLES, "angle_unit": "degree"}
    if len(set(keys)) < len(keys):
        head["duplicates"] = "repeat"
    parts = [_lines(head)]
    if remarks:
        parts.append("[record]\n" + _lines({"remarks": remarks}))
    for sweep in sweeps:
        listed = {name: [sweep[name]] for name in _PLANE if name not in _LEFT_OUT}
        for name, several in _LEFT_OUT.items():
            if sweep[name]:
                listed[name] = [sweep[name]] if several else sweep[name]
        parts.append("[[part]]\n" + _lines(listed | {"sensor_zenith": sweep["sensor_zenith"]}))
    return "\n".join(parts)


def plan_columns(columns: dict[str, FloatArray], arms: Arms) -> dict[str, FloatArray]:
    """Geometries of arms and sample as the plan of an instrument states them.

    Where a stage turns the sample, as they are. Hands turn it to an illumination azimuth, and a plan's angles are then
    those of the sample; a sensor azimuth beyond the arm's travel is stated from the other side.
    """
    turned = rotation(columns)
    if arms.sample_rotation is not None or not np.any(turned):
        return columns
    low, high = arms.sensor_azimuth
    azimuth = np.where(turned == 0, columns["sensor_azimuth"], np.mod(columns["sensor_azimuth"] - turned, 360.0))
    beyond = (turned != 0) & ((azimuth < low) | (azimuth > high))
    return {name: columns[name] for name in COORDINATES} | {
        "illumination_azimuth": columns["illumination_azimuth"] - turned,
        "sensor_azimuth": np.where(beyond, np.mod(azimuth + 180.0, 360.0), azimuth),
        "sensor_zenith": np.where(beyond, -columns["sensor_zenith"], columns["sensor_zenith"]),
    }


def _lines(keys: Mapping[str, Any]) -> str:
    """Keys of a table, one a line; JSON of texts, numbers and lists of numbers is TOML as well."""
    return "".join(f"{name} = {json.dumps(value, ensure_ascii=False)}\n" for name, value in keys.items())


def _sweeps(columns: dict[str, FloatArray]) -> list[dict[str, Any]]:
    """Points in sequence that share a plane and go one way; a turn begins another sweep."""
    zenith = columns["sensor_zenith"]
    known = columns | {ROTATION: rotation(columns)}
    plane = np.round(np.stack([known[name] for name in _PLANE], axis=1), 6) + 0.0
    found: list[dict[str, Any]] = []
    way = 0.0
    for number in range(len(zenith)):
        step = float(np.sign(zenith[number] - zenith[number - 1])) if number else 0.0
        same = number > 0 and bool(np.all(plane[number] == plane[number - 1])) and step != 0 and way in (0.0, step)
        if same:
            way = step
        else:
            way = 0.0
            found.append(dict(zip(_PLANE, plane[number].tolist(), strict=True)) | {"sensor_zenith": []})
        found[-1]["sensor_zenith"].append(round(float(zenith[number]), 6) + 0.0)
    return found


def duration_of(text: str, facility: Facility, dwell: float | None = None) -> float:
    """Seconds that the instrument takes over a plan: homing, reference, moves and readings.

    Parameters
    ----------
    dwell
        Seconds a point takes once the arms stand; that of a scan by default.

    Raises
    ------
    InputError
        If the instrument cannot carry it out.
    """
    settings = ScanSettings() if dwell is None else ScanSettings(dwell=dwell)
    plan = make_plan(parse_form(parse_toml(text, _SOURCE), PlanForm, _SOURCE), facility, _SOURCE)
    pace = pace_on_paper(None, facility, _SPEEDS, settings, plan.samples)
    return float(go_through(plan, facility, pace)[1].duration)
