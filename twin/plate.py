"""Where light enters a plate with holes, and how sight lines are shared out over the holes.

Outside its openings the top of the plate is flat, and nothing stands between it, the beam and the sensor: its part
of the reading is an integral without a ray (:meth:`twin.paths.Paths.plate_top`). Rays are needed through the openings
alone, so a sight line is chosen by the opening that it goes through, one that shows much light more often.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.optics import Layout

#: Least number of equal slots that a geometry's sight lines are divided into, and slots for each opening at least.
_SLOTS, _PER_OPENING = 1024, 2
#: Light scattered in the cavity fades from this far inside the beam's edge on, over this range, to a floor; mm.
_LEVEL_MM, _FADING_MM, _FAR_SHARE = 4.0, 3.5, 0.03
#: Share of an opening through which no directly lit surface is expected.
_UNLIT_SHARE = 0.02
_DEPTH_NODES = 7
#: Light that enters beside the target counts less: range in mm, and what is left far away.
_NEAR_TARGET_MM, _FAR_FROM_TARGET = 6.0, 0.1
#: Openings around one that its light is looked for in.
NEIGHBOURS = 8
#: Below these cosines of view and light the openings are no good coordinates for sight lines.
_LOWEST_VIEW, _LOWEST_LIGHT = 0.03, 0.02


@dataclass(frozen=True)
class Plate:
    """A flat plate top at z = 0, pierced inside discs that do not overlap; lengths in mm.

    Attributes
    ----------
    half
        Half sides of the outline.
    centre, shape (opening, 2), radius, shape (opening,)
        Discs outside which the plate is whole.
    depth
        How far below the top the sample is hollow.
    closed
        Whether light leaves the cavity by the openings alone.
    """

    half: tuple[float, float]
    centre: FloatArray
    radius: FloatArray
    depth: float
    closed: bool


@dataclass(frozen=True)
class Slots:
    """Shares of the openings: equal parts of the unit interval, some in a row for each opening.

    Arrays of shape (point, slot): ``opening``, and where its row starts and how long it is.
    """

    opening: NDArray[np.uint32]
    start: NDArray[np.uint32]
    count: NDArray[np.uint32]

    def take(self, chosen: NDArray[Any]) -> Slots:
        """The slots of some of the geometries."""
        return Slots(self.opening[chosen], self.start[chosen], self.count[chosen])


def make_plate(
    half: tuple[float, float], centre: FloatArray, radius: FloatArray, depth: float, *, closed: bool
) -> Plate | None:
    """A plate, or None if discs overlap or leave the outline."""
    from scipy.spatial import cKDTree

    inside = bool(np.all(np.abs(centre) + radius[:, None] <= np.asarray(half)))
    if len(radius) > 1:
        tree, widest = cKDTree(centre), float(radius.max())
        pairs = tree.query_pairs(2 * widest, output_type="ndarray")
        gap = np.linalg.norm(centre[pairs[:, 0]] - centre[pairs[:, 1]], axis=1) - radius[pairs].sum(axis=1)
        inside = inside and not bool(np.any(gap < 0))
    return Plate(half, centre, radius, depth, closed) if inside else None


@dataclass(frozen=True)
class Spot:
    """The beam on the plane of the plate's top: ``centre + q_u step_u + q_v step_v``, \\|q\\| up to ``radius``.

    Arrays of shape (point, 2) and (point,); an unbounded beam has a radius of 0 here.
    """

    centre: FloatArray
    step_u: FloatArray
    step_v: FloatArray
    radius: FloatArray

    def take(self, chosen: NDArray[Any]) -> Spot:
        """The spots of some of the geometries."""
        return Spot(self.centre[chosen], self.step_u[chosen], self.step_v[chosen], self.radius[chosen])

    def area(self) -> FloatArray:
        """In mm2, shape (point,)."""
        u, v = self.step_u, self.step_v
        return np.asarray(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) * np.pi * self.radius**2)


def spot_on_top(layout: Layout) -> Spot:
    """Where the beam meets the plane z = 0; a beam that is not parallel gets a margin."""
    light = np.where(layout.light[:, 2:] > _LOWEST_LIGHT, layout.light, [0.0, 0.0, 1.0])
    slope = light[:, :2] / light[:, 2:]

    def drop(v: FloatArray) -> FloatArray:
        return np.asarray(v[:, :2] - slope * v[:, 2:])

    parallel = (layout.inverse_source == 0) & (layout.divergence_rad == 0)
    finite = np.where(np.isfinite(layout.radius), layout.radius, 0.0)
    spread = 6 * layout.divergence_rad * (2 * finite + 10) / light[:, 2]
    margin = np.where(parallel, 0.0, 0.2 + spread)
    return Spot(
        drop(layout.beam), drop(layout.light_u), drop(layout.light_v), np.where(finite > 0, finite + margin, 0.0)
    )


def served(plate: Plate, layout: Layout, spot: Spot) -> NDArray[np.bool_]:
    """Geometries whose every reading comes through the top of the plate, shape (point,).

    Either every sight line crosses the top, or no light reaches the sample's sides: the beam stays on the top, and
    the cavity is closed.
    """
    half = np.asarray(plate.half)
    lowest = layout.view[:, 2] - layout.inverse_distance * (_reach(layout.along, layout.across) + _mirror(layout))
    usable = (lowest > _LOWEST_VIEW) & (layout.light[:, 2] > _LOWEST_LIGHT)
    width = np.hypot(spot.step_u, spot.step_v) * spot.radius[:, None]
    lit_inside = np.all(np.abs(spot.centre) + width < half, axis=1) & np.isfinite(layout.radius)
    seen = np.stack([_to_top(layout, layout.target + edge) for edge in _rim(layout)], axis=1)
    seen_inside = np.all(np.abs(seen) < half, axis=(1, 2)) & (layout.inverse_distance == 0)
    return np.asarray(usable & ((lit_inside & plate.closed) | seen_inside))


def share_out(plate: Plate, layout: Layout, spot: Spot, *, scattered: bool) -> Slots:
    """Share the sight lines of every geometry out over the openings.

    An opening that no sight line of the target can reach gets none; every other one gets some, whatever is expected
    of it.

    Parameters
    ----------
    scattered
        For light reflected at least twice, which shows beside the beam too, instead of once.
    """
    if not len(plate.radius):
        none = np.zeros((len(layout), _SLOTS), dtype=np.uint32)
        return Slots(none, none, np.full_like(none, _SLOTS))
    beside = _beside_beam(plate, layout, spot)
    reach, kept = _seen_share(plate, layout)
    if scattered:
        expected = np.exp(-np.maximum(beside, -_LEVEL_MM) / _FADING_MM)
        weight = reach * expected + _FAR_SHARE
    else:
        blur = 0.3 + plate.depth * layout.inverse_distance * _mirror(layout) / layout.view[:, 2] ** 2
        expected = np.clip((plate.radius + np.minimum(blur, 1.0)[:, None] - beside) / (2 * plate.radius), 0.0, 1.0)
        # The noise of an opening goes with the root of the share of it that shines.
        weight = np.sqrt(reach * expected) + _UNLIT_SHARE
    return _slots(plate, np.where(kept, weight, 0.0))


def light_through(plate: Plate, layout: Layout, spot: Spot) -> Slots:
    """Share the beam's light out over the openings that it can enter by, those near the target first."""
    if not len(plate.radius):
        return share_out(plate, layout, spot, scattered=True)
    beside = _beside_beam(plate, layout, spot, on_top=True)
    margin = np.where(np.isfinite(layout.radius), spot.radius - layout.radius, 0.0)[:, None] + 1e-3
    entered = np.clip((plate.radius + margin - beside) / (2 * plate.radius), 0.0, 1.0)
    gap = plate.centre[None] - layout.target[:, None, :2]
    beyond = np.hypot(gap[..., 0], gap[..., 1]) - np.linalg.norm(layout.along, axis=1)[:, None]
    return _slots(plate, np.sqrt(entered) * (np.exp(-np.maximum(beyond, 0.0) / _NEAR_TARGET_MM) + _FAR_FROM_TARGET))


