"""From a world to readings: light, laws, electronics, noise; and the same without noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.facility import Facility
from instrument.plan import Plan
from sim_fixtures.cases.world import Moments, World, moments_of
from sim_fixtures.examples.coupon import (
    COMPONENTS,
    DARK,
    GAINS,
    LOW_SIGNAL,
    REFERENCE_CURRENT,
    REFERENCE_NOISE,
    RESOLUTION,
    U_DARK,
    Points,
    relative_budget,
)
from sim_fixtures.reality import Coating, Imperfections, Reality

_STUDENT = 6  # degrees of freedom of the readings' noise
_MINUTE_S = 60.0


@dataclass(frozen=True)
class Laboratory:
    """What is stated and nominal: shared by all cases of a set.

    ``rays`` a simulation, a power of two.
    """

    facility: Facility
    artifact: ArtifactDimensions
    coating: Coating
    plan: Plan
    rays: int = 16384

    @cached_property
    def moments(self) -> Moments:
        """Of the plan's points."""
        return moments_of(self.plan)

    @cached_property
    def reference_moments(self) -> Moments:
        """Of the readings of the reference, a minute apart before the scan."""
        form = self.facility.reference
        azimuth = np.array(form.sensor_azimuth, dtype=float)
        same = np.ones(len(azimuth))
        before = np.asarray((np.arange(len(azimuth)) - 20.0) * _MINUTE_S, dtype=np.float64)
        return Moments(same * form.illumination_zenith, same * form.sensor_zenith, azimuth, before, 0 * same, -same)

    @cached_property
    def relative_uncertainty(self) -> FloatArray:
        """Combined standard uncertainty of the BRF over the BRF, shape (point,)."""
        points = Points.of(self.plan)
        rows = [relative_budget(self.facility.budget, row, points) for row in COMPONENTS]
        return np.asarray(np.sqrt(np.sum(np.square(rows), axis=0)))

    @cached_property
    def normalisation(self) -> FloatArray:
        """N of the data contract at every point, 1 at the reference geometry, shape (point,)."""
        at, nominal = self.moments, Reality(self.facility, self.artifact)
        geometries = zip(at.illumination_zenith, at.sensor_zenith, at.sensor_azimuth, strict=True)
        return np.array([nominal.normalisation(*geometry) for geometry in geometries])


@dataclass(frozen=True)
class Light:
    """Flux of the sample (point,) and of the reference (reference,), before the laws of a world."""

    sample: FloatArray
    reference: FloatArray


@dataclass(frozen=True)
class Clean:
    """What a noise-free instrument reads.

    Attributes
    ----------
    current, reference_current
        Of the detector in A, shape (point, sample) and (reference, sample).
    gain, reference_gain
        V/A, shape (point,) and (reference,).
    brf
        As it would be evaluated, shape (point,).
    """

    current: FloatArray
    reference_current: FloatArray
    gain: FloatArray
    reference_gain: FloatArray
    brf: FloatArray


def light(laboratory: Laboratory, world: World, seed: int) -> Light:
    """Trace the world's optics; ``seed`` as :class:`~sim_fixtures.reality.Reality`."""
    reality = Reality(
        laboratory.facility,
        laboratory.artifact,
        world.optics,
        seed,
        coating=laboratory.coating,
        rays=laboratory.rays,
    )
    moments, points = laboratory.moments, Points.of(laboratory.plan)
    sample = np.zeros(len(moments.order))
    true_zenith = moments.sensor_zenith + 0.5 * world.backlash_deg * moments.travel
    groups = np.stack([moments.illumination_zenith, points.wavelength], axis=1)
    for illumination, wavelength in np.unique(groups, axis=0):
        mine = np.flatnonzero((groups == (illumination, wavelength)).all(axis=1))
        sample[mine] = reality.radiances(
            float(illumination), true_zenith[mine], moments.sensor_azimuth[mine], float(wavelength)
        )
    sample *= response(world.optics, moments)
    form = laboratory.facility.reference
    before = laboratory.reference_moments
    reference = reality.flux_many("reference", form.illumination_zenith, before.sensor_zenith, before.sensor_azimuth)
    return Light(sample, reference)


