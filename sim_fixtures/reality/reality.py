"""What the imperfect instrument would read: flux in the true geometry of the true sample.

The commanded angles, the nominal beam and the stated dimensions are what the program under test knows; the truth
behind them is here. Shares nothing with the twin: other geometry, other arithmetic, other estimator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np

from instrument.angles import FloatArray, angle_between, direction
from instrument.artifact import ArtifactDimensions
from instrument.facility import Facility
from sim_fixtures.polarizer import DEGREE, behind_polarizer, response
from sim_fixtures.reality.bundle import ACROSS, Bundle, Pose, beam_bundle, seen_from_sample, sensor_bundle
from sim_fixtures.reality.cache import Cache
from sim_fixtures.reality.coating import EXAMPLE_COATING, Coating
from sim_fixtures.reality.flat import lambertian_radiance
from sim_fixtures.reality.gather import gather
from sim_fixtures.reality.imperfections import CUT, Imperfections
from sim_fixtures.reality.scene import Scene
from sim_fixtures.reality.spoiled import (
    bent_zenith,
    spoiled_beam,
    spoiled_reflection,
    spoiled_scene,
    spoiled_sensor,
)
from sim_fixtures.reality.stability import Stability
from sim_fixtures.reality.tracer import Vertices, collect, trace

Mounted = Literal["sample", "reference"]

#: Angles are taken to this many decimals (degree): a readback's last digit asks for no new simulation.
_DECIMALS = 4


class Reality:
    """The simulated instrument with a sample, as far as light is concerned.

    Parameters
    ----------
    facility, artifact
        What is stated about both.
    imperfections
        How the truth differs.
    seed
        Of every draw: the sample's true dimensions, the run's stability, the tracer's rays. Two objects made
        alike read alike, whatever the order in which they are asked.
    coating
        Of all faces of the sample.
    rays
        A simulation, a power of two. 131072 leave a standard error of 0.05 % (median of Table IV; 0.25 % at
        most). All sensor directions of an illumination share their rays, so their errors are correlated.

    Notes
    -----
    Safe to use from several threads; the compiled kernels release the interpreter lock.
    """

    def __init__(
        self,
        facility: Facility,
        artifact: ArtifactDimensions,
        imperfections: Imperfections | None = None,
        seed: int = 1,
        *,
        coating: Coating = EXAMPLE_COATING,
        rays: int = 131072,
    ) -> None:
        self.facility = facility
        self.artifact = artifact
        self.imperfections = imperfections or Imperfections()
        self.seed = seed
        self.coating = coating
        self.rays = rays
        self._stability = Stability(self.imperfections.stability_kind, seed)
        self._forward = facility.beam.diameter != "unbounded"
        self._lit: Cache[tuple[float, ...], Vertices] = Cache(2)
        self._fluxes: Cache[tuple[str | float, ...], float] = Cache(100_000)

    def flux(
        self,
        mounted: Mounted,
        illumination_zenith: float,
        sensor_zenith: float,
        sensor_azimuth: float,
        wavelength: float = 500.0,
        sample_rotation: float = 0.0,
        polarizer: float | None = None,
    ) -> float:
        """Detected flux.

        Parameters
        ----------
        mounted
            What lies on the stage. The reference is a flat Lambertian standard, placed well.
        illumination_zenith, sensor_zenith, sensor_azimuth
            What the arms show, degree; the sensor zenith signed.
        wavelength
            nm.
        sample_rotation
            What the stage under the sample shows, degree.
        polarizer
            Azimuth of its axis from the plane of incidence, degree; None where there is none.

        Returns
        -------
        float
            Over what a perfect instrument reads of an ideal Lambertian sample of reflectance 1 at the reference
            geometry. 0 where the detector's head shadows the beam.
        """
        angles = tuple(round(float(a), _DECIMALS) for a in (illumination_zenith, sensor_zenith, sensor_azimuth))
        turned = round(float(sample_rotation), _DECIMALS)
        key = (mounted, *angles, float(wavelength), turned, "none" if polarizer is None else float(polarizer))
        return self._fluxes.get(
            key, lambda: self._flux(mounted, angles[0], angles[1], angles[2], float(wavelength), turned, polarizer)
        )

    def flux_many(
        self,
        mounted: Mounted,
        illumination_zenith: float,
        sensor_zenith: Sequence[float] | FloatArray,
        sensor_azimuth: Sequence[float] | FloatArray,
        wavelength: float = 500.0,
    ) -> FloatArray:
        """:meth:`flux` of several sensor directions, shape (direction,), under one illumination."""
        pairs = zip(sensor_zenith, sensor_azimuth, strict=True)
        return np.array([self.flux(mounted, illumination_zenith, z, a, wavelength) for z, a in pairs])

    def radiances(
        self,
        illumination_zenith: float,
        sensor_zenith: FloatArray,
        sensor_azimuth: FloatArray,
        wavelength: float = 500.0,
    ) -> FloatArray:
        """Optical part of :meth:`flux` of the sample for many sensor directions at once, shape (direction,).

        Without the instability and the response of the detector. Much faster than one by one.

        Raises
        ------
        ValueError
            If the beam is unbounded: every direction then needs rays of its own.
        """
        if not self._forward:
            raise ValueError("an unbounded beam lights no common set of points")
        reflection = spoiled_reflection(self.coating, self.imperfections.coating, wavelength)
        beam = seen_from_sample(self._beam(illumination_zenith), self._pose)
        lit = trace(self._scene, reflection, beam, self.rays, self.seed)
        sensors = [
            seen_from_sample(self._sensor(float(z), float(a)), self._pose)
            for z, a in zip(sensor_zenith, sensor_azimuth, strict=True)
        ]
        return gather(self._scene, reflection, lit, sensors, self.seed) / self._nominal_reference

    def normalisation(self, illumination_zenith: float, sensor_zenith: float, sensor_azimuth: float) -> float:
        """What a perfect instrument reads of an ideal Lambertian sample: N of the data contract, 1 at the reference.

        ``flux/normalisation`` at the shown angles, the reference taken for true, is the measured BRF.
        """
        beam = beam_bundle(self.facility.beam, illumination_zenith)
        sensor = sensor_bundle(self.facility.sensor, sensor_zenith, sensor_azimuth)
        return lambertian_radiance(beam, sensor) / self._nominal_reference

    def _flux(
        self,
        mounted: Mounted,
        illumination_zenith: float,
        sensor_zenith: float,
        sensor_azimuth: float,
        wavelength: float,
        turned: float,
        polarizer: float | None,
    ) -> float:
        if self._shadowed(illumination_zenith, sensor_zenith, sensor_azimuth):
            return 0.0
        beam, sensor = self._beam(illumination_zenith), self._sensor(sensor_zenith, sensor_azimuth)
        if mounted == "reference":
            stated = self.facility.reference.reflectance_factor
            radiance = stated * self.imperfections.reference_reflectance * lambertian_radiance(beam, sensor)
        else:
            radiance = self._sample_radiance(beam, sensor, illumination_zenith, wavelength, turned)
            drift = self._stability.value(illumination_zenith, sensor_zenith, sensor_azimuth)
            radiance *= 1.0 + self.imperfections.stability * drift
        return radiance * self._response(sensor_zenith, sensor_azimuth, polarizer) / self._nominal_reference

    def _sample_radiance(
        self, beam: Bundle, sensor: Bundle, illumination_zenith: float, wavelength: float, turned: float
    ) -> float:
        pose = self._turned(turned)
        beam, sensor = seen_from_sample(beam, pose), seen_from_sample(sensor, pose)
        reflection = spoiled_reflection(self.coating, self.imperfections.coating, wavelength)
        if not self._forward:
            sight = trace(self._scene, reflection, sensor, self.rays, self.seed)
            return collect(self._scene, reflection, sight, beam, self.seed)
        key = (illumination_zenith, wavelength, turned)
        lit = self._lit.get(key, lambda: trace(self._scene, reflection, beam, self.rays, self.seed))
        return collect(self._scene, reflection, lit, sensor, self.seed)

    def _beam(self, illumination_zenith: float) -> Bundle:
        wrong = self.imperfections
        return beam_bundle(
            spoiled_beam(self.facility.beam, wrong.optics),
            illumination_zenith + wrong.illumination_zenith_offset_deg,
            offset_mm=(wrong.beam_offset_x_mm, wrong.beam_offset_y_mm),
            extra_divergence=wrong.beam_divergence_deg,
        )

    def _sensor(self, sensor_zenith: float, sensor_azimuth: float) -> Bundle:
        wrong = self.imperfections
        sensor = sensor_bundle(
            spoiled_sensor(self.facility.sensor, wrong.optics),
            bent_zenith(sensor_zenith, wrong.optics) + wrong.sensor_zenith_offset_deg,
            sensor_azimuth * (1.0 + wrong.optics.azimuth_scale) + wrong.sensor_azimuth_offset_deg,
        )
        if wrong.optics.sensor_runout_mm == 0.0:
            return sensor
        return sensor._replace(centre=sensor.centre + wrong.optics.sensor_runout_mm * sensor.frame[ACROSS])

    def _response(self, sensor_zenith: float, sensor_azimuth: float, polarizer: float | None) -> float:
        """Response of the detector to light of a direction, 1 for a perfect one without a polariser."""
        amplitude = self.imperfections.polarization
        if polarizer is None:
            return response(amplitude, sensor_zenith, sensor_azimuth)
        return behind_polarizer(polarizer, sensor_zenith, sensor_azimuth, amplitude / DEGREE)

    def _shadowed(self, illumination_zenith: float, sensor_zenith: float, sensor_azimuth: float) -> bool:
        gap = angle_between(direction(illumination_zenith, 0.0), direction(sensor_zenith, sensor_azimuth))
        return bool(gap < self.facility.arms.shadow_half_angle - 1e-6)

    @cached_property
    def _pose(self) -> Pose:
        return self._turned(0.0)

    def _turned(self, angle: float) -> Pose:
        """Where the sample lies when the stage has turned it by so many degrees; its tilt is that of the stage."""
        wrong = self.imperfections
        azimuth = wrong.sample_azimuth_deg + angle
        pose = Pose.of(
            wrong.sample_tilt_x_deg,
            wrong.sample_tilt_y_deg,
            azimuth,
            (wrong.sample_offset_x_mm, wrong.sample_offset_y_mm),
            wrong.sample_height_mm,
        )
        if not any(wrong.sample_pivot_mm):
            return pose
        pivot = Pose.of(azimuth_deg=azimuth).rotation @ np.array(wrong.sample_pivot_mm)
        tilt = Pose.of(wrong.sample_tilt_x_deg, wrong.sample_tilt_y_deg).rotation
        return Pose(pose.rotation, pose.shift + pivot - tilt @ pivot)

    @cached_property
    def _scene(self) -> Scene:
        wrong = self.imperfections
        artifact = true_dimensions(self.artifact, wrong.dimension_errors, self.seed)
        return spoiled_scene(artifact, wrong.shape, wrong.coating)

    @cached_property
    def _nominal_reference(self) -> float:
        reference = self.facility.reference
        beam = beam_bundle(self.facility.beam, reference.illumination_zenith)
        return lambertian_radiance(beam, sensor_bundle(self.facility.sensor, reference.sensor_zenith, 0.0))


def true_dimensions(artifact: ArtifactDimensions, multiple: float, seed: int) -> ArtifactDimensions:
    """Dimensions that differ from the stated ones by normal draws of ``multiple`` standard uncertainties."""
    if multiple == 0.0 or not len(artifact.holes):
        return artifact
    generator = np.random.default_rng((seed, 5))
    thickness, depth = np.clip(generator.standard_normal(2), -CUT, CUT) * multiple
    form, holes = artifact.form, artifact.holes
    x, y, diameter = generator.standard_normal((3, len(holes))) * multiple
    return replace(
        artifact,
        form=form.model_copy(
            update={
                "plate_thickness": form.plate_thickness + thickness * form.u_plate_thickness,
                "cavity_depth": form.cavity_depth + depth * form.u_cavity_depth,
            }
        ),
        holes=replace(
            holes,
            x=holes.x + x * holes.u_x,
            y=holes.y + y * holes.u_y,
            diameter=holes.diameter + diameter * holes.u_diameter,
        ),
    )
