"""What depends on when, and in which order, the points were read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition
from twin.diagnosis.effects.base import Known, Parameter, ReadingEffect

#: Curvatures below it are told from zero by no reading.
_STRAIGHT = 1e-6


class SourceDrift(ReadingEffect):
    """Relative change of the source's power from the first to the last point: steady, settling or setting in.

    With the progress p of the run from 0 to 1 the power changes as (1 - exp(-c p))/(1 - exp(-c)), linearly for c = 0:
    what a source does that warms up, or that fails.
    """

    name = "source_drift"
    title = "source drifts during the scan"
    parameters = (
        Parameter("fraction", "1", 0.02, (-0.3, 0.3)),
        Parameter("curvature", "1", 1.0, (-4.0, 4.0), shape=True),
    )
    needs = ("progress",)
    confused_with = ("session_scale",)
    separated_by = "the reference read again after the scan, or slices in another order"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        assert run.progress is not None
        fraction, curvature = values[..., :1], values[..., 1:]
        bent = np.where(np.abs(curvature) < _STRAIGHT, _STRAIGHT, curvature)
        return np.asarray(brf * (1 + fraction * np.expm1(-bent * run.progress) / np.expm1(-bent)))


class SessionScale(ReadingEffect):
    """One factor for all points of an illumination zenith: a reference measurement each."""

    name = "session_scale"
    title = "each illumination angle has a scale of its own"
    parameters = (Parameter("ratio", "1", 0.014, (0.8, 1.25), nominal=1.0),)
    confused_with = ("source_drift", "illumination_zenith_offset", "reference_scale")
    separated_by = "illumination zenith 60 degrees, or the reference read again between the angles"

    def resolve(self, known: Known, run: Acquisition | None = None) -> tuple[Parameter, ...]:
        """One ratio for every illumination zenith of the run, named ``ratio_`` and the angle."""
        (parameter,) = super().resolve(known, run)
        if run is None:
            return (parameter,)
        return tuple(replace(parameter, name=f"ratio_{zenith:g}") for zenith in _zeniths(run)[0])

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        return np.asarray(brf * values[..., _zeniths(run)[1]])


class StaleSample(ReadingEffect):
    """Share of the previous point in a reading: light that an averaging detector still remembers."""

    name = "stale_sample"
    title = "readings hold a share of the previous point"
    parameters = (Parameter("fraction", "1", 0.08, (0.0, 0.8)),)
    confused_with = ("sensor_zenith_offset", "backlash", "sensor_arm_runout")
    separated_by = "a slice in the opposite scan direction, or in irregular steps"

    def reading(self, run: Acquisition, brf: FloatArray, values: FloatArray) -> FloatArray:
        signal = brf * run.signal_per_brf
        return np.asarray(((1 - values) * signal + values * signal[..., run.previous]) / run.signal_per_brf)


def _zeniths(run: Acquisition) -> tuple[FloatArray, NDArray[np.int64]]:
    distinct, place = np.unique(np.round(run.columns["illumination_zenith"], 3), return_inverse=True)
    return distinct, place.reshape(-1)
