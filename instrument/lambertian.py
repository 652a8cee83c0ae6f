"""Flux that an ideal Lambertian sample gives in a geometry: the N of the data contract.

The sensor is a target disc centred on the optical centre, seen from a mirror disc: a ray joins a uniformly sampled
point of each. With m a point of the mirror and s u a point of the target (u a unit vector in its plane at the
angle psi, 0 <= s <= target radius), the ray meets the sample plane z = 0 at

    p = s (m_z u - u_z m)/(m_z - s u_z)

so p runs outwards along one straight line as s grows and leaves the beam once, at a known s. That splits the
integral over s exactly at the edge of the iris. Around the disc the integrand has a kink where the edge of the iris
meets the edge of the target: four angles at most, the arguments of the roots of a quartic, which become limits
of Gauss-Legendre panels. A parallel sensor is the limit m -> infinity.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from instrument.angles import FloatArray, direction
from instrument.facility import Beam, Facility, Sensor


class _Fineness(NamedTuple):
    """Numbers of nodes: in a panel around the target, of panels, along the mirror and across it."""

    panel: int
    around_target: int
    around_footprint: int
    along_mirror: int
    across_mirror: int


_NORMAL, _GRAZING = _Fineness(8, 4, 8, 4, 3), _Fineness(16, 8, 16, 24, 6)
#: Sensor zenith in degree beyond which the footprint is long, and mirror radii to the horizon: then the finer rule.
_GRAZING_ZENITH, _NEAR_HORIZON = 80.5, 3.0
#: A gaussian beam without an iris ends here, in units of its 1/e^2 radius: exp(-2 * 3.5^2) = 2e-11.
_GAUSSIAN_END = 3.5
_CHUNK = 128


def lambertian_flux(
    facility: Facility,
    illumination_zenith: ArrayLike,
    sensor_zenith: ArrayLike,
    sensor_azimuth: ArrayLike,
    *,
    illumination_azimuth: ArrayLike = 0.0,
) -> FloatArray:
    """Mean over the sensor's rays of the irradiance where they meet the sample plane.

    The irradiance is cos(illumination zenith) times the profile of the beam, 1 on its axis; so a wide uniform beam
    seen by a small sensor gives cos(illumination zenith). The beam is parallel: its divergence would
    blur its edge by less than 0.01 mm.

    Parameters
    ----------
    facility
        Beam and sensor.
    illumination_zenith, sensor_zenith, sensor_azimuth, illumination_azimuth
        Commanded angles in degree, broadcast to shape (point,).

    Returns
    -------
    array, shape (point,)
        Dimensionless. The quadrature error is below 1e-5 of it, up to a sensor zenith of 88 degrees; it grows to 5e-4
        at 90 degrees, where the sample plane cuts the mirror.
    """
    given = (illumination_zenith, illumination_azimuth, sensor_zenith, sensor_azimuth)
    angles = np.broadcast_arrays(*(np.asarray(angle, dtype=float) for angle in given))
    shape = angles[0].shape
    illumination, illumination_az, sensor, sensor_az = (np.ravel(angle) for angle in angles)
    # Only the azimuth between the arms matters: work in the frame of the illumination, each geometry once.
    between = np.mod(sensor_az - illumination_az + np.where(illumination < 0, 180.0, 0.0), 360.0)
    geometries = np.round(np.stack([np.abs(illumination), sensor, between]), 10)
    keys, inverse = np.unique(geometries, axis=1, return_inverse=True)
    values = np.empty(keys.shape[1])
    grazing = (np.abs(keys[1]) > _GRAZING_ZENITH) | (_horizon(facility.sensor, keys[1]) < _NEAR_HORIZON)
    for fineness, which in ((_NORMAL, ~grazing), (_GRAZING, grazing)):
        rows = np.flatnonzero(which)
        for start in range(0, len(rows), _CHUNK):
            chunk = rows[start : start + _CHUNK]
            values[chunk] = _flux(facility, fineness, *keys[:, chunk])
    return np.asarray(values[np.ravel(inverse)].reshape(shape))


def _flux(
    facility: Facility, fineness: _Fineness, illumination: FloatArray, sensor: FloatArray, azimuth: FloatArray
) -> FloatArray:
    cosine = np.cos(np.deg2rad(illumination))
    zenith = np.zeros_like(sensor) if facility.sensor.target_shape == "horizontal_disc" else sensor
    flux = np.zeros_like(cosine)
    for mirror_x, mirror_y, weight in _mirror_nodes(facility.sensor, fineness, zenith):
        flux += weight * _target_mean(facility, fineness, cosine, zenith, azimuth, mirror_x, mirror_y)
    return np.asarray(cosine * flux)


def _mirror_nodes(
    sensor: Sensor, fineness: _Fineness, zenith: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Points of the mirror disc that are above the horizon, and their weights; arrays of shape (point,) each.

    One point serves a parallel sensor, and a target that lies flat: what it sees does not depend on the mirror.
    """
    zero = np.zeros_like(zenith)
    if sensor.mirror_diameter == 0 or sensor.target_shape == "horizontal_disc":
        yield zero, zero, zero + 1
        return
    radius = sensor.mirror_diameter / 2
    # x = radius sin(alpha) points away from the normal. A whole disc is best served by equal steps of alpha (the
    # Gauss-Chebyshev rule of the second kind), one that the horizon cuts by a rule that ends there.
    last = np.arcsin(np.clip(_horizon(sensor, zenith), -1, 1))[:, None]
    nodes, weights = _gauss_legendre(fineness.along_mirror)
    steps = np.arange(1, fineness.along_mirror + 1) / (fineness.along_mirror + 1)
    whole = last == np.pi / 2
    alpha = (last + np.pi / 2) * np.where(whole, steps, nodes) - np.pi / 2
    strip = np.where(whole, 1.0, weights) * np.cos(alpha) ** 2
    share = (last + np.pi / 2 + np.sin(last) * np.cos(last)) / np.pi
    strip *= share / np.maximum(strip.sum(axis=-1, keepdims=True), 1e-300)
    away = np.where(zenith < 0, -radius, radius)
    for i in range(fineness.along_mirror):
        for across, weight in zip(*_gauss_legendre(fineness.across_mirror), strict=True):
            yield away * np.sin(alpha[:, i]), radius * np.cos(alpha[:, i]) * (2 * across - 1), weight * strip[:, i]


