"""What detector and amplifier make of the light."""

from __future__ import annotations

import numpy as np

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects.base import Known, Parameter, ReadingEffect

#: Refractive index of common binders, and the view at which laws of the polarisation are the same.
_BINDER_INDEX, _GRAZING_RAD = 1.5, np.deg2rad(80.0)


class StrayLight(ReadingEffect):
    """Signal added at every geometry, over the reference reading (which counts as read with it)."""

    name = "stray_light"
    title = "stray light"
    parameters = (Parameter("fraction", "1", 0.0026, (0.0, 0.1)),)
    confused_with = ("dark_offset", "detector_nonlinearity", "edge_chamfer", "arm_sag")
    separated_by = "the same scan with a quarter of the light"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        return np.asarray(brf + values / run.signal_per_brf)


class DarkOffset(ReadingEffect):
    """Constant voltage added at the detector's output, in the reference reading too."""

    name = "dark_offset"
    title = "offset of the detector voltage"
    parameters = (Parameter("voltage_v", "V", 0.005, (-0.2, 0.2)),)
    needs = ("gain", "reference_gain", "reference_current")
    confused_with = ("stray_light", "detector_nonlinearity", "gain_step")
    separated_by = "the same scan with a quarter of the light"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        assert run.gain is not None
        assert run.reference_gain is not None
        assert run.reference_current is not None
        added = values / (run.gain * run.reference_current)
        of_reference = values / (run.reference_gain * run.reference_current)
        return np.asarray((brf + added / run.signal_per_brf) / (1 + of_reference))


class DetectorNonlinearity(ReadingEffect):
    """Response 1 + fraction (s^q - 1)/q, s the signal over the reference reading; q = 1 unless the run says more."""

    name = "detector_nonlinearity"
    title = "detector not linear"
    parameters = (
        Parameter("fraction", "1", 0.02, (-0.4, 0.4)),
        Parameter("power", "1", 0.5, (0.5, 2.0), nominal=1.0, shape=True),
    )
    confused_with = ("stray_light", "dark_offset", "gain_step", "sample_height", "arm_sag")
    separated_by = "the same scan with a quarter of the light"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        fraction, power = values[..., :1], values[..., 1:]
        signal = np.maximum(brf * run.signal_per_brf, 0.0)
        return np.asarray(brf * (1 + fraction * (signal**power - 1) / power))


class GainStep(ReadingEffect):
    """Relative error of the higher gain range; a reference read in that range has it too."""

    name = "gain_step"
    title = "gain ranges do not agree"
    parameters = (Parameter("fraction", "1", 0.02, (-0.2, 0.2)),)
    needs = ("gain",)
    confused_with = ("detector_nonlinearity", "dark_offset")
    separated_by = "points read in both gain ranges"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        assert run.gain is not None
        highest = float(max(run.gain.max(), run.reference_gain or 0.0))
        higher = np.isclose(run.gain, highest)
        of_reference = bool(run.reference_gain is not None and np.isclose(run.reference_gain, highest))
        return np.asarray(brf * (1 + values * higher) / (1 + values * of_reference))


class Polarization(ReadingEffect):
    """Response varying as cos(2 sensor azimuth) times the degree of polarisation of the light.

    Which goes with the square of the sine of the sensor zenith, or, for the share ``refracted``, as that of light that
    leaves a smooth body by refraction (Fresnel): as the square of the sine near the normal and far more steeply at
    grazing views. Both are the same at 80 degrees.
    """

    name = "polarization"
    title = "detector sensitive to polarisation"
    parameters = (
        Parameter("fraction", "1", 0.04, (-0.5, 0.5)),
        Parameter("refracted", "1", 0.2, (0.0, 1.0), nominal=0.0, shape=True),
    )
    confused_with = ("anisotropy", "specular_lobe")
    separated_by = "the same scan with the polariser turned, or of the white reference"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        fraction, refracted = values[..., :1], values[..., 1:]
        here = _polarised(run.columns["sensor_zenith"], run.columns["sensor_azimuth"], refracted)
        there = _polarised(np.asarray(run.reference_zenith), run.reference_azimuth, refracted)
        return np.asarray(brf * (1 + fraction * here) / (1 + fraction * np.mean(there, axis=-1, keepdims=True)))


