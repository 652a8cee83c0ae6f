"""Where on the plate's top the light of each reading comes from.

A place of the top shines with the beam's profile there and counts where the sensor's target lies behind it, seen along
the view. Beam and view are taken as parallel: what divergence and mirror blur is finer than the places lie apart.
"""

from __future__ import annotations

import numpy as np

from instrument.angles import FloatArray
from instrument.optics import Layout
from twin.diagnosis.effects import Known
from twin.optics import lay_out

#: Places on either side of the sample, and how far out they reach over the radius of the beam.
_SIDE, _REACH = 40, 2.2


def top_light(known: Known, columns: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Places on the plate's top and the share of the top's light that comes from each.

    Parameters
    ----------
    columns
        Commanded geometries, arrays of shape (point,) in degree.

    Returns
    -------
    places, shape (place, 2)
        In the frame of the sample, mm; none of them in a hole.
    light, shape (point, place)
        Adds up to 1 for each point whose target is lit at all.
    """
    half = np.minimum(np.asarray(known.artifact.form.outline) / 2, _REACH * max(known.facility.beam.iris))
    axes = [(np.arange(_SIDE) + 0.5) / _SIDE * 2 * h - h for h in half]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    places = places[~_in_a_hole(known, places)]
    layout, edge = lay_out(known.facility, columns), float(2 * half.max() / _SIDE)
    light = np.stack([_beam(layout, k, places, edge) * _seen(layout, k, places, edge) for k in range(len(layout))])
    return places, light / np.maximum(light.sum(axis=1, keepdims=True), 1e-300)


def _in_a_hole(known: Known, places: FloatArray) -> np.ndarray:
    holes = known.artifact.holes
    if not len(holes):
        return np.zeros(len(places), dtype=bool)
    apart = np.hypot(places[:, :1] - holes.x, places[:, 1:] - holes.y)
    return np.asarray(np.any(apart < np.asarray(holes.diameter) / 2, axis=1))


def _beam(layout: Layout, k: int, places: FloatArray, edge: float) -> FloatArray:
    """Irradiance normal to the beam over that on its axis, shape (place,)."""
    away = np.column_stack([places, np.zeros(len(places))]) - layout.beam[k]
    p, q = away @ layout.light_u[k], away @ layout.light_v[k]
    inside = _ramp((1 - np.hypot(p / layout.iris[k, 0], q / layout.iris[k, 1])) * layout.radius[k] / edge)
    profile = np.exp(-layout.falloff[k, 0] * p**2 - layout.falloff[k, 1] * q**2)
    return np.asarray(inside * profile * (1.0 if layout.picture is None else layout.picture.at(p, q)))


def _seen(layout: Layout, k: int, places: FloatArray, edge: float) -> FloatArray:
    """Whether the target lies behind each place along the view, shape (place,)."""
    along, across, view = layout.along[k], layout.across[k], layout.view[k]
    normal, size = np.cross(along, across), float(np.linalg.norm(along))
    away = np.column_stack([places, np.zeros(len(places))]) - layout.target[k]
    on_target = away - np.outer(away @ normal / (view @ normal), view)
    u, v = on_target @ along / size**2, on_target @ across / size**2
    out = np.maximum(np.abs(u), np.abs(v)) if layout.square else np.hypot(u, v)
    return _ramp((1 - out) * size / edge)


def _ramp(x: FloatArray) -> FloatArray:
    """0 below -1/2, 1 above 1/2, linear between."""
    return np.asarray(np.clip(0.5 + x, 0.0, 1.0))