def neighbours(plate: Plate) -> tuple[NDArray[np.uint32], NDArray[np.uint32], FloatArray]:
    """The openings around each: indices (opening, NEIGHBOURS), how many of them count, and within which distance.

    They are all the openings within that distance.
    """
    from scipy.spatial import cKDTree

    openings = len(plate.radius)
    found = min(NEIGHBOURS + 2, openings)
    index = np.zeros((openings, NEIGHBOURS), dtype=np.uint32)
    if found < 2:
        return index, np.zeros(openings, dtype=np.uint32), np.zeros(openings)
    distance, nearest = (np.asarray(found_) for found_ in cKDTree(plate.centre).query(plate.centre, k=found))
    distance = np.concatenate([distance, np.full((openings, 1), np.inf)], axis=1)[:, 1:]
    gap = distance[:, 1:] > distance[:, :-1] * (1 + 1e-4) + 1e-4
    allowed = gap[:, : min(NEIGHBOURS, found - 1)]
    count: NDArray[np.int64] = np.max(np.where(allowed, np.arange(1, allowed.shape[1] + 1), 0), axis=1)
    last = distance[np.arange(openings), np.maximum(count - 1, 0)]
    width = min(NEIGHBOURS, found - 1)
    index[:, :width] = nearest[:, 1 : 1 + width]
    return index, count.astype(np.uint32), np.where(count > 0, last * (1 + 5e-5) + 5e-5, 0.0)


