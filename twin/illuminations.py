"""Which geometries of a request share their illumination."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.optics import Layout
from twin.plate import Plate, Slots, Spot, light_through
from twin.plate_sight import plate_records

_LIGHT_COLUMNS = (
    "light",
    "light_u",
    "light_v",
    "beam",
    "iris",
    "falloff",
    "inverse_source",
    "divergence_rad",
    "target",
)


@dataclass(frozen=True)
class Illuminations:
    """The different illuminations of some geometries.

    Attributes
    ----------
    group, shape (point,)
        Which illumination each geometry has.
    keys
        What tells each of them apart.
    records, extra, slots
        Of the illuminations, as of geometries; the slots share the light out over the openings.
    """

    group: NDArray[np.int64]
    keys: list[bytes]
    records: FloatArray
    extra: FloatArray
    slots: Slots

    def take(self, chosen: NDArray[np.int64]) -> Illuminations:
        """Those of some of the geometries."""
        kept, group = np.unique(self.group[chosen], return_inverse=True)
        return Illuminations(
            group.reshape(-1), [self.keys[k] for k in kept], self.records[kept], self.extra[kept], self.slots.take(kept)
        )

    def __len__(self) -> int:
        return len(self.keys)


def illuminations(
    plate: Plate, layout: Layout, spot: Spot, table_index: NDArray[np.int64], records: FloatArray
) -> Illuminations:
    """Group geometries by their illumination."""
    count = len(layout)
    parts = [np.asarray(getattr(layout, name)).reshape(count, -1) for name in _LIGHT_COLUMNS]
    parts += [np.linalg.norm(layout.along, axis=1)[:, None], table_index[:, None].astype(float)]
    rows = np.round(np.concatenate(parts, axis=1), 9) + 0.0
    distinct, first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    picture = b"" if layout.picture is None else layout.picture.digest.encode()
    keys = [row.tobytes() + picture for row in distinct]
    some, lit = layout.take(first), spot.take(first)
    slots = light_through(plate, some, lit)
    return Illuminations(group.reshape(-1), keys, records[first], plate_records(some, lit), slots)
