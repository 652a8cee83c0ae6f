"""Feasible scans after a run: slices as they were, reversed, back and forth, dimmed; other planes, light, rotation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.next_plan import plan_columns
from twin.diagnosis.next_stage import Stage, geometries, one_illumination, unshadowed, usual_rotation
from twin.diagnosis.observation import LEAST_FOLLOWING, Observation
from twin.diagnosis.turned import ROTATION, alike, in_words, of_the_arms, rotation
from twin.optics import COORDINATES

if TYPE_CHECKING:
    from instrument.facility import Arms

IntArray = NDArray[np.int64]
#: Slices of other planes are thinned to about so many points.
_MOST = 17
#: Share of the light of a dimmed scan.
DIMMED = 0.25
#: Illumination zeniths that are offered where the run lacks them, degree, and how near the run's may be.
_LIGHTS, _NEW_LIGHT = (0.0, 15.0, 30.0, 45.0, 60.0), 7.5
#: Other planes of an illumination zenith at most, and other illumination zeniths.
_NEW_PLANES, _NEW_LIGHTS = 2, 2
#: Kinds whose geometries the run may lack.
PLANE, LIGHT, TURNED = "another plane", "another illumination", "turned sample"
#: By how much the sample is turned, degree: an axis in it changes places with that across it; a side with the other.
_TURNS = (90.0, 180.0)
#: Rotations so little apart are the same, degree.
_SAME_TURN = 0.01
#: Slices of a turned sample are thinned to about so many points.
_MOST_TURNED = 13


@dataclass(frozen=True)
class Scan:
    """Points in the order in which they are read.

    Attributes
    ----------
    kind
        Of scan, to offer different ones.
    description
        In words, to stand behind "measure".
    rows
        Numbers of the points on its :class:`~twin.diagnosis.next_stage.Stage`.
    light
        Share of the run's light.
    stage
        Number of the stage.
    """

    kind: str
    description: str
    rows: IntArray
    light: float = 1.0
    stage: int = 0

    def joined(self, other: Scan) -> Scan:
        """One scan after the other."""
        text = f"{self.description}; then {other.description}"
        return replace(self, description=text, rows=np.concatenate([self.rows, other.rows]))


def scans(stages: Sequence[Stage]) -> list[Scan]:
    """Every scan of one slice, or of one back and forth; the first stage holds the run's own points."""
    stage, *others = stages
    run = stage.observation
    found: list[Scan] = []
    for rows in _apart(run, list(_slices(run, np.arange(stage.of_run)))):
        found += _again(run, rows)
    known = np.unique(np.round(run.columns["illumination_zenith"][: stage.of_run], 6))
    turned = rotation(run.columns)
    for rows in _slices(run, np.arange(stage.of_run, len(run))):
        light = run.columns["illumination_zenith"][rows[0]]
        kind = PLANE if np.any(np.abs(known - light) < 1e-6) else LIGHT
        if turned[rows[0]] not in turned[: stage.of_run]:
            kind = TURNED
        found.append(Scan(kind, f"a slice at {_where(run, rows)} ({_span(run, rows)})", rows))
    for number, other in enumerate(others, start=1):
        for rows in _slices(other.observation, np.arange(len(other.observation))):
            text = f"the {other.sample} at {_where(other.observation, rows)} ({_span(other.observation, rows)})"
            found.append(Scan(other.sample, text, rows, stage=number))
    return found


def _slices(run: Observation, rows: IntArray) -> Iterator[IntArray]:
    """Points of each plane, in time order, of planes with enough of them."""
    if not len(rows):
        return
    part = run.take(rows)
    order = np.arange(len(part)) if part.seconds is None else np.argsort(part.seconds, kind="stable")
    plane = part.plane
    for number in range(int(plane.max()) + 1):
        chosen = order[plane[order] == number]
        if len(chosen) >= LEAST_FOLLOWING:
            yield rows[chosen]


def _apart(run: Observation, slices: Sequence[IntArray]) -> list[IntArray]:
    """Of each illumination zenith the slice nearest to the plane of incidence and the one most across it."""
    first = np.array([rows[0] for rows in slices], dtype=np.int64)
    across = np.abs(np.sin(np.deg2rad(run.columns["sensor_azimuth"] - run.columns["illumination_azimuth"])[first]))
    light = np.round(run.columns["illumination_zenith"][first], 6)
    chosen: dict[int, IntArray] = {}
    for one in np.unique(light):
        there = np.flatnonzero(light == one)
        for number in (there[np.argmin(across[there])], there[np.argmax(across[there])]):
            chosen[int(number)] = slices[int(number)]
    return list(chosen.values())


def _again(run: Observation, rows: IntArray) -> Iterator[Scan]:
    where = f"the slice at {_where(run, rows)} again"
    back = rows[::-1]
    yield Scan("as it was", f"{where}, as it was", rows)
    yield Scan("reversed", f"{where}, in the opposite direction ({_span(run, back)})", back)
    yield Scan("serpentine", f"{where}, back and forth", np.concatenate([rows, back]))
    yield Scan("dimmed", f"{where}, with a quarter of the light", rows, DIMMED)


