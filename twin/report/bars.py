"""Bars by azimuth plane (paper, Figs. 16 and 17)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from twin.figures import BLACK, BLUE, CATEGORY_STYLE, ORANGE, VERMILION
from twin.metrics import Category
from twin.report.document import Columns

#: The three metrics: column prefix and title.
METRICS = (("relative_difference", r"$|\Delta R^\star|$"), ("t", "$|t'|$"), ("level_of_agreement", "$n'$"))
_LINES = ((BLACK, "--"), (BLACK, ":"), (VERMILION, "--"), (VERMILION, ":"))
_HATCHES = {Category.GOOD: "", Category.ACCEPTABLE: "///", Category.POOR: "xxx"}


def bars_height(rows: int) -> float:
    """Height in inch of :func:`draw_shares` and :func:`draw_means`."""
    return 0.235 * rows + 1.1


def draw_shares(figure: FigureBase, data: Columns) -> None:
    """Points of every plane in the three categories; labels are per cent of the plane's points.

    Parameters
    ----------
    data
        ``plane``, ``points`` and, for each metric, ``METRIC_good``, ``_acceptable`` and ``_poor``: numbers of points.
    """
    axes = _side_by_side(figure, len(data["plane"]), 3, list(data["plane"]))
    for axis, (metric, title) in zip(axes, METRICS, strict=True):
        left = np.zeros(len(data["plane"]))
        whole = np.asarray(data["points"], dtype=float)
        for category, (colour, _, _) in CATEGORY_STYLE.items():
            counts = np.asarray(data[f"{metric}_{category.name.lower()}"], dtype=float)
            places = np.arange(len(counts))[::-1]
            axis.barh(
                places,
                counts,
                left=left,
                height=0.74,
                color=colour,
                hatch=_HATCHES[category],
                edgecolor="white",
                lw=0,
                label=category.name.lower(),
            )
            for place, start, count, total in zip(places, left, counts, whole, strict=True):
                if count / total >= 0.1:
                    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8}
                    percent = f"{100 * count / total:.0f}"
                    axis.text(start + count / 2, place, percent, ha="center", va="center", fontsize=6, bbox=box)
            left += counts
        axis.set_title(title, fontsize=8.5, pad=3)
        axis.set_xlabel("points", fontsize=7.5, labelpad=2)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=3, fontsize=7.5, frameon=False, borderpad=0.1)


def draw_means(figure: FigureBase, data: Columns, lines: dict[str, tuple[float, float]]) -> None:
    """Mean metrics of every plane (paper, Fig. 17).

    Parameters
    ----------
    data
        ``plane``, ``in_plane`` (1 or 0), ``mean_absolute_relative_difference_percent`` and ``level_of_agreement``.
    lines
        By label: dashed lines in the left and in the right panel, nan for none.
    """
    axes = _side_by_side(figure, len(data["plane"]), 2, list(data["plane"]))
    inside = np.asarray(data["in_plane"], dtype=bool)
    names = ("mean_absolute_relative_difference_percent", "level_of_agreement")
    titles = (r"mean $|\Delta R^\star|$ / %", "mean $n'$")
    for panel, (axis, name, title) in enumerate(zip(axes, names, titles, strict=True)):
        values = np.asarray(data[name], dtype=float)
        places = np.arange(len(values))[::-1]
        for chosen, colour, hatch, label in ((inside, BLUE, "", "in-plane"), (~inside, ORANGE, "///", "out-of-plane")):
            axis.barh(
                places[chosen],
                values[chosen],
                height=0.74,
                color=colour,
                hatch=hatch,
                edgecolor="white",
                lw=0,
                label=label,
            )
        for place, value in zip(places, values, strict=True):
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.85}
            axis.text(
                value + 0.012 * values.max(), place, f"{value:.2f}", va="center", fontsize=6.5, bbox=box, zorder=4
            )
        axis.set_title(title, fontsize=8.5, pad=3)
        for (label, both), (colour, style) in zip(lines.items(), _LINES, strict=False):
            if np.isfinite(both[panel]):
                axis.axvline(both[panel], color=colour, lw=1.1, ls=style, label=label)
        axis.set_xlim(
            0, 1.14 * max(values.max(), *(both[panel] for both in lines.values() if np.isfinite(both[panel])))
        )
    found: dict[str, object] = {}
    for axis in axes:
        found |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    labels = [*sorted(name for name in found if name not in lines), *(name for name in lines if name in found)]
    handles: list[Any] = [found[name] for name in labels]
    figure.legend(
        handles, labels, loc="upper center", ncols=3, fontsize=7, frameon=False, borderpad=0.1, handlelength=3.2
    )


def _side_by_side(figure: FigureBase, rows: int, panels: int, names: list[str]) -> list[Axes]:
    height = bars_height(rows)
    margins = {"left": 0.2, "right": 0.985, "bottom": 0.36 / height, "top": 1 - 0.62 / height, "wspace": 0.09}
    axes = list(np.ravel(figure.subplots(1, panels, sharey=True, gridspec_kw=margins)))
    axes[0].set_yticks(np.arange(rows)[::-1], names, fontsize=7)
    axes[0].set_ylim(-0.6, rows - 0.4)
    for axis in axes:
        axis.tick_params(labelsize=7)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(True, axis="x", lw=0.4, alpha=0.5)
        axis.set_axisbelow(True)
    return axes