def _horizon(sensor: Sensor, zenith: FloatArray) -> FloatArray:
    """How far from the mirror's centre the sample plane cuts it, in mirror radii; infinite where it never does."""
    sine, cosine = np.abs(np.sin(np.deg2rad(zenith))), np.cos(np.deg2rad(zenith))
    radius = sensor.mirror_diameter / 2 * sine
    return np.asarray(
        np.divide(sensor.mirror_distance * cosine, radius, out=np.full_like(sine, np.inf), where=radius > 0)
    )


def _target_mean(
    facility: Facility,
    fineness: _Fineness,
    cosine: FloatArray,
    zenith: FloatArray,
    azimuth: FloatArray,
    mirror_x: FloatArray,
    mirror_y: FloatArray,
) -> FloatArray:
    """Mean of the beam's profile over the target, seen from one point of the mirror (or along one direction)."""
    sensor, beam = facility.sensor, facility.beam
    target, visible = sensor.target_diameter / 2, _visible_radius(beam)
    inverse_distance = 1 / sensor.mirror_distance if sensor.mirror_diameter > 0 else 0.0
    view = direction(zenith, azimuth)
    along = direction(zenith + 90.0, azimuth)  # in the plane of the target, towards growing zenith
    across = direction(90.0, azimuth + 90.0)
    mirror = view + inverse_distance * (
        mirror_x[:, None] * along + mirror_y[:, None] * across
    )  # in units of the distance
    # Footprint of the unit vector at psi, across the beam: cos(psi) a + sin(psi) b, for s = 1 and no divergence.
    height = np.maximum(mirror[:, 2], 0.0)
    squeeze = np.stack([cosine, np.ones_like(cosine)], axis=-1)
    a = squeeze * (height[:, None] * along - along[:, 2:] * mirror)[:, :2]
    b = squeeze * (height[:, None] * across)[:, :2]
    drop = inverse_distance * along[:, 2]  # of the unit vector at psi: drop * cos(psi)
    psi, weight = _panels(fineness, a, b, drop, height, target, visible)
    spread = np.hypot(*(np.cos(psi) * a[:, i, None] + np.sin(psi) * b[:, i, None] for i in (0, 1)))
    slope = np.cos(psi) * drop[:, None]
    reach = _reach(spread, slope, height[:, None], target, visible)
    nodes, weights = _gauss_legendre(_radial_nodes(beam, visible))
    s = reach[..., None] * nodes
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = s * spread[..., None] / (height[:, None, None] - s * slope[..., None])
        radial = np.sum(weights * s * _profile(beam, radius), axis=-1) * reach
    mean = np.sum(weight * radial, axis=-1) / (np.pi * target**2)
    return np.where(height > 0, mean, 0.0)