def response(wrong: Imperfections, moments: Moments) -> FloatArray:
    """Of the detector to light of a direction, as far as the budget allows, shape (reading,)."""
    zenith_rad, azimuth_rad = np.deg2rad(moments.sensor_zenith), np.deg2rad(moments.sensor_azimuth)
    return np.asarray(1.0 + wrong.polarization * np.cos(2.0 * azimuth_rad) * np.sin(zenith_rad) ** 2)


def clean(laboratory: Laboratory, world: World, lit: Light) -> Clean:
    """Readings without noise."""
    samples = laboratory.plan.samples
    flux, before = lit.sample, lit.reference * world.reference_scale
    for law in world.laws:
        flux = law(laboratory.moments, flux)
        before = law(laboratory.reference_moments, before)
    electronics = world.electronics
    unit = before.mean()
    flux, before = (_counted(values, unit, electronics.dead_time) for values in (flux, before))
    current = _lagging(flux, samples, electronics.lag) * REFERENCE_CURRENT
    reference_current = np.repeat(before[:, None], samples, axis=1) * REFERENCE_CURRENT
    gain, reference_gain = (_gain(values.mean(axis=1)) for values in (current, reference_current))
    current, reference_current = (
        values * (1.0 + electronics.gain_error * (chosen > GAINS[0]))[:, None] + electronics.offset_v / chosen[:, None]
        for values, chosen in ((current, gain), (reference_current, reference_gain))
    )
    stated = laboratory.facility.reference.reflectance_factor
    brf = current.mean(axis=1) / (reference_current.mean() / stated) / laboratory.normalisation
    return Clean(current, reference_current, gain, reference_gain, brf)


def noisy(
    laboratory: Laboratory, true: Clean, stability: FloatArray, generator: np.random.Generator
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], dict[str, FloatArray], FloatArray]:
    """Readings with noise.

    Parameters
    ----------
    stability
        Factor less one of every point, shape (point,).

    Returns
    -------
    signal (point, sample), dark and gain (point,); the same of the reference by name; brf (point,).
    """
    points = Points.of(laboratory.plan)
    noise = relative_budget(laboratory.facility.budget, "measurement_noise", points) * np.sqrt(true.current.shape[1])
    current = true.current * (1.0 + stability)[:, None]
    signal, dark = _voltages(generator, current, true.gain, noise)
    same = np.full(len(true.reference_gain), REFERENCE_NOISE)
    reference_signal, reference_dark = _voltages(generator, true.reference_current, true.reference_gain, same)
    azimuth = laboratory.reference_moments.sensor_azimuth
    reference = {
        "sensor_azimuth": azimuth,
        "signal": reference_signal,
        "dark": reference_dark,
        "gain": true.reference_gain,
    }
    stated = laboratory.facility.reference.reflectance_factor
    unit = np.mean((reference_signal.mean(axis=1) - reference_dark) / true.reference_gain) / stated
    brf = (signal.mean(axis=1) - dark) / true.gain / unit / laboratory.normalisation
    return (signal, dark, true.gain), reference, brf


def _counted(flux: FloatArray, unit: float, dead_time: float) -> FloatArray:
    """Of a detector that is blind for a while after every photon; the reference's reading stays what it is."""
    return np.asarray(flux * (1.0 + dead_time) / (1.0 + dead_time * flux / unit))


def _lagging(flux: FloatArray, samples: int, lag: float) -> FloatArray:
    """Raw samples behind an RC filter, shape (point, sample); the first point has settled."""
    decay = np.exp(-lag * np.arange(1, samples + 1)) if np.isfinite(lag) else np.zeros(samples)
    result = np.empty((len(flux), samples))
    state = flux[0]
    for i, level in enumerate(flux):
        result[i] = level + (state - level) * decay
        state = result[i, -1]
    return result


def _gain(current: FloatArray) -> FloatArray:
    return np.asarray(np.where(current * GAINS[0] < LOW_SIGNAL, GAINS[1], GAINS[0]))


def _voltages(
    generator: np.random.Generator, current: FloatArray, gain: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    # Heavier tails than normal, as speckle and the odd disturbance make them; the factor restores the variance.
    deviation = generator.standard_t(_STUDENT, current.shape) * np.sqrt((_STUDENT - 2.0) / _STUDENT)
    signal = DARK + current * gain[:, None] * (1.0 + noise[:, None] * deviation)
    dark = DARK + U_DARK * generator.standard_normal(len(current))
    return np.round(signal / RESOLUTION) * RESOLUTION, np.round(dark / RESOLUTION) * RESOLUTION
