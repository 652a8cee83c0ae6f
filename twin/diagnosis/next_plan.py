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

if TYPE_CHECKING:
    from instrument.facility import Facility

#: Axes of a plane, in the order of a plan.
_PLANE = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_azimuth")
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
        Commanded geometries.
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
        listed = {name: [sweep[name]] for name in _PLANE if name != "illumination_azimuth"}
        if sweep["illumination_azimuth"]:
            listed["illumination_azimuth"] = sweep["illumination_azimuth"]
        parts.append("[[part]]\n" + _lines(listed | {"sensor_zenith": sweep["sensor_zenith"]}))
    return "\n".join(parts)


def _lines(keys: Mapping[str, Any]) -> str:
    """Keys of a table, one a line; JSON of texts, numbers and lists of numbers is TOML as well."""
    return "".join(f"{name} = {json.dumps(value, ensure_ascii=False)}\n" for name, value in keys.items())


def _sweeps(columns: dict[str, FloatArray]) -> list[dict[str, Any]]:
    """Points in sequence that share a plane and go one way; a turn begins another sweep."""
    zenith = columns["sensor_zenith"]
    plane = np.round(np.stack([columns[name] for name in _PLANE], axis=1), 6) + 0.0
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