def _reach(spread: FloatArray, slope: FloatArray, height: FloatArray, target: float, visible: float) -> FloatArray:
    """Up to which s the rays of an angle meet the lit plane: to the edge of the target, of the beam, or the horizon."""
    if np.isfinite(visible):
        edge, steepness = visible * height, spread + visible * slope
    else:
        edge, steepness = np.broadcast_to(height, slope.shape), slope
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(steepness > 0, np.minimum(target, edge / steepness), target))


def _panels(
    fineness: _Fineness,
    a: FloatArray,
    b: FloatArray,
    drop: FloatArray,
    height: FloatArray,
    target: float,
    visible: float,
) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights around the target, shape (point, node): panels that end where the integrand has a kink."""
    fixed = np.broadcast_to(
        np.arange(fineness.around_target) * (2 * np.pi / fineness.around_target), (len(a), fineness.around_target)
    )
    chi = (np.arange(fineness.around_footprint) + 0.5) * (2 * np.pi / fineness.around_footprint)
    length_a, length_b = np.hypot(*a.T)[:, None], np.hypot(*b.T)[:, None]
    footprint = np.arctan2(length_a * np.sin(chi), length_b * np.cos(chi))
    limits = [fixed, footprint]
    if np.isfinite(visible):
        limits.append(_kinks(a, b, drop, height, target, visible))
    edges = np.sort(np.mod(np.concatenate(limits, axis=-1), 2 * np.pi), axis=-1)
    edges = np.concatenate([edges, edges[:, :1] + 2 * np.pi], axis=-1)
    nodes, weights = _gauss_legendre(fineness.panel)
    width = np.diff(edges, axis=-1)[..., None]
    psi, weight = edges[:, :-1, None] + width * nodes, width * weights
    return psi.reshape(len(a), -1), weight.reshape(len(a), -1)


def _kinks(
    a: FloatArray, b: FloatArray, drop: FloatArray, height: FloatArray, target: float, visible: float
) -> FloatArray:
    """Angles where the edges of target and beam meet on the sample, shape (point, 4).

    There |cos(psi) a + sin(psi) b| = visible (height/target - cos(psi) drop). Squared, and with z = exp(i psi), that
    is a quartic in z whose coefficients are conjugate in pairs. Roots off the unit circle are no kinks; a panel
    that ends at their argument does no harm.
    """
    cos2 = np.sum(a * a, axis=-1) - (visible * drop) ** 2
    sin2, both = np.sum(b * b, axis=-1), np.sum(a * b, axis=-1)
    first = 2 * visible**2 * height * drop / target
    constant = -((visible * height / target) ** 2)
    leading = (cos2 - sin2) / 4 - 0.5j * both
    middle = (cos2 + sin2) / 2 + constant
    scale = np.sum(a * a + b * b, axis=-1) + 1e-30
    leading = np.where(np.abs(leading) < 1e-12 * scale, 1e-12 * scale, leading)  # a circle has no kink
    companion = np.zeros((len(a), 4, 4), dtype=complex)
    companion[:, 1:, :3] = np.eye(3)
    for row, coefficient in enumerate((np.conj(leading), first / 2, middle, first / 2)):
        companion[:, row, 3] = -coefficient / leading
    return np.asarray(np.angle(np.linalg.eigvals(companion)))


def _radial_nodes(beam: Beam, visible: float) -> int:
    """Nodes that a radius needs: the narrower the gaussian inside the iris, the more."""
    if beam.profile != "gaussian" or beam.radius_1_e2 is None:
        return 1  # the integrand is linear
    return 5 + int(1.5 * (visible / beam.radius_1_e2) ** 2)


def _visible_radius(beam: Beam) -> float:
    """Where the irradiance ends, mm from the beam's axis; infinite for a beam without an edge."""
    iris = np.inf if beam.diameter == "unbounded" else beam.diameter / 2
    if beam.profile == "gaussian" and beam.radius_1_e2 is not None:
        return float(min(iris, _GAUSSIAN_END * beam.radius_1_e2))
    return float(iris)


def _profile(beam: Beam, radius: FloatArray) -> FloatArray:
    if beam.profile == "gaussian" and beam.radius_1_e2 is not None:
        return np.asarray(np.exp(-2 * (radius / beam.radius_1_e2) ** 2))
    return np.ones_like(radius)


@lru_cache(maxsize=8)
def _gauss_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights on (0, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1) / 2, weights / 2
