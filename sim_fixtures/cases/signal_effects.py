"""Effects on the light along a scan and on the electronics: names and parameters of the data contract."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from instrument.angles import FloatArray
from sim_fixtures.cases.effects import Parameters, effect, either_sign, growing
from sim_fixtures.cases.world import Moments, World

P = Mapping[str, float]
_WARM_UP = 0.5  # time constant of a drifting source over the duration of the scan
_INDEX = 1.5  # refractive index of the coating's binder
_STEEPEST_RAD = np.deg2rad(80.0)
_CONE_DEG, _FADED_DEG = 5.0, 20.0  # edge of the shadow cone, and where the penumbra of the head ends


@effect("reference_scale", either_sign(ratio=0.012), 12.0, optical=False)
def reference_scale(world: World, p: P) -> World:
    """The reference reads more or less than was assumed."""
    return replace(world, reference_scale=world.reference_scale * p["ratio"])


@effect("stray_light", growing(fraction=0.003), 20.0, optical=False)
def stray_light(world: World, p: P) -> World:
    """The room glows with the beam: the same light at every geometry."""

    def law(_: Moments, flux: FloatArray) -> FloatArray:
        return flux + p["fraction"]

    return world.with_law(law)


@effect("dark_offset", either_sign(voltage_v=0.01), 15.0, optical=False)
def dark_offset(world: World, p: P) -> World:
    """A voltage that the dark reading does not show: it comes with the open shutter."""
    return world.with_electronics(offset_v=p["voltage_v"])


@effect("detector_nonlinearity", either_sign(fraction=0.02), 12.0, optical=False)
def detector_nonlinearity(world: World, p: P) -> World:
    """Dead time after every photon (negative: a response that grows), of slope ``fraction`` at the reference."""
    return world.with_electronics(dead_time=-p["fraction"] / (1.0 + p["fraction"]))


@effect("gain_step", either_sign(fraction=0.013), 12.0, optical=False)
def gain_step(world: World, p: P) -> World:
    """The higher gain is not what it is taken for."""
    return world.with_electronics(gain_error=p["fraction"])


@effect("source_drift", either_sign(fraction=0.022), 12.0, optical=False)
def source_drift(world: World, p: P) -> World:
    """The source warms up: an exponential approach, by ``fraction`` from the first point to the last."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        risen = np.expm1(-at.progress / _WARM_UP) / np.expm1(-1.0 / _WARM_UP)
        return np.asarray(flux * (1.0 + p["fraction"] * risen))

    return world.with_law(law)


def _ratios(generator: np.random.Generator) -> Parameters:
    """A step at each of two re-alignments; the first illumination is the one the reference was measured with."""
    first, second = 0.018 * generator.choice([-1.0, 1.0], 2) * generator.uniform(0.5, 1.0, 2)
    return {"ratio_1": 1.0, "ratio_2": 1.0 + float(first), "ratio_3": 1.0 + float(second)}


@effect("session_scale", _ratios, 12.0, optical=False)
def session_scale(world: World, p: P) -> World:
    """One factor for all points of an illumination zenith: ``ratio_1`` for the first that was measured, and so on."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        if np.all(at.order < 0):
            return flux
        _, first = np.unique(at.illumination_zenith, return_index=True)
        for number, start in enumerate(np.sort(first), start=1):
            mine = at.illumination_zenith == at.illumination_zenith[start]
            flux = np.where(mine, flux * p.get(f"ratio_{number}", 1.0), flux)
        return flux

    return world.with_law(law)


@effect("stale_sample", growing(fraction=0.085), 8.0, optical=False)
def stale_sample(world: World, p: P) -> World:
    """An RC filter before the meter; ``fraction`` of the point before is left in the mean of nine raw samples."""
    return world.with_electronics(lag=lag_of(p["fraction"]))


def lag_of(fraction: float, samples: int = 9) -> float:
    """Sample interval over the time constant that leaves ``fraction`` of a step in the mean of ``samples``."""
    if fraction <= 0.0:
        return float("inf")
    low, high = 1e-6, 50.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        if np.mean(np.exp(-middle * np.arange(1, samples + 1))) > fraction:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@effect("polarization", either_sign(fraction=0.025), 10.0, optical=False)
def polarization(world: World, p: P) -> World:
    """The detector prefers a polarisation, and light that leaves the coating at an angle has one, after Fresnel."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        share = leaving_polarization(np.deg2rad(at.sensor_zenith)) * np.sin(_STEEPEST_RAD) ** 2
        share = share / leaving_polarization(_STEEPEST_RAD)
        return np.asarray(flux * (1.0 + p["fraction"] * share * np.cos(2.0 * np.deg2rad(at.sensor_azimuth))))

    return world.with_law(law)


def leaving_polarization(zenith_rad: FloatArray | float) -> FloatArray:
    """Degree of linear polarisation of unpolarised light that leaves a smooth body by refraction."""
    n, sine, cosine = _INDEX, np.sin(zenith_rad), np.cos(zenith_rad)
    numerator = (n - 1.0 / n) ** 2 * sine**2
    root = np.sqrt(n**2 - sine**2)
    return np.asarray(numerator / (2.0 + 2.0 * n**2 - (n + 1.0 / n) ** 2 * sine**2 + 4.0 * np.abs(cosine) * root))


@effect("arm_shadow", growing(fraction=0.05), 18.0, optical=False)
def arm_shadow(world: World, p: P) -> World:
    """The detector's head covers part of the round source: ``fraction`` is lost at the edge of the shadow cone."""

    def law(at: Moments, flux: FloatArray) -> FloatArray:
        gap = np.clip((at.retro_angle - _CONE_DEG) / (_FADED_DEG - _CONE_DEG), 0.0, 1.0)
        covered = 2.0 / np.pi * (np.arccos(gap) - gap * np.sqrt(1.0 - gap**2))
        return np.asarray(flux * (1.0 - p["fraction"] * covered))

    return world.with_law(law)
