"""Where the errors of an artifact, its coating and the sensor arm act: nothing changes that is not wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from instrument.artifact import ArtifactDimensions
from instrument.facility import Beam, Sensor
from sim_fixtures.reality.bores import ellipse, rounded_rim
from sim_fixtures.reality.coating import PEAK_AT_1_E, Coating, Reflection
from sim_fixtures.reality.imperfections import CoatingErrors, OpticsErrors, ShapeErrors
from sim_fixtures.reality.scene import FLOOR, LEDGE, SPACER, UNDERSIDE, WALL, Scene, artifact_scene, with_bores


def spoiled_scene(artifact: ArtifactDimensions, shape: ShapeErrors, coating: CoatingErrors) -> Scene:
    """The scene of an artifact with errors of its shape and of single faces."""
    if len(artifact.holes):
        form, holes = artifact.form, artifact.holes
        dimensions = {
            "plate_thickness": form.plate_thickness + shape.plate_thickness_mm,
            "cavity_depth": form.cavity_depth + shape.cavity_depth_mm,
        }
        artifact = replace(
            artifact,
            form=form.model_copy(update=dimensions),
            holes=replace(holes, diameter=holes.diameter + shape.hole_diameter_mm),
        )
    scene = artifact_scene(artifact)
    if (shape.rim_radius_mm, shape.hole_taper_mm, shape.hole_elongation) != (0.0, 0.0, 0.0):
        profile = rounded_rim(scene.thickness, shape.rim_radius_mm, shape.hole_taper_mm)
        scene = with_bores(scene, profile, ellipse(shape.hole_elongation, shape.hole_axis_deg))
    factor = scene.factor.copy()
    factor[[FLOOR, UNDERSIDE, SPACER, LEDGE]] *= coating.cavity_scale
    factor[WALL] *= coating.wall_scale
    return scene._replace(
        factor=factor * coating.scale,
        slope=np.array([shape.floor_slope_x, shape.floor_slope_y]),
        patch=np.array([coating.stain_x_mm, coating.stain_y_mm, coating.stain_radius_mm, coating.stain]),
    )


def spoiled_reflection(coating: Coating, wrong: CoatingErrors, wavelength: float) -> Reflection:
    """The coating at a wavelength (nm) with its errors."""
    width = np.tan(np.deg2rad(wrong.retro_width_deg) / 2.0) / PEAK_AT_1_E
    twice_rad = 2.0 * np.deg2rad(wrong.grain_axis_deg)
    reflection = coating.at(wavelength)
    share = wrong.diffusion_share if wrong.diffusion_length_mm > 0.0 else 0.0
    return reflection._replace(
        forward=reflection.forward * wrong.forward_scale,
        retro=np.array([wrong.retro_amplitude, width]),
        glossy=np.array([wrong.glossy_amplitude, wrong.glossy_slope]),
        grain=wrong.grain * np.array([np.cos(twice_rad), np.sin(twice_rad)]),
        diffusion=np.array([share, wrong.diffusion_length_mm]),
    )


def spoiled_beam(beam: Beam, wrong: OpticsErrors) -> Beam:
    """The facility's beam with its true iris."""
    if beam.diameter == "unbounded" or wrong.beam_radius_mm == 0.0:
        return beam
    return beam.model_copy(update={"diameter": beam.diameter + 2.0 * wrong.beam_radius_mm})


def spoiled_sensor(sensor: Sensor, wrong: OpticsErrors) -> Sensor:
    """The facility's sensor with its true target and mirror."""
    if wrong.target_radius_mm == 0.0 and wrong.mirror_radius_mm == 0.0:
        return sensor
    return sensor.model_copy(
        update={
            "target_diameter": sensor.target_diameter + 2.0 * wrong.target_radius_mm,
            "mirror_diameter": sensor.mirror_diameter + 2.0 * wrong.mirror_radius_mm,
        }
    )


def bent_zenith(zenith: float, wrong: OpticsErrors) -> float:
    """Where the sensor arm points whose scale shows ``zenith`` (degree, signed)."""
    true = zenith * (1.0 + wrong.zenith_scale)
    if wrong.eccentricity_deg != 0.0:
        off, phase_rad = np.deg2rad(wrong.eccentricity_deg), np.deg2rad(wrong.eccentricity_phase_deg)
        # A mark at a scale angle, seen from an axis that lies off the scale's centre; the zero was set at the normal.
        mark_rad = np.deg2rad(np.array([true, 0.0]))
        seen = np.arctan2(np.sin(mark_rad) + off * np.sin(phase_rad), np.cos(mark_rad) + off * np.cos(phase_rad))
        true = float(np.rad2deg(seen[0] - seen[1]))
    straight = true
    for _ in range(20 if wrong.arm_sag_deg != 0.0 else 0):
        true = straight + wrong.arm_sag_deg * float(np.sin(np.deg2rad(true)))
    return true
