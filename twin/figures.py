"""Figures of a comparison, one per azimuth plane, after the paper's Figs. 13 and 14.

Above: measured and simulated reflectance factor against the signed sensor zenith, with k = 1 and k = 2. Below: the
relative difference with the band of +-1 and +-2 combined uncertainties, each point drawn by its category of t'
(Table V). A small polar plot shows where the plane lies and where the light comes from.
Colours are Okabe and Ito's, which colour-blind people tell apart; shapes say the same without colour. Only
matplotlib's object interface is used, so that nothing depends on a display or on global state.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from twin.comparison import Comparison, Plane
from twin.metrics import Category, categorise_t

BLACK, BLUE, GREEN, ORANGE, VERMILION, GREY = "#000000", "#0072B2", "#009E73", "#E69F00", "#D55E00", "#7F7F7F"
#: Colour, marker and name of each category.
CATEGORY_STYLE = {
    Category.GOOD: (GREEN, "o", "good, $|t'| < 1$"),
    Category.ACCEPTABLE: (ORANGE, "s", "acceptable"),
    Category.POOR: (VERMILION, "^", "poor, $|t'| > 2$"),
}
_SIZE_INCH = (7.2, 5.6)
_DPI = 130


def draw_planes(comparison: Comparison, folder: Path, formats: tuple[str, ...] = ("png", "svg")) -> list[Path]:
    """Draw every plane of a comparison and an overview of all of them.

    Parameters
    ----------
    comparison
        Of a run and its prediction.
    folder
        Created if missing; files of the same names are replaced.
    formats
        File formats that matplotlib writes without a display.

    Returns
    -------
    list of Path
        The files written, planes in the order of the comparison and the overview last.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for plane in comparison.planes:
        figure = draw_plane(comparison.points, plane)
        written += _save(figure, folder / plane_name(plane), formats)
    return written + _save(draw_overview(comparison), folder / "overview", formats)


def plane_name(plane: Plane) -> str:
    """Name of a plane's file, without suffix: wavelength, illumination zenith, sensor azimuth."""
    turned = f"_from{plane.illumination_azimuth:g}" if plane.illumination_azimuth else ""
    return f"plane_{plane.wavelength:g}nm_ill{plane.illumination_zenith:g}{turned}_azi{plane.sensor_azimuth:g}"


def draw_plane(points: xr.Dataset, plane: Plane) -> Figure:
    """One plane: reflectance factors above, relative differences below.

    Parameters
    ----------
    points
        :attr:`~twin.comparison.Comparison.points`.
    plane
        Which of them to draw.
    """
    rows = by_zenith(points, plane)
    figure = Figure(figsize=_SIZE_INCH)
    # Fixed margins: a layout engine would take three times as long for the same picture.
    margins = {"left": 0.095, "right": 0.985, "bottom": 0.085, "top": 0.86, "hspace": 0.17}
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2), gridspec_kw=margins)
    draw_reflectance(upper, rows)
    draw_difference(lower, rows)
    figure.text(margins["left"], 0.945, _title(plane), fontsize=11)
    _draw_thumbnail(figure, plane, rows)
    upper.set_ylabel("reflectance factor")
    lower.set_ylabel(r"$(R_\mathrm{sim} - R_\mathrm{mes})\,/\,R_\mathrm{mes}$ / %")
    lower.set_xlabel("sensor zenith / degree")
    placed = {"fontsize": 8.5, "frameon": False, "borderaxespad": 0.2, "borderpad": 0.0, "loc": "lower left"}
    upper.legend(ncols=2, bbox_to_anchor=(0.0, 1.0), **placed)
    lower.legend(ncols=5, bbox_to_anchor=(0.0, 1.0), **placed)
    scale_zenith(lower, rows)
    return figure


