"""Picture of a sample: its solid with a quarter cut away, coloured by surface."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.artifact import Surface, SurfaceMesh
from twin.cells import IntArray

#: Colours of the surfaces, and of the cut.
_COLOURS = {
    Surface.PLATE_TOP: "#a9b0ba",
    Surface.HOLE_WALL: "#4f8fd0",
    Surface.UNDERSIDE: "#7a5bb0",
    Surface.SPACER: "#3f9d6b",
    Surface.FLOOR: "#e8a33d",
    Surface.OUTSIDE: "#8d939c",
}
_NAMES = {
    Surface.PLATE_TOP: "top of the plate",
    Surface.HOLE_WALL: "walls of the holes",
    Surface.UNDERSIDE: "underside",
    Surface.SPACER: "spacer",
    Surface.FLOOR: "floor",
    Surface.OUTSIDE: "outside",
}
_CUT, _CUT_COLOUR = 100, "#b5463c"


def picture(mesh: SurfaceMesh, path: Path, *, size: tuple[int, int] = (1200, 900), whole: bool = False) -> None:
    """Draw the sample into a PNG file, without a screen.

    Parameters
    ----------
    size
        Width and height in pixels.
    whole
        Do not cut a quarter away.

    Raises
    ------
    InputError
        If the file is no PNG or cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: found the suffix {path.suffix!r}; expected .png")
    vertices, faces, labels = (mesh.vertices, mesh.faces, mesh.labels) if whole else cut_open(mesh)
    try:
        with _quiet():
            _draw(vertices, faces, labels, path, size)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _draw(
    vertices: FloatArray, faces: IntArray, labels: NDArray[np.integer[Any]], path: Path, size: tuple[int, int]
) -> None:
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=list(size))
    plotter.set_background("white")
    names = {label: (_NAMES[label], colour) for label, colour in _COLOURS.items()} | {_CUT: ("cut", _CUT_COLOUR)}
    legend = []
    for label, (name, colour) in names.items():
        chosen = faces[labels == label]
        if not len(chosen):
            continue
        surface = pyvista.PolyData(vertices, np.insert(chosen, 0, 3, axis=1).ravel())
        plotter.add_mesh(surface, color=colour, ambient=0.45, diffuse=0.6, specular=0.0)
        legend.append((name, colour))
    plotter.enable_anti_aliasing("ssaa")
    plotter.view_vector((0.68, -0.82, 0.92), viewup=(0.0, 0.0, 1.0))  # the whole solid, whatever its size
    plotter.camera.zoom(1.1)
    try:
        image = plotter.screenshot(None, return_img=True)
    finally:
        plotter.close()
    extent = vertices.max(axis=0) - vertices.min(axis=0)
    title = " × ".join(f"{length:.4g}" for length in extent) + " mm"
    _annotate(np.asarray(image), legend, title, path)


def _annotate(image: NDArray[np.uint8], legend: list[tuple[str, str]], title: str, path: Path) -> None:
    """Write what the colours are beside the picture, and its size below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    dots = 100
    figure = Figure(figsize=(image.shape[1] / dots, image.shape[0] / dots), dpi=dots)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(image)
    axes.set_axis_off()
    patches = [Patch(facecolor=colour, edgecolor="none", label=name) for name, colour in legend]
    axes.legend(handles=patches, loc="upper right", fontsize=13, frameon=False)
    axes.text(0.02, 0.03, title, transform=axes.transAxes, fontsize=13)
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=dots)


def cut_open(mesh: SurfaceMesh) -> tuple[FloatArray, IntArray, IntArray]:
    """Cut the quarter x > 0, y < 0 away, along the middle of the hole nearest to the centre.

    A mesh that is no solid comes back whole.

    Returns
    -------
    vertices, shape (vertex, 3), faces, shape (face, 3), labels, shape (face,)
        Labels are those of :class:`~twin.artifact.Surface`, and 100 on the cut.
    """
    import manifold3d

    source = manifold3d.Manifold.reserve_ids(1)
    faces = mesh.faces.astype(np.uint64)
    runs = {
        "run_index": np.array([0, faces.size], dtype=np.uint64),
        "run_original_id": np.array([source], dtype=np.uint32),
    }
    solid = manifold3d.Manifold(manifold3d.Mesh64(mesh.vertices, faces, face_id=mesh.labels.astype(np.uint64), **runs))
    if solid.status() != manifold3d.Error.NoError:
        return mesh.vertices, mesh.faces, mesh.labels.astype(np.int64)
    size = 2 * float(np.abs(mesh.vertices).max()) + 1
    plate = mesh.plate
    centres = np.zeros((1, 2)) if plate is None or not len(plate.centre) else plate.centre
    x, y = centres[np.argmin(np.linalg.norm(centres, axis=1))]
    tool = manifold3d.Manifold.cube([size, size, 2 * size]).translate([x, y - size, -size])
    result = (solid - tool).to_mesh64()
    own = np.zeros(len(result.tri_verts), dtype=bool)
    bounds = np.asarray(result.run_index, dtype=np.int64) // 3
    for start, end, origin in zip(bounds[:-1], bounds[1:], result.run_original_id, strict=True):
        own[start:end] = origin == source
    labels = np.where(own, np.asarray(result.face_id, dtype=np.int64), _CUT)
    return np.asarray(result.vert_properties)[:, :3], np.asarray(result.tri_verts, dtype=np.int64), labels


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep VTK from complaining about the missing screen before it draws without one."""
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)