class ReferenceScale(ReadingEffect):
    """Reference reading over what was assumed."""

    name = "reference_scale"
    title = "reference reading wrong"
    parameters = (Parameter("ratio", "1", 0.014, (0.7, 1.4), nominal=1.0, budget_of="facility.reference.u_relative"),)
    confused_with = ("reflectance_scale", "cavity_reflectance", "session_scale")
    separated_by = "an absolute measurement of the sample"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        return np.asarray(brf / values)


class ArmShadow(ReadingEffect):
    """Share of the light lost at the edge of the shadow cone, fading within about 15 degrees.

    fraction * exp(-(angle^2 - edge^2)/width^2), angle that between illumination and view: the penumbra of the detector
    head. It fades the faster, the smaller the source's image is against the head. The reference reading loses its
    share as well, which raises all points.
    """

    name = "arm_shadow"
    title = "arm or detector head cuts the beam"
    parameters = (
        Parameter("fraction", "1", 0.1, (0.0, 1.0)),
        Parameter("width_deg", "degree", 3.0, (5.0, 14.0), nominal=8.0, shape=True),
    )
    confused_with = ("retroreflection",)
    separated_by = "a scan of the white reference at several illumination zeniths"

    _EDGE_DEG = 5.0

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        fraction, width = values[..., :1], values[..., 1:]
        here = self._lost(phase_angle_deg(run.columns), width)
        there = np.mean(self._lost(phase_angle_deg(run.reference_columns), width), axis=-1, keepdims=True)
        return np.asarray(brf * (1 - fraction * here) / (1 - fraction * there))

    def _lost(self, angle: FloatArray, width: FloatArray) -> FloatArray:
        """Share of the fraction, shape (..., point) for widths of shape (..., 1)."""
        return np.asarray(np.exp(-np.maximum(angle**2 - self._EDGE_DEG**2, 0.0) / width**2))

    def not_applicable(self, known: Known) -> str:
        return "nothing shades the beam" if known.facility.arms.shadow_half_angle == 0 else ""


def phase_angle_deg(columns: dict[str, FloatArray]) -> FloatArray:
    """Angle between illumination and view, shape (point,)."""
    from instrument.angles import direction

    light = direction(columns["illumination_zenith"], columns["illumination_azimuth"])
    view = direction(columns["sensor_zenith"], columns["sensor_azimuth"])
    return np.asarray(np.rad2deg(2 * np.arcsin(np.clip(np.linalg.norm(light - view, axis=-1) / 2, 0, 1))))


def _polarised(zenith: FloatArray, azimuth: FloatArray, refracted: FloatArray) -> FloatArray:
    """Shape (..., point) for shares of shape (..., 1)."""
    angle = np.abs(np.deg2rad(zenith))
    square = np.sin(angle) ** 2
    steep = _degree(angle) * np.sin(_GRAZING_RAD) ** 2 / _degree(_GRAZING_RAD)
    return np.asarray(np.cos(2 * np.deg2rad(azimuth)) * (square + refracted * (steep - square)))


def _degree(zenith_rad: FloatArray | np.floating) -> FloatArray:
    """Degree of polarisation of light that leaves a body by refraction: transmittances are as cos^2 of the deflection.

    Fresnel's equations; Born and Wolf, Principles of Optics, section 1.5.3.
    """
    deflection = zenith_rad - np.arcsin(np.sin(zenith_rad) / _BINDER_INDEX)
    return np.asarray(np.sin(deflection) ** 2 / (1 + np.cos(deflection) ** 2))
