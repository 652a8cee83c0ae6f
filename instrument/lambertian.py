"""Flux that an ideal Lambertian sample gives in a geometry: the N of the data contract.

The sensor is a target disc centred on the optical centre, seen from a mirror disc: a ray joins a uniformly sampled
point of each. With m a point of the mirror and s u a point of the target (u a unit vector in its plane,
0 <= s <= target radius), the ray meets the sample plane z = 0 at

    p = s (m_z u - u_z m)/(m_z - s u_z)

so p runs outwards along one straight line as s grows, and leaves the beam once, at a known s. That splits the
integral over the target exactly at the edge of the iris: what is left is smooth along s, and periodic around
the disc. A parallel sensor is the limit m -> infinity.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from instrument.angles import FloatArray, direction
from instrument.facility import Beam, Facility, Sensor

#: Nodes along a radius of the target, around it, and along a radius of the mirror and around it.
_RADIAL, _AROUND, _MIRROR_RADIAL, _MIRROR_AROUND = 6, 256, 2, 6
_CHUNK = 256


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
        Dimensionless; its quadrature error is below 1e-5 of it up to a sensor zenith of 85 degrees.
    """
    angles = np.broadcast_arrays(
        *(
            np.asarray(a, dtype=float)
            for a in (illumination_zenith, illumination_azimuth, sensor_zenith, sensor_azimuth)
        )
    )
    shape = angles[0].shape
    illumination, illumination_az, sensor, sensor_az = (np.ravel(a) for a in angles)
    # Only the azimuth between the arms matters: work in the frame of the illumination.
    keys, inverse = np.unique(
        np.round(
            np.stack(
                [
                    np.abs(illumination),
                    sensor,
                    np.mod(sensor_az - illumination_az + np.where(illumination < 0, 180.0, 0.0), 360.0),
                ]
            ),
            10,
        ),
        axis=1,
        return_inverse=True,
    )
    values = np.concatenate(
        [_flux(facility, *keys[:, start : start + _CHUNK]) for start in range(0, keys.shape[1], _CHUNK)]
        or [np.zeros(0)]
    )
    return np.asarray(values[np.ravel(inverse)].reshape(shape))


def _flux(facility: Facility, illumination: FloatArray, sensor: FloatArray, azimuth: FloatArray) -> FloatArray:
    cosine = np.cos(np.deg2rad(illumination))
    shape = facility.sensor.target_shape
    zenith = np.zeros_like(sensor) if shape == "horizontal_disc" else sensor
    flux = np.zeros_like(cosine)
    for mirror_x, mirror_y, weight in _mirror_nodes(facility.sensor):
        flux += weight * _target_mean(facility, cosine, zenith, azimuth, mirror_x, mirror_y)
    return cosine * flux


def _target_mean(
    facility: Facility,
    cosine: FloatArray,
    zenith: FloatArray,
    azimuth: FloatArray,
    mirror_x: float,
    mirror_y: float,
) -> FloatArray:
    """Mean of the beam's profile over the target, seen from one point of the mirror (or along one direction)."""
    sensor, beam = facility.sensor, facility.beam
    inverse_distance = 1 / sensor.mirror_distance if sensor.mirror_diameter > 0 else 0.0
    view = direction(zenith, azimuth)
    along = direction(zenith + 90.0, azimuth)  # in the plane of the target, towards growing zenith
    across = direction(90.0, azimuth + 90.0)
    mirror = view + inverse_distance * (mirror_x * along + mirror_y * across)  # in units of the distance
    psi = (np.arange(_AROUND) + 0.5) * (2 * np.pi / _AROUND)
    ray = np.cos(psi)[:, None] * along[:, None, :] + np.sin(psi)[:, None] * across[:, None, :]
    height, slope = mirror[:, None, 2], inverse_distance * ray[..., 2]
    footprint = height[..., None] * ray - ray[..., 2:] * mirror[:, None, :]
    spread = np.hypot(cosine[:, None] * footprint[..., 0], footprint[..., 1])  # across the beam
    reach = np.full(spread.shape, sensor.target_diameter / 2)
    visible = _visible_radius(beam)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Where the denominator is not positive the ray never leaves the beam, or never meets the plane.
        edge = np.where(np.isfinite(visible), visible * height / (spread + visible * slope), height / slope)
    denominator = spread + visible * slope if np.isfinite(visible) else slope
    reach = np.where(denominator > 0, np.minimum(reach, edge), reach)
    nodes, weights = _gauss_legendre(_RADIAL)
    s = reach[..., None] * nodes
    radius = s * spread[..., None] / (height[..., None] - s * slope[..., None])
    radial = np.sum(weights * s * _profile(beam, radius), axis=-1) * reach
    mean = 2 * radial.mean(axis=-1) / (sensor.target_diameter / 2) ** 2
    return np.where(mirror[:, 2] > 0, mean, 0.0)


def _visible_radius(beam: Beam) -> float:
    """Where the irradiance ends, mm from the beam's axis; infinite for a beam without an edge."""
    iris = np.inf if beam.diameter == "unbounded" else beam.diameter / 2
    if beam.profile == "gaussian" and beam.radius_1_e2 is not None:
        return float(min(iris, 3.5 * beam.radius_1_e2))  # exp(-2 * 3.5^2) = 2e-11
    return float(iris)


def _profile(beam: Beam, radius: FloatArray) -> FloatArray:
    if beam.profile == "gaussian" and beam.radius_1_e2 is not None:
        return np.asarray(np.exp(-2 * (radius / beam.radius_1_e2) ** 2))
    return np.ones_like(radius)


def _mirror_nodes(sensor: Sensor) -> list[tuple[float, float, float]]:
    """Points of the mirror disc and their weights; one for a parallel sensor and for a target that lies flat."""
    if sensor.mirror_diameter == 0 or sensor.target_shape == "horizontal_disc":
        return [(0.0, 0.0, 1.0)]
    nodes, weights = _gauss_legendre(_MIRROR_RADIAL)
    angles = (np.arange(_MIRROR_AROUND) + 0.5) * (2 * np.pi / _MIRROR_AROUND)
    radii = sensor.mirror_diameter / 2 * np.sqrt(nodes)
    return [
        (float(radius * np.cos(angle)), float(radius * np.sin(angle)), float(weight / _MIRROR_AROUND))
        for radius, weight in zip(radii, weights, strict=True)
        for angle in angles
    ]


@lru_cache(maxsize=8)
def _gauss_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights on (0, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1) / 2, weights / 2
