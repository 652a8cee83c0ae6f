"""An ideal flat Lambertian sample, by quadrature: what readings are scaled with, and a check of the tracer.

Between the target disc and the beam's disc stand two central (or parallel) projections by way of the plane z = 0, so
one homography H joins them. Along a radius of the target the edge of the beam is then the root of a
quadratic: the integrand is smooth between exact limits, and a few Gauss points do.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from instrument.angles import FloatArray
from sim_fixtures.reality.bundle import ACROSS, AXIS, DISC, FAR_DISC, IN_PLANE, PARALLEL, Bundle

_AZIMUTHS = 720  # of one pair of far ends; several share the work
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_GOLDEN = 0.6180339887498949


def lambertian_radiance(beam: Bundle, sensor: Bundle) -> float:
    """Mean radiance that a sensor sees of an infinite Lambertian plane z = 0 of reflectance 1.

    Parameters
    ----------
    beam, sensor
        With discs as cross-sections, in the frame of the plane.

    Returns
    -------
    float
        In units of the beam's peak irradiance, 1/sr. Error below 1e-4 of it; a sensor direction on the wrong
        side of the plane gives 0.
    """
    if sensor.shape != DISC or beam.shape != DISC:
        raise ValueError("the quadrature knows discs only")
    pairs = list(product(_far_ends(sensor), _far_ends(beam)))
    count = round(_AZIMUTHS / np.sqrt(len(pairs)))
    total = 0.0
    for number, ((sensor_end, sensor_weight), (beam_end, beam_weight)) in enumerate(pairs):
        if sensor_end[2] <= 0.0 or beam_end[2] <= 0.0:
            continue
        # The grids are turned against each other: errors at the kinks, where the two edges cross, then cancel.
        azimuth_rad = 2.0 * np.pi * (np.arange(count) + number * _GOLDEN) / count
        to_plane = _onto_plane(sensor, sensor_end)
        to_beam = np.asarray(np.linalg.inv(_onto_plane(beam, beam_end)), dtype=np.float64)
        total += sensor_weight * beam_weight * _disc_integral(beam, sensor, to_plane, to_beam, azimuth_rad)
    return float(total * sensor.density / np.pi)


def _disc_integral(
    beam: Bundle, sensor: Bundle, to_plane: FloatArray, to_beam: FloatArray, azimuth_rad: FloatArray
) -> float:
    """Irradiance of the plane, integrated over the target disc along the sight lines, mm^2."""
    joined = to_beam @ to_plane
    along = joined[:, :2] @ np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)])  # (3, azimuth)
    low, high = _inside_beam(beam, along, joined[:, 2:], sensor.extent)
    radius = 0.5 * (high + low) + 0.5 * np.multiply.outer(_NODES, high - low)  # (node, azimuth)
    area = 0.5 * np.multiply.outer(_WEIGHTS, high - low) * radius * (2.0 * np.pi / len(azimuth_rad))
    target = np.stack([radius * np.cos(azimuth_rad), radius * np.sin(azimuth_rad), np.ones_like(radius)])
    on_beam = (joined @ target.reshape(3, -1)).reshape(target.shape)
    depth = (to_plane[2] @ target.reshape(3, -1)).reshape(radius.shape)
    # A projection changes areas by det H / w^3: the light of an area of the disc lies on one of the plane.
    irradiance = abs(np.linalg.det(to_beam)) * np.abs((depth / on_beam[2]) ** 3)
    if beam.waist > 0.0:
        squared = (on_beam[0] ** 2 + on_beam[1] ** 2) / on_beam[2] ** 2
        irradiance = irradiance * np.exp(-2.0 * squared / beam.waist**2)
    return float(np.sum(area * irradiance) * beam.density)


def _inside_beam(beam: Bundle, along: FloatArray, middle: FloatArray, extent: float) -> tuple[FloatArray, FloatArray]:
    """Where radii of the target lie inside the beam's edge: lower and upper limit, shape (azimuth,) each."""
    low, high = np.zeros(along.shape[1]), np.full(along.shape[1], extent)
    if not np.isfinite(beam.extent):
        return low, high
    squared: FloatArray = np.array([1.0, 1.0, -(beam.extent**2)])
    a = squared @ along**2
    b = squared @ (along * middle)
    c = squared @ (middle * np.ones_like(along)) ** 2
    discriminant = b**2 - a * c
    root = np.sqrt(np.maximum(discriminant, 0.0))
    first, second = (-b - root) / a, (-b + root) / a
    first, second = np.minimum(first, second), np.maximum(first, second)
    low = np.clip(first, 0.0, extent)
    high = np.where(discriminant > 0.0, np.clip(second, 0.0, extent), low)
    return low, high


def _onto_plane(bundle: Bundle, end: FloatArray) -> FloatArray:
    """Homography from the disc's plane to z = 0, shape (3, 3); ``end`` is homogeneous, shape (4,)."""
    lift = np.zeros((4, 3))
    lift[:3, 0], lift[:3, 1] = bundle.frame[IN_PLANE], bundle.frame[IN_PLANE + 1]
    lift[:3, 2], lift[3, 2] = bundle.centre, 1.0
    # Where the line from the far end through a point meets z = 0: end_z * point - point_z * end.
    drop = end[2] * np.eye(4)
    drop[:, 2] -= end
    matrix = (drop @ lift)[[0, 1, 3]]
    return matrix / abs(end[2])


def _far_ends(bundle: Bundle) -> list[tuple[FloatArray, float]]:
    """Far ends as homogeneous points, shape (4,), with weights that add up to one."""
    axis, first, second = bundle.frame[AXIS], bundle.frame[ACROSS], bundle.frame[ACROSS + 1]
    if bundle.far == PARALLEL:
        return [(np.append(axis, 0.0), 1.0)]
    if bundle.far == FAR_DISC:
        centre = bundle.centre + bundle.far_distance * axis
        if bundle.far_radius == 0.0:
            return [(np.append(centre, 1.0), 1.0)]
        nodes, weights = np.polynomial.legendre.leggauss(2)
        radii = bundle.far_radius * np.sqrt(0.5 * (1.0 + nodes))
        turns = 2.0 * np.pi * (np.arange(6) + 0.5) / 6
        return [
            (np.append(centre + r * (np.cos(turn) * first + np.sin(turn) * second), 1.0), float(w) / 12.0)
            for r, w in zip(radii, weights, strict=True)
            for turn in turns
        ]
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    weights = weights / weights.sum()
    slopes = np.tan(bundle.spread_rad * nodes)
    return [
        (np.append(axis + u * first + v * second, 0.0), float(a * b))
        for u, a in zip(slopes, weights, strict=True)
        for v, b in zip(slopes, weights, strict=True)
    ]
