"""Angles of the arms that are off everywhere by the same amount, and a sensor axis that misses the centre."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects.base import Parameter, SceneEffect, ZenithEffect
from twin.diagnosis.variation import Variation
from twin.optics import Setup


class IlluminationZenithOffset(SceneEffect):
    """True illumination zenith = commanded + angle."""

    name = "illumination_zenith_offset"
    title = "zero of the illumination zenith off"
    parameters = (Parameter("angle_deg", "degree", 1.9, (-8.0, 8.0), budget_of="facility.arms.u_illumination_zenith"),)
    nodes: ClassVar = (7,)
    confused_with = ("session_scale",)
    separated_by = "illumination zenith 60 degrees"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(illumination_zenith_deg=float(values[0])))


class SensorZenithOffset(ZenithEffect):
    """True sensor zenith = commanded + angle, also during the reference measurement."""

    name = "sensor_zenith_offset"
    title = "zero of the sensor zenith off"
    parameters = (Parameter("angle_deg", "degree", 0.37, (-3.0, 3.0), budget_of="facility.arms.u_sensor_zenith"),)
    confused_with = ("backlash", "stale_sample", "sensor_arm_runout", "sample_tilt")
    separated_by = "a slice in the opposite scan direction, and planes from both sides"

    def zenith_error(self, run: Acquisition, values: FloatArray) -> FloatArray:
        return np.broadcast_to(values, (len(values), len(run)))

    def reference_setup(self, values: FloatArray, reference_zenith: float) -> Setup:
        return Setup(sensor_zenith_deg=float(values[0]))


class SensorAzimuthOffset(SceneEffect):
    """True sensor azimuth = commanded + angle."""

    name = "sensor_azimuth_offset"
    title = "zero of the sensor azimuth off"
    parameters = (Parameter("angle_deg", "degree", 8.0, (-30.0, 30.0), budget_of="facility.arms.u_sensor_azimuth"),)
    nodes: ClassVar = (9,)
    confused_with = ("sample_azimuth",)
    separated_by = "a fine scan of the sensor azimuth across a lobe"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(sensor_azimuth_deg=float(values[0])))


class SensorArmRunout(SceneEffect):
    """Sensor axis displaced sideways, towards growing sensor zenith."""

    name = "sensor_arm_runout"
    title = "sensor axis beside the optical centre"
    parameters = (Parameter("offset_mm", "mm", 1.3, (-3.0, 3.0)),)
    nodes: ClassVar = (15,)
    crowding: ClassVar = 1.4
    confused_with = ("sensor_zenith_offset", "stale_sample", "sample_tilt")
    separated_by = "points beyond 70 degrees of sensor zenith, and a scan with a smaller iris"

    def variation(self, values: FloatArray) -> Variation:
        return Variation(Setup(sensor_runout_mm=float(values[0])))
