"""How the coating reflects."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from instrument.angles import FloatArray
from twin.artifact import Surface
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.changes import Retroreflection, SpecularLobe
from twin.diagnosis.direct_light import pierced_plate
from twin.diagnosis.effects.base import Known, Parameter, ReadingEffect, SceneEffect
from twin.diagnosis.turned import rotation
from twin.diagnosis.variation import Variation

_CAVITY = (Surface.FLOOR, Surface.UNDERSIDE, Surface.SPACER)


#: Share of the light that a lobe of amplitude 1 reflects at most.
_LOBE_REFLECTANCE = {"retroreflection": 0.6, "specular_lobe": 1.0}
_LEAST_ROOM = 0.01
#: Laws of lobes and of steps inside a coating are several (GGX or Beckmann facets, exponential or normal peaks and
#: steps); amplitude and width of one fitted to another differ by some tens of per cent.
_FORM_ERROR = 0.3


class _Lobe(SceneEffect):
    """A lobe on top of the coating; with it no more light may leave the coating than it receives."""

    form_error = _FORM_ERROR

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        amplitude, *shapes = super().resolve(known, run)
        most = 0.95 * reflectance_room(known) / _LOBE_REFLECTANCE[self.name]
        return replace(amplitude, cap=(amplitude.cap[0], min(amplitude.cap[1], most))), *shapes

    def not_applicable(self, known: Known) -> str:
        return "the coating reflects all light already" if reflectance_room(known) < _LEAST_ROOM else ""

    def axes(self, parameters: tuple[Parameter, ...]) -> tuple[FloatArray, ...]:
        amplitude, width, *laws = parameters
        amplitudes = np.array([0.0, 0.1, 0.3, 1.0]) * amplitude.cap[1]
        ends = (np.array(law.cap) for law in laws)
        return amplitudes, np.geomspace(*width.cap, self.nodes[1]), *ends


def reflectance_room(known: Known) -> float:
    """Share of the light that the coating does not reflect, at the worst incidence."""
    material = known.material
    most = max(float(material.directional_reflectance(material.cos_i, k).max()) for k in range(len(material.brdf)))
    return 1 - most


class RetroreflectionPeak(_Lobe):
    """BRF added at exact retro-reflection, falling to 1/e within the width: exp(-angle/width)."""

    name = "retroreflection"
    title = "peak about retro-reflection"
    parameters = (
        Parameter("amplitude", "1", 0.06, (0.0, 0.6)),
        Parameter("width_deg", "degree", 8.0, (3.0, 40.0), nominal=10.0, shape=True),
    )
    nodes: ClassVar = (4, 5)
    confused_with = ("arm_shadow",)
    separated_by = "illumination zeniths that bring retro-reflection to other sensor zeniths, with a white reference"

    def variation(self, values: FloatArray) -> Variation:
        if values[0] == 0:
            return Variation()
        return Variation(material=(Retroreflection(float(values[0]), float(values[1])),))


class SpecularReflection(_Lobe):
    """A microfacet lobe (Torrance-Sparrow) added: reflectance of the facets, their roughness, and the law of slopes.

    Slopes have tails (GGX), or for a share of the facets are distributed normally (Beckmann).
    """

    name = "specular_lobe"
    title = "specular lobe"
    parameters = (
        Parameter("amplitude", "1", 0.01, (0.0, 0.15)),
        Parameter("roughness", "1", 0.15, (0.1, 0.7), nominal=0.3, shape=True),
        Parameter("normal", "1", 0.2, (0.0, 1.0), shape=True),
    )
    nodes: ClassVar = (4, 5, 2)
    confused_with = ("polarization", "sensor_zenith_offset")
    separated_by = "larger illumination zeniths, where the lobe grows and moves"

    def variation(self, values: FloatArray) -> Variation:
        if values[0] == 0:
            return Variation()
        return Variation(material=(SpecularLobe(*map(float, values)),))


class CavityReflectance(SceneEffect):
    """Reflectance of floor, underside and spacer walls over nominal, the walls of the holes unchanged."""

    name = "cavity_reflectance"
    title = "coating inside the cavity brighter or darker"
    parameters = (Parameter("ratio", "1", 0.07, (0.4, 1.4), nominal=1.0),)
    nodes: ClassVar = (7,)
    confused_with = ("reflectance_scale", "reference_scale", "translucency", "cavity_depth")
    separated_by = "an independent measurement of the coating inside the cavity"

    def not_applicable(self, known: Known) -> str:
        return "the sample has no cavity" if not len(known.artifact.holes) else ""

    def variation(self, values: FloatArray) -> Variation:
        ratio = float(values[0])
        return Variation(surface_factor=tuple((surface, ratio) for surface in _CAVITY))


class ReflectanceScale(SceneEffect):
    """Reflectance of the whole coating over nominal, with all its reflections."""

    name = "reflectance_scale"
    title = "coating brighter or darker than the coupon"
    parameters = (Parameter("ratio", "1", 0.012, (0.8, 1.2), nominal=1.0),)
    nodes: ClassVar = (5,)
    confused_with = ("reference_scale", "cavity_reflectance")
    separated_by = "an absolute measurement of the coupon, by an integrating sphere"

    def variation(self, values: FloatArray) -> Variation:
        ratio = float(values[0])
        return Variation(surface_factor=tuple((surface, ratio) for surface in Surface))


class Translucency(SceneEffect):
    """A share of the light goes sideways inside the coating, by a mean length, before it leaves."""

    name = "translucency"
    title = "light goes sideways inside the coating"
    parameters = (
        Parameter("length_mm", "mm", 0.2, (0.02, 2.0), nominal=0.3, shape=True),
        Parameter("fraction", "1", 0.2, (0.0, 1.0)),
    )
    nodes: ClassVar = (6, 3)
    form_error = _FORM_ERROR
    confused_with = ("field_of_view", "cavity_reflectance", "detector_nonlinearity", "edge_chamfer")
    separated_by = "a pencil of light scanned across an edge, or the same scan with a smaller iris"

    def not_applicable(self, known: Known) -> str:
        return "" if pierced_plate(known.artifact) is not None else "the sample is a mesh, or its floor is not level"

    def axes(self, parameters: tuple[Parameter, ...]) -> tuple[FloatArray, ...]:
        length, fraction = parameters
        return np.geomspace(*length.cap, self.nodes[0]), np.linspace(*fraction.cap, self.nodes[1])

    def variation(self, values: FloatArray) -> Variation:
        return Variation(transport=(float(values[0]), float(values[1]))) if values[1] else Variation()


class Anisotropy(ReadingEffect):
    """Relative modulation with twice the azimuth about an axis fixed in the sample.

    1 + amplitude cos(2 (sensor azimuth - axis)) sin^q(sensor zenith), the azimuth as the sample sees it, and q = 2
    unless the run says more: the lowest harmonic that is smooth where the view along the normal has no azimuth. Grooves
    show as well near the normal as at grazing views (q below 2), shadows between them at grazing views alone.

    By reciprocity the light's direction counts as the view's does: while the sample lies still that is a scale of each
    illumination. What holes and a second reflection leave of it, and laws without it, are covered by ``light_share``.
    """

    name = "anisotropy"
    title = "coating reflects differently along and across an axis"
    parameters = (
        Parameter("amplitude", "1", 0.04, (0.0, 0.5)),
        Parameter("axis_deg", "degree", 45.0, (0.0, 180.0), shape=True),
        Parameter("power", "1", 1.0, (0.5, 4.0), nominal=2.0, shape=True),
        Parameter("light_share", "1", 0.5, (0.0, 1.0), nominal=1.0, shape=True),
    )
    shapes = 4
    confused_with = ("polarization",)
    separated_by = "the same scan with the sample turned by 90 degrees"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        columns, turned = run.columns, rotation(run.columns)
        amplitude, axis, power, share = (values[..., k : k + 1] for k in range(4))

        def along(side: str) -> FloatArray:
            sine = np.abs(np.sin(np.deg2rad(columns[f"{side}_zenith"])))
            return np.asarray(np.cos(2 * np.deg2rad(columns[f"{side}_azimuth"] - turned - axis)) * sine**power)

        return np.asarray(brf * (1 + amplitude * (along("sensor") + share * along("illumination"))))
