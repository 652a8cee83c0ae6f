"""A design study: pattern, signal, separation and plan of an artifact, and the same along sweeps of its dimensions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.errors import InputError
from instrument.facility import Budget, Facility
from twin.design.candidates import Candidate
from twin.design.pattern import Signal, hemispherical_pattern, measurable, signal
from twin.design.separation import Information, Separation, candidate_points, information, separation, signatures
from twin.material import Material

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Settings:
    """How a study is done.

    Attributes
    ----------
    illumination_zenith
        Degree.
    planes
        Planes of a scan: one in the plane of incidence for each illumination, the others as they tell most.
    standard_error
        Relative Monte Carlo error of the patterns.
    samples
        Sight lines of a signature's points in each randomisation.
    zenith_step, azimuth_step
        Of the points that stand for planes, degree.
    """

    illumination_zenith: tuple[float, ...] = (0.0, 15.0, 30.0)
    wavelength: float = 500.0
    planes: int = 12
    standard_error: float = 0.01
    samples: int = 32
    zenith_step: float = 10.0
    azimuth_step: float = 15.0
    seed: int = 1


@dataclass(frozen=True)
class Judgement:
    """What was found of one candidate.

    Attributes
    ----------
    separation
        None where the facility has no budget to weigh signatures with.
    planes
        Illumination zenith and sensor azimuth of the chosen planes, degree.
    """

    candidate: Candidate
    pattern: xr.Dataset
    signal: Signal
    separation: Separation | None
    planes: list[tuple[float, float]] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        found: dict[str, Any] = {
            "name": self.candidate.name,
            "changes": {name: _plain(value) for name, value in self.candidate.changes.items()},
            "hemispherical_reflectance": {
                f"{light:g}": float(value)
                for light, value in zip(
                    self.pattern["illumination_zenith"].values,
                    self.pattern["hemispherical_reflectance"].values,
                    strict=True,
                )
            },
            "planes": [{"illumination_zenith": light, "sensor_azimuth": azimuth} for light, azimuth in self.planes],
            "signal": {
                "structure": self.signal.structure,
                "share_on_measurable_directions": self.signal.share,
                "measurable_share_of_hemisphere": self.signal.directions,
                "structure_over_budget": self.signal.over_budget,
            },
        }
        if self.separation is not None:
            found["separation"] = separation_json(self.separation)
        return found


def separation_json(found: Separation) -> dict[str, Any]:
    """For programs; angles in degree, numbers of standard deviations otherwise."""
    return {
        "score": found.score,
        "effects": {
            name: {
                "detectable": float(found.detectable[i]),
                "distinct": float(found.distinct[i]),
                "nearest": found.effects[_nearest(found, i)],
                "angle_to_nearest": float(found.angle[i, _nearest(found, i)]),
            }
            for i, name in enumerate(found.effects)
        },
    }


def _nearest(found: Separation, number: int) -> int:
    angle = found.angle[number].copy()
    angle[number] = np.inf
    return int(np.argmin(angle))


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, str) else float(value)


def judge(candidate: Candidate, facility: Facility, material: Material, settings: Settings) -> Judgement:
    """Find pattern, signal, separation and the planes worth scanning of one candidate."""
    pattern = hemispherical_pattern(
        facility,
        candidate.artifact,
        material,
        np.array(settings.illumination_zenith),
        wavelength=settings.wavelength,
        standard_error=settings.standard_error,
        seed=settings.seed,
    )
    strength = signal(pattern, facility)
    if facility.budget == Budget():
        return Judgement(candidate, pattern, strength, None, prominent_planes(pattern, facility, settings.planes))
    known, planes = knowledge(facility, candidate.artifact, material, settings)
    start = in_plane(planes)
    chosen = known.choose(start, max(settings.planes, len(start)))
    return Judgement(candidate, pattern, strength, separation(known, chosen), [planes[i] for i in chosen])


def knowledge(
    facility: Facility, artifact: ArtifactDimensions, material: Material, settings: Settings
) -> tuple[Information, list[tuple[float, float]]]:
    """What every measurable plane would tell, and which planes these are."""
    light: FloatArray = np.array(settings.illumination_zenith)
    columns, plane = candidate_points(facility, light, settings.wavelength, settings.zenith_step, settings.azimuth_step)
    if not len(plane):
        raise InputError("the facility's arms reach no point outside the shadow cone; expected some to design for")
    found = signatures(facility, artifact, material, columns, plane, samples=settings.samples, seed=settings.seed)
    return information(found, facility), found.planes


def prominent_planes(pattern: xr.Dataset, facility: Facility, count: int) -> list[tuple[float, float]]:
    """Planes with the most structure on measurable directions, those of incidence first: where no budget decides."""
    azimuth, zenith = pattern["azimuth"].values, pattern["zenith"].values
    first, last = facility.arms.sensor_azimuth
    usable = [a for a in azimuth if first <= a <= last and a < first + 180.0]
    weight = pattern["weight"].values[:, 0]
    planes, structure = [], []
    for number, light in enumerate(pattern["illumination_zenith"].values):
        mean = float(pattern["hemispherical_reflectance"].values[number])
        square = (pattern["brf"].values[number] / mean - 1) ** 2 * weight[:, None]
        square = square * measurable(facility.arms, float(light), zenith[:, None], azimuth[None, :])
        by_azimuth = square.sum(axis=0)
        opposite = np.roll(by_azimuth, len(azimuth) // 2)
        for a in usable:
            planes.append((float(light), float(a)))
            structure.append(float((by_azimuth + opposite)[azimuth == a][0]))
    start = in_plane(planes)
    others = sorted(set(range(len(planes))) - set(start), key=lambda i: -structure[i])
    return [planes[i] for i in [*start, *others[: max(0, count - len(start))]]]


def in_plane(planes: list[tuple[float, float]]) -> list[int]:
    """For each illumination the plane nearest to the plane of incidence."""
    result = []
    for light in sorted({light for light, _ in planes}):
        members = [i for i, plane in enumerate(planes) if plane[0] == light]
        result.append(min(members, key=lambda i: abs(np.sin(np.deg2rad(planes[i][1])))))
    return result


def best(judgements: list[Judgement]) -> Judgement:
    """The candidate with the best separation, or the most structure where no budget says what can be told apart."""
    return max(judgements, key=lambda j: j.separation.score if j.separation is not None else j.signal.structure)
