"""Slices along the signed sensor zenith (paper, Figs. 11, 13, 14, 18, 19, 20)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from twin.comparison import Plane
from twin.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    by_zenith,
    draw_difference,
    draw_reflectance,
    scale_zenith,
    share_limits,
)
from twin.report.document import WIDTH, Columns, title_size
from twin.report.facets import Facet

#: Panels side by side, and at most in one figure: as many as a sheet holds.
COLUMNS, PANELS = 3, 12
_ROW, _HEAD, _FOOT = 1.86, 0.42, 0.42
_SERIES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (VERMILION, "v"), ("#CC79A7", "D"), ("#56B4E9", "P"), (BLACK, "x"))


def panels_height(panels: int) -> float:
    """Height in inch of a figure of small panels."""
    return _ROW * -(-panels // COLUMNS) + _HEAD + _FOOT


def _panels(
    figure: FigureBase, titles: Sequence[str], fill: Callable[[Axes, int], None], what: str, bottom: str
) -> list[Axes]:
    """Panels with common scales, the legend of the fullest one above them."""
    height = panels_height(len(titles))
    lines = -(-len(titles) // COLUMNS)
    columns = min(COLUMNS, len(titles))
    grid = figure.add_gridspec(
        lines,
        columns,
        left=0.62 / WIDTH,
        right=1 - 0.08 / WIDTH if columns == COLUMNS else (0.62 + columns * 2.1) / WIDTH,
        bottom=_FOOT / height,
        top=1 - (_HEAD + 0.12) / height,
        hspace=0.27,
        wspace=0.08,
    )
    axes: list[Axes] = []
    for number, title in enumerate(titles):
        axis = figure.add_subplot(grid[number // COLUMNS, number % COLUMNS])
        fill(axis, number)
        axis.set_title(
            title, fontsize=title_size(title, 7.5), loc="left", pad=2.5, y=1.0
        )  # where a small picture may be beside it
        axis.tick_params(labelsize=7, labelleft=number % COLUMNS == 0, labelbottom=number + COLUMNS >= len(titles))
        axes.append(axis)
    share_limits(axes)
    handles, labels = max((axis.get_legend_handles_labels() for axis in axes), key=lambda both: len(both[0]))
    figure.legend(
        handles, labels, loc="upper center", ncols=min(len(handles), 5), fontsize=7.5, frameon=False, borderpad=0.2
    )
    figure.text(0.5, 0.1 / height, bottom, ha="center", fontsize=8)
    figure.text(0.12 / WIDTH, 0.5, what, va="center", ha="left", rotation=90, fontsize=8)
    return axes


def draw_comparison(figure: FigureBase, points: xr.Dataset, planes: Sequence[Plane], titles: Sequence[str]) -> None:
    """Measured and simulated reflectance factor in every plane, with k = 1 and k = 2 (paper, Fig. 13)."""

    def fill(axis: Axes, number: int) -> None:
        rows = by_zenith(points, planes[number])
        draw_reflectance(axis, rows)
        scale_zenith(axis, rows, step=40)
        _thumbnail(axis, planes[number], rows)

    _panels(figure, titles, fill, "reflectance factor", "sensor zenith / degree")


def draw_differences(figure: FigureBase, points: xr.Dataset, planes: Sequence[Plane], titles: Sequence[str]) -> None:
    """Relative difference in every plane with the limits of t' (paper, Fig. 14)."""

    def fill(axis: Axes, number: int) -> None:
        rows = by_zenith(points, planes[number])
        draw_difference(axis, rows)
        scale_zenith(axis, rows, step=40)

    what = r"$(R_\mathrm{sim} - R_\mathrm{mes})\,/\,R_\mathrm{mes}$ / %"
    _panels(figure, titles, fill, what, "sensor zenith / degree")