def draw_overview(comparison: Comparison) -> Figure:
    """All planes on one sheet, reflectance factors above relative differences, with common scales."""
    columns = min(4, len(comparison.planes))
    lines = -(-len(comparison.planes) // columns)
    width, height = 3.6 * columns + 0.4, 3.3 * lines + 0.9
    figure = Figure(figsize=(width, height))
    grid = figure.add_gridspec(
        lines,
        columns,
        left=0.55 / width,
        right=1 - 0.1 / width,
        bottom=0.5 / height,
        top=1 - 0.65 / height,
        hspace=0.16,
    )
    uppers, lowers = [], []
    for number, plane in enumerate(comparison.planes):
        line, column = divmod(number, columns)
        cell = grid[line, column].subgridspec(2, 1, height_ratios=(3, 2), hspace=0.08)
        upper = figure.add_subplot(cell[0])
        lower = figure.add_subplot(cell[1], sharex=upper)
        rows = by_zenith(comparison.points, plane)
        draw_reflectance(upper, rows)
        draw_difference(lower, rows)
        scale_zenith(lower, rows, step=40)
        upper.set_title(_title(plane, short=True), loc="left", fontsize=9)
        uppers.append(upper)
        lowers.append(lower)
        for axis in (upper, lower):
            axis.tick_params(labelsize=8, labelbottom=axis is lower and number + columns >= len(comparison.planes))
        if column == 0:
            upper.set_ylabel("reflectance factor", fontsize=8)
            lower.set_ylabel("difference / %", fontsize=8)
    share_limits(uppers)
    share_limits(lowers)
    handles = [handle for axis in (uppers[0], lowers[0]) for handle in axis.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="upper center", ncols=min(len(handles), 4 * columns), fontsize=9, frameon=False)
    figure.text(0.5, 0.12 / height, "sensor zenith / degree", ha="center", fontsize=9)
    return figure


def _draw_thumbnail(figure: Figure, plane: Plane, rows: xr.Dataset) -> None:
    """The hemisphere seen from above: the measured points and the light, rings at 45 and 90 degrees."""
    axis = figure.add_axes((0.885, 0.868, 0.1, 0.125), aspect="equal")
    for radius, colour in ((45, GREY), (90, BLACK)):
        axis.add_patch(Circle((0, 0), radius, fill=False, lw=0.6, ec=colour))
    azimuth_rad = np.deg2rad(rows["sensor_azimuth"].values)
    zenith = rows["sensor_zenith"].values
    axis.plot(zenith * np.cos(azimuth_rad), zenith * np.sin(azimuth_rad), ".", ms=1.8, color=BLUE)
    light_rad = np.deg2rad(plane.illumination_azimuth)
    light = plane.illumination_zenith * np.array([np.cos(light_rad), np.sin(light_rad)])
    axis.plot(*light, "o", ms=5, color=ORANGE, mec=BLACK, mew=0.5)
    axis.set(xlim=(-94, 94), ylim=(-94, 94))
    axis.set_axis_off()


def draw_reflectance(axis: Axes, rows: xr.Dataset) -> None:
    """Measured and simulated reflectance factors of one plane (:func:`by_zenith`) with k = 1 and k = 2."""
    zenith, simulated, u_simulated = _with_gaps(rows, "simulated", "u_simulated")
    axis.fill_between(zenith, simulated - 2 * u_simulated, simulated + 2 * u_simulated, color=BLUE, alpha=0.18, lw=0)
    axis.fill_between(zenith, simulated - u_simulated, simulated + u_simulated, color=BLUE, alpha=0.32, lw=0)
    axis.plot(zenith, simulated, color=BLUE, lw=1.3, label="simulated, $k$ = 1, 2")
    x, measured, u = (rows[name].values for name in ("sensor_zenith", "measured", "u_measured"))
    axis.errorbar(x, measured, yerr=2 * u, fmt="none", ecolor=BLACK, elinewidth=0.7, capsize=1.8, capthick=0.7)
    axis.errorbar(
        x, measured, yerr=u, fmt="o", ms=2.6, color=BLACK, ecolor=BLACK, elinewidth=1.8, label="measured, $k$ = 1, 2"
    )
    axis.grid(True, lw=0.4, alpha=0.5)


def draw_difference(axis: Axes, rows: xr.Dataset) -> None:
    """Relative differences of one plane in per cent, by category of t', on bands of 1 and 2 combined uncertainties."""
    zenith, sigma = _with_gaps(rows, "relative_combined")
    sigma = 100 * sigma
    axis.fill_between(zenith, -2 * sigma, 2 * sigma, color=GREY, alpha=0.18, lw=0, label=r"$\pm 2\,\sigma_c$")
    axis.fill_between(zenith, -sigma, sigma, color=GREY, alpha=0.32, lw=0, label=r"$\pm 1\,\sigma_c$")
    axis.axhline(0, color=BLACK, lw=0.6)
    x, difference = rows["sensor_zenith"].values, 100 * rows["relative_difference"].values
    category = categorise_t(rows["t"].values)
    for kind, (colour, marker, name) in CATEGORY_STYLE.items():
        chosen = category == kind
        axis.plot(x[chosen], difference[chosen], marker, ms=4.2, color=colour, mec=BLACK, mew=0.4, label=name)
    axis.grid(True, lw=0.4, alpha=0.5)


def by_zenith(points: xr.Dataset, plane: Plane) -> xr.Dataset:
    """The points of a plane along the sensor zenith, with their combined relative uncertainty."""
    rows = points.isel(point=list(plane.rows)).sortby("sensor_zenith")
    sigma = np.hypot(rows["u_simulated"], rows["u_measured"]) / np.abs(rows["measured"])
    return rows.assign(relative_combined=sigma)


def _with_gaps(rows: xr.Dataset, *names: str) -> tuple[NDArray[np.float64], ...]:
    """Sensor zenith and variables with a not-a-number wherever a point is missing, so that no line bridges it."""
    zenith = rows["sensor_zenith"].values
    steps = np.diff(zenith)
    typical = np.median(steps) if len(steps) else 0.0
    gaps = np.flatnonzero(steps > 1.5 * typical) + 1
    return tuple(np.insert(rows[name].values.astype(float), gaps, np.nan) for name in ("sensor_zenith", *names))


def scale_zenith(axis: Axes, rows: xr.Dataset, step: float = 20) -> None:
    """Symmetric limits and round marks along the sensor zenith."""
    extent = max(float(np.abs(rows["sensor_zenith"]).max()), 1.0)
    axis.set_xlim(-1.04 * extent, 1.04 * extent)
    if extent >= 1.5 * step:
        axis.xaxis.set_major_locator(MultipleLocator(step))


def share_limits(axes: list[Axes]) -> None:
    """The same scale of values for all of them."""
    limits = np.array([axis.get_ylim() for axis in axes])
    for axis in axes:
        axis.set_ylim(limits[:, 0].min(), limits[:, 1].max())


def _title(plane: Plane, short: bool = False) -> str:
    turned = f" from {plane.illumination_azimuth:g}°" if plane.illumination_azimuth else ""
    if short:
        return (
            f"{plane.wavelength:g} nm, ill. {plane.illumination_zenith:g}°{turned}, azimuth {plane.sensor_azimuth:g}°"
        )
    return (
        f"{plane.wavelength:g} nm, illumination zenith {plane.illumination_zenith:g}°{turned},"
        f" sensor azimuth {plane.sensor_azimuth:g}°"
    )


def rendered(figure: Figure, form: str, dpi: float = _DPI) -> bytes:
    """A figure as the content of a file, the same bytes for the same figure.

    Parameters
    ----------
    form
        ``png``, ``svg`` or ``pdf``.
    dpi
        Of pixels; vector formats need it for what is no vector.
    """
    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(form)
    figure.savefig(stream, format=form, dpi=dpi, metadata=undated)
    return stream.getvalue()


def _save(figure: Figure, stem: Path, formats: tuple[str, ...]) -> list[Path]:
    written = []
    for suffix in formats:
        path = stem.with_name(f"{stem.name}.{suffix}")
        path.write_bytes(rendered(figure, suffix))
        written.append(path)
    return written