def nearest_openings(plate: Plate, spacing_mm: float = 0.4) -> tuple[NDArray[np.uint32], tuple[int, int]]:
    """The opening nearest to each cell of a grid over the plate, shape (x, y), and the grid's size."""
    from scipy.spatial import cKDTree

    nx, ny = (max(1, round(2 * half / spacing_mm)) for half in plate.half)
    if not len(plate.radius):
        return np.zeros((nx, ny), dtype=np.uint32), (nx, ny)
    x, y = ((np.arange(n) + 0.5) * (2 * half / n) - half for n, half in zip((nx, ny), plate.half, strict=True))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    return np.asarray(cKDTree(plate.centre).query(places)[1], dtype=np.uint32), (nx, ny)


def _slots(plate: Plate, weight: FloatArray) -> Slots:
    """Slots in proportion to weight and area of the openings; where there is no weight any opening will do."""
    weight = weight * plate.radius**2
    weight[~np.any(weight > 0, axis=1), 0] = 1.0
    slots = _SLOTS
    while slots < _PER_OPENING * len(plate.radius):
        slots *= 2
    return _in_rows(in_proportion(weight, slots), slots)


def in_proportion(weight: FloatArray, total: int) -> NDArray[np.int64]:
    """Whole numbers in proportion to the weights: at least 1, or 0 for no weight; every row's sum is the total.

    They follow small changes of the weights by small steps, so that differences between like geometries keep their
    common random numbers.

    Parameters
    ----------
    weight, shape (row, n)
        At least one positive in each row, not more than ``total``.
    """
    some = weight > 0
    cumulative = np.cumsum(np.where(some, weight, 0.0), axis=1)
    share = cumulative / cumulative[:, -1:]
    free = total - some.sum(axis=1, keepdims=True)
    edge = np.rint(share * free).astype(np.int64) + np.cumsum(some, axis=1)
    return np.diff(edge, axis=1, prepend=0)


def _in_rows(count: NDArray[np.int64], slots: int) -> Slots:
    opening = np.broadcast_to(np.arange(count.shape[1]), count.shape)
    start = np.cumsum(count, axis=1) - count

    def by_slot(value: NDArray[np.int64]) -> NDArray[np.uint32]:
        return np.repeat(value.ravel(), count.ravel()).reshape(-1, slots).astype(np.uint32)

    return Slots(by_slot(opening), by_slot(start), by_slot(count))


