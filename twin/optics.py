"""Beam and sensor of the instrument, as planned and as they may really stand.

:class:`Setup` holds what can be off; :func:`lay_out` turns commanded geometries and a setup into the rays of beam and
sensor in the artifact frame, where they are traced. The flux is that of the *true* geometry; the division by the
*commanded* one happens in :mod:`twin.prediction` (data contract, section What the measured BRF is).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from instrument.angles import FloatArray, direction
from instrument.facility import Facility

COORDINATES = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")


@dataclass(frozen=True)
class Setup:
    """What is added to the nominal configuration; names and signs after the effects of the data contract.

    Every value is a number or an array of shape (point,); angles in degree, lengths in mm.

    Attributes
    ----------
    source_distance_mm
        Distance of a point source; infinite for a parallel beam.
    square_target
        A square target of the same width instead of the disc.
    """

    tilt_x_deg: Any = 0.0
    tilt_y_deg: Any = 0.0
    sample_azimuth_deg: Any = 0.0
    height_mm: Any = 0.0
    offset_x_mm: Any = 0.0
    offset_y_mm: Any = 0.0
    illumination_zenith_deg: Any = 0.0
    sensor_zenith_deg: Any = 0.0
    sensor_azimuth_deg: Any = 0.0
    sensor_runout_mm: Any = 0.0
    beam_x_mm: Any = 0.0
    beam_y_mm: Any = 0.0
    beam_radius_mm: Any = 0.0
    target_radius_mm: Any = 0.0
    mirror_radius_mm: Any = 0.0
    divergence_deg: Any = 0.0
    source_distance_mm: Any = np.inf
    square_target: bool = False

    def without_sample(self) -> Setup:
        """The same instrument, its sample in the nominal place: what the reference reading sees."""
        in_place = {"tilt_x_deg": 0.0, "tilt_y_deg": 0.0, "sample_azimuth_deg": 0.0}
        in_place |= {"height_mm": 0.0, "offset_x_mm": 0.0, "offset_y_mm": 0.0}
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)} | in_place
        return Setup(**values)

    @property
    def changes_the_instrument(self) -> bool:
        """Whether beam or sensor differ from the nominal ones."""
        nominal, bare = Setup(source_distance_mm=self.source_distance_mm), self.without_sample()
        return any(np.any(getattr(bare, f.name) != getattr(nominal, f.name)) for f in fields(Setup))


@dataclass(frozen=True)
class Layout:
    """Beam and sensor of every geometry in the artifact frame; lengths in mm, arrays of shape (point, ...).

    A sensor ray joins the point ``target + u * along + v * across`` (u, v of the unit disc, or of the square)
    with a mirror point; the direction towards the sensor there is proportional to
    ``view + inverse_distance * (mirror point - target point)``. The light comes from ``light``, or for a point source
    from ``light - inverse_source * (place - beam)``, with irradiance exp(-decay r^2) inside ``radius``.
    """

    target: FloatArray
    along: FloatArray
    across: FloatArray
    view: FloatArray
    mirror_along: FloatArray
    mirror_across: FloatArray
    inverse_distance: FloatArray
    light: FloatArray
    light_u: FloatArray
    light_v: FloatArray
    beam: FloatArray
    radius: FloatArray
    decay: FloatArray
    inverse_source: FloatArray
    divergence_rad: FloatArray
    square: bool

    def __len__(self) -> int:
        return len(self.view)

    def take(self, chosen: NDArray[np.int64]) -> Layout:
        """The layout of some of the geometries."""
        arrays = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name != "square"}
        return Layout(**arrays, square=self.square)


def geometry_columns(geometries: Any) -> dict[str, FloatArray]:
    """Commanded coordinates as arrays of shape (point,), from a sequence of geometries or a dataset."""
    if isinstance(geometries, xr.Dataset):
        count = geometries.sizes["point"]
        return {
            name: np.broadcast_to(np.asarray(geometries[name].values, dtype=float), (count,))
            if name in geometries
            else np.zeros(count)
            for name in COORDINATES
        }
    return {name: np.array([getattr(g, name) for g in geometries], dtype=float) for name in COORDINATES}


def lay_out(facility: Facility, columns: dict[str, FloatArray], setup: Setup | None = None) -> Layout:
    """Place beam and sensor for commanded geometries.

    Parameters
    ----------
    columns
        From :func:`geometry_columns`.
    setup
        What is off; None for the nominal instrument.
    """
    setup = Setup() if setup is None else setup
    count = len(columns["sensor_zenith"])

    def per_point(value: ArrayLike) -> FloatArray:
        return np.array(np.broadcast_to(np.asarray(value, dtype=float), (count,)))

    def vector(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> FloatArray:
        return np.stack([per_point(x), per_point(y), per_point(z)], axis=-1)

    sensor_zenith = columns["sensor_zenith"] + setup.sensor_zenith_deg
    sensor_azimuth = columns["sensor_azimuth"] + setup.sensor_azimuth_deg
    light_zenith = columns["illumination_zenith"] + setup.illumination_zenith_deg
    light_azimuth = columns["illumination_azimuth"]
    view, light = direction(sensor_zenith, sensor_azimuth), direction(light_zenith, light_azimuth)
    along = direction(sensor_zenith + 90.0, sensor_azimuth)
    across = direction(np.full(count, 90.0), sensor_azimuth + 90.0)
    light_u = direction(light_zenith + 90.0, light_azimuth)
    light_v = direction(np.full(count, 90.0), light_azimuth + 90.0)
    target = per_point(setup.sensor_runout_mm)[:, None] * along

    to_artifact = np.swapaxes(_rotation(setup, per_point), 1, 2)
    shift = vector(setup.offset_x_mm, setup.offset_y_mm, setup.height_mm)

    def turned(v: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("nij,nj->ni", to_artifact, v))

    sensor, beam = facility.sensor, facility.beam
    flat = sensor.target_shape == "horizontal_disc"
    target_along, target_across = (vector(1, 0, 0), vector(0, 1, 0)) if flat else (along, across)
    target_radius = per_point(sensor.target_diameter / 2 + setup.target_radius_mm)[:, None]
    parallel = flat or sensor.mirror_diameter == 0
    mirror_radius = per_point(0.0 if parallel else sensor.mirror_diameter / 2 + setup.mirror_radius_mm)[:, None]
    radius, decay = _profile(facility)
    return Layout(
        target=turned(target - shift),
        along=turned(target_along * target_radius),
        across=turned(target_across * target_radius),
        view=turned(view),
        mirror_along=turned(along * mirror_radius),
        mirror_across=turned(across * mirror_radius),
        inverse_distance=per_point(0.0 if parallel else 1 / sensor.mirror_distance),
        light=turned(light),
        light_u=turned(light_u),
        light_v=turned(light_v),
        beam=turned(vector(setup.beam_x_mm, setup.beam_y_mm, 0.0) - shift),
        radius=per_point(radius + setup.beam_radius_mm),
        decay=per_point(decay),
        inverse_source=per_point(1 / np.asarray(setup.source_distance_mm)),
        divergence_rad=np.deg2rad(per_point(beam.divergence + setup.divergence_deg)),
        square=setup.square_target,
    )


def _profile(facility: Facility) -> tuple[float, float]:
    """Radius of the iris in mm and the decay of the irradiance with the squared radius in 1/mm2."""
    beam = facility.beam
    radius = np.inf if beam.diameter == "unbounded" else beam.diameter / 2
    gaussian = beam.profile == "gaussian" and beam.radius_1_e2 is not None
    decay = 2 / beam.radius_1_e2**2 if gaussian and beam.radius_1_e2 is not None else 0.0
    return radius, decay


def _rotation(setup: Setup, per_point: Any) -> FloatArray:
    """Pose of the sample in the laboratory, shape (point, 3, 3): turned about its z, then tilted."""
    from scipy.spatial.transform import Rotation

    zero = per_point(0.0)
    turn = np.stack([zero, zero, per_point(setup.sample_azimuth_deg)], axis=-1)
    tilt = np.stack([per_point(setup.tilt_x_deg), per_point(setup.tilt_y_deg), zero], axis=-1)
    pose = Rotation.from_rotvec(np.deg2rad(tilt)) * Rotation.from_rotvec(np.deg2rad(turn))
    return np.asarray(pose.as_matrix())


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


def reference_change(facility: Facility, setup: Setup, nodes: int = 2**17) -> float:
    """Reference reading with an instrument that is off, over that of the nominal one.

    The reading of the run is divided by the reading of a reference sample, taken with the same instrument; the
    reference sample is taken to be Lambertian, flat and in place.
    """
    bare = setup.without_sample()
    if not setup.changes_the_instrument:
        return 1.0
    for field in fields(Setup):
        if np.ndim(getattr(bare, field.name)):
            mean: Any = {field.name: float(np.mean(getattr(bare, field.name)))}
            bare = replace(bare, **mean)
    reference = facility.reference
    count = len(reference.sensor_azimuth)
    columns = {
        "wavelength": np.full(count, np.nan),
        "illumination_zenith": np.full(count, reference.illumination_zenith),
        "illumination_azimuth": np.zeros(count),
        "sensor_zenith": np.full(count, reference.sensor_zenith),
        "sensor_azimuth": np.array(reference.sensor_azimuth),
    }
    true = _plane_irradiance(lay_out(facility, columns, bare), nodes)
    nominal = Setup(source_distance_mm=setup.source_distance_mm)
    return float(np.sum(true) / np.sum(_plane_irradiance(lay_out(facility, columns, nominal), nodes)))


def _plane_irradiance(layout: Layout, nodes: int) -> FloatArray:
    """Mean over the sensor's rays of the irradiance on the plane z = 0, shape (point,)."""
    from scipy.stats import norm, qmc

    u = qmc.Sobol(6, scramble=True, rng=7).random(nodes)
    angle, radius = 2 * np.pi * u[:, 0:4:2], np.sqrt(u[:, 1:4:2])
    disc = radius[:, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    normal = norm.ppf(np.clip(u[:, 4:], 1e-9, 1 - 1e-9))

    def across(first: FloatArray, second: FloatArray, pair: FloatArray) -> FloatArray:
        return first[:, None] * pair[None, :, :1] + second[:, None] * pair[None, :, 1:]

    offset = across(layout.along, layout.across, disc[:, 0])
    lever = across(layout.mirror_along, layout.mirror_across, disc[:, 1]) - offset
    towards = layout.view[:, None] + lever * layout.inverse_distance[:, None, None]
    point = layout.target[:, None] + offset
    place = point - towards * (point[..., 2:] / towards[..., 2:])
    from_beam = place - layout.beam[:, None]
    source = layout.light[:, None] - from_beam * layout.inverse_source[:, None, None]
    distance = np.linalg.norm(source, axis=-1, keepdims=True)
    spread = across(layout.light_u, layout.light_v, normal) * layout.divergence_rad[:, None, None]
    light = source / distance + spread
    light /= np.linalg.norm(light, axis=-1, keepdims=True)
    axis = layout.light[:, None]
    along = np.sum(from_beam * axis, axis=-1) / np.sum(light * axis, axis=-1)
    r2 = np.sum((from_beam - light * along[..., None]) ** 2, axis=-1)
    profile = np.where(r2 <= layout.radius[:, None] ** 2, np.exp(-layout.decay[:, None] * r2), 0.0)
    return np.asarray(np.mean(profile * light[..., 2] / distance[..., 0] ** 2, axis=1))
