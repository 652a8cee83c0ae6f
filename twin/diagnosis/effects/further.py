"""Causes beyond the catalogue of the data contract: not named, but what they explain is nobody else's.

Effects mimic each other, so a run with a cause that no effect of the catalogue covers would be given a wrong name.
These stand for such causes: where one of them explains a run better than any effect of the catalogue, the verdict is
unknown, and the cause is told as a suspicion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from instrument.angles import FloatArray, direction
from instrument.artifact import ArtifactDimensions
from twin.artifact import Surface
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects.base import AzimuthEffect, Known, Parameter, ReadingEffect, SceneEffect, TopEffect
from twin.diagnosis.effects.material import reflectance_room
from twin.diagnosis.effects.travel import ByAngle
from twin.diagnosis.variation import ArtifactChange, Variation


@dataclass(frozen=True)
class FloorTilt(ArtifactChange):
    """The block under the plate tilted about x and y, degrees."""

    x_deg: float
    y_deg: float

    def dimensions(self, artifact: ArtifactDimensions) -> ArtifactDimensions:
        return artifact.changed(block_tilt_x=self.x_deg, block_tilt_y=self.y_deg)


class FloorWedge(SceneEffect):
    """The floor of the cavity tilted against the plate: glue of uneven thickness."""

    name = "floor_wedge"
    title = "floor of the cavity tilted against the plate"
    catalogued = False
    parameters = (
        Parameter("x_deg", "degree", 1.5, (-3.0, 3.0)),
        Parameter("y_deg", "degree", 1.5, (-3.0, 3.0)),
    )
    nodes: ClassVar = (3, 3)

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        """The floor stays between the plate and the bottom of the block."""
        form = known.artifact.form
        room = 0.4 * min(form.cavity_depth - form.plate_thickness, form.block_thickness)
        reach = [(side / 2 - form.spacer_edge) for side in form.outline]
        steepest = float(np.rad2deg(np.arctan(room / max(*reach, 1e-6))))
        return tuple(replace(p, cap=(-steepest, steepest)) for p in super().resolve(known, run))

    def not_applicable(self, known: Known) -> str:
        if known.artifact.mesh is not None:
            return "the sample is a mesh without dimensions"
        return "the sample has no cavity" if not len(known.artifact.holes) else ""

    def variation(self, values: FloatArray) -> Variation:
        if not np.any(values):
            return Variation()
        return Variation(artifact=(FloorTilt(float(values[0]), float(values[1])),))


class WallReflectance(SceneEffect):
    """Reflectance of the holes' walls alone over nominal: a coating that does not reach, or runs down."""

    name = "wall_reflectance"
    title = "walls of the holes brighter or darker"
    catalogued = False
    parameters = (Parameter("ratio", "1", 0.2, (0.2, 2.0), nominal=1.0),)
    nodes: ClassVar = (7,)

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        """No wall reflects more light than it receives."""
        (parameter,) = super().resolve(known, run)
        most = 1.0 / max(1.0 - reflectance_room(known), 1e-6)
        return (replace(parameter, cap=(parameter.cap[0], max(1.02, min(parameter.cap[1], most)))),)

    def not_applicable(self, known: Known) -> str:
        return "the sample has no holes" if not len(known.artifact.holes) else ""

    def variation(self, values: FloatArray) -> Variation:
        return Variation(surface_factor=((Surface.HOLE_WALL, float(values[0])),))


class SourceJump(ReadingEffect):
    """The source's power changes at once, somewhere in the run."""

    name = "source_jump"
    title = "source jumps during the scan"
    catalogued = False
    parameters = (
        Parameter("fraction", "1", 0.02, (-0.3, 0.3)),
        Parameter("progress", "1", 0.5, (0.05, 0.95), nominal=0.5, shape=True),
    )
    needs = ("progress",)
    shapes = 19

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        fraction, when = values[..., :1], values[..., 1:]
        assert run.progress is not None
        # As wide as a few points: a moment between two points is no more than that.
        step = 1 / (1 + np.exp(-(run.progress - when) / 0.004))
        return np.asarray(brf * (1 + fraction * step))


