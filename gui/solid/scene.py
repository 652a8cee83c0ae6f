"""The parts of the instrument as actors of a PyVista plotter, and where they are put."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from gui.solid.geometry import DETECTOR, LAMP, SAMPLE, SURFACES, Camera, Stance, beam, eye, placement, sample_placement
from instrument.angles import FloatArray, direction
from instrument.artifact import ArtifactForm, read_artifact
from instrument.errors import InputError
from instrument.facility import read_facility

#: Sides of the drawn holes: enough for a picture, a fifth of the twin's triangles.
_SIDES = 14
_BASE, _RING = -0.42, -0.39  # heights of the ground plate and of the ring that carries the sensor arm
_FIELD = 38.0  # opening of the camera, degree
_CLOSE_FIELD = 62.0  # of one that looks down an arm


@dataclass(frozen=True)
class Sample:
    """What lies on the stage, and the light that falls on it; lengths in mm.

    Attributes
    ----------
    vertices, shape (vertex, 3)
    faces, shape (face, 3)
    labels, shape (face,)
        :class:`twin.surface_mesh.Surface`.
    problem
        Why it is not the run's own sample; empty where it is.
    """

    vertices: FloatArray
    faces: Any
    labels: Any
    beam: float = 10.8
    target: float = 10.8
    mirror: float = 10.8
    problem: str = ""

    @property
    def scale(self) -> float:
        """Units of the picture a mm."""
        return SAMPLE / float(np.abs(self.vertices[:, :2]).max())


def sample_of(folder: Path | None) -> Sample:
    """The sample of a run folder with its holes; a plain one where the run has none, or one that is no solid."""
    from twin.artifact import build_mesh, flat_sample

    sizes, problem, mesh = {}, "", None
    if folder is not None and (folder / "facility.toml").is_file():
        try:
            sizes = _sizes(folder / "facility.toml")
        except InputError as error:
            problem = str(error)
    if folder is not None and (folder / "artifact.toml").is_file():
        try:
            mesh = build_mesh(read_artifact(folder / "artifact.toml"), _SIDES)
        except InputError as error:
            problem = str(error)
    if mesh is None:
        mesh = flat_sample(ArtifactForm())
    return Sample(mesh.vertices, mesh.faces, mesh.labels, **sizes, problem=problem)


def _sizes(path: Path) -> dict[str, float]:
    facility = read_facility(path)
    known = {"target": facility.sensor.target_diameter, "mirror": facility.sensor.mirror_diameter}
    if not known["mirror"]:  # parallel sight
        known["mirror"] = known["target"]
    if facility.beam.diameter != "unbounded":
        known["beam"] = facility.beam.diameter
    return known


@dataclass
class _Tube:
    """A beam: its side and its foot, whose points follow the arm."""

    side: pv.PolyData
    foot: pv.PolyData
    actors: tuple[Any, Any] = field(default=(None, None))


class Scene:
    """Everything that is drawn, in a plotter that is made elsewhere.

    Parameters
    ----------
    plotter
        Of :class:`pyvista.Plotter`; it is not rendered here.
    """

    def __init__(self, plotter: Any) -> None:
        self.plotter = plotter
        plotter.remove_all_lights()
        plotter.add_light(pv.Light(light_type="headlight", intensity=0.65))
        plotter.add_light(pv.Light(position=(1.0, -2.0, 4.0), light_type="scene light", intensity=0.45))
        self._actors: dict[str, Any] = {}
        self._colours: dict[str, str] = {}
        self._tubes: dict[str, _Tube] = {}
        self._sample: Sample | None = None
        self._lit = False
        self._still()
        for name, head in (("light", LAMP), ("sensor", DETECTOR)):
            self._add(name, _arm(name, head), name, smooth_shading=False)
            tube = _Tube(_side(), _foot())
            tube.actors = (
                self._add(f"{name} beam", tube.side, name, opacity=0.25, lighting=False),
                self._add(f"{name} foot", tube.foot, name, opacity=0.45, lighting=False),
            )
            self._tubes[name] = tube
        self._add("turntable", _turntable(), "sensor")

    def _add(self, name: str, mesh: pv.DataSet, colour: str, **how: Any) -> Any:
        actor = self.plotter.add_mesh(mesh, color="#808080", name=name, reset_camera=False, render=False, **how)
        self._actors[name], self._colours[name] = actor, colour
        return actor

    def _still(self) -> None:
        ground = pv.Cylinder(center=(0, 0, _BASE - 0.02), direction=(0, 0, 1), radius=1.34, height=0.04, resolution=90)
        self._add("ground", ground, "raised")
        post = pv.Box((-0.05, 0.05, LAMP - 0.05, LAMP + 0.05, _BASE, 0.05))
        self._add("post", post, "light")
        self._add("net", _net(), "line", line_width=1.4, lighting=False)

    def show_sample(self, sample: Sample) -> None:
        """Put another sample on the stage."""
        self._sample = sample
        mesh = pv.make_tri_mesh(np.asarray(sample.vertices, dtype=float), np.asarray(sample.faces))
        colours = np.array([pv.Color(SURFACES[key][0]).int_rgb for key in sorted(SURFACES)], dtype=np.uint8)
        mesh.cell_data["surface"] = colours[np.asarray(sample.labels, dtype=int)]
        actor = self.plotter.add_mesh(
            mesh, scalars="surface", rgb=True, name="sample", reset_camera=False, render=False, ambient=0.25
        )
        self._actors["sample"] = actor
        bottom = float(sample.vertices[:, 2].min()) * sample.scale
        height = bottom - _BASE
        stage = pv.Cylinder(center=(0, 0, _BASE + height / 2), direction=(0, 0, 1), radius=0.15, height=height)
        self._add("stage", stage, "quiet_text")

    def show_theme(self, theme: Mapping[str, str]) -> None:
        """Use other colours, by what they mean (:class:`gui.theme.Theme`)."""
        meant = dict(theme) | {"light": theme["simulated"], "sensor": theme["measured"]}
        self.plotter.set_background(theme["surface"])
        for name, colour in self._colours.items():
            self._actors[name].prop.color = meant[colour]

    def show_light(self, on: bool) -> None:
        """Whether light falls on the sample now."""
        self._lit = on
        side, foot = self._tubes["light"].actors
        side.prop.opacity = 0.42 if on else 0.13
        foot.prop.opacity = 0.75 if on else 0.2

    def stand(self, stance: Stance) -> None:
        """Put the parts where the axes say."""
        sample = self._sample
        assert sample is not None
        scale = sample.scale
        light, sensor = (stance.illumination_zenith, 0.0), (stance.sensor_zenith, stance.sensor_azimuth)
        self._actors["light"].user_matrix = placement(*light)
        self._actors["sensor"].user_matrix = placement(*sensor)
        self._actors["turntable"].user_matrix = placement(0.0, stance.sensor_azimuth)
        self._actors["sample"].user_matrix = sample_placement(stance.sample_turn, scale)
        beams = {
            "light": beam(*light, LAMP, scale * sample.beam / 2, scale * sample.beam / 2),
            "sensor": beam(*sensor, DETECTOR, scale * sample.mirror / 2, scale * sample.target / 2),
        }
        for name, rims in beams.items():
            tube = self._tubes[name]
            tube.side.points = rims.reshape(-1, 3)
            lift = 0.004 if name == "light" else 0.007  # neither in the other nor in the sample's top
            tube.foot.points = rims[1] + np.array([0.0, 0.0, lift])

    def look(self, camera: Camera, stance: Stance) -> None:
        """Put the camera where it belongs in a stance."""
        for name, view in (("light", "lamp"), ("sensor", "detector")):
            hidden = camera.view == view  # who looks down an arm does not see its head
            self._actors[name].visibility = not hidden
            self._tubes[name].actors[0].visibility = not hidden
        position, centre, up = eye(camera, stance)
        look = self.plotter.camera
        look.position, look.focal_point, look.up = position.tolist(), centre.tolist(), up.tolist()
        look.view_angle = _FIELD if camera.view == "free" else _CLOSE_FIELD / camera.zoom
        self.plotter.reset_camera_clipping_range()

    def where(self, stance: Stance, width: int, height: int) -> dict[str, tuple[float, float]]:
        """Where the names of things belong in the picture: pixels from its upper left corner."""
        places = {
            "light": LAMP * direction(stance.illumination_zenith, 0.0),
            "sensor": DETECTOR * direction(stance.sensor_zenith, stance.sensor_azimuth),
        }
        for azimuth in (0, 90, 180, 270):
            places[str(azimuth)] = 1.44 * direction(90.0, azimuth) + np.array([0.0, 0.0, _BASE])
        aspect = width / height
        matrix = self.plotter.camera.GetCompositeProjectionTransformMatrix(aspect, -1, 1)
        whole = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
        found = {}
        for name, place in places.items():
            x, y, _, w = whole @ np.append(place, 1.0)
            if w > 0:
                found[name] = (float((1 + x / w) * width / 2), float((1 - y / w) * height / 2))
        return found


def _arm(name: str, head: float) -> pv.PolyData:
    """A rigid arm that stands upright: from its pivot beside the sample up, and across to the head over the sample."""
    outer, thick = head, 0.035
    pivot = pv.Cylinder(center=(0, outer, 0), direction=(0, 1, 0), radius=0.085, height=0.1, resolution=24)
    upright = pv.Box((-thick, thick, outer - thick, outer + thick, 0.0, head + 0.1))
    across = pv.Box((-thick, thick, 0.0, outer, head + 0.06, head + 0.12))
    if name == "light":
        body = pv.Cylinder(center=(0, 0, head + 0.08), direction=(0, 0, 1), radius=0.1, height=0.2, resolution=28)
        nozzle = pv.Cylinder(center=(0, 0, head - 0.01), direction=(0, 0, 1), radius=0.07, height=0.06, resolution=28)
    else:
        body = pv.Box((-0.1, 0.1, -0.1, 0.1, head, head + 0.17))
        nozzle = pv.Cylinder(center=(0, 0, head - 0.02), direction=(0, 0, 1), radius=0.065, height=0.05, resolution=28)
    return _joined(pivot, upright, across, body, nozzle)


def _joined(*parts: pv.PolyData) -> pv.PolyData:
    return parts[0].append_polydata(*parts[1:])


def _turntable() -> pv.PolyData:
    """The ring about the stage that carries the sensor arm's post."""
    ring = pv.Disc(center=(0, 0, _RING), inner=DETECTOR - 0.07, outer=DETECTOR + 0.07, r_res=1, c_res=90)
    post = pv.Box((-0.05, 0.05, DETECTOR - 0.05, DETECTOR + 0.05, _RING, 0.05))
    return _joined(ring, post)


def _net() -> pv.PolyData:
    """Directions about the sample: circles at 30, 60 and 90 degrees, half-circles every 30 degrees of azimuth."""
    lines = [direction(zenith, np.arange(0, 361, 5)) for zenith in (30, 60, 90)]
    lines += [direction(np.arange(-90, 91, 5), azimuth) for azimuth in range(0, 180, 30)]
    for azimuth in range(0, 360, 30):
        out = direction(90.0, azimuth)
        lines.append(np.stack([1.24 * out, 1.33 * out]) + np.array([0.0, 0.0, _BASE + 0.005]))
    return _joined(*(pv.lines_from_points(line) for line in lines))


def _side() -> pv.PolyData:
    count = beam(0.0, 0.0, 1.0, 1.0, 1.0).shape[1]
    here = np.arange(count)
    after = (here + 1) % count
    return pv.PolyData.from_regular_faces(
        np.zeros((2 * count, 3)), np.stack([here, after, after + count, here + count], axis=1)
    )


def _foot() -> pv.PolyData:
    count = beam(0.0, 0.0, 1.0, 1.0, 1.0).shape[1]
    return pv.PolyData.from_regular_faces(np.zeros((count, 3)), np.arange(count)[None, :])
