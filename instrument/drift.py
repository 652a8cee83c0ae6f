"""Drift of the source between references that are read on schedule: corrected linearly in time, with its uncertainty.

A point between two calibrations is scaled with the level between theirs. What a straight line cannot know is taken for
a random walk of the size that the levels show: between two references, at the share w of the time between them, its
variance is D T w(1 - w) (a Brownian bridge over the time T), and D t at a time t after the last one. D is the mean
squared change of the level over the time that it took; with three changes and more their common slope is taken out.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux

COMPONENT = "u_brf_drift"
CORRECTION = "drift_correction"
_ENOUGH = 3  # changes, of which a slope can be taken out


@dataclass(frozen=True)
class Drift:
    """Level at the times of points over that of the calibration each is scaled with, and its relative uncertainty."""

    ratio: FloatArray
    u: FloatArray


def diffusion(times: FloatArray, levels: FloatArray) -> float:
    """Mean squared relative change of a level in a second.

    Parameters
    ----------
    times
        s, ascending, shape (calibration,).
    levels
        Shape (calibration,).
    """
    if len(times) < 2:
        return 0.0
    spans, changes = np.diff(times), np.diff(levels) / np.mean(levels)
    if len(changes) < _ENOUGH:
        return float(np.sum(changes**2) / np.sum(spans))
    # Changes of a walk with a slope have variance D T: weighted least squares of the slope, and what is left.
    slope = np.sum(changes) / np.sum(spans)
    return float(np.mean((changes - slope * spans) ** 2 / spans) * len(changes) / (len(changes) - 1))


def drift_of(points: FloatArray, used: np.ndarray, times: FloatArray, levels: FloatArray, joined: np.ndarray) -> Drift:
    """Levels at the times of points.

    Parameters
    ----------
    points
        Times of the points, s, shape (point,).
    used
        Calibration that each is scaled with: the last before it, shape (point,).
    times, levels
        Of the calibrations, shape (calibration,).
    joined
        Whether the light was the same from the calibration before to this one, shape (calibration,): only then the
        level between the two is known.
    """
    ratio, variance = np.ones(len(points)), np.zeros(len(points))
    starts = [0, *(k for k in range(1, len(times)) if not joined[k]), len(times)]
    for first, last in pairwise(starts):
        walk = diffusion(times[first:last], levels[first:last])
        inside = (used >= first) & (used < last)
        level = np.interp(points[inside], times[first:last], levels[first:last])
        ratio[inside] = level / levels[used[inside]]
        after = np.clip(np.searchsorted(times[first:last], points[inside]) + first, first, last - 1)
        before = np.clip(after - 1, first, last - 1)
        span = times[after] - times[before]
        share = np.where(span > 0, (points[inside] - times[before]) / np.where(span > 0, span, 1.0), 0.0)
        bridge = span * share * (1 - share)
        beyond = np.maximum(points[inside] - times[last - 1], times[first] - points[inside])
        variance[inside] = walk * np.where(beyond > 0, beyond, bridge)
    return Drift(ratio, np.sqrt(np.maximum(variance, 0.0)))


def correct_drift(
    dataset: xr.Dataset,
    facility: Facility,
    reference_current: FloatArray,
    light: np.ndarray,
    reference_light: np.ndarray,
) -> None:
    """Scale ``brf`` of a run with the level at the time of each point; adds the correction and its uncertainty.

    Parameters
    ----------
    dataset
        Has ``brf``, times, and the sets of the reference; changed in place.
    reference_current
        A, shape (reference,).
    light, reference_light
        Which points and which readings of the reference share their light (a number each).
    """
    known = facility.reference
    flux = lambertian_flux(
        facility, known.illumination_zenith, known.sensor_zenith, dataset["reference_sensor_azimuth"].values
    )
    origin = dataset["time"].values.min()
    point_time, reference_time = (_seconds(dataset[name].values, origin) for name in ("time", "reference_time"))
    sets, used = dataset["reference_set"].values, dataset["point_reference_set"].values
    repeated = dataset["reference_repeated"].values.astype(bool)
    ratio, u = np.ones(dataset.sizes["point"]), np.zeros(dataset.sizes["point"])
    for channel in np.unique(light):
        rows = light == channel
        numbers = [number for number in np.unique(sets) if np.any((sets == number) & (reference_light == channel))]
        chosen = [(sets == number) & (reference_light == channel) for number in numbers]
        times = np.array([reference_time[one].mean() for one in chosen])
        levels = np.array([np.mean(reference_current[one] / flux[one]) for one in chosen])
        joined = np.array([bool(np.all(repeated[one])) for one in chosen])
        result = drift_of(point_time[rows], np.searchsorted(numbers, used[rows]), times, levels, joined)
        ratio[rows], u[rows] = result.ratio, result.u
    dataset["brf"] = ("point", dataset["brf"].values / ratio, dataset["brf"].attrs)
    about = {"units": "1", "long_name": "level of the reference at the point's time over that of its calibration"}
    dataset[CORRECTION] = ("point", ratio, about)
    dataset[COMPONENT] = (
        "point",
        u * np.abs(dataset["brf"].values),
        {
            "units": "1",
            "long_name": "standard uncertainty (k=1) of brf: drift between references",
            "pdf_shape": "gaussian",
            "source": "random walk of the size that the references show",
        },
    )


def _seconds(times: np.ndarray, origin: np.datetime64) -> FloatArray:
    return np.asarray((times - origin) / np.timedelta64(1, "ns"), dtype=float) * 1e-9
