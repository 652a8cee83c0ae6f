"""Polar maps over the sensor's direction (paper, Figs. 10, 12, 15): every measured point a cell, nothing in between.

The centre is the normal of the sample, the radius the sensor zenith, to the right azimuth 0. Cells are as long as the
step of the zenith and at most :data:`_CELL` wide to each side: what was not measured stays white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.figures import BLACK, CATEGORY_STYLE, ORANGE
from twin.metrics import Category
from twin.report.document import WIDTH, Columns, title_size
from twin.report.facets import Facet

#: Half the width of a cell, degree of azimuth, where planes lie far apart.
_CELL = 11.0
#: Half its length at most, degree of zenith: points that are few stand for themselves.
_LONGEST = 5.0
_PANELS = 3
#: Inch: a row of panels, and the line of the scale below.
_ROW, _FOOT = 2.45, 0.62
_EDGE = 97.0


@dataclass(frozen=True)
class Scale:
    """Colours of a quantity; ``extend`` is "both" where values may lie beyond the limits."""

    label: str
    colours: str | Colormap
    limits: tuple[float, float]
    extend: Literal["neither", "both"] = "neither"

    @property
    def norm(self) -> Normalize:
        """From values to 0 to 1."""
        return Normalize(*self.limits)


def map_height(panels: int) -> float:
    """Height in inch of :func:`draw_maps`."""
    return _ROW * -(-panels // _PANELS) + _FOOT


def draw_maps(figure: FigureBase, data: Columns, facets: Sequence[Facet], name: str, scale: Scale) -> None:
    """One map for each light, coloured by one column.

    Parameters
    ----------
    data
        Columns of the figure; ``name`` is one of them.
    """
    height = map_height(len(facets))
    for number, facet in enumerate(facets):
        axis = _panel(figure, number, len(facets), height, facet.title)
        _hemisphere(axis, facet.light)
        x, y = _places(data, facet.rows)
        drawn = PolyCollection(_cells(data, facet.rows), cmap=scale.colours, norm=scale.norm, edgecolors="none")
        drawn.set_array(np.asarray(data[name])[facet.rows])
        axis.add_collection(drawn)
        axis.plot(x, y, "o", ms=1.5, color="white", mec=BLACK, mew=0.25)
        _light(axis, facet.light)
    bar = figure.add_axes((0.25, 0.36 / height, 0.5, 0.1 / height))
    figure.colorbar(drawn, cax=bar, orientation="horizontal")
    bar.set_title(scale.label, fontsize=7.5, pad=3)
    bar.tick_params(labelsize=7)
    figure.text(0.99, 0.06 / height, "star: light", fontsize=7, ha="right")


@dataclass(frozen=True)
class Metric:
    """A row of :func:`draw_metrics`: the column that colours the markers, and the column of categories."""

    column: str
    category: str
    scale: Scale


def metric_height(metrics: int) -> float:
    """Height in inch of :func:`draw_metrics`."""
    return 2.3 * metrics + 0.35


def draw_metrics(figure: FigureBase, data: Columns, facets: Sequence[Facet], metrics: Sequence[Metric]) -> None:
    """A row of maps for each metric: markers coloured by its value, cells shaded by the category of Table V."""
    height = metric_height(len(metrics))
    for line, metric in enumerate(metrics):
        for column, facet in enumerate(facets):
            width = 0.89 / max(len(facets), _PANELS)
            bottom = (0.3 + 2.3 * (len(metrics) - 1 - line)) / height
            axis = figure.add_axes((0.01 + width * column, bottom, width * 0.94, 2.05 / height), aspect="equal")
            axis.set_title(facet.title, fontsize=title_size(facet.title, 7.5), pad=2)
            _hemisphere(axis, facet.light)
            drawn = _draw_metric(axis, data, facet, metric)
            _light(axis, facet.light)
        bar = figure.add_axes((0.905, bottom + 0.2 / height, 0.014, 1.65 / height))
        figure.colorbar(drawn, cax=bar, label=metric.scale.label, extend=metric.scale.extend)
        bar.yaxis.label.set_fontsize(7.5)
        bar.tick_params(labelsize=7)
    handles = [
        Line2D([], [], ls="none", marker=marker, mfc=colour, mec=BLACK, mew=0.4, ms=4.5, label=kind.name.lower())
        for kind, (colour, marker, _) in CATEGORY_STYLE.items()
    ]
    figure.legend(handles=handles, loc="lower center", ncols=3, fontsize=7.5, frameon=False, borderpad=0.1)


def _draw_metric(axis: Axes, data: Columns, facet: Facet, metric: Metric) -> PolyCollection:
    x, y = _places(data, facet.rows)
    values, category = (np.asarray(data[name])[facet.rows] for name in (metric.column, metric.category))
    cells = _cells(data, facet.rows)
    shades = [CATEGORY_STYLE[Category(kind)][0] for kind in category]
    axis.add_collection(PolyCollection(cells, facecolors=shades, alpha=0.3, edgecolors="none"))
    drawn = None
    for kind, (_, marker, _) in CATEGORY_STYLE.items():
        chosen = category == kind
        drawn = axis.scatter(
            x[chosen],
            y[chosen],
            c=values[chosen],
            s=11,
            marker=marker,
            cmap=metric.scale.colours,
            norm=metric.scale.norm,
            edgecolors=BLACK,
            linewidths=0.25,
        )
    return drawn  # type: ignore[return-value]


def _panel(figure: FigureBase, number: int, panels: int, height: float, title: str) -> Axes:
    lines, columns = -(-panels // _PANELS), min(panels, _PANELS)
    line, column = divmod(number, _PANELS)
    side = 2.1
    left = (WIDTH - columns * WIDTH / _PANELS) / 2 / WIDTH + column / _PANELS + (WIDTH / _PANELS - side) / 2 / WIDTH
    bottom = (_FOOT + _ROW * (lines - 1 - line)) / height
    axis = figure.add_axes((left, bottom, side / WIDTH, side / height), aspect="equal")
    axis.set_title(title, fontsize=title_size(title, 8), pad=3)
    return axis


def _hemisphere(axis: Axes, light: tuple[float, float, float]) -> None:
    """Rings at 30, 60 and 90 degrees, and the four directions of the azimuth."""
    for radius in (30, 60, 90):
        axis.add_patch(Circle((0, 0), radius, fill=False, lw=0.7 if radius == 90 else 0.35, ec=BLACK, zorder=1.5))
        if radius < 90:
            turn = np.deg2rad(-67.5)
            place = radius * np.cos(turn), radius * np.sin(turn)
            axis.text(*place, f"{radius}°", fontsize=5.5, ha="center", va="center", color=BLACK, zorder=4)
    for azimuth, across, along in ((0, "left", "center"), (90, "center", "bottom"), (180, "right", "center")):
        turn = np.deg2rad(azimuth)
        axis.text(92 * np.cos(turn), 92 * np.sin(turn), f"{azimuth}°", fontsize=5.5, ha=across, va=along)
    axis.set(xlim=(-_EDGE - 8, _EDGE + 8), ylim=(-_EDGE, _EDGE + 4))
    axis.set_axis_off()


def _light(axis: Axes, light: tuple[float, float, float]) -> None:
    turn = np.deg2rad(light[1])
    place = light[0] * np.cos(turn), light[0] * np.sin(turn)
    axis.plot(*place, marker="*", ms=8, color=ORANGE, mec=BLACK, mew=0.5, zorder=5)


def _places(data: Columns, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    zenith, azimuth = (np.asarray(data[name], dtype=float)[rows] for name in ("sensor_zenith", "sensor_azimuth"))
    return zenith * np.cos(np.deg2rad(azimuth)), zenith * np.sin(np.deg2rad(azimuth))


def _cells(data: Columns, rows: NDArray[np.int64]) -> list[FloatArray]:
    """Corners of the cell of every point, shape (4, 2) each."""
    zenith, azimuth = (np.asarray(data[name], dtype=float)[rows] for name in ("sensor_zenith", "sensor_azimuth"))
    planes = np.unique(np.mod(np.round(azimuth, 6), 180.0))
    gaps = np.diff([*planes, planes[0] + 180.0]) if len(planes) > 1 else np.array([180.0])
    half = min(_CELL, float(gaps.min()) / 2)
    low, high = np.empty(len(rows)), np.empty(len(rows))
    for plane in np.unique(azimuth):
        own = np.flatnonzero(azimuth == plane)
        low[own], high[own] = _edges(zenith[own])
    corners = np.stack([low, low, high, high], axis=-1)
    turns = np.deg2rad(np.stack([azimuth - half, azimuth + half, azimuth + half, azimuth - half], axis=-1))
    return list(np.stack([corners * np.cos(turns), corners * np.sin(turns)], axis=-1))


def _edges(zenith: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the cells of a plane begin and end: half-way to the neighbour, no farther than half the usual step."""
    known, inverse = np.unique(zenith, return_inverse=True)
    steps = np.diff(known)
    half = min(float(np.median(steps)) / 2, _LONGEST) if len(steps) else _LONGEST / 2
    below = np.minimum(np.concatenate([[half], steps / 2]), half)
    above = np.minimum(np.concatenate([steps / 2, [half]]), half)
    return (known - below)[inverse], (known + above)[inverse]
