"""Whether the arms' axes meet: the same direction reached in two ways, and an edge seen from all around.

*Two ways.* The direction (zenith, azimuth 0) is (-zenith, azimuth 180) as well. A zero error of the sensor zenith makes
the arm stand too steep on the one way and too flat on the other; a tilt of the stage changes both alike, and left
against right. With N the flux of an ideal sample (:func:`instrument.lambertian.lambertian_flux`) and its slope
s = d ln N / d zenith,

    ln I(z, 0) - ln I(-z, 180) = 2 s(z) offset
    [ln I(z, 0) + ln I(-z, 180) - ln I(-z, 0) - ln I(z, 180)]/2 = -2 s(z) tilt .

*Edge.* With the sensor upright and a target that is white for x > 0, an axis that misses the optical centre by d
carries the field of view along a circle as the azimuth turns: I = I0 (1 + k d cos azimuth), where k follows from beam
and field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux
from instrument.procedures.reading import beyond, least_squares, relative_error
from instrument.procedures.results import Finding, Quantity
from instrument.procedures.room import Room

#: Sensor zeniths of the first part, degree; azimuths of the second, and its illumination: steep, so that the light
#: reaches beyond the field of view.
ZENITHS = (30.0, 45.0, 60.0)
AZIMUTHS = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0)
STEEP = 60.0
#: Standard uncertainty of the meeting of the axes that is taken for granted, mm: the sample's surface is set to it.
_ALLOWED_MM = 0.1


def intersection(
    room: Room, wavelength: float = 500.0, edge: bool = True, samples: int = 9, repeats: int = 2
) -> Finding:
    """Check zero of the sensor zenith, tilt of the stage, and the distance of the sensor's axis from the centre.

    Fails where one of them exceeds what the facility states (``arms.u_sensor_zenith``, ``sample.u_tilt``; 0.1 mm).

    Parameters
    ----------
    edge
        Use the edge target too.
    repeats
        How many times each geometry is read; all in turn, so that a steady drift hardly counts.
    """
    room.home()
    room.mount("reference")
    room.light()
    values, readings = _two_ways(room, wavelength, samples, repeats)
    limits = {
        "sensor zenith offset": room.facility.arms.u_sensor_zenith,
        "stage tilt": room.facility.sample.u_tilt,
        "sensor axis distance": _ALLOWED_MM,
    }
    if edge:
        room.mount("edge_target")
        room.light()
        more, further = _edge(room, wavelength, samples, repeats)
        values |= more
        readings += further
    wrong = [
        f"{name} {values[name]}"
        for name, limit in limits.items()
        if name in values and beyond(values[name].value, values[name].u or 0.0, limit)
    ]
    main = "; ".join(f"{name} {values[name]}" for name in limits if name in values)
    return Finding(
        verdict="failed" if wrong else "passed",
        summary="more than stated: " + "; ".join(wrong) if wrong else main,
        values=values,
        advice=("align the instrument (goniotwin align), then repeat this check",) if wrong else (),
        readings=tuple(readings),
    )


def _read(
    room: Room, geometries: Sequence[tuple[float, float, float]], wavelength: float, samples: int, repeats: int
) -> tuple[FloatArray, FloatArray, list[dict[str, float]]]:
    """Logarithms of the photocurrents at (illumination, zenith, azimuth) and their errors, shape (geometry,)."""
    order = [*range(len(geometries)), *reversed(range(len(geometries)))] * ((repeats + 1) // 2)
    logs: list[list[float]] = [[] for _ in geometries]
    errors: list[list[float]] = [[] for _ in geometries]
    for index in order[: repeats * len(geometries)]:
        illumination, zenith, azimuth = geometries[index]
        room.go(illumination, zenith, azimuth, wavelength)
        burst, _ = room.station.read(samples)
        logs[index].append(math.log(burst.current))
        errors[index].append(relative_error(burst))
    # Pooled: nine samples say little about their own scatter.
    pooled = math.sqrt(sum(e * e for one in errors for e in one) / sum(map(len, errors)))
    means = np.array([np.mean(one) for one in logs])
    records = [
        {"illumination_zenith": i, "sensor_zenith": z, "sensor_azimuth": a, "current": math.exp(m)}
        for (i, z, a), m in zip(geometries, means, strict=True)
    ]
    return means, pooled / np.sqrt([len(one) for one in logs]), records


def _two_ways(
    room: Room, wavelength: float, samples: int, repeats: int
) -> tuple[dict[str, Quantity], list[dict[str, float]]]:
    ways = [(0.0, way, azimuth) for zenith in ZENITHS for way, azimuth in _four(zenith)]
    logs, errors, records = _read(room, ways, wavelength, samples, repeats)
    table, u = logs.reshape(-1, 4), errors.reshape(-1, 4)
    slope = flux_slope(room.facility, np.array(ZENITHS))
    closure = table[:, 0] - table[:, 1]
    lean = (table[:, 0] + table[:, 1] - table[:, 2] - table[:, 3]) / 2
    # The way back is a second closure of the same offset, mirrored.
    mirrored = table[:, 3] - table[:, 2]
    design, both = np.concatenate([2 * slope, 2 * slope]), np.concatenate([closure, mirrored])
    u_both = np.concatenate([np.hypot(u[:, 0], u[:, 1]), np.hypot(u[:, 2], u[:, 3])])
    offset, u_offset, chi_offset = _one(design, both, u_both)
    tilt, u_tilt, chi_tilt = _one(-2 * slope, lean, np.sqrt(np.sum(u**2, axis=1)) / 2)
    return {
        "sensor zenith offset": Quantity(value=offset, u=u_offset, unit="degree"),
        "stage tilt": Quantity(value=tilt, u=u_tilt, unit="degree"),
        "reduced chi-square of the offset": Quantity(value=chi_offset, unit="1"),
        "reduced chi-square of the tilt": Quantity(value=chi_tilt, unit="1"),
    }, records


def _four(zenith: float) -> list[tuple[float, float]]:
    """Two ways to the direction of azimuth 0, then two to that of azimuth 180."""
    return [(zenith, 0.0), (-zenith, 180.0), (-zenith, 0.0), (zenith, 180.0)]


def _one(design: FloatArray, values: FloatArray, u: FloatArray) -> tuple[float, float, float]:
    parameter, covariance, chi_square = least_squares(design[:, None], values, u)
    return float(parameter[0]), float(np.sqrt(covariance[0, 0])), chi_square


def flux_slope(facility: Facility, zenith: FloatArray, step: float = 0.5) -> FloatArray:
    """d ln N / d zenith at normal illumination and azimuth 0, 1/degree, shape (zenith,).

    Raises
    ------
    InputError
        If the instrument's flux does not depend on the zenith: then nothing can be told from readings.
    """
    above, below = (np.log(lambertian_flux(facility, 0.0, zenith + sign * step, 0.0)) for sign in (1, -1))
    slope = (above - below) / (2 * step)
    if np.all(np.abs(slope) < 1e-4):
        raise InputError("the flux of this beam and sensor hardly depends on the zenith; two ways cannot be compared")
    return np.asarray(slope)


def _edge(
    room: Room, wavelength: float, samples: int, repeats: int
) -> tuple[dict[str, Quantity], list[dict[str, float]]]:
    sensitivity = edge_sensitivity(room.facility, STEEP)
    logs, errors, records = _read(room, [(STEEP, 0.0, azimuth) for azimuth in AZIMUTHS], wavelength, samples, repeats)
    angles = np.deg2rad(AZIMUTHS)
    design = np.stack([np.ones_like(angles), sensitivity * np.cos(angles), sensitivity * np.sin(angles)], axis=1)
    parameters, covariance, chi_square = least_squares(design, logs - logs.mean(), errors)
    return {
        "sensor axis distance": Quantity(value=float(parameters[1]), u=float(np.sqrt(covariance[1, 1])), unit="mm"),
        "across the edge": Quantity(value=float(parameters[2]), u=float(np.sqrt(covariance[2, 2])), unit="mm"),
        "edge sensitivity": Quantity(value=sensitivity, unit="mm-1"),
        "reduced chi-square of the edge": Quantity(value=chi_square, unit="1"),
    }, records


def edge_sensitivity(facility: Facility, illumination_zenith: float, nodes: int = 400) -> float:
    """Relative change of the light of a white half plane x > 0 when the field of view moves by 1 mm along x.

    The field of view is the target disc, seen upright; what it gains along its rim counts against what it holds.

    Raises
    ------
    InputError
        If no light falls on the rim of the field, or the beam is a picture.
    """
    beam, radius = facility.beam, facility.sensor.target_diameter / 2
    if beam.profile == "image":
        raise InputError("beam.profile: found 'image'; the edge target needs a gaussian or tophat beam (--no-edge)")
    (iris, iris_across), (decay, decay_across) = beam.iris, beam.decay
    shrink = math.cos(math.radians(illumination_zenith))

    def light(x: FloatArray, y: FloatArray) -> FloatArray:
        along = x * shrink
        inside = (along / iris) ** 2 + (y / iris_across) ** 2 <= 1
        return np.where(inside, np.exp(-decay * along**2 - decay_across * y**2), 0.0)

    angle = (np.arange(nodes) + 0.5) / nodes * math.pi - math.pi / 2
    distance = (np.arange(nodes) + 0.5) / nodes * radius
    rim = (
        float(np.sum(light(radius * np.cos(angle), radius * np.sin(angle)) * np.cos(angle))) * radius * math.pi / nodes
    )
    r, a = np.meshgrid(distance, angle, indexing="ij")
    held = float(np.sum(light(r * np.cos(a), r * np.sin(a)) * r)) * (radius / nodes) * (math.pi / nodes)
    if rim < 1e-3 * held:
        raise InputError("no light falls on the rim of the field of view; the edge target cannot be used (--no-edge)")
    return rim / held
