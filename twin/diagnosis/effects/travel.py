"""Angles of the sensor arm that are off by an amount that depends on the angle, or on how the arm got there."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects.base import Parameter, ZenithEffect
from twin.optics import Setup

_AMPLITUDE = (-3.0, 3.0)


class Backlash(ZenithEffect):
    """True sensor zenith = commanded + angle/2 in the direction of travel.

    The reference reading counts as taken in place: from which side its angle was approached is not recorded.
    """

    name = "backlash"
    title = "play in the drive of the sensor zenith"
    parameters = (Parameter("angle_deg", "degree", 0.74, (-4.0, 4.0)),)
    confused_with = ("sensor_zenith_offset", "stale_sample")
    separated_by = "a slice in the opposite scan direction"

    def zenith_error(self, run: Acquisition, values: FloatArray) -> FloatArray:
        return np.asarray(values / 2 * run.travel)


class ByAngle(ZenithEffect):
    """An error that depends on the sensor zenith alone, and so affects the reference measurement too."""

    @abstractmethod
    def error(self, zenith_rad: FloatArray, values: FloatArray) -> FloatArray:
        """Degree, shape (n, point), for values of shape (n, parameter)."""

    def zenith_error(self, run: Acquisition, values: FloatArray) -> FloatArray:
        return self.error(np.deg2rad(run.columns["sensor_zenith"]), values)

    def reference_setup(self, values: FloatArray, reference_zenith: float) -> Setup:
        error = self.error(np.deg2rad(np.array([reference_zenith])), values[None])
        return Setup(sensor_zenith_deg=float(error[0, 0]))


class ArmSag(ByAngle):
    """The sensor arm bends under its weight: true zenith = commanded + angle sin(zenith)."""

    name = "arm_sag"
    title = "sensor arm bends under its weight"
    parameters = (Parameter("angle_deg", "degree", 0.4, _AMPLITUDE),)
    confused_with = ("encoder_eccentricity", "sample_height", "detector_nonlinearity", "stray_light")
    separated_by = "a scan of the white reference over the sensor zenith"

    def error(self, zenith_rad: FloatArray, values: FloatArray) -> FloatArray:
        return np.asarray(values * np.sin(zenith_rad))


class EncoderEccentricity(ByAngle):
    """A scale off its axis: once a turn, zero where the arm was zeroed, at zenith 0.

    True zenith = commanded + sine sin(zenith) + cosine (cos(zenith) - 1).
    """

    name = "encoder_eccentricity"
    title = "angular scale of the sensor arm off its axis"
    parameters = (
        Parameter("sine_deg", "degree", 0.4, _AMPLITUDE),
        Parameter("cosine_deg", "degree", 0.5, _AMPLITUDE),
    )
    confused_with = ("arm_sag", "sensor_zenith_offset", "encoder_ellipticity")
    separated_by = "a scan of the white reference over the sensor zenith"

    def error(self, zenith_rad: FloatArray, values: FloatArray) -> FloatArray:
        sine, cosine = values[:, :1], values[:, 1:]
        return np.asarray(sine * np.sin(zenith_rad) + cosine * (np.cos(zenith_rad) - 1))


class EncoderEllipticity(ByAngle):
    """A scale that is tilted or not round: twice a turn, zero at zenith 0.

    True zenith = commanded + sine sin(2 zenith) + cosine (cos(2 zenith) - 1).
    """

    name = "encoder_ellipticity"
    title = "angular scale of the sensor arm not round"
    catalogued = False
    parameters = (
        Parameter("sine_deg", "degree", 0.8, _AMPLITUDE),
        Parameter("cosine_deg", "degree", 0.25, _AMPLITUDE),
    )
    confused_with = ("encoder_eccentricity", "arm_sag", "sensor_zenith_offset")
    separated_by = "a scan of the white reference over the sensor zenith"

    def error(self, zenith_rad: FloatArray, values: FloatArray) -> FloatArray:
        sine, cosine = values[:, :1], values[:, 1:]
        return np.asarray(sine * np.sin(2 * zenith_rad) + cosine * (np.cos(2 * zenith_rad) - 1))
