"""Figures of a diagnosis: maps before and after, planes with their bands, probabilities, and the size of the gap.

Sign and size are told by the markers' shape and area as well as by colour; colours are Okabe and Ito's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.diagnosis.observation import Observation
from twin.diagnosis.turned import rotation
from twin.figures import BLACK, BLUE, GREY, VERMILION
from twin.metrics import root_mean_square

#: Panels of a figure at most; further groups are named, not drawn.
MOST_MAPS, MOST_PLANES = 8, 24


@dataclass(frozen=True)
class Sides:
    """A run beside its prediction before and after the correction; arrays of shape (point,).

    Attributes
    ----------
    run
        The measurement.
    before, after
        Relative difference (prediction - measurement)/measurement.
    u
        Combined relative standard uncertainty (k = 1) of measurement and prediction.
    """

    run: Observation
    before: FloatArray
    after: FloatArray
    u: FloatArray


def draw_maps(sides: Sides, *, score: bool) -> Figure:
    """Polar maps over the sensor's direction, one column an illumination, before above after.

    Parameters
    ----------
    score
        Draw t' (difference over combined uncertainty) instead of the relative difference in per cent.
    """
    groups = illuminations(sides.run)[:MOST_MAPS]
    scale = sides.u if score else np.full(len(sides.u), 0.01)
    rows = [("before", sides.before / scale), ("after", sides.after / scale)]
    limit = float(np.quantile(np.abs(np.concatenate([values for _, values in rows])), 0.98)) or 1.0
    columns = len(groups)
    width = 0.6 + 2.9 * columns + 0.9
    figure = Figure(figsize=(width, 7.0))
    what = "t'" if score else "relative difference / %"
    for line, (name, values) in enumerate(rows):
        for column, (title, points) in enumerate(groups):
            left, bottom = (0.5 + 2.9 * column) / width, 0.075 + 0.475 * (1 - line)
            box = (left, bottom, 2.5 / width, 0.345)
            axes = figure.add_axes(box, projection="polar")
            beyond = np.abs(values * scale) > sides.u
            drawn = _draw_map(axes, sides.run, points, values, beyond, limit)
            axes.set_title(f"{name}: {title}", fontsize=8.5, pad=9)
    bar = figure.add_axes(((width - 0.75) / width, 0.2, 0.14 / width, 0.6))
    figure.colorbar(drawn, cax=bar).set_label(f"{what} (prediction - measurement)", fontsize=8.5)
    text = "triangle up: prediction higher, down: lower, by more than 1 u; dot: within 1 u; area grows with size"
    figure.text(0.5, 0.012, text, ha="center", fontsize=8)
    return figure


def _draw_map(
    axes: Axes,
    run: Observation,
    points: NDArray[np.int64],
    values: FloatArray,
    beyond: NDArray[np.bool_],
    limit: float,
) -> Any:
    zenith = run.columns["sensor_zenith"][points]
    relative = run.columns["sensor_azimuth"][points] - run.columns["illumination_azimuth"][points]
    angle = np.deg2rad(relative + np.where(zenith < 0, 180.0, 0.0))
    shown, unit = values[points], beyond[points]
    size = 8 + 34 * np.minimum(np.abs(shown) / limit, 1.0)
    drawn = None
    for marker, chosen in (("^", unit & (shown > 0)), ("v", unit & (shown <= 0)), ("o", ~unit)):
        drawn = axes.scatter(
            angle[chosen],
            np.abs(zenith[chosen]),
            s=size[chosen] * (0.4 if marker == "o" else 1.0),
            c=shown[chosen],
            marker=marker,
            cmap="RdBu_r",
            vmin=-limit,
            vmax=limit,
            edgecolors=GREY,
            linewidths=0.4,
        )
    axes.set_rlim(0, 90)  # type: ignore[attr-defined]
    axes.set_rticks([30, 60])  # type: ignore[attr-defined]
    axes.set_xticks(np.deg2rad([0, 90, 180, 270]))
    axes.tick_params(labelsize=7, pad=-1)
    light = float(run.columns["illumination_zenith"][points[0]])
    axes.plot([0.0], [light], marker="*", color=BLACK, markersize=8, linestyle="none")
    axes.grid(alpha=0.4)
    return drawn


def draw_planes(sides: Sides) -> Figure:
    """Relative differences of every plane against the signed sensor zenith, with bands of 1 and 2 u."""
    run = sides.run
    numbers = range(min(int(run.plane.max()) + 1, MOST_PLANES))
    columns = min(4, len(numbers))
    lines = -(-len(numbers) // columns)
    width, height = 2.7 * columns + 0.95, 1.95 * lines + 0.8
    figure = Figure(figsize=(width, height))
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    figure.subplots_adjust(
        left=0.85 / width,
        right=1 - 0.1 / width,
        bottom=0.5 / height,
        top=1 - 0.55 / height,
        hspace=0.28,
        wspace=0.06,
    )
    for axes in grid.flat[len(numbers) :]:
        axes.set_visible(False)
    for number, axes in zip(numbers, grid.flat, strict=False):
        _draw_plane(axes, sides, np.flatnonzero(run.plane == number))
    handles, labels = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=4, fontsize=8.5, frameon=False)
    figure.supxlabel("sensor zenith / degree", fontsize=9, y=0.1 / height)
    figure.supylabel("(prediction - measurement)/measurement / %", fontsize=9, x=0.12 / width)
    return figure


def _draw_plane(axes: Axes, sides: Sides, points: NDArray[np.int64]) -> None:
    columns = sides.run.columns
    points = points[np.argsort(columns["sensor_zenith"][points], kind="stable")]
    zenith, u = columns["sensor_zenith"][points], 100 * sides.u[points]
    axes.fill_between(zenith, -2 * u, 2 * u, color="0.9", label="2 u")
    axes.fill_between(zenith, -u, u, color="0.78", label="1 u")
    axes.axhline(0, color=GREY, linewidth=0.6)
    axes.plot(zenith, 100 * sides.before[points], "o", markerfacecolor="none", color=VERMILION, ms=3.2, label="before")
    axes.plot(zenith, 100 * sides.after[points], "x", color=BLUE, ms=3.2, label="after")
    light, azimuth = columns["illumination_zenith"][points[0]], columns["sensor_azimuth"][points[0]]
    wavelength = columns["wavelength"][points[0]]
    several = len(np.unique(columns["wavelength"])) > 1
    title = f"{wavelength:g} nm, " if several else ""
    turned = rotation(columns)[points[0]]
    title += f"illumination {light:g}, azimuth {azimuth:g}" + (f", turned {turned:g}" if turned else "")
    axes.set_title(title, fontsize=7.5, pad=2)
    axes.tick_params(labelsize=7)


def ranking_height(names: Sequence[str]) -> float:
    """Height in inch of :func:`ranking_bars`."""
    return 0.36 * len(names) + 0.75


def draw_ranking(names: Sequence[str], probabilities: Sequence[float]) -> Figure:
    """Probabilities as bars, numbers beside them."""
    figure = Figure(figsize=(6.4, ranking_height(names)))
    ranking_bars(figure, names, probabilities)
    return figure


def ranking_bars(figure: FigureBase, names: Sequence[str], probabilities: Sequence[float]) -> None:
    """:func:`draw_ranking` in a figure, or part of one, of :func:`ranking_height`."""
    height = ranking_height(names)
    axes = figure.add_axes((0.36, 0.42 / height, 0.56, 1 - 0.5 / height))
    place = np.arange(len(names))[::-1]
    axes.barh(place, probabilities, color=BLUE, height=0.62)
    for y, probability in zip(place, probabilities, strict=True):
        text = f"{probability:.3f}" if probability >= 0.001 else "< 0.001"
        axes.text(min(probability, 1.0) + 0.012, y, text, va="center", fontsize=8)
    axes.set_yticks(place, list(names), fontsize=8.5)
    axes.set_xlim(0, 1.12)
    axes.set_xlabel("probability", fontsize=8.5)
    axes.tick_params(axis="x", labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


#: Height in inch of :func:`gap_bars`.
GAP_HEIGHT = 1.75


def draw_gap(before: float, after: float, left: float) -> Figure:
    """The held-out gap before and after, beside what noise and budget alone leave."""
    figure = Figure(figsize=(6.4, GAP_HEIGHT))
    gap_bars(figure, before, after, left)
    return figure


def gap_bars(figure: FigureBase, before: float, after: float, left: float) -> None:
    """:func:`draw_gap` in a figure, or part of one, of :data:`GAP_HEIGHT`."""
    axes = figure.add_axes((0.36, 0.28, 0.56, 0.68))
    names = ["held-out slices, before", "held-out slices, after", "noise and budget alone"]
    values = 100 * np.array([before, after, left])
    bars = axes.barh([2, 1, 0], values, color=[VERMILION, BLUE, "0.7"], height=0.62)
    for bar, hatch in zip(bars, ("//", "", ".."), strict=True):
        bar.set_hatch(hatch)
    for y, value in zip((2, 1, 0), values, strict=True):
        axes.text(value + 0.012 * values.max(), y, f"{value:.2f} %", va="center", fontsize=8)
    axes.set_yticks([2, 1, 0], names, fontsize=8.5)
    axes.set_xlim(0, 1.15 * values.max())
    axes.set_xlabel("root mean square relative difference / %", fontsize=8.5)
    axes.tick_params(axis="x", labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def illuminations(run: Observation) -> list[tuple[str, NDArray[np.int64]]]:
    """Title and points of each wavelength, illumination zenith and rotation of the sample, in order of the file."""
    columns = run.columns
    wavelength = np.round(np.nan_to_num(columns["wavelength"], nan=0.0), 3)
    several = len(np.unique(wavelength)) > 1
    turned = rotation(columns)
    found = []
    for one, angle in dict.fromkeys(zip(wavelength.tolist(), turned.tolist(), strict=True)):
        for number in dict.fromkeys(run.illumination.tolist()):
            points = np.flatnonzero((wavelength == one) & (turned == angle) & (run.illumination == number))
            if len(points):
                light = columns["illumination_zenith"][points[0]]
                title = f"{one:g} nm, {light:g} deg" if several else f"illumination {light:g} deg"
                found.append((f"{title}, turned {angle:g}" if angle else title, points))
    return found


def summary(values: FloatArray, points: NDArray[np.int64]) -> float:
    """Root mean square in per cent at some points."""
    return 100 * root_mean_square(values[points])