def _where(run: Observation, rows: IntArray) -> str:
    light, azimuth = (run.columns[name][rows[0]] for name in ("illumination_zenith", "sensor_azimuth"))
    turned = in_words(run.columns, int(rows[0]))
    return f"illumination zenith {light:g}, sensor azimuth {azimuth:g} degrees{turned}"


def _span(run: Observation, rows: IntArray) -> str:
    zenith = run.columns["sensor_zenith"][rows]
    return f"{zenith[0]:g} to {zenith[-1]:g}"


def other_geometries(run: Observation, arms: Arms) -> dict[str, FloatArray]:
    """Planes that the run lacks: between its azimuths at each illumination zenith, at others, and of a turned sample.

    Returns
    -------
    dict
        Columns as :func:`~twin.diagnosis.turned.arm_columns`, of shape (point,); empty ones where nothing is left.
    """
    columns = run.columns
    values, counts = np.unique(columns["wavelength"], return_counts=True)
    wavelength = float(values[np.argmax(counts)])
    zeniths = thinned(columns["sensor_zenith"])
    lights = np.unique(np.round(columns["illumination_zenith"], 6))
    parts = []
    for light in lights:
        there = np.abs(columns["illumination_zenith"] - light) < 1e-6
        azimuths = between(columns["sensor_azimuth"][there], arms.sensor_azimuth)
        parts.append(geometries(wavelength, [float(light)], azimuths, zeniths))
    low, high = arms.illumination_zenith
    new = [one for one in _LIGHTS if low <= one <= high and np.min(np.abs(lights - one)) > _NEW_LIGHT]
    # The largest first: what depends on the light's angle grows with it.
    for light in sorted(new, reverse=True)[:_NEW_LIGHTS]:
        parts.append(geometries(wavelength, [light], [0.0, 90.0], zeniths))
    usual = usual_rotation(run)
    if usual:
        parts = [part | {ROTATION: np.full(len(part["wavelength"]), usual)} for part in parts]
    parts = alike(parts + turned_geometries(run, arms, wavelength))
    every = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return unshadowed(every, arms.shadow_half_angle)


def turned_geometries(run: Observation, arms: Arms, wavelength: float) -> list[dict[str, FloatArray]]:
    """Slices along and across the plane of incidence with the sample turned, where a stage or hands can turn it.

    At the illumination zenith with most of the run's points, a part for each rotation.
    """
    rows = one_illumination(run)
    light = float(run.columns["illumination_zenith"][rows[0]])
    slices = _apart(run, list(_slices(run, rows)))
    azimuths = sorted({float(run.columns["sensor_azimuth"][one[0]]) for one in slices})
    zeniths = thinned(run.columns["sensor_zenith"], _MOST_TURNED)
    found = []
    for angle in _rotations(run, arms):
        part = geometries(wavelength, [light], azimuths, zeniths)
        part[ROTATION] = np.full(len(part["wavelength"]), angle)
        # By hands some directions are reached from the other side: arms as the plan will have them.
        stated = plan_columns(part, arms)
        found.append(of_the_arms({name: stated[name] for name in COORDINATES}, rotation(stated)))
    return found


def _rotations(run: Observation, arms: Arms) -> list[float]:
    """New rotations of the sample that the instrument can give, at most one for each of :data:`_TURNS`."""
    known, usual = np.unique(rotation(run.columns)), usual_rotation(run)
    travel, way = arms.sample_rotation, 1.0
    if travel is None:
        travel, way = arms.illumination_azimuth, -1.0
    if travel is None:
        return []
    found = []
    for turn in _TURNS:
        # Hands turn it to a positive azimuth where they can: the arm's travel then needs no other side.
        both = [usual + way * turn, usual - way * turn]
        # A whole turn more or less is the same sample.
        new = [one for one in both if np.all(np.abs(np.mod(known - one + 180.0, 360.0) - 180.0) > _SAME_TURN)]
        free = [one for one in new if travel[0] <= way * one <= travel[1]]
        found += free[:1]
    return found


def thinned(zenith: FloatArray, most: int = _MOST) -> FloatArray:
    """The run's sensor zeniths, from the first end to the last, at most about so many of them, evenly."""
    distinct = np.unique(np.round(zenith, 6))
    step = int(np.ceil(len(distinct) / most))
    chosen = distinct[(len(distinct) - 1) % step // 2 :: step]
    descends = len(zenith) > 1 and zenith[1] < zenith[0]
    return np.asarray(chosen[::-1] if descends else chosen)


def between(azimuths: FloatArray, travel: tuple[float, float]) -> list[float]:
    """Middles of the widest gaps between sensor azimuths, degree; planes half a turn apart are the same one."""
    known = np.unique(np.round(np.mod(azimuths, 180.0), 6))
    gaps = np.diff(np.append(known, known[0] + 180.0))
    widest = np.argsort(-gaps, kind="stable")[:_NEW_PLANES]
    middle = np.mod(known[widest] + gaps[widest] / 2, 180.0)
    low, high = travel
    return sorted(float(round(a, 1)) for a in middle if low <= a <= high)
