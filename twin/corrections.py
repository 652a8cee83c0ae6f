"""The corrected twin: named effects with their parameters in a file, and predictions that include them.

A corrections file (``docs/corrections.md``) is written by ``goniotwin diagnose --save-twin``. Effects on scene,
material and arms change what is traced; effects on the reading change what is made of it. Some cannot be predicted
without a run: those are left out, and said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from pydantic import Field

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, read_artifact
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Facility, read_facility
from instrument.forms import Form, read_form
from instrument.lambertian import lambertian_flux
from instrument.output import write_result
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.effects import (
    AzimuthEffect,
    Effect,
    Known,
    ReadingEffect,
    SceneEffect,
    TopEffect,
    ZenithEffect,
    effect,
)
from twin.diagnosis.turned import ROTATION, arm_columns, from_sample, of_the_arms, rotation, setup_seen
from twin.diagnosis.variation import Variation, together
from twin.material import Material, read_material
from twin.optics import Setup, reference_change
from twin.prediction import Estimate, Twin

#: Effects that depend on the order in which points were read.
_OF_THE_ORDER = ("backlash", "stale_sample")


class Correction(Form):
    """One effect with the values and standard uncertainties of its parameters."""

    effect: str
    parameters: dict[str, float]
    u: dict[str, float] = Field(default_factory=dict)


class Corrections(Form):
    """The corrections file."""

    form: Literal["corrections"]
    version: Literal[1]
    found_in: tuple[str, ...] = ()
    effects: tuple[Correction, ...]


def read_corrections(path: Path) -> Corrections:
    """Read a corrections file; effects and parameters are checked by :func:`corrected_twin`.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it.
    """
    found = read_form(path, Corrections)
    for number, one in enumerate(found.effects):
        try:
            effect(one.effect)
        except InputError as error:
            raise InputError(f"{path}: effects.{number}: {error}") from None
    return found


def write_corrections(corrections: Corrections, path: Path) -> None:
    """Write a corrections file; as :func:`instrument.output.write_result`."""
    import tomli_w

    write_result(path, tomli_w.dumps(corrections.model_dump(mode="json")).encode())


@dataclass(frozen=True)
class Applied:
    """What corrections do to a twin.

    Attributes
    ----------
    variation
        Of scene, material and instrument, the same for all points.
    arm
        Effects that move the sensor arm by an angle of its own at each point, with their values.
    readings
        Effects on the reading, with their values.
    left_out
        Effects that cannot be predicted without a run, and why.
    """

    variation: Variation = field(default_factory=Variation)
    arm: tuple[tuple[ZenithEffect, FloatArray], ...] = ()
    readings: tuple[tuple[ReadingEffect, FloatArray], ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def effects(self) -> list[Effect]:
        """Those of arm and reading."""
        return [one for one, _ in (*self.arm, *self.readings)]


def resolve(corrections: Corrections, known: Known, *, ordered: bool) -> Applied:
    """Turn named effects into changes of a twin.

    Parameters
    ----------
    ordered
        Whether predictions are of whole plans or runs, in the order in which they are read.

    Raises
    ------
    InputError
        For a parameter that the effect does not have, or values that its physics does not allow.
    """
    variation, arm, readings, left_out = Variation(), [], [], {}
    for one in corrections.effects:
        found = effect(one.effect)
        reason = found.not_applicable(known) or _unpredictable(found, ordered)
        if reason:
            left_out[found.name] = reason
            continue
        values = _values(found, one, known)
        if isinstance(found, SceneEffect):
            try:
                variation = together(variation, found.variation(values))
            except ValueError as error:
                raise InputError(f"corrections: {found.name}: {error}; expected effects that can be joined") from None
        elif isinstance(found, ZenithEffect):
            arm.append((found, values))
        elif isinstance(found, ReadingEffect):
            readings.append((found, values))
    if variation.transport[1]:
        left_out["translucency"] = "the ray tracer does not follow light inside the coating"
        variation = replace(variation, transport=(0.0, 0.0))
    return Applied(variation, tuple(arm), tuple(readings), left_out)


def _unpredictable(found: Effect, ordered: bool) -> str:
    if isinstance(found, AzimuthEffect):
        return "the twin does not turn its sensor by another angle at each point"
    if isinstance(found, TopEffect):
        return "the twin's surfaces are the same everywhere"
    if found.needs:
        return f"it depends on what a run records ({', '.join(found.needs)})"
    if found.name == "session_scale":
        return "it belongs to one run's sessions"
    if found.name in _OF_THE_ORDER and not ordered:
        return "it depends on the order of the points, which a single prediction does not know"
    return ""


def _values(found: Effect, one: Correction, known: Known) -> FloatArray:
    parameters = found.resolve(known)
    names = [p.name for p in parameters]
    strangers = [name for name in one.parameters if name not in names]
    if strangers:
        raise InputError(f"corrections: {found.name}: unknown {', '.join(strangers)}; expected {', '.join(names)}")
    values = np.array([one.parameters.get(p.name, p.nominal) for p in parameters])
    for parameter, value in zip(parameters, values, strict=True):
        low, high = parameter.cap
        if not low <= value <= high:
            raise InputError(
                f"corrections: {found.name}: {parameter.name}: found {value:g}; expected {low:g} to {high:g}"
                f" {parameter.unit}"
            )
    return values


class CorrectedTwin(Twin):
    """A twin with effects added.

    Parameters
    ----------
    facility, artifact, material, seed
        The nominal twin, as for :class:`~twin.prediction.Twin`.
    applied
        What the corrections do to it.
    """

    def __init__(
        self, facility: Facility, artifact: ArtifactDimensions, material: Material, applied: Applied, *, seed: int = 1
    ) -> None:
        variation, dimensions = applied.variation, artifact
        for change in variation.artifact:
            dimensions = change.dimensions(dimensions)
        for altered in variation.material:
            material = altered.apply(material)
        factor = dict(variation.surface_factor) or None
        super().__init__(facility, dimensions, material, seed=seed, surface_factor=factor)
        self.applied = applied

    def estimate(
        self, columns: dict[str, FloatArray], *, setup: Setup | None = None, **options: Any
    ) -> Estimate:  # the options are those of the nominal twin
        """As the nominal twin's, in the corrected geometry and divided by the reference read with what is off then.

        Of a turned sample what is of the arms stays in the laboratory. Another illumination azimuth is one that hands
        have turned; one on a stage says so itself (:func:`twin.diagnosis.turned.arm_columns`).
        """
        if setup is not None:
            raise InputError("setup: the corrections say what is off; expected none beside them")
        arms = of_the_arms(columns, rotation(columns))
        acquired = plan_acquisition(arms, self.facility)
        error = sum((one.zenith_error(acquired, values[None])[0] for one, values in self.applied.arm), np.zeros(1))
        nominal = self.applied.variation.setup
        if ROTATION in arms:
            nominal = setup_seen(nominal, rotation(arms))
        off = replace(nominal, sensor_zenith_deg=nominal.sensor_zenith_deg + np.broadcast_to(error, len(acquired)))
        found = super().estimate(from_sample(arms), setup=off, **options)
        scale = reference_change(self.facility, off) / reference_change(self.facility, self._reference())
        brf = found.brf * scale
        for one, values in self.applied.readings:
            brf = one.reading(acquired, brf, values)
        return Estimate(brf, found.standard_error * np.abs(brf / found.brf), found.samples)

    def _columns(self, geometries: Sequence[Geometry] | xr.Dataset) -> dict[str, FloatArray]:
        # Angles as the sample sees them do not tell from which side the arm came to them.
        return arm_columns(geometries)

    def _reference(self) -> Setup:
        """What is off while the reference is measured."""
        setup = self.applied.variation.reference_setup()
        zenith = float(np.mean(setup.sensor_zenith_deg))
        reference = self.facility.reference.sensor_zenith
        zenith += sum(
            float(one.reference_setup(values, reference).sensor_zenith_deg) for one, values in self.applied.arm
        )
        return replace(setup, sensor_zenith_deg=zenith)

    def predict(self, geometries: Sequence[Geometry] | xr.Dataset, **options: Any) -> xr.Dataset:
        """As the nominal twin's; attributes name the effects that are in it, and those that are not."""
        prediction = super().predict(geometries, **options)
        return prediction.assign_attrs(describe(self.applied))


