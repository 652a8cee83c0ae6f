"""Where on the sensor's target lie the sight lines that meet directly lit surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from instrument.angles import FloatArray
from instrument.optics import Layout


@dataclass(frozen=True)
class Footprint:
    """Where on the target lie the sight lines that meet directly lit surface; target coordinates (u, v).

    ``centre + frame @ q`` with q in the unit disc are the sight lines through the beam's cross-section with the
    plate top; the rectangle |q . across_sweep| <= 1, -1 <= q . sweep <= 1 + length those through the beam anywhere down
    to ``depth``. Arrays of shape (point, ...).
    """

    centre: FloatArray
    frame: FloatArray
    inverse: FloatArray
    sweep: FloatArray
    length: FloatArray
    bounded: np.ndarray


def lit_footprint(layout: Layout, depth: FloatArray, margin_mm: float = 0.2) -> Footprint:
    """Find the sight lines that meet directly lit surface between the plate top and a depth below it.

    Parameters
    ----------
    depth, shape (point,)
        mm below z = 0.
    margin_mm
        Widens the beam: sight lines are not quite parallel.
    """
    bounded = np.isfinite(layout.radius) & (layout.light[:, 2] > 0.02) & (layout.view[:, 2] > 0.02)
    radius = np.where(bounded, layout.radius + margin_mm, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(bounded[:, None], layout.light / layout.light[:, 2:], 0.0)
        start = layout.beam - slope * layout.beam[:, 2:]
        step_u = layout.light_u - slope * layout.light_u[:, 2:]
        step_v = layout.light_v - slope * layout.light_v[:, 2:]
    centre = _on_target(layout, np.asarray(start - layout.target))
    frame: FloatArray = (
        np.stack([_on_target(layout, step_u), _on_target(layout, step_v)], axis=-1) * radius[:, None, None]
    )
    determinant = np.abs(np.linalg.det(frame))
    bounded = bounded & (determinant > 1e-6)
    frame = np.where(bounded[:, None, None], frame, np.eye(2))
    inverse = np.asarray(np.linalg.inv(frame), dtype=float)
    deep = np.einsum("nij,nj->ni", inverse, _on_target(layout, -slope * depth[:, None]))
    length = np.linalg.norm(deep, axis=1)
    sweep: FloatArray = np.where((length > 1e-9)[:, None], deep / np.maximum(length, 1e-9)[:, None], [1.0, 0.0])
    return Footprint(centre, frame, inverse, sweep, np.where(bounded, length, 0.0), bounded)


def _on_target(layout: Layout, offset: FloatArray) -> FloatArray:
    """Project offsets from the target's centre along the view; coordinates in units of the target's radius."""
    basis = np.stack([layout.along, layout.across, layout.view], axis=-1)
    return np.asarray(np.linalg.solve(basis, offset[..., None])[:, :2, 0])
