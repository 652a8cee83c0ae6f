"""Where arms, beam, detector and sample lie in space for what the axes say. Plain arrays, without Qt and without VTK.

The frame is the laboratory's (:mod:`instrument.angles`): the sample's top at z = 0, azimuth 0 along x, z upwards. One
unit is the length of the sensor arm, nearly; the sample, and with it the beam and the sensor's target, is drawn larger
than the arms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np

from instrument.angles import FloatArray, direction
from instrument.events import Geometry
from instrument.turning import driven

View = Literal["free", "lamp", "detector"]
#: Distances of lamp and detector from the sample: the detector passes below the lamp, and may stand in its light.
LAMP, DETECTOR = 1.18, 0.92
#: Half of the longer side of the drawn sample.
SAMPLE = 0.26
#: The sample's surfaces (:class:`twin.surface_mesh.Surface`): colour, after the palette of Okabe and Ito, and name.
SURFACES = {
    0: ("#e8e4da", "top"),
    1: ("#2fae86", "hole walls"),
    2: ("#e6c84b", "underside of the plate"),
    3: ("#8d99a5", "walls of the cavity"),
    4: ("#d37fb0", "floor"),
    5: ("#a9b3bc", "outside"),
}
#: Those that can be seen from without.
SEEN = (0, 1, 4, 5)
#: Least |cos| of a zenith angle for which a beam is drawn down to the sample's plane: below, its foot would be endless.
_GRAZING = 0.12
_TURNS = 48  # points about a beam


class Stance(NamedTuple):
    """What the axes say, degree; ``sample_turn`` is right-handed about z."""

    illumination_zenith: float
    sensor_azimuth: float
    sensor_zenith: float
    sample_turn: float = 0.0


class Camera(NamedTuple):
    """From where one looks: a view that goes with an arm, or a direction (degree) and how near."""

    view: View = "free"
    azimuth: float = -62.0
    height: float = 28.0
    zoom: float = 1.0


def commanded(geometry: Geometry) -> Stance:
    """Where the axes are sent for a geometry; a manual stage turns the sample by minus the illumination azimuth."""
    illumination, azimuth, zenith = driven(geometry)
    return Stance(illumination, azimuth, zenith, geometry.sample_rotation - geometry.illumination_azimuth)


def reported(positions: Mapping[str, float], otherwise: Stance, illumination_azimuth: float = 0.0) -> Stance:
    """Where the drives say that the axes are; what they do not say as it is otherwise.

    Parameters
    ----------
    positions
        Degree, by role.
    illumination_azimuth
        Set by hand at the stage below the sample, degree.
    """
    turn = positions.get("sample_rotation")
    return Stance(
        positions.get("illumination_zenith", otherwise.illumination_zenith),
        positions.get("sensor_azimuth", otherwise.sensor_azimuth),
        positions.get("sensor_zenith", otherwise.sensor_zenith),
        otherwise.sample_turn if turn is None else turn - illumination_azimuth,
    )


def between(one: Stance, other: Stance, share: float) -> Stance:
    """On the way from one stance to another; ``share`` 0 is the first."""
    return Stance(*(a + share * (b - a) for a, b in zip(one, other, strict=True)))


def placement(zenith: float, azimuth: float) -> FloatArray:
    """What stands upright on the z axis, brought to a direction: about y by the zenith angle, then about z.

    Returns
    -------
    array, shape (4, 4)
        Its third column is :func:`instrument.angles.direction`; x points to growing zenith, y to growing azimuth.
    """
    zenith_rad, azimuth_rad = math.radians(zenith), math.radians(azimuth)
    tilt = np.array(
        [
            [math.cos(zenith_rad), 0.0, math.sin(zenith_rad)],
            [0.0, 1.0, 0.0],
            [-math.sin(zenith_rad), 0.0, math.cos(zenith_rad)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = _about_z(azimuth_rad) @ tilt
    return matrix


def sample_placement(turn: float, scale: float) -> FloatArray:
    """The sample (mm, top at z = 0) turned about z and drawn at a scale, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * _about_z(math.radians(turn))
    return matrix


def beam(zenith: float, azimuth: float, head: float, at_head: float, at_sample: float) -> FloatArray:
    """The rim of a round beam at its head and in the plane of the sample.

    Parameters
    ----------
    head
        Distance of the head.
    at_head, at_sample
        Radius across the beam at the head and at the optical centre.

    Returns
    -------
    array, shape (2, point, 3)
        Head first; straight down the beam's axis where it grazes.
    """
    frame = placement(zenith, azimuth)[:3, :3]
    turn_rad = np.linspace(0.0, 2 * math.pi, _TURNS, endpoint=False)
    round_about = np.cos(turn_rad)[:, None] * frame[:, 0] + np.sin(turn_rad)[:, None] * frame[:, 1]
    upper = head * frame[:, 2] + at_head * round_about
    lower = at_sample * round_about
    if abs(frame[2, 2]) > _GRAZING:
        along = upper - lower
        lower = lower - (lower[:, 2] / along[:, 2])[:, None] * along
    return np.stack([upper, lower])


def eye(camera: Camera, stance: Stance) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where a camera stands, what it looks at, and what is up for it; shape (3,) each."""
    centre = np.zeros(3)
    if camera.view == "lamp":
        zenith, azimuth, distance = stance.illumination_zenith, 0.0, LAMP
    elif camera.view == "detector":
        zenith, azimuth, distance = stance.sensor_zenith, stance.sensor_azimuth, DETECTOR
    else:
        distance, centre = 4.5 / camera.zoom, np.array([0.0, 0.0, 0.16]) / camera.zoom
        zenith, azimuth = 90.0 - camera.height, camera.azimuth
    frame = placement(zenith, azimuth)[:3, :3]
    # Towards falling zenith is up, for a free view; an arm's own view keeps to the arm, across the zenith too.
    return centre + distance * frame[:, 2], centre, -frame[:, 0]


def from_direction(zenith: float, azimuth: float) -> tuple[float, float]:
    """Azimuth and height, degree, of someone who looks from a direction; the zenith angle may be negative."""
    x, y, z = direction(zenith, azimuth).tolist()
    return math.degrees(math.atan2(y, x)), math.degrees(math.asin(min(max(z, -1.0), 1.0)))


def _about_z(angle_rad: float) -> FloatArray:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
