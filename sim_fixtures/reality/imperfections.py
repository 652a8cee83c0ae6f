"""What is wrong with the simulated instrument. Nothing, unless asked for.

A further imperfection is a field here and one line where it acts: on the pose or the bundles
(:mod:`sim_fixtures.reality.reality`, ``_beam``, ``_sensor``, ``_pose``), on the scene or the coating
(:mod:`sim_fixtures.reality.spoiled`) or on the reading (``_response``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from instrument.facility import Budgeted, Facility

StabilityKind = Literal["none", "slice", "angle", "global", "independent"]
#: Draws that hold for a whole run stay within this many standard deviations.
CUT = 1.5
_GRAZING = 80.0  # largest sensor zenith of the budget, degree
_STEEPEST = 60.0  # largest illumination zenith of the budget, degree


@dataclass(frozen=True)
class ShapeErrors:
    """How the artifact's shape differs from its stated dimensions, mm unless said otherwise.

    Attributes
    ----------
    hole_diameter_mm, plate_thickness_mm, cavity_depth_mm
        Added to every hole's diameter, to the thickness of the plate, to the depth of the cavity.
    rim_radius_mm
        Of the rounding of the upper hole edges.
    hole_taper_mm
        Radius of the holes at the underside less that at the top.
    hole_elongation, hole_axis_deg
        Ratio of the axes of the holes' section less one, and where the long axis points.
    floor_slope_x, floor_slope_y
        Of the block under the cavity, mm a mm.
    """

    hole_diameter_mm: float = 0.0
    plate_thickness_mm: float = 0.0
    cavity_depth_mm: float = 0.0
    rim_radius_mm: float = 0.0
    hole_taper_mm: float = 0.0
    hole_elongation: float = 0.0
    hole_axis_deg: float = 0.0
    floor_slope_x: float = 0.0
    floor_slope_y: float = 0.0


@dataclass(frozen=True)
class CoatingErrors:
    """How the coating of the artifact differs from the coupon's.

    Attributes
    ----------
    scale, cavity_scale, wall_scale
        Reflectance of every face; of floor, underside and spacer; of the hole walls.
    forward_scale
        Of the forward lobe.
    retro_amplitude, retro_width_deg
        BRF added at exact retro-reflection, and the angle at which it has fallen to 1/e.
    glossy_amplitude, glossy_slope
        Reflectance of facets that lie on the coating, and the root mean square of their slopes.
    grain, grain_axis_deg
        Relative amplitude and axis of a modulation with twice the azimuth of source and of sensor.
    diffusion_length_mm, diffusion_share
        Of the light that travels inside the coating.
    stain, stain_x_mm, stain_y_mm, stain_radius_mm
        Relative change of the reflectance in the middle of a stain on the plate, where it lies and where it has
        faded to exp(-2).
    """

    scale: float = 1.0
    cavity_scale: float = 1.0
    wall_scale: float = 1.0
    forward_scale: float = 1.0
    retro_amplitude: float = 0.0
    retro_width_deg: float = 8.0
    glossy_amplitude: float = 0.0
    glossy_slope: float = 0.3
    grain: float = 0.0
    grain_axis_deg: float = 0.0
    diffusion_length_mm: float = 0.0
    diffusion_share: float = 0.0
    stain: float = 0.0
    stain_x_mm: float = 0.0
    stain_y_mm: float = 0.0
    stain_radius_mm: float = 3.0


@dataclass(frozen=True)
class OpticsErrors:
    """How beam and sensor differ from the facility's, and how the sensor arm deforms.

    Attributes
    ----------
    beam_radius_mm, target_radius_mm, mirror_radius_mm
        Added to the radius of the iris, of the target disc, of the collecting mirror.
    sensor_runout_mm
        The sensor's axis displaced sideways, towards growing sensor zenith.
    arm_sag_deg
        The sensor arm bends under its weight: by so much where it lies level, by the sine of its true zenith elsewhere.
    eccentricity_deg, eccentricity_phase_deg
        The zenith scale's centre lies off the axis by a fraction of its radius, given as an angle; where.
    zenith_scale, azimuth_scale
        Relative error of the degree of the two sensor scales.
    """

    beam_radius_mm: float = 0.0
    target_radius_mm: float = 0.0
    mirror_radius_mm: float = 0.0
    sensor_runout_mm: float = 0.0
    arm_sag_deg: float = 0.0
    eccentricity_deg: float = 0.0
    eccentricity_phase_deg: float = 0.0
    zenith_scale: float = 0.0
    azimuth_scale: float = 0.0


@dataclass(frozen=True)
class Imperfections:
    """Differences between the true configuration and the nominal one: degree, mm, fractions.

    Attributes
    ----------
    sample_tilt_x_deg, sample_tilt_y_deg, sample_azimuth_deg, sample_height_mm, sample_offset_x_mm, sample_offset_y_mm
        Pose of the sample; tilts are right-handed about the laboratory's axes.
    illumination_zenith_offset_deg, sensor_zenith_offset_deg, sensor_azimuth_offset_deg
        True angle of an arm minus the angle it shows.
    beam_offset_x_mm, beam_offset_y_mm
        Where the axis of the beam crosses z = 0.
    beam_divergence_deg
        Added to the facility's divergence.
    reference_reflectance
        True reflectance factor of the reference over the stated one.
    dimension_errors
        Every dimension of the artifact is off by this many times a normal draw of its stated standard uncertainty.
    polarization
        Relative amplitude of a response varying as cos(2 sensor azimuth) sin^2(sensor zenith).
    stability, stability_kind
        Relative standard deviation of the readings' stability, and how it is correlated: one value a slice
        (illumination zenith and sensor azimuth), smooth in angle, one for all, or a new one each geometry.
    sample_pivot_mm
        What stays where it is when the sample is tilted (artifact frame).
    shape, coating, optics
        Of the artifact, of its surface, of beam and sensor.
    """

    sample_tilt_x_deg: float = 0.0
    sample_tilt_y_deg: float = 0.0
    sample_azimuth_deg: float = 0.0
    sample_height_mm: float = 0.0
    sample_offset_x_mm: float = 0.0
    sample_offset_y_mm: float = 0.0
    illumination_zenith_offset_deg: float = 0.0
    sensor_zenith_offset_deg: float = 0.0
    sensor_azimuth_offset_deg: float = 0.0
    beam_offset_x_mm: float = 0.0
    beam_offset_y_mm: float = 0.0
    beam_divergence_deg: float = 0.0
    reference_reflectance: float = 1.0
    dimension_errors: float = 0.0
    polarization: float = 0.0
    stability: float = 0.0
    stability_kind: StabilityKind = "none"
    sample_pivot_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shape: ShapeErrors = ShapeErrors()
    coating: CoatingErrors = CoatingErrors()
    optics: OpticsErrors = OpticsErrors()

    @classmethod
    def within_budget(cls, facility: Facility, seed: int, mounting: int = 0) -> Imperfections:
        """What the budget of a facility allows: normal draws, cut at 1.5 standard uncertainties.

        The uncertainties of the angles in the facility are those of the readings; an arm whose zero were off by all of
        0.25 degree would change the BRF at grazing by five times its row of the budget (the reading is scaled
        with the cosine of the *shown* angle). So zero errors and tilt are no larger than what their rows allow
        at the steepest angle.

        Parameters
        ----------
        facility
            Its uncertainties and its budget.
        seed
            Of the instrument: errors of the arms, the beam and the reference.
        mounting
            Of this placement of a sample: its pose and the stability of the run.
        """
        instrument, placement = _Normal((seed, 1)), _Normal((seed, 2, mounting))
        arms, sample, budget = facility.arms, facility.sample, facility.budget
        sensor_zenith = min(arms.u_sensor_zenith, _angle_of(_worst(budget.sensor_zenith), _GRAZING))
        illumination_zenith = min(arms.u_illumination_zenith, _angle_of(_worst(budget.illumination_zenith), _STEEPEST))
        tilt = min(sample.u_tilt, _angle_of(_worst(budget.beam_and_placement), _GRAZING))
        kinds = [kind for kind in get_args(StabilityKind) if kind != "none"]
        return cls(
            sample_tilt_x_deg=placement(tilt),
            sample_tilt_y_deg=placement(tilt),
            sample_azimuth_deg=placement(sample.u_azimuth),
            sample_height_mm=placement(sample.u_height),
            sample_offset_x_mm=placement(sample.u_offset),
            sample_offset_y_mm=placement(sample.u_offset),
            illumination_zenith_offset_deg=instrument(illumination_zenith),
            sensor_zenith_offset_deg=instrument(sensor_zenith),
            sensor_azimuth_offset_deg=instrument(arms.u_sensor_azimuth),
            beam_divergence_deg=abs(instrument(facility.beam.u_divergence)),
            reference_reflectance=1.0 + instrument(facility.reference.u_relative),
            dimension_errors=1.0,
            polarization=instrument(_worst(budget.polarization)),
            stability=_worst(budget.instrument_stability),
            stability_kind=kinds[placement.generator.integers(len(kinds))],
        )


class _Normal:
    """Normal draws of zero mean, cut at 1.5 standard deviations: each a sound instrument, none an outlier."""

    def __init__(self, seed: tuple[int, ...]) -> None:
        self.generator = np.random.default_rng(seed)

    def __call__(self, standard_deviation: float) -> float:
        while abs(draw := self.generator.standard_normal()) > CUT:
            pass
        return float(draw) * standard_deviation


def _worst(row: Budgeted | str) -> float:
    """Largest relative uncertainty of a row; without bound where the facility leaves it to samples or slopes."""
    if isinstance(row, str):
        return float("inf")
    return max(row) if isinstance(row, tuple) else row


def _angle_of(relative: float, zenith: float) -> float:
    """Error of a zenith angle (degree) that changes its cosine by a relative amount."""
    return float(np.rad2deg(relative / np.tan(np.deg2rad(zenith))))
