"""Light reflected once by a pierced plate over a floor, by quadrature: what a ray tracer's noise would hide.

More than nine tenths of a reading is light that met one surface. For round holes in a flat plate it is an integral over
the plate's top: a whole top, less the top that the holes lack, plus what is seen through each hole, its wall, its
chamfer or the floor. The whole top is summed over nodes that move with the beam, the rest over nodes that are fixed to
each hole. Edges of beam, target, shadow and view run across the nodes as ramps as wide as the nodes lie apart. So the
sum follows small changes of any input smoothly, which differences need more than a small error: that of the sum is some
0.1 % of the reading, and nearly the same for like scenes.
"""

# The arguments of compiled functions are what the compiler makes of them.
# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.optics import Layout
from twin.artifact import Surface
from twin.diagnosis.direct_light_kernels import map_floor, sum_all
from twin.material import Material

#: Nodes of a hole and of the beam, and points of the mirror that they take turns with.
NODES, _BEAM_NODES, _MIRROR = 320, 3072, 24
#: Parallel beams that stand for a divergent one.
_BEAMS = 12
_GOLDEN = np.pi * (3 - np.sqrt(5))
_CELL_MM = 0.3


@dataclass(frozen=True)
class PiercedPlate:
    """Round holes in a plate at z = 0 over a level floor; lengths in mm, arrays of shape (hole,).

    Attributes
    ----------
    centre, shape (hole, 2)
    chamfer
        Width of the 45 degree chamfer at the upper edges.
    thickness, depth
        Of the plate, and of the floor below the plate's top.
    nearest, shape (x, y)
        The hole nearest to each cell of a grid over the plate that begins at ``-half``.
    """

    centre: FloatArray
    radius: FloatArray
    chamfer: FloatArray
    thickness: float
    depth: float
    half: FloatArray
    nearest: NDArray[np.int64]


def pierced_plate(artifact: ArtifactDimensions) -> PiercedPlate | None:
    """The plate of these dimensions, without holes for a flat sample; None for a mesh or a floor that is not level."""
    form, holes = artifact.form, artifact.holes
    if artifact.mesh is not None or any(form.floor_slope):
        return None
    from scipy.spatial import cKDTree

    centre = np.stack([holes.x, holes.y], axis=1)
    half = np.asarray(form.outline, dtype=float) / 2
    x, y = (np.arange(-h + _CELL_MM / 2, h, _CELL_MM) for h in half)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    nearest = cKDTree(centre).query(places)[1] if len(holes) else np.zeros(places.shape[:2])
    return PiercedPlate(
        centre,
        np.asarray(holes.diameter, dtype=float) / 2,
        artifact.chamfers,
        form.plate_thickness,
        form.cavity_depth,
        half,
        np.asarray(nearest, dtype=np.int64),
    )


def served(layout: Layout) -> bool:
    """Whether the quadrature knows this instrument: a round beam from afar, a round target and no field stop."""
    round_beam = np.all(layout.iris[:, 0] == layout.iris[:, 1]) and np.all(layout.falloff[:, 0] == layout.falloff[:, 1])
    plain = layout.picture is None and not layout.square and np.all(layout.inverse_source == 0)
    bounded = np.all(np.isfinite(layout.radius))
    return bool(round_beam and plain and bounded and np.all(np.isinf(layout.stop[:, 0])))


def once_reflected(
    plate: PiercedPlate,
    material: Material,
    layout: Layout,
    table_index: NDArray[np.int64],
    surface_factor: dict[Surface, float] | None = None,
    *,
    nodes: int = NODES,
) -> FloatArray:
    """Mean radiance over the sensor's rays of light reflected once, times pi over the beam's irradiance on its axis.

    Parameters
    ----------
    layout
        Beam and sensor in the frame of the sample, :func:`served`; ``table_index`` the material's table of each point.
    surface_factor
        Reflectance of surfaces over the material's.

    Returns
    -------
    array, shape (point,)
    """
    diverging = np.flatnonzero(layout.divergence_rad > 0)
    result = _of_parallel(plate, material, layout, table_index, surface_factor, nodes)
    if len(diverging):
        some, total = layout.take(diverging), np.zeros(len(diverging))
        for deviation in _deviations():
            beam = _deviated(some, deviation)
            total += _of_parallel(plate, material, beam, table_index[diverging], surface_factor, nodes)
        result[diverging] = total / _BEAMS
    return result


