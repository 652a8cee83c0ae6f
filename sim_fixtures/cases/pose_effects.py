"""Effects of pose, arms, beam and sensor: names and parameters of the data contract.

Draws are about one standard uncertainty of the BRF; caps are what a person would notice without any measurement.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sim_fixtures.cases.effects import any_way, effect, either_sign, growing
from sim_fixtures.cases.world import World

P = Mapping[str, float]
#: The three-legged stage: a tilted sample turns about the leg in its corner, under its base.
_LEG = (-21.0, -21.0, -8.3)


@effect("sample_tilt", any_way(0.5, "x_deg", "y_deg"), 8.0)
def sample_tilt(world: World, p: P) -> World:
    """The plane of the sample is moved by two of three legs: it tilts, and rises a little where the beam is."""
    optics = world.optics
    return world.with_optics(
        sample_tilt_x_deg=optics.sample_tilt_x_deg + p["x_deg"],
        sample_tilt_y_deg=optics.sample_tilt_y_deg + p["y_deg"],
        sample_pivot_mm=_LEG,
    )


@effect("sample_azimuth", either_sign(angle_deg=8.0), 5.0)
def sample_azimuth(world: World, p: P) -> World:
    """The sample is turned about its normal."""
    return world.with_optics(sample_azimuth_deg=world.optics.sample_azimuth_deg + p["angle_deg"])


@effect("sample_height", either_sign(height_mm=1.3), 4.0)
def sample_height(world: World, p: P) -> World:
    """The sample is raised."""
    return world.with_optics(sample_height_mm=world.optics.sample_height_mm + p["height_mm"])


@effect("sample_offset", any_way(1.5, "x_mm", "y_mm"), 2.0)
def sample_offset(world: World, p: P) -> World:
    """The sample is moved in its plane."""
    optics = world.optics
    return world.with_optics(
        sample_offset_x_mm=optics.sample_offset_x_mm + p["x_mm"],
        sample_offset_y_mm=optics.sample_offset_y_mm + p["y_mm"],
    )


@effect("illumination_zenith_offset", either_sign(angle_deg=1.9), 4.0)
def illumination_zenith_offset(world: World, p: P) -> World:
    """Zero error of the illumination arm."""
    wrong = world.optics.illumination_zenith_offset_deg
    return world.with_optics(illumination_zenith_offset_deg=wrong + p["angle_deg"])


@effect("sensor_zenith_offset", either_sign(angle_deg=0.4), 8.0)
def sensor_zenith_offset(world: World, p: P) -> World:
    """Zero error of the sensor arm's zenith."""
    return world.with_optics(sensor_zenith_offset_deg=world.optics.sensor_zenith_offset_deg + p["angle_deg"])


@effect("sensor_azimuth_offset", either_sign(angle_deg=8.0), 3.0)
def sensor_azimuth_offset(world: World, p: P) -> World:
    """Zero error of the sensor arm's azimuth."""
    return world.with_optics(sensor_azimuth_offset_deg=world.optics.sensor_azimuth_offset_deg + p["angle_deg"])


@effect("sensor_arm_runout", either_sign(offset_mm=1.0), 5.0)
def sensor_arm_runout(world: World, p: P) -> World:
    """Target and mirror stand beside the arm's axis."""
    return world.with_arm(sensor_runout_mm=p["offset_mm"])


@effect("backlash", growing(angle_deg=0.8), 6.0)
def backlash(world: World, p: P) -> World:
    """Play of the sensor arm: it runs ahead or behind by half, as it came."""
    return replace(world, backlash_deg=p["angle_deg"])


@effect("arm_sag", growing(angle_deg=0.5), 6.0)
def arm_sag(world: World, p: P) -> World:
    """The arm bends under its own weight until torque and stiffness balance."""
    return world.with_arm(arm_sag_deg=p["angle_deg"])


@effect("encoder_eccentricity", growing(angle_deg=0.6, phase_deg=(0.0, 360.0)), 8.0, fixed=("phase_deg",))
def encoder_eccentricity(world: World, p: P) -> World:
    """The scale's centre lies off the axis of the arm."""
    return world.with_arm(eccentricity_deg=p["angle_deg"], eccentricity_phase_deg=p["phase_deg"])


@effect("beam_offset", any_way(1.3, "x_mm", "y_mm"), 3.0)
def beam_offset(world: World, p: P) -> World:
    """The beam misses the optical centre."""
    return world.with_optics(beam_offset_x_mm=p["x_mm"], beam_offset_y_mm=p["y_mm"])


@effect("beam_radius", either_sign(radius_mm=0.8), 4.0)
def beam_radius(world: World, p: P) -> World:
    """Another iris."""
    return world.with_arm(beam_radius_mm=p["radius_mm"])


@effect("field_of_view", either_sign(radius_mm=0.8), 4.0)
def field_of_view(world: World, p: P) -> World:
    """The sensor's target is larger or smaller."""
    return world.with_arm(target_radius_mm=p["radius_mm"])


@effect("acceptance_angle", growing(radius_mm=15.0), 3.0)
def acceptance_angle(world: World, p: P) -> World:
    """The sensor's mirror is larger."""
    return world.with_arm(mirror_radius_mm=p["radius_mm"])


@effect("beam_divergence", growing(angle_deg=3.0), 4.0)
def beam_divergence(world: World, p: P) -> World:
    """The beam spreads."""
    return world.with_optics(beam_divergence_deg=world.optics.beam_divergence_deg + p["angle_deg"])
