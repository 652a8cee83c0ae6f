"""Where and how the sample stands."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects.base import JoinedEffect, Known, Parameter, SceneEffect
from twin.diagnosis.variation import Variation
from twin.optics import Setup


class SampleTilt(JoinedEffect):
    """Sample rotated about axes parallel to the laboratory's x and y, through a point up to its own corners away.

    Where it tilts about a leg, and not about the spot that the beam lights, the spot rises: by ``pivot_mm``, the
    distance of the spot from the axis of the tilt, times the sine of the tilt.
    """

    name = "sample_tilt"
    title = "sample tilted"
    parameters = (
        Parameter("x_deg", "degree", 0.55, (-3.5, 3.5), budget_of="facility.sample.u_tilt"),
        Parameter("y_deg", "degree", 0.55, (-3.5, 3.5), budget_of="facility.sample.u_tilt"),
        Parameter("pivot_mm", "mm", 10.0, (-35.0, 35.0), shape=True),
    )
    nodes: ClassVar = (5, 5, 1)
    shapes: ClassVar = 4
    part: ClassVar = "sample_height"
    confused_with = ("sensor_zenith_offset", "sensor_arm_runout", "beam_offset")
    separated_by = "the same planes from both sides (azimuth and azimuth + 180), and the sample turned by 180 degrees"

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        x, y, pivot = super().resolve(known, run)
        corner = float(np.hypot(*known.artifact.form.outline)) / 2
        return x, y, replace(pivot, cap=(-corner, corner))

    def variation(self, values: FloatArray) -> Variation:
        (height,) = self.of_part(values[None])[0]
        return Variation(Setup(tilt_x_deg=float(values[0]), tilt_y_deg=float(values[1]), height_mm=float(height)))

    def of_part(self, values: FloatArray) -> FloatArray:
        tilt = np.deg2rad(np.hypot(values[:, 0], values[:, 1]))
        return np.asarray(values[:, 2:] * np.sin(tilt)[:, None])


class SampleAzimuth(SceneEffect):
    """Sample rotated about its normal: of an isotropic material only the lattice of holes turns."""

    name = "sample_azimuth"
    title = "sample turned about its normal"
    parameters = (Parameter("angle_deg", "degree", 7.8, (-45.0, 45.0), budget_of="facility.sample.u_azimuth"),)
    nodes: ClassVar = (13,)
    confused_with = ("sensor_azimuth_offset",)
    separated_by = "a fine scan of the sensor azimuth across a lobe of the lattice"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(sample_azimuth_deg=float(values[0])))


class SampleHeight(SceneEffect):
    """Sample raised along its nominal normal."""

    name = "sample_height"
    title = "sample too high or too low"
    parameters = (Parameter("height_mm", "mm", 1.3, (-6.0, 6.0), budget_of="facility.sample.u_height"),)
    nodes: ClassVar = (25,)
    crowding: ClassVar = 1.5
    confused_with = ("edge_chamfer", "field_of_view")
    separated_by = "a scan of the white reference over the sensor zenith"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(height_mm=float(values[0])))


class SampleOffset(SceneEffect):
    """Sample moved in its plane: other holes come into the beam."""

    name = "sample_offset"
    title = "sample moved in its plane"
    parameters = (
        Parameter("x_mm", "mm", 2.4, (-1.6, 1.6), budget_of="facility.sample.u_offset"),
        Parameter("y_mm", "mm", 2.4, (-1.6, 1.6), budget_of="facility.sample.u_offset"),
    )
    nodes: ClassVar = (7, 7)
    confused_with = ("beam_offset",)
    separated_by = "the same scan with the sample moved by half a pitch"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(offset_x_mm=float(values[0]), offset_y_mm=float(values[1])))
