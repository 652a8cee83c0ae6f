"""Geometries made ready for the tracing kernels: their records, the shares of the openings, their illuminations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.beam_image import BeamImage
from twin.illuminations import Illuminations, illuminations
from twin.optics import Footprint, Layout, lit_footprint
from twin.plate import Plate, Slots, served, share_out, spot_on_top
from twin.plate_sight import plate_records
from twin.sight import records

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Mixture:
    """How sight lines are chosen over the whole target: shares of those through the lit top, and the lit depth.

    The rest goes over the whole target, because light scattered inside the cavity shows beyond the lit volume. A
    region that covers most of the target gets a smaller share: there is nothing to restrict.
    """

    lit_top: float = 0.4
    lit_depth: float = 0.35

    def shares(self, footprint: Footprint) -> FloatArray:
        """Shares of the two regions, shape (point, 2)."""
        area = np.abs(np.linalg.det(footprint.frame))
        top, deep = area, area * 2 * (2 + footprint.length) / np.pi
        gain = np.stack([np.clip(1 - top, 0, 1), np.clip(1 - deep, 0, 1)], axis=1)
        bounded = footprint.bounded[:, None]
        return np.where(bounded, np.array([self.lit_top, self.lit_depth]) * np.sqrt(gain), 0.0)


#: Every sight line of the target equally likely: slow, and the yardstick for the other ways.
UNRESTRICTED = Mixture(0.0, 0.0)


@dataclass(frozen=True)
class Geometries:
    """Geometries that are traced in the same way, as the kernels take them; arrays of shape (point, ...).

    Attributes
    ----------
    extra, once, scattered, light
        Where sight lines go through the openings of a plate: the rest of the record, shares of the openings for
        light reflected once and for scattered light, and the illuminations. None elsewhere.
    picture
        Irradiance of the beam, where it is a picture.
    """

    records: FloatArray
    square: bool
    diverging: bool
    extra: FloatArray | None = None
    once: Slots | None = None
    scattered: Slots | None = None
    light: Illuminations | None = None
    picture: BeamImage | None = None

    def take(self, chosen: IntArray) -> Geometries:
        """Some of the geometries."""
        parts: dict[str, Any] = {"records": self.records[chosen]}
        if self.extra is not None:
            parts["extra"] = self.extra[chosen]
        for name in ("once", "scattered", "light"):
            value = getattr(self, name)
            parts[name] = None if value is None else value.take(chosen)
        return replace(self, **parts)

    def __len__(self) -> int:
        return len(self.records)


@dataclass(frozen=True)
class Prepared:
    """All geometries of a request: which are traced in which way.

    Attributes
    ----------
    through, shape (point,)
        Through the openings of the plate.
    place, shape (point,)
        Of each geometry among those traced in its way.
    """

    through: NDArray[np.bool_]
    place: IntArray
    by_target: Geometries
    by_plate: Geometries | None

    def __len__(self) -> int:
        return len(self.through)


def prepare(
    layout: Layout,
    table_index: IntArray,
    keys: NDArray[np.uint32],
    *,
    plate: Plate | None,
    visible_depth: FloatArray,
    mixture: Mixture | None,
) -> Prepared:
    """Make geometries ready.

    Parameters
    ----------
    keys, shape (point,)
        Numbers that tell geometries apart.
    plate
        The sample's top, if it is known to be a plate.
    visible_depth, shape (point,)
        How deep sight lines through a hole can go, mm.
    mixture
        Choose sight lines over the whole target in these shares, plate or not.
    """
    count = len(layout)
    spot = spot_on_top(layout)
    through = np.zeros(count, dtype=bool)
    if plate is not None and mixture is None:
        through = served(plate, layout, spot)
    footprint = lit_footprint(layout, visible_depth)
    packed = records(layout, table_index, footprint, (mixture or Mixture()).shares(footprint), keys)
    diverging = bool(np.any(layout.divergence_rad > 0))
    by_plate = None
    if plate is not None and np.any(through):
        some, lit = layout.take(np.flatnonzero(through)), spot.take(through)
        by_plate = Geometries(
            packed[through],
            layout.square,
            diverging,
            plate_records(some, lit),
            share_out(plate, some, lit, scattered=False),
            share_out(plate, some, lit, scattered=True),
            illuminations(plate, some, lit, table_index[through], packed[through]),
            layout.picture,
        )
    place = np.where(through, np.cumsum(through), np.cumsum(~through)) - 1
    by_target = Geometries(packed[~through], layout.square, diverging, picture=layout.picture)
    return Prepared(through, place, by_target, by_plate)
