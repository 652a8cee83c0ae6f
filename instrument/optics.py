"""Beam and sensor of the instrument, as planned and as they may really stand.

:class:`Setup` holds what can be off; :func:`lay_out` turns commanded geometries and a setup into the rays of beam and
sensor in the frame of the sample. The flux is that of the *true* geometry; for a reflectance factor it is divided by
that of the *commanded* one (data contract, section What the measured BRF is).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from instrument.angles import FloatArray, direction
from instrument.beam_image import BeamImage
from instrument.facility import Facility

_SHARPEST_MM = 1e-3


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
    stop_radius_mm: Any = 0.0
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
    """Beam and sensor of every geometry in the frame of the sample; lengths in mm, arrays of shape (point, ...).

    A sensor ray joins the point ``target + u * along + v * across`` (u, v of the unit disc, or of the square)
    with a mirror point; the direction towards the sensor there is proportional to
    ``view + inverse_distance * (mirror point - target point)``. It counts with the transmission of the field stop
    at the place where it crosses the plane of the stop. The light comes from ``light``, or for a point source from
    ``light - inverse_source * (place - beam)``. Where it crosses the plane through ``beam`` at (p, q) along ``light_u``
    and ``light_v``, the irradiance is exp(-falloff . (p^2, q^2)) times that of ``picture``, inside the ellipse with the
    semi-axes ``iris``; ``radius`` is the longer one.

    Attributes
    ----------
    stop
        Radius, width of the rim and distance over that of the mirror of the field stop; an infinite radius for none.
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
    iris: FloatArray
    falloff: FloatArray
    inverse_source: FloatArray
    divergence_rad: FloatArray
    stop: FloatArray
    square: bool
    picture: BeamImage | None = None

    def __len__(self) -> int:
        return len(self.view)

    @property
    def decay(self) -> FloatArray:
        """Of a round beam, shape (point,)."""
        return self.falloff[:, 0]

    def take(self, chosen: NDArray[Any]) -> Layout:
        """The layout of some of the geometries."""
        arrays = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name not in ("square", "picture")}
        return replace(self, **arrays)


def lay_out(facility: Facility, columns: dict[str, FloatArray], setup: Setup | None = None) -> Layout:
    """Place beam and sensor for commanded geometries.

    Parameters
    ----------
    columns
        Arrays of shape (point,) in degree: ``illumination_zenith``, ``illumination_azimuth``, ``sensor_zenith``,
        ``sensor_azimuth``.
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

    to_sample = np.swapaxes(_rotation(setup, per_point), 1, 2)
    shift = vector(setup.offset_x_mm, setup.offset_y_mm, setup.height_mm)

    def turned(v: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("nij,nj->ni", to_sample, v))

    sensor, beam = facility.sensor, facility.beam
    flat = sensor.target_shape == "horizontal_disc"
    target_along, target_across = (vector(1, 0, 0), vector(0, 1, 0)) if flat else (along, across)
    target_radius = per_point(sensor.target_diameter / 2 + setup.target_radius_mm)[:, None]
    parallel = flat or sensor.mirror_diameter == 0
    mirror_radius = per_point(0.0 if parallel else sensor.mirror_diameter / 2 + setup.mirror_radius_mm)[:, None]
    iris = np.asarray(beam.iris) + per_point(setup.beam_radius_mm)[:, None]
    if beam.picture is not None:
        iris = np.minimum(iris, beam.picture.reach)  # beyond it there is no light
    # The edge of a stop without one is a micrometre wide: a step has no place in single precision.
    stop_radius = math.inf if sensor.field_stop_diameter is None else sensor.field_stop_diameter / 2
    stop = vector(
        stop_radius + setup.stop_radius_mm,
        max(sensor.field_stop_edge, _SHARPEST_MM),
        0.0 if parallel else sensor.field_stop_distance / sensor.mirror_distance,
    )
    turn = np.deg2rad(beam.orientation)
    first = math.cos(turn) * light_u + math.sin(turn) * light_v
    second = math.cos(turn) * light_v - math.sin(turn) * light_u
    return Layout(
        target=turned(target - shift),
        along=turned(target_along * target_radius),
        across=turned(target_across * target_radius),
        view=turned(view),
        mirror_along=turned(along * mirror_radius),
        mirror_across=turned(across * mirror_radius),
        inverse_distance=per_point(0.0 if parallel else 1 / sensor.mirror_distance),
        light=turned(light),
        light_u=turned(first),
        light_v=turned(second),
        beam=turned(vector(setup.beam_x_mm, setup.beam_y_mm, 0.0) - shift),
        radius=iris.max(axis=1),
        iris=iris,
        falloff=np.tile(beam.decay, (count, 1)),
        inverse_source=per_point(1 / np.asarray(setup.source_distance_mm)),
        divergence_rad=np.deg2rad(per_point(beam.divergence + setup.divergence_deg)),
        stop=stop,
        square=setup.square_target,
        picture=beam.picture,
    )


def _rotation(setup: Setup, per_point: Any) -> FloatArray:
    """Pose of the sample in the laboratory, shape (point, 3, 3): turned about its z, then tilted."""
    zero = per_point(0.0)
    turn = np.stack([zero, zero, per_point(setup.sample_azimuth_deg)], axis=-1)
    if not np.any(turn) and not np.any(setup.tilt_x_deg) and not np.any(setup.tilt_y_deg):
        return np.broadcast_to(np.eye(3), (len(zero), 3, 3))
    from scipy.spatial.transform import Rotation

    tilt = np.stack([per_point(setup.tilt_x_deg), per_point(setup.tilt_y_deg), zero], axis=-1)
    pose = Rotation.from_rotvec(np.deg2rad(tilt)) * Rotation.from_rotvec(np.deg2rad(turn))
    return np.asarray(pose.as_matrix())
