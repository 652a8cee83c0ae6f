"""What a coupon's table gets wrong where it was not measured: readings are held out, and predicted from the others.

The gap at retro-reflection is widened by a step, the last zenith of emergence and the last of incidence are taken away;
the error at the readings held out stands for that of the entries filled one step further on. It holds the noise of
these readings and is no bound: what a narrow peak does inside the gap, no reading tells.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from twin.coupon import Method, Readings, coupon_readings, from_coupon, left_out_errors, smooth_gridding_error
from twin.coupon_layout import lay_out
from twin.material_changes import retro_angle_rad
from twin.reflection_models.smooth import smooth

_SAME = 1e-3
#: Half-width of the widened gap at retro-reflection, degree.
_WIDENED = 10.0 + 1e-3

Rule = Callable[[Readings], np.ndarray]


def fill_errors(run: xr.Dataset, name: str, method: Method = "auto") -> dict[str, float]:
    """Relative root mean square error of filled entries, by rule.

    Parameters
    ----------
    run, name, method
        As of :func:`~twin.coupon.from_coupon`.

    Returns
    -------
    dict
        By the rules of ``Material.filled``; a rule without readings to hold out is left out.
    """
    chosen = from_coupon(run, name, method).method
    rules: dict[str, Rule] = {
        "retroreflection": lambda r: (retro_angle(r) < _WIDENED) & (r.theta_o < np.max(r.theta_o)),
        "grazing emergence": lambda r: r.theta_o > np.max(r.theta_o) - _SAME,
        "grazing incidence": lambda r: r.theta_i > np.max(r.theta_i) - _SAME,
    }
    errors: dict[str, float] = {}
    for rule, hidden in rules.items():
        wrong = [
            predict(rule, r.take(~hidden(r)), r.take(hidden(r)), chosen) / r.brf[hidden(r)] - 1
            for r in coupon_readings(run, name).values()
            if np.any(hidden(r)) and not np.all(hidden(r))
        ]
        every = np.concatenate([w[np.isfinite(w)] for w in wrong]) if wrong else np.zeros(0)
        if len(every):
            errors[rule] = float(np.sqrt(np.mean(every**2)))
    return errors


def interpolation_error(run: xr.Dataset, name: str, method: Method = "auto") -> float:
    """Relative root mean square error at readings that are predicted from the others, one at a time."""
    readings = list(coupon_readings(run, name).values())
    layouts = [lay_out(r.theta_i, r.theta_o, r.phi, name) for r in readings]
    linear, fitted = left_out_errors(readings, layouts)
    chosen = fitted if from_coupon(run, name, method).method == "smooth" else linear
    return float(np.sqrt(np.mean(chosen**2)))


def table_error(run: xr.Dataset, name: str, method: Method = "auto") -> float:
    """Relative root mean square difference of the table from the smooth fit that it stands for; 0 without one."""
    if from_coupon(run, name, method).method != "smooth":
        return 0.0
    readings = coupon_readings(run, name).values()
    return max(smooth_gridding_error(r, lay_out(r.theta_i, r.theta_o, r.phi, name)) for r in readings)


def retro_angle(readings: Readings) -> FloatArray:
    """Angle between emergence and retro-reflection, degree."""
    i, o, phi = (np.deg2rad(a) for a in (readings.theta_i, readings.theta_o, readings.phi))
    return np.rad2deg(retro_angle_rad(np.cos(o), phi, np.cos(i)))


def predict(rule: str, known: Readings, wanted: Readings, method: str) -> FloatArray:
    """Predict readings as the table of a method fills entries; NaN where its rule finds nothing to go by."""
    if method != "linear":
        return smooth(known.directions(), known.brf, wanted.directions())
    along = _along_incidence if rule == "grazing incidence" else _along_emergence
    return np.array([along(known, *row) for row in zip(wanted.theta_i, wanted.theta_o, wanted.phi, strict=True)])


def _along_emergence(known: Readings, theta_i: float, theta_o: float, phi: float) -> float:
    """Linear along the line through the normal, the last value beyond its ends."""
    same = np.abs(known.theta_i - theta_i) < _SAME
    ahead = same & ((np.abs(known.phi - phi) < _SAME) | (known.theta_o < _SAME))
    behind = same & (np.abs(known.phi - (180.0 - phi)) < _SAME) & (known.theta_o >= _SAME)
    zenith = np.concatenate([-known.theta_o[behind], known.theta_o[ahead]])
    if len(zenith) < 2:
        return float("nan")
    order = np.argsort(zenith, kind="stable")
    return float(np.interp(theta_o, zenith[order], np.concatenate([known.brf[behind], known.brf[ahead]])[order]))


def _along_incidence(known: Readings, theta_i: float, theta_o: float, phi: float) -> float:
    """The reading of the nearest incidence in the same direction of emergence."""
    same = (np.abs(known.theta_o - theta_o) < _SAME) & ((np.abs(known.phi - phi) < _SAME) | (theta_o < _SAME))
    if not np.any(same):
        return float("nan")
    return float(known.brf[same][np.argmin(np.abs(known.theta_i[same] - theta_i))])