def describe(applied: Applied) -> dict[str, str]:
    """Attributes of a corrected prediction."""
    variation = applied.variation
    inside = [one.name for one in applied.effects]
    if variation != Variation():
        inside.insert(0, variation.key())
    text = {"corrections": "; ".join(inside) or "none"}
    if applied.left_out:
        text["corrections_left_out"] = "; ".join(f"{name}: {why}" for name, why in applied.left_out.items())
    return text


def plan_acquisition(columns: dict[str, FloatArray], facility: Facility) -> Acquisition:
    """What is known of points before they are read, if they are read in this order."""
    flux = lambertian_flux(
        facility,
        columns["illumination_zenith"],
        columns["sensor_zenith"],
        columns["sensor_azimuth"],
        illumination_azimuth=columns["illumination_azimuth"],
    )
    reference = facility.reference
    azimuth = np.asarray(reference.sensor_azimuth, dtype=float)
    of_reference = lambertian_flux(facility, reference.illumination_zenith, reference.sensor_zenith, azimuth)
    order = np.arange(len(flux))
    previous = np.maximum(order - 1, 0)
    signal = np.asarray(flux / (np.mean(of_reference) * reference.reflectance_factor))
    return Acquisition(
        columns,
        signal,
        reference.sensor_zenith,
        azimuth,
        previous,
        travel_direction(columns, order),
        reference_illumination=reference.illumination_zenith,
    )


def corrected_twin(
    facility: Path, artifact: Path, material: Path, corrections: Path, *, seed: int = 1, ordered: bool = True
) -> CorrectedTwin:
    """Build a corrected twin from its files; an :class:`~instrument.errors.InputError` names what is wrong."""
    known = Known(read_facility(facility), read_artifact(artifact), read_material(material))
    try:
        applied = resolve(read_corrections(corrections), known, ordered=ordered)
    except InputError as error:
        text = str(error)
        raise InputError(text if str(corrections) in text else f"{corrections}: {text}") from None
    return CorrectedTwin(known.facility, known.artifact, known.material, applied, seed=seed)
