"""The same sight lines for every evaluation of a plan.

Sight lines go through the openings of a plate in shares that follow beam and target (:mod:`twin.plate`). Chosen anew
for every small change of the inputs, they would move within the openings, and common random numbers would be common in
name only. Here the nominal instrument decides, for all evaluations. Every opening gets some, so that none that only
another evaluation sees or lights is missed, and the result is as unbiased as with shares of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.illuminations import Illuminations
from twin.optics import Layout
from twin.plate import Plate, Slots, in_proportion, served, share_out, spot_on_top
from twin.plate import light_through as share_light
from twin.plate_sight import plate_records
from twin.prepared import Prepared, prepare

IntArray = NDArray[np.int64]
#: Slots that the sight lines of a geometry are divided into; more where a plate has more openings than half of it.
_SLOTS = 512
#: The shares are those of a target and a beam so much wider, mm: others will stand a little beside the nominal ones.
_MARGIN_MM = 0.3
#: What of a layout does not matter to the light.
_SENSOR = {"target", "along", "across", "view", "mirror_along", "mirror_across", "inverse_distance", "stop"}


@dataclass(frozen=True)
class CommonShares:
    """Shares of the openings for the sight lines and for the light of every geometry of a plan.

    Attributes
    ----------
    once, scattered, light
        Of light reflected once, of scattered light, and of the light that enters; shape (point, slot).
    """

    once: Slots
    scattered: Slots
    light: Slots

    @classmethod
    def of(cls, plate: Plate, layout: Layout) -> CommonShares | None:
        """Shares for a nominal layout; None for a plate without openings, which needs none."""
        if not len(plate.radius):
            return None
        wider = _widened(layout)
        spot = spot_on_top(wider)
        spot = replace(spot, radius=np.where(spot.radius > 0, spot.radius + _MARGIN_MM, 0.0))
        shares = (
            share_out(plate, wider, spot, scattered=False),
            share_out(plate, wider, spot, scattered=True),
            share_light(plate, wider, spot),
        )
        return cls(*(_with_every_opening(slots, len(plate.radius)) for slots in shares))


def _widened(layout: Layout) -> Layout:
    def longer(side: FloatArray) -> FloatArray:
        length = np.linalg.norm(side, axis=1, keepdims=True)
        return np.asarray(side * (1 + _MARGIN_MM / np.maximum(length, 1e-9)))

    return replace(layout, along=longer(layout.along), across=longer(layout.across), radius=layout.radius + _MARGIN_MM)


def _with_every_opening(slots: Slots, openings: int) -> Slots:
    total = _SLOTS
    while total < 2 * openings:
        total *= 2
    rows = len(slots.opening)
    place = slots.opening.astype(np.int64) + openings * np.arange(rows)[:, None]
    number = np.bincount(place.ravel(), minlength=rows * openings).reshape(rows, openings)
    # A weight without slots still gets one.
    count = in_proportion(np.asarray(number + 1e-3, dtype=float), total)
    first = np.cumsum(count, axis=1) - count

    def by_slot(value: NDArray[np.int64]) -> NDArray[np.uint32]:
        return np.repeat(value.ravel(), count.ravel()).reshape(rows, total).astype(np.uint32)

    return Slots(by_slot(np.broadcast_to(np.arange(openings), count.shape)), by_slot(first), by_slot(count))


def prepare_alike(
    shares: CommonShares,
    plate: Plate,
    layout: Layout,
    table_index: IntArray,
    keys: NDArray[np.uint32],
) -> Prepared:
    """Make evaluations of a plan ready for the tracer, with common shares of the openings.

    Parameters
    ----------
    shares
        For the plan, whose geometries are all repeated in every evaluation.
    plate
        Of the sample that is traced.
    layout, table_index, keys
        One evaluation after the other, every geometry in each.

    Notes
    -----
    Geometries that the openings do not serve are traced over the whole target, as without common shares.
    """
    points = len(shares.once.opening)
    sine = np.linalg.norm(layout.view[:, :2], axis=1)
    reach = 2 * plate.radius.max() * np.abs(layout.view[:, 2]) / np.maximum(sine, 1e-6)
    whole = prepare(
        layout, table_index, keys, plate=None, visible_depth=np.minimum(plate.depth, reach), mixture=None
    ).by_target
    spot = spot_on_top(layout)
    through = served(plate, layout, spot)
    by_plate = None
    if np.any(through):
        rows = np.flatnonzero(through)
        some, point = layout.take(rows), rows % points
        by_plate = replace(
            whole.take(rows),
            extra=plate_records(some, spot.take(rows)),
            once=shares.once.take(point),
            scattered=shares.scattered.take(point),
        )
        assert by_plate.extra is not None
        light = _lights(shares, some, table_index[rows], by_plate.records, by_plate.extra, point)
        by_plate = replace(by_plate, light=light)
    place = np.where(through, np.cumsum(through), np.cumsum(~through)) - 1
    return Prepared(through, place, whole.take(np.flatnonzero(~through)), by_plate)


def _lights(
    shares: CommonShares,
    layout: Layout,
    table_index: IntArray,
    packed: FloatArray,
    extra: FloatArray,
    point: IntArray,
) -> Illuminations:
    """Group geometries by their light: what their target is does not matter, for its shares are common."""
    count = len(layout)
    values = [getattr(layout, field.name) for field in fields(layout) if field.name not in _SENSOR]
    parts = [value.reshape(count, -1) for value in values if isinstance(value, np.ndarray)]
    rows = np.round(np.concatenate([*parts, table_index[:, None].astype(float)], axis=1), 9) + 0.0
    distinct, first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    keys = [row.tobytes() for row in distinct]
    return Illuminations(group.reshape(-1), keys, packed[first], extra[first], shares.light.take(point[first]))