class CableTorsion(ReadingEffect):
    """Light lost with the sensor's azimuth, once a turn: a fibre that is twisted."""

    name = "cable_torsion"
    title = "signal depends on the sensor's azimuth"
    catalogued = False
    parameters = (
        Parameter("cosine", "1", 0.02, (-0.3, 0.3)),
        Parameter("sine", "1", 0.02, (-0.3, 0.3)),
    )

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        azimuth = np.deg2rad(run.columns["sensor_azimuth"])
        change = values[..., :1] * np.cos(azimuth) + values[..., 1:] * np.sin(azimuth)
        of_reference = np.mean(
            values[..., :1] * np.cos(np.deg2rad(run.reference_azimuth))
            + values[..., 1:] * np.sin(np.deg2rad(run.reference_azimuth)),
            axis=-1,
            keepdims=True,
        )
        return np.asarray(brf * (1 + change) / (1 + of_reference))


class DirectionalResponse(ReadingEffect):
    """Response that falls as a power of the cosine of the sensor's zenith."""

    name = "directional_response"
    title = "response of the detector depends on the viewing zenith"
    catalogued = False
    parameters = (Parameter("exponent", "1", 0.03, (-0.5, 0.5)),)

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        ratio = np.cos(np.deg2rad(run.columns["sensor_zenith"])) / np.cos(np.deg2rad(run.reference_zenith))
        return np.asarray(brf * np.maximum(ratio, 1e-6) ** values)


class Ghost(ReadingEffect):
    """Light that arrives around one direction of the sensor: a glint of the mount, an image of the source."""

    name = "ghost"
    title = "extra light around one viewing direction"
    catalogued = False
    parameters = (
        Parameter("amplitude", "1", 0.05, (-0.5, 0.5)),
        Parameter("zenith_deg", "degree", 20.0, (-80.0, 80.0), shape=True),
        Parameter("azimuth_deg", "degree", 45.0, (0.0, 180.0), nominal=90.0, shape=True),
        Parameter("width_deg", "degree", 8.0, (6.0, 30.0), nominal=12.0, shape=True),
    )
    shapes = 4

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        view = direction(run.columns["sensor_zenith"], run.columns["sensor_azimuth"])
        towards = direction(values[..., 1], values[..., 2])
        cosine = np.clip(towards @ view.T, -1.0, 1.0)
        angle = np.rad2deg(np.arccos(cosine))
        lobe = np.exp(-((angle / values[..., 3:]) ** 2))
        return np.asarray(brf + values[..., :1] * lobe)


class ZenithScale(ByAngle):
    """Steps of the sensor arm too long or too short: the error grows with the angle itself."""

    name = "zenith_scale"
    title = "scale factor of the sensor's zenith"
    catalogued = False
    parameters = (Parameter("fraction", "1", 0.007, (-0.05, 0.05)),)

    def error(self, zenith_rad: FloatArray, values: FloatArray) -> FloatArray:
        return np.asarray(values * np.rad2deg(zenith_rad))


class AzimuthScale(AzimuthEffect):
    """A gear ratio of the sensor's azimuth that is wrong: the error grows with the angle to the plane of incidence."""

    name = "azimuth_scale"
    title = "scale factor of the sensor's azimuth"
    catalogued = False
    parameters = (Parameter("fraction", "1", 0.04, (-0.16, 0.16)),)

    def azimuth_error(self, run: Acquisition, values: FloatArray) -> FloatArray:
        azimuth = run.columns["sensor_azimuth"]
        return np.asarray(values * np.where(azimuth > 180.0, azimuth - 360.0, azimuth))


class Stain(TopEffect):
    """A spot on the plate's top that is darker, or brighter: a fingerprint, dust, a worn coating."""

    name = "stain"
    title = "stain on the top of the sample"
    catalogued = False
    parameters = (
        Parameter("fraction", "1", 0.08, (-0.6, 0.3)),
        Parameter("x_mm", "mm", 2.0, (-1.0, 1.0), shape=True),
        Parameter("y_mm", "mm", 2.0, (-1.0, 1.0), shape=True),
        Parameter("radius_mm", "mm", 2.0, (0.1, 1.0), shape=True),
    )
    shapes = 3

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        """Caps of place and size are shares of the beam's radius."""
        fraction, *place = super().resolve(known, run)
        reach = max(known.facility.beam.iris)
        middle = [replace(p, cap=(p.cap[0] * reach, p.cap[1] * reach)) for p in place]
        return fraction, *(replace(p, nominal=0.5 * sum(p.cap)) for p in middle)

    def not_applicable(self, known: Known) -> str:
        return "the sample is a mesh" if known.artifact.mesh is not None else ""

    def change(self, places: FloatArray, values: FloatArray) -> FloatArray:
        fraction, x, y, radius = (values[:, [k]] for k in range(4))
        apart = np.hypot(places[:, 0] - x, places[:, 1] - y)
        return np.asarray(fraction * np.exp(-((apart / radius) ** 4)))