def _deviations() -> FloatArray:
    """Directions of parallel beams that stand for a divergent one, in standard deviations, shape (beam, 2)."""
    k = np.arange(_BEAMS // 2)
    radius = np.sqrt(-2 * np.log1p(-(2 * k + 1) / _BEAMS))
    return balanced(np.stack([radius * np.cos(k * _GOLDEN), radius * np.sin(k * _GOLDEN)], axis=1), 1.0)


def _deviated(layout: Layout, deviation: FloatArray) -> Layout:
    """Beams of other directions through the same disc across the axis."""
    spread = layout.divergence_rad[:, None] * deviation
    light = layout.light + spread[:, :1] * layout.light_u + spread[:, 1:] * layout.light_v
    return replace(layout, light=light / np.linalg.norm(light, axis=1, keepdims=True))


def _of_parallel(
    plate: PiercedPlate,
    material: Material,
    layout: Layout,
    table_index: NDArray[np.int64],
    surface_factor: dict[Surface, float] | None,
    nodes: int,
) -> FloatArray:
    factor = np.ones(len(Surface))
    for surface, value in (surface_factor or {}).items():
        factor[surface] = value
    disc = sunflower(nodes)
    mirror = mirror_points()
    spot = sunflower(_BEAM_NODES)
    turn = np.random.default_rng(5).permutation(np.arange(max(nodes, _BEAM_NODES)) % _MIRROR)
    result = np.empty(len(layout))
    sum_all(
        result,
        layout.target,
        layout.along,
        layout.across,
        layout.view,
        layout.mirror_along,
        layout.mirror_across,
        layout.inverse_distance,
        layout.light,
        layout.light_u,
        layout.light_v,
        layout.beam,
        layout.radius,
        layout.decay,
        np.asarray(table_index, dtype=np.int64),
        plate.centre,
        plate.radius,
        plate.chamfer,
        plate.thickness,
        plate.depth,
        plate.half,
        plate.nearest,
        material.cos_o,
        material.phi_rad,
        material.cos_i,
        np.ascontiguousarray(material.brdf),
        factor,
        disc,
        spot,
        mirror,
        turn,
    )
    return result


def mirror_points() -> FloatArray:
    """Points of the mirror's disc that nodes take turns with, shape (point, 2)."""
    k = np.arange(_MIRROR // 2)
    radius = np.sqrt((2 * k + 1) / _MIRROR)
    return balanced(np.stack([radius * np.cos(k * _GOLDEN), radius * np.sin(k * _GOLDEN)], axis=1), 0.25)


def balanced(half: FloatArray, variance: float) -> FloatArray:
    """Points, shape (n, 2), and their opposites, with a variance that is the same along every direction.

    A few points that lean to one side would be read as an arm that is off. What a narrow spread does depends on mean
    and covariance alone.
    """
    factor = np.linalg.cholesky(half.T @ half / len(half))
    even = np.sqrt(variance) * np.linalg.solve(factor, half.T).T
    return np.concatenate([even, -even])


def sunflower(count: int) -> FloatArray:
    """Points spread evenly over the unit disc, shape (count, 2)."""
    k = np.arange(count)
    radius = np.sqrt((k + 0.5) / count)
    return np.stack([radius * np.cos(k * _GOLDEN), radius * np.sin(k * _GOLDEN)], axis=1)


def floor_light(
    plate: PiercedPlate,
    xs: FloatArray,
    ys: FloatArray,
    light: FloatArray,
    beam: FloatArray,
    radius: float,
    decay: float,
    edge_mm: float,
) -> FloatArray:
    """Irradiance of the floor straight from the beam, over that on the beam's axis, shape (x, y)."""
    result = np.zeros((len(xs), len(ys)))
    map_floor(
        result, xs, ys, light, beam, radius, decay, plate.centre, plate.radius, plate.chamfer, plate.thickness,
        plate.depth, plate.half, plate.nearest, edge_mm,
    )  # fmt: skip
    return result
