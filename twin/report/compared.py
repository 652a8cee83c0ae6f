"""Measurement beside simulation (paper, Tables V and VI, Figs. 13 to 17)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from twin import metrics
from twin.comparison import Comparison, Group, Plane
from twin.metrics import Category
from twin.report.bars import METRICS, bars_height, draw_means, draw_shares
from twin.report.curves import PANELS, draw_comparison, draw_differences, panels_height
from twin.report.document import Block, Plot, Points, Table
from twin.report.facets import Facet, by_light, geometry
from twin.report.maps import Metric, Scale, draw_metrics, metric_height
from twin.report.measured import in_parts, part
from twin.report.words import fixed
from twin.tables import TABLE_VI

#: Draws planes into a figure.
Drawing = Callable[..., None]
_SYMBOLS = {"relative_difference": "|ΔR*|", "t": "|t'|", "level_of_agreement": "n'"}
_VALUES = ("measured", "u_measured", "simulated", "u_simulated", "relative_difference", "t", "level_of_agreement")
#: Lights in one figure of three rows of maps.
_MAPS = 3
#: Planes in one figure of bars.
_BARS = 34


def compared_blocks(comparison: Comparison) -> list[Block]:
    """Everything that the comparison is shown by."""
    return [
        categories_table(),
        group_table(comparison),
        table_six(comparison),
        Points(_remarks(comparison)),
        *plane_plots(comparison),
        *metric_maps(comparison),
        *bar_plots(comparison),
    ]


def categories_table() -> Table:
    """The limits of good, acceptable and poor (Table V)."""
    dr, t, n = metrics.RELATIVE_DIFFERENCE_LIMITS, metrics.T_LIMITS, metrics.LEVEL_OF_AGREEMENT_LIMITS
    rows = [
        ["|ΔR*| / %", f"0 - {100 * dr[0]:g}", f"{100 * dr[0]:g} - {100 * dr[1]:g}", f"{100 * dr[1]:g}+"],
        ["|t'|", f"0 - {t[0]:g}", f"{t[0]:g} - {t[1]:g}", f"{t[1]:g}+"],
        ["n' / %", f"{100 * n[0]:g}+", f"{100 * n[0]:g} - {100 * n[1]:g}", f"{100 * n[1]:g} - 0"],
    ]
    caption = (
        "Categories of a point. ΔR* = (simulated - measured)/measured, t' = (simulated - measured)/combined standard"
        " uncertainty, n' = share of the simulation's distribution within 2 combined standard uncertainties of the"
        " measured value."
    )
    return Table("table_05_categories", caption, ["metric", "good", "acceptable", "poor"], rows, (), "Table V")


def group_table(comparison: Comparison) -> Table:
    """Metrics by azimuth plane, in-plane, out-of-plane and of all points."""
    header = ["plane", "points", "mean |ΔR*| / %", "rel. RMSE", "rms t'", "mean n'"]
    header += [f"{symbol} g/a/p" for symbol in _SYMBOLS.values()]
    groups = [(title, plane.group) for title, plane in zip(titles(comparison.planes), comparison.planes, strict=True)]
    groups += [
        ("in-plane", comparison.in_plane),
        ("out-of-plane", comparison.out_of_plane),
        ("all points", comparison.overall),
    ]
    caption = "Metrics by azimuth plane. g/a/p: good, acceptable and poor, in per cent of the points."
    rows = [[title, *_cells(group)] for title, group in groups]
    return Table("planes", caption, header, rows, tuple(range(1, len(header))))


def _cells(group: Group) -> list[str]:
    shares = [group.shares[metric] for metric in _SYMBOLS]
    return [
        str(group.points),
        fixed(100 * group.mean_absolute_relative_difference, 2),
        fixed(group.relative_rmse, 4),
        fixed(group.rms_t, 2),
        fixed(group.level_of_agreement, 2),
        *("/".join(fixed(100 * share, 0) for share in (s.good, s.acceptable, s.poor)) for s in shares),
    ]


def table_six(comparison: Comparison) -> Table:
    """Level of agreement and relative RMSE beside the published ones (Table VI)."""
    groups = {"in-plane": comparison.in_plane, "out-of-plane": comparison.out_of_plane, "global": comparison.overall}
    rows = []
    for line, (name, group) in enumerate(groups.items()):
        published = [f"{study.level_of_agreement[line]:.2f}" for study in TABLE_VI]
        rows.append([f"level of agreement ({name})", fixed(group.level_of_agreement, 2), *published])
    for line, (name, group) in enumerate(groups.items()):
        published = [f"{study.relative_rmse[line]:.2g}" for study in TABLE_VI]
        rows.append([f"relative RMSE ({name})", fixed(group.relative_rmse, 3), *published])
    header = ["metric", "this run", *(study.study for study in TABLE_VI)]
    return Table("table_06_agreement", "This run beside published studies.", header, rows, (1, 2, 3), "Table VI")


def _remarks(comparison: Comparison) -> list[str]:
    median = 100 * comparison.median_relative_standard_error
    return [f"Ray tracer's relative standard error: {median:.2f} % (median of the points).", *comparison.notes]


def titles(planes: Sequence[Plane]) -> list[str]:
    """What planes are called next to each other."""
    several = len({plane.wavelength for plane in planes}) > 1
    turned = any(plane.illumination_azimuth for plane in planes)
    return [
        (f"{plane.wavelength:g} nm, " if several else "")
        + f"ill. {plane.illumination_zenith:g}°"
        + (f" from {plane.illumination_azimuth:g}°" if turned else "")
        + f", azimuth {plane.sensor_azimuth:g}°"
        for plane in planes
    ]


def plane_plots(comparison: Comparison) -> list[Block]:
    """Reflectance factors and relative differences of every plane (Figs. 13 and 14)."""
    points, names = comparison.points, dict(zip(map(id, comparison.planes), titles(comparison.planes), strict=True))

    def of(drawing: Drawing, counterpart: str) -> Callable[[Sequence[Plane], str, str], Plot]:
        def plot(chosen: Sequence[Plane], stem: str, said: str) -> Plot:
            draw = partial(drawing, points=points, planes=chosen, titles=[names[id(plane)] for plane in chosen])
            rows = [row for plane in chosen for row in plane.rows]
            return Plot(stem, said, panels_height(len(chosen)), draw, point_columns(points, rows), counterpart)

        return plot

    first = (
        "Measured and simulated reflectance factor. Dots with bars: measured with k = 1 (thick) and k = 2 (tips); line"
        " with bands: simulated with k = 1 and k = 2. The small picture shows plane and light from above."
    )
    second = (
        "Relative difference between simulation and measurement in every plane. Bands: one and two combined standard"
        " uncertainties, the limits of good and acceptable for t'."
    )
    planes = comparison.planes
    return [
        *in_parts(planes, PANELS, "fig_13_planes", first, of(draw_comparison, "Fig. 13")),
        *in_parts(planes, PANELS, "fig_14_differences", second, of(draw_differences, "Fig. 14")),
    ]


def point_columns(points: xr.Dataset, rows: Sequence[int]) -> dict[str, np.ndarray]:
    """What is known of compared points, with their categories."""
    chosen = points.isel(point=list(rows))
    columns = {"row": chosen["row"].values, **geometry(chosen), **{name: chosen[name].values for name in _VALUES}}
    return columns | {f"{metric}_category": _categories(chosen, metric) for metric in _SYMBOLS}


def _categories(points: xr.Dataset, metric: str) -> np.ndarray:
    categorise = {
        "relative_difference": metrics.categorise_relative_difference,
        "t": metrics.categorise_t,
        "level_of_agreement": metrics.categorise_level_of_agreement,
    }[metric]
    return categorise(points[metric].values)


def metric_maps(comparison: Comparison) -> list[Block]:
    """Polar view of the three metrics (Fig. 15)."""
    points = comparison.points
    data = point_columns(points, range(points.sizes["point"]))
    data["relative_difference_percent"] = 100 * data["relative_difference"]
    shown = [
        Metric(
            "relative_difference_percent",
            "relative_difference_category",
            Scale("ΔR* / %", "RdBu_r", (-6.0, 6.0), "both"),
        ),
        Metric("t", "t_category", Scale("t'", "RdBu_r", (-3.0, 3.0), "both")),
        Metric("level_of_agreement", "level_of_agreement_category", Scale("n'", "cividis", (0.0, 1.0))),
    ]
    caption = (
        "Relative difference, t-score and level of agreement over the sensor's direction. Colour of a marker: the"
        " value; its shape and the shading behind it: the category. Categories in the data: 0 good, 1 acceptable,"
        " 2 poor."
    )

    def plot(chosen: Sequence[Facet], stem: str, said: str) -> Plot:
        own, moved = part(data, chosen)
        draw = partial(draw_metrics, data=own, facets=moved, metrics=shown)
        return Plot(stem, said, metric_height(len(shown)), draw, own, "Fig. 15")

    return in_parts(by_light(points), _MAPS, "fig_15_metrics", caption, plot)


def bar_plots(comparison: Comparison) -> list[Block]:
    """Points by category and mean metrics of every plane (Figs. 16 and 17)."""
    named = dict(zip(map(id, comparison.planes), titles(comparison.planes), strict=True))

    def shares(chosen: Sequence[Plane], stem: str, said: str) -> Plot:
        data = share_columns([(named[id(plane)], plane.group) for plane in chosen])
        return Plot(stem, said, bars_height(len(chosen)), partial(draw_shares, data=data), data, "Fig. 16")

    inside, outside = comparison.in_plane, comparison.out_of_plane
    lines = {
        "in-plane, all": (100 * inside.mean_absolute_relative_difference, inside.level_of_agreement),
        "out-of-plane, all": (100 * outside.mean_absolute_relative_difference, outside.level_of_agreement),
        "Jaanson et al., in-plane": (float("nan"), TABLE_VI[1].level_of_agreement[0]),
        "Jaanson et al., out-of-plane": (float("nan"), TABLE_VI[1].level_of_agreement[1]),
    }

    def means(chosen: Sequence[Plane], stem: str, said: str) -> Plot:
        data = mean_columns(chosen, [named[id(plane)] for plane in chosen])
        draw = partial(draw_means, data=data, lines=lines)
        return Plot(stem, said, bars_height(len(chosen)), draw, data, "Fig. 17")

    first = "Points of every plane by category for the three metrics; labels: per cent of the plane's points."
    second = (
        "Mean relative deviation and mean level of agreement of every plane. Lines: all in-plane and all out-of-plane"
        " points of this run, and the level of agreement that Jaanson et al. reported."
    )
    return [
        *in_parts(comparison.planes, _BARS, "fig_16_categories", first, shares),
        *in_parts(comparison.planes, _BARS, "fig_17_means", second, means),
    ]


def share_columns(groups: Sequence[tuple[str, Group]]) -> dict[str, list[Any]]:
    """Numbers of points of groups by metric and category."""
    data: dict[str, list[Any]] = {
        "plane": [name for name, _ in groups],
        "points": [group.points for _, group in groups],
    }
    for metric, _ in METRICS:
        for category in Category:
            name = category.name.lower()
            counts = [round(getattr(group.shares[metric], name) * group.points) for _, group in groups]
            data[f"{metric}_{name}"] = counts
    return data


def mean_columns(planes: Sequence[Plane], names: Sequence[str]) -> dict[str, list[Any]]:
    """Mean metrics of planes."""
    turned = [np.mod(plane.sensor_azimuth - plane.illumination_azimuth, 180.0) for plane in planes]
    return {
        "plane": list(names),
        "in_plane": [int(min(angle, 180.0 - angle) < 1e-6) for angle in turned],
        "points": [plane.group.points for plane in planes],
        "mean_absolute_relative_difference_percent": [
            100 * plane.group.mean_absolute_relative_difference for plane in planes
        ],
        "level_of_agreement": [plane.group.level_of_agreement for plane in planes],
    }
