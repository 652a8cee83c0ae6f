"""The beam and the sensor's optics."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects.base import Known, Parameter, SceneEffect
from twin.diagnosis.variation import Variation
from twin.optics import Setup

#: Share of the iris' radius by which it may be narrower.
_OF_RADIUS = 0.65


def _unbounded(known: Known) -> str:
    return "the beam of the facility has no edge" if known.facility.beam.diameter == "unbounded" else ""


class BeamOffset(SceneEffect):
    """Where the beam's axis crosses the plane z = 0."""

    name = "beam_offset"
    title = "beam beside the optical centre"
    parameters = (Parameter("x_mm", "mm", 0.4, (-2.1, 2.1)), Parameter("y_mm", "mm", 0.4, (-2.1, 2.1)))
    nodes: ClassVar = (7, 7)
    confused_with = ("sample_tilt", "sample_offset", "sensor_arm_runout")
    separated_by = "a scan with a smaller iris, and planes from both sides"

    def not_applicable(self, known: Known) -> str:
        return _unbounded(known)

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(beam_x_mm=float(values[0]), beam_y_mm=float(values[1])))


class BeamRadius(SceneEffect):
    """Radius of the iris."""

    name = "beam_radius"
    title = "iris wider or narrower"
    parameters = (Parameter("radius_mm", "mm", 1.0, (-3.5, 2.0)),)
    nodes: ClassVar = (19,)
    confused_with = ("field_of_view",)
    separated_by = "the same scan with another iris"

    def not_applicable(self, known: Known) -> str:
        return _unbounded(known)

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        (parameter,) = super().resolve(known, run)
        diameter = known.facility.beam.diameter
        if diameter == "unbounded":
            return (parameter,)
        return (replace(parameter, cap=(max(parameter.cap[0], -_OF_RADIUS * diameter / 2), parameter.cap[1])),)

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(beam_radius_mm=float(values[0])))


class BeamDivergence(SceneEffect):
    """Standard deviation of the light's direction about the axis; a spread has no sign."""

    name = "beam_divergence"
    title = "beam less parallel"
    parameters = (Parameter("angle_deg", "degree", 9.0, (0.0, 12.0), budget_of="facility.beam.u_divergence"),)
    nodes: ClassVar = (9,)
    confused_with = ("acceptance_angle",)
    separated_by = "a fine scan of the sensor zenith across a lobe"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(divergence_deg=float(values[0])))


class FieldOfView(SceneEffect):
    """Radius of the target disc."""

    name = "field_of_view"
    title = "field of view of the sensor wider or narrower"
    parameters = (Parameter("radius_mm", "mm", 1.0, (-1.5, 3.0)),)
    nodes: ClassVar = (13,)
    crowding: ClassVar = 1.3
    confused_with = ("beam_radius", "translucency", "sample_height")
    separated_by = "a scan of the white reference over the sensor zenith with two irises"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(target_radius_mm=float(values[0])))


class AcceptanceAngle(SceneEffect):
    """Radius of the collecting mirror's disc."""

    name = "acceptance_angle"
    title = "acceptance angle of the sensor larger or smaller"
    parameters = (Parameter("radius_mm", "mm", 40.0, (-4.0, 60.0)),)
    nodes: ClassVar = (7,)
    confused_with = ("beam_divergence",)
    separated_by = "a fine scan of the sensor zenith across a lobe"

    def not_applicable(self, known: Known) -> str:
        return "the sensor of the facility is a parallel one" if known.facility.sensor.mirror_diameter == 0 else ""

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(mirror_radius_mm=float(values[0])))
