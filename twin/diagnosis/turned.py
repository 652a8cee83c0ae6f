"""A sample that was turned about its normal: angles as the arms have them, and as the sample sees them.

Arms, beam, detector and source stay in the laboratory, whose x axis is that of the illumination arm's plane; the sample
and how it lies on its mount turn with the stage. An illumination azimuth is a turned sample as well: the illumination
arm keeps to its plane, and hands turn the sample the other way (:mod:`instrument.turning`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.events import Geometry
from instrument.turning import driven
from twin.diagnosis.variation import Variation
from twin.optics import COORDINATES, Setup, geometry_columns, sample_rotation

#: Column that says how far the sample is turned, degree, right-handed; there only where some point's is.
ROTATION = "sample_rotation"
_AZIMUTHS = ("illumination_azimuth", "sensor_azimuth")
#: Decimals of a place in mm: what is left of the cosine of a right angle makes no other scene.
_DECIMALS = 9
Columns = dict[str, FloatArray]


def arm_columns(run: Sequence[Geometry] | xr.Dataset) -> Columns:
    """Commanded geometries of a run or plan as the arms had them, degree; see :func:`of_the_arms`."""
    return of_the_arms(geometry_columns(run), sample_rotation(run))


def of_the_arms(columns: Columns, turned: FloatArray) -> Columns:
    """Geometries as the arms have them, with :data:`ROTATION` where the sample is turned.

    Points of another illumination azimuth become those of azimuth 0 and a sample that is turned by minus the azimuth.

    Parameters
    ----------
    turned, shape (point,)
        By how much a stage turns the sample besides, degree.
    """
    by_hand = np.flatnonzero(columns["illumination_azimuth"])
    if len(by_hand):
        turned = turned - columns["illumination_azimuth"]
        columns = {name: np.array(column) for name, column in columns.items()}
        for point in by_hand:
            angles: dict[str, Any] = {name: float(columns[name][point]) for name in COORDINATES}
            _, columns["sensor_azimuth"][point], columns["sensor_zenith"][point] = driven(Geometry(**angles))
        columns["illumination_azimuth"][by_hand] = 0.0
    return columns | {ROTATION: turned} if np.any(turned) else columns


def rotation(columns: Columns) -> FloatArray:
    """How far the sample is turned at each point, degree, shape (point,)."""
    return columns[ROTATION] if ROTATION in columns else np.zeros(len(columns["sensor_zenith"]))


def in_words(columns: Columns, point: int) -> str:
    """How far the sample is turned at a point, to stand behind other circumstances; empty where it is not."""
    angle = float(rotation(columns)[point])
    return f", sample turned by {angle:g} degrees" if angle else ""


def from_sample(columns: Columns) -> Columns:
    """Geometries in the frame of the sample, of :data:`~twin.optics.COORDINATES` alone."""
    seen = {name: columns[name] for name in COORDINATES}
    turned = rotation(columns)
    for name in _AZIMUTHS if np.any(turned) else ():
        seen[name] = np.where(turned == 0, seen[name], np.mod(seen[name] - turned, 360.0))
    return seen


def alike(parts: Sequence[Columns]) -> list[Columns]:
    """The same columns in all: with the rotation where one has it."""
    if not any(ROTATION in part for part in parts):
        return list(parts)
    return [part | {ROTATION: rotation(part)} for part in parts]


def turns(variation: Variation) -> bool:
    """Whether a turned sample sees another change: of what stays in the laboratory, but is not known by an arm."""
    return bool(variation.setup.beam_x_mm or variation.setup.beam_y_mm)


def seen_turned(variation: Variation, angle_deg: float) -> Variation:
    """A change of the laboratory in the frame of a sample that is turned by an angle; see :func:`setup_seen`."""
    if not (angle_deg and turns(variation)):
        return variation
    seen = setup_seen(variation.setup, angle_deg)
    return replace(variation, setup=replace(seen, beam_x_mm=float(seen.beam_x_mm), beam_y_mm=float(seen.beam_y_mm)))


def setup_seen(setup: Setup, angle_deg: float | FloatArray) -> Setup:
    """An instrument that is off in the frame of a sample that is turned by an angle, one or each point's.

    What is off about the arms goes with their angles, what is about the sample and its placement with the sample; the
    beam's axis stays where it was, and is turned the other way as the sample sees it.
    """
    x, y, turned = setup.beam_x_mm, setup.beam_y_mm, np.deg2rad(angle_deg)
    seen_x = np.round(x * np.cos(turned) + y * np.sin(turned), _DECIMALS) + 0.0
    seen_y = np.round(y * np.cos(turned) - x * np.sin(turned), _DECIMALS) + 0.0
    return replace(setup, beam_x_mm=seen_x, beam_y_mm=seen_y)
