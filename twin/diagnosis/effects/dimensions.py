"""The sample's dimensions."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.changes import CavityDepth, EdgeChamfer, HoleDiameter, PlateThickness
from twin.diagnosis.effects.base import Known, Parameter, SceneEffect
from twin.diagnosis.variation import ArtifactChange, Variation

#: Shares of a dimension, or of the room for it, that a change may take.
_OF_DIAMETER, _OF_THICKNESS, _OF_GAP, _OF_ROOM = 0.15, 0.55, 0.35, 0.8


class _Dimension(SceneEffect):
    """A change of a plate with holes."""

    def not_applicable(self, known: Known) -> str:
        if known.artifact.mesh is not None:
            return "the sample is a mesh without dimensions"
        return "the sample has no holes" if not len(known.artifact.holes) else ""

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        (parameter,) = super().resolve(known, run)
        return (replace(parameter, cap=self.limits(known), budget=self.budget(known)),)

    def limits(self, known: Known) -> tuple[float, float]:
        """Lowest and highest change, mm."""
        raise NotImplementedError

    def budget(self, known: Known) -> float:
        """Standard uncertainty of the dimension, mm."""
        return 0.0

    def change(self, value: float) -> ArtifactChange:
        """The change by so many mm."""
        raise NotImplementedError

    def variation(self, values: FloatArray) -> Variation:
        return Variation(artifact=(self.change(float(values[0])),))


class HoleDiameterChange(_Dimension):
    """Every hole wider by the same."""

    name = "hole_diameter"
    title = "holes wider or narrower"
    parameters = (Parameter("delta_mm", "mm", 0.055, (-0.3, 0.3)),)
    nodes: ClassVar = (5,)
    confused_with = ("edge_chamfer", "cavity_reflectance", "plate_thickness")
    separated_by = "illumination zenith 60 degrees"

    def limits(self, known: Known) -> tuple[float, float]:
        smallest = float(known.artifact.holes.diameter.min())
        room = 0.9 * narrowest_bridge(known)
        return -_OF_DIAMETER * smallest, min(_OF_DIAMETER * smallest, room)

    def budget(self, known: Known) -> float:
        # What the holes have in common is not stated; that of one hole is an upper limit.
        return float(np.mean(known.artifact.holes.u_diameter))

    def change(self, value: float) -> ArtifactChange:
        return HoleDiameter(value)


class PlateThicknessChange(_Dimension):
    """Plate thicker, its top and the floor where they were."""

    name = "plate_thickness"
    title = "plate thicker or thinner"
    parameters = (Parameter("delta_mm", "mm", 0.13, (-0.6, 0.7)),)
    nodes: ClassVar = (9,)
    confused_with = ("hole_diameter", "cavity_depth")
    separated_by = "illumination zenith 60 degrees"

    def limits(self, known: Known) -> tuple[float, float]:
        form = known.artifact.form
        gap = form.cavity_depth - form.plate_thickness
        return -_OF_THICKNESS * form.plate_thickness, min(0.7 * form.plate_thickness, _OF_GAP * gap)

    def budget(self, known: Known) -> float:
        return known.artifact.form.u_plate_thickness

    def change(self, value: float) -> ArtifactChange:
        return PlateThickness(value)


class CavityDepthChange(_Dimension):
    """Floor deeper below the plate's top."""

    name = "cavity_depth"
    title = "cavity deeper or shallower"
    parameters = (Parameter("delta_mm", "mm", 0.17, (-0.7, 1.1)),)
    nodes: ClassVar = (11,)
    confused_with = ("plate_thickness", "cavity_reflectance", "hole_diameter")
    separated_by = "illumination zenith 60 degrees"

    def limits(self, known: Known) -> tuple[float, float]:
        form = known.artifact.form
        gap = _OF_GAP * (form.cavity_depth - form.plate_thickness)
        return -gap, 1.5 * gap

    def budget(self, known: Known) -> float:
        return known.artifact.form.u_cavity_depth

    def change(self, value: float) -> ArtifactChange:
        return CavityDepth(value)


class EdgeChamferWidth(_Dimension):
    """The 45 degree chamfer at the upper edges of the holes wider; the model may have sharp ones."""

    name = "edge_chamfer"
    title = "edges of the holes chamfered"
    parameters = (Parameter("delta_mm", "mm", 0.055, (0.0, 0.3)),)
    nodes: ClassVar = (7,)
    confused_with = ("hole_diameter", "sample_height", "stray_light", "dark_offset")
    separated_by = "the same scan with a quarter of the light, and a profile of an edge"

    def not_applicable(self, known: Known) -> str:
        reason = super().not_applicable(known)
        if reason:
            return reason
        return "" if self.limits(known)[1] > 0 else "the holes leave no room for a chamfer"

    def limits(self, known: Known) -> tuple[float, float]:
        chamfers = known.artifact.chamfers
        room = min(
            _OF_ROOM * narrowest_bridge(known) / 2, 0.5 * known.artifact.form.plate_thickness - float(chamfers.max())
        )
        return 0.0 - float(chamfers.min()), min(0.3, room)

    def budget(self, known: Known) -> float:
        return float(np.mean(known.artifact.u_chamfers))

    def change(self, value: float) -> ArtifactChange:
        return EdgeChamfer(value)


def narrowest_bridge(known: Known) -> float:
    """What separates the closest holes with their chamfers, or a hole from the edge of the plate, mm."""
    holes, half = known.artifact.holes, np.asarray(known.artifact.form.outline) / 2
    radius = holes.diameter / 2 + known.artifact.chamfers
    gap = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y) - radius[:, None] - radius
    np.fill_diagonal(gap, np.inf)
    to_edge = np.minimum(half[0] - np.abs(holes.x), half[1] - np.abs(holes.y)) - radius
    return float(max(0.0, min(gap.min(), 2 * to_edge.min())))
