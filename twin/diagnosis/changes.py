"""The changes of dimensions and material that the library's effects need."""

from __future__ import annotations

from dataclasses import dataclass

from instrument.artifact import ArtifactDimensions
from twin.diagnosis.variation import ArtifactChange, MaterialChange
from twin.material import Material
from twin.material_changes import with_retroreflection, with_specular_lobe


@dataclass(frozen=True)
class HoleDiameter(ArtifactChange):
    """Every hole's diameter changed, mm."""

    delta_mm: float

    def dimensions(self, artifact: ArtifactDimensions) -> ArtifactDimensions:
        return artifact.changed(hole_diameter=self.delta_mm)


@dataclass(frozen=True)
class PlateThickness(ArtifactChange):
    """The plate thicker by so many mm, the depth of the cavity from the plate's top unchanged."""

    delta_mm: float

    def dimensions(self, artifact: ArtifactDimensions) -> ArtifactDimensions:
        return artifact.changed(plate_thickness=self.delta_mm)


@dataclass(frozen=True)
class CavityDepth(ArtifactChange):
    """The floor deeper by so many mm."""

    delta_mm: float

    def dimensions(self, artifact: ArtifactDimensions) -> ArtifactDimensions:
        return artifact.changed(cavity_depth=self.delta_mm)


@dataclass(frozen=True)
class EdgeChamfer(ArtifactChange):
    """The chamfer at the upper edge of every hole wider by so many mm."""

    delta_mm: float

    def dimensions(self, artifact: ArtifactDimensions) -> ArtifactDimensions:
        return artifact.changed(edge_chamfer=self.delta_mm)


@dataclass(frozen=True)
class Retroreflection(MaterialChange):
    """A peak about exact retro-reflection."""

    amplitude: float
    width_deg: float

    def apply(self, material: Material) -> Material:
        return with_retroreflection(material, self.amplitude, self.width_deg)

    def grid_key(self) -> str:
        return f"retroreflection {self.width_deg!r}"


@dataclass(frozen=True)
class SpecularLobe(MaterialChange):
    """A microfacet lobe; a share of its facets has normally distributed slopes."""

    amplitude: float
    roughness: float
    normal: float = 0.0

    def apply(self, material: Material) -> Material:
        return with_specular_lobe(material, self.amplitude, self.roughness, self.normal)

    def grid_key(self) -> str:
        return f"specular {self.roughness!r} {self.normal!r}"