def _beside_beam(plate: Plate, layout: Layout, spot: Spot, *, on_top: bool = False) -> FloatArray:
    """How far the lit volume lies beside the sight line through an opening's centre, mm; shape (point, opening).

    ``on_top``: beside the opening's centre itself.

    Measured across the beam from its edge, negative inside.
    """
    bounded = np.isfinite(layout.radius)
    slope = layout.view[:, :2] / layout.view[:, 2:] - layout.light[:, :2] / layout.light[:, 2:]
    widest = 2 * plate.radius.max(initial=0.0)
    deep = np.minimum(plate.depth, widest * layout.view[:, 2] / np.maximum(np.hypot(*layout.view[:, :2].T), 1e-6))
    frame = np.where(
        bounded[:, None, None], np.stack([spot.step_u, spot.step_v], axis=-1), np.eye(2)
    )  # columns: what a step across the beam is on the top
    inverse = np.linalg.inv(frame)
    offset = np.einsum("nij,nhj->nhi", inverse, plate.centre[None] - spot.centre[:, None])
    step = np.einsum("nij,nj->ni", inverse, slope * deep[:, None])
    nearest = np.full(offset.shape[:2], np.inf)
    for part in [0.0] if on_top else np.linspace(0.0, 1.0, _DEPTH_NODES):
        gap = offset - part * step[:, None]
        nearest = np.minimum(nearest, np.hypot(gap[..., 0], gap[..., 1]))
    return np.where(bounded[:, None], nearest - np.where(bounded, layout.radius, 0.0)[:, None], -np.inf)


def _seen_share(plate: Plate, layout: Layout) -> tuple[FloatArray, NDArray[np.bool_]]:
    """About which share of an opening lies on the target, and whether any of it can; shape (point, opening)."""
    place = np.concatenate([plate.centre, np.zeros((len(plate.radius), 1))], axis=1)
    gap = layout.target[:, None] - place[None]
    towards = layout.view[:, None] + layout.inverse_distance[:, None, None] * gap
    normal = np.cross(layout.along, layout.across)
    step = np.einsum("nhi,ni->nh", gap, normal) / np.einsum("nhi,ni->nh", towards, normal)
    offset = step[..., None] * towards - gap
    size = np.stack([np.linalg.norm(side, axis=1) for side in (layout.along, layout.across)], axis=-1)
    u, v = (
        np.einsum("nhi,ni->nh", offset, side) / size[:, k, None] ** 2
        for k, side in enumerate((layout.along, layout.across))
    )
    distance = np.maximum(np.abs(u), np.abs(v)) if layout.square else np.hypot(u, v)
    beyond = (distance - 1) * size.min(axis=1)[:, None]
    # Seen from another point of the mirror the opening moves; so does it a little more than by its radius.
    moved = np.abs(step) * (layout.inverse_distance * _mirror(layout))[:, None] * 1.2
    stretch = 1.05 + (layout.inverse_distance * _reach(layout.along, layout.across))[:, None]
    size_seen = plate.radius * stretch + moved + 0.02
    return np.clip((size_seen - beyond) / (2 * size_seen), 0.0, 1.0), beyond < size_seen


def _mirror(layout: Layout) -> FloatArray:
    return _reach(layout.mirror_along, layout.mirror_across)


def _reach(along: FloatArray, across: FloatArray) -> FloatArray:
    """Half diagonal that two sides span at most, shape (point,)."""
    return np.asarray(np.sqrt(np.sum(along**2 + across**2, axis=1)))


def _rim(layout: Layout) -> list[FloatArray]:
    """Corners of a square around the target's shape, relative to its centre."""
    return [a * layout.along + b * layout.across for a in (-1, 1) for b in (-1, 1)]


def _to_top(layout: Layout, point: FloatArray) -> FloatArray:
    """Follow the view from points to z = 0, shape (point, 2)."""
    height = np.maximum(layout.view[:, 2:], 1e-6)
    return np.asarray(point[:, :2] - layout.view[:, :2] / height * point[:, 2:])