def draw_symmetric(figure: FigureBase, data: Columns, facets: Sequence[Facet]) -> None:
    """Every plane with what symmetry makes equal to it; thick bars k = 1, thin ones with tips k = 2 (Figs. 18 to 20).

    Parameters
    ----------
    data
        Columns ``sensor_zenith``, ``brf``, ``u_brf``, and ``brf_symmetric``, ``u_brf_symmetric``, nan where there is
        none.
    """
    columns = {name: np.asarray(data[name], dtype=float) for name in _SYMMETRIC}

    def fill(axis: Axes, number: int) -> None:
        rows = facets[number].rows
        rows = rows[np.argsort(columns["sensor_zenith"][rows], kind="stable")]
        x = columns["sensor_zenith"][rows]
        # Equal values lie upon each other: the broad orange ones stay visible behind the narrow blue ones.
        for suffix, colour, marker, label, width in (
            ("", BLUE, "o", "baseline", 1.0),
            ("_symmetric", ORANGE, "s", "symmetric", 2.6),
        ):
            y, u = columns[f"brf{suffix}"][rows], columns[f"u_brf{suffix}"][rows]
            there = np.isfinite(y)
            if np.any(there):
                _bars(axis, x[there], y[there], u[there], Look(colour, marker, label, width))
        axis.grid(True, lw=0.4, alpha=0.5)

    axes = _panels(figure, [f.title for f in facets], fill, "reflectance factor", "sensor zenith / degree")
    extent = 1.04 * float(np.abs(columns["sensor_zenith"]).max())
    for axis in axes:
        axis.set_xlim(-extent, extent)


_SYMMETRIC = ("sensor_zenith", "brf", "u_brf", "brf_symmetric", "u_brf_symmetric")


def draw_principal(figure: FigureBase, data: Columns, facets: Sequence[Facet]) -> None:
    """The plane of incidence of every light in one panel, with k = 1 (paper, Fig. 11)."""
    axis = figure.add_axes((0.085, 0.13, 0.9, 0.72))
    for number, facet in enumerate(facets):
        zenith = np.asarray(data["sensor_zenith"])[facet.rows]
        rows = facet.rows[np.argsort(zenith, kind="stable")]
        colour, marker = _SERIES[number % len(_SERIES)]
        axis.errorbar(
            np.asarray(data["sensor_zenith"])[rows],
            np.asarray(data["brf"])[rows],
            yerr=np.asarray(data["u_brf"])[rows],
            fmt=marker,
            color=colour,
            ms=3.2,
            elinewidth=0.8,
            capsize=1.6,
            label=facet.title,
        )
    axis.grid(True, lw=0.4, alpha=0.5)
    axis.set_xlabel("sensor zenith / degree", fontsize=8)
    axis.set_ylabel("reflectance factor", fontsize=8)
    axis.tick_params(labelsize=7)
    columns = min(5, len(facets))
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, fontsize=7.5, frameon=False)


@dataclass(frozen=True)
class Look:
    """Of a series: colour, marker, name, width of the bars in points; narrow ones lie in front."""

    colour: str
    marker: str
    label: str
    width: float


def _bars(axis: Axes, x: np.ndarray, y: np.ndarray, u: np.ndarray, look: Look) -> None:
    caps = 1.0 + 0.4 * look.width
    size = 1.6 + 0.5 * look.width
    order = 3 - look.width / 10
    tips: dict[str, Any] = {"elinewidth": 0.5, "capsize": caps, "capthick": 0.5, "zorder": order}
    axis.errorbar(x, y, yerr=2 * u, fmt="none", ecolor=look.colour, **tips)
    bars: dict[str, Any] = {
        "fmt": look.marker,
        "ms": size,
        "color": look.colour,
        "elinewidth": look.width,
        "zorder": order,
    }
    axis.errorbar(x, y, yerr=u, label=look.label, **bars)


def _thumbnail(axis: Axes, plane: Plane, rows: xr.Dataset) -> None:
    """The hemisphere from above beside the title: where the points lie, and the light."""
    small = axis.inset_axes((0.87, 0.99, 0.13, 0.19))
    small.set_aspect("equal")
    around = np.deg2rad(np.linspace(0, 360, 73))
    small.plot(90 * np.cos(around), 90 * np.sin(around), color=GREY, lw=0.6)
    turn, zenith = np.deg2rad(rows["sensor_azimuth"].values), rows["sensor_zenith"].values
    small.plot(zenith * np.cos(turn), zenith * np.sin(turn), ".", ms=0.9, color=BLUE)
    light = np.deg2rad(plane.illumination_azimuth)
    place = plane.illumination_zenith * np.cos(light), plane.illumination_zenith * np.sin(light)
    small.plot(*place, "o", ms=2.8, color=ORANGE, mec=BLACK, mew=0.4)
    small.set(xlim=(-95, 95), ylim=(-95, 95))
    small.set_axis_off()
