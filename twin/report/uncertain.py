"""Dimensions of the sample and the uncertainty budgets (paper, Tables I and II)."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from instrument.artifact import ArtifactDimensions, Holes
from instrument.errors import InputError
from instrument.quality.budget_report import budget_summary
from twin.report.document import Block, LeftOut, Points, Table
from twin.report.words import fixed, number

#: Smaller parts, in per cent, are shown as less than this.
_LEAST = 0.005


def dimensions_table(artifact: ArtifactDimensions) -> Table:
    """Dimensions with their standard uncertainties (Table I).

    The value of a mean is followed by the standard deviation over the holes and by the mean of what was stated for one.
    """
    form, holes = artifact.form, artifact.holes
    rows = [["outline", " x ".join(f"{side:g}" for side in form.outline), "", "", "mm"]]
    if artifact.mesh is not None:
        rows.append(["mesh in place of dimensions", artifact.mesh.name, "", "", ""])
    if len(holes):
        rows.append(["holes", str(len(holes)), "", "", ""])
        rows.append(["mean hole diameter", *_mean(holes.diameter, holes.u_diameter), "mm"])
        if (spacing := hole_spacings(holes)) is not None:
            u = np.sqrt(2) * (holes.u_x + holes.u_y) / 2  # both ends, along the row
            rows.append(["mean hole centre spacing", *_mean(spacing, u), "mm"])
        rows.append(["hole plate thickness", f"{form.plate_thickness:g}", "", number(form.u_plate_thickness, 2), "mm"])
        rows.append(
            ["top of hole plate to top of block", f"{form.cavity_depth:g}", "", number(form.u_cavity_depth, 2), "mm"]
        )
        if np.any(artifact.chamfers > 0):
            rows.append(["mean chamfer of hole edges", *_mean(artifact.chamfers, artifact.u_chamfers), "mm"])
        for axis in ("x", "y"):
            tilt, u_tilt = getattr(form, f"block_tilt_{axis}"), getattr(form, f"u_block_tilt_{axis}")
            if tilt or u_tilt:
                rows.append([f"tilt of the block about {axis}", f"{tilt:g}", "", number(u_tilt, 2), "degree"])
        rows.append(["block thickness", f"{form.block_thickness:g}", "", "", "mm"])
        rows.append(["width of the spacer's edge", f"{form.spacer_edge:g}", "", "", "mm"])
    else:
        rows.append(["holes", "none: a flat sample", "", "", ""])
    caption = (
        "Dimensions of the sample as its artifact.toml and table of holes state them. Flatness of plate and block is"
        " not part of those files."
    )
    header = ["quantity", "value", "standard deviation over holes", "standard uncertainty stated for one", "unit"]
    return Table("table_01_dimensions", caption, header, rows, (1, 2, 3), "Table I")


def hole_spacings(holes: Holes) -> np.ndarray | None:
    """Distances in mm of holes from their nearest neighbours along rows and columns; None for fewer than two.

    Neighbours are pairs no farther apart than 1.2 times the least distance; every pair counts once.
    """
    if len(holes) < 2:
        return None
    apart = np.hypot(holes.x[:, None] - holes.x, holes.y[:, None] - holes.y)
    pairs = apart[np.triu_indices(len(holes), k=1)]
    return pairs[pairs < 1.2 * pairs.min()]


def _mean(values: np.ndarray, u: np.ndarray) -> list[str]:
    spread = f"{np.std(values, ddof=1):.2g}" if len(values) > 1 else ""
    return [f"{np.mean(values):.4f}", spread, f"{np.mean(u):.2g}"]


def budget_blocks(run: xr.Dataset) -> list[Block]:
    """The measurement's budget (Table II)."""
    try:
        summary = budget_summary(run, "run")
    except InputError as error:
        return [LeftOut("Table II: uncertainty budget of the measurement", str(error).removeprefix("run: "))]
    lines = [f"{row['name']}: {row['source']}." for row in summary["components"] if row["source"]]
    if "scatter" in summary:
        low, median, high = summary["scatter"]
        lines.append(
            f"Standard error of the samples themselves, beside the budget: {low:.2f} to {high:.2f} %, median"
            f" {median:.2f} %."
        )
    if "outliers" in summary:
        lines.append(
            f"Outliers among the samples: in {summary['outliers']} of {summary['points']} points (about"
            f" {0.014 * summary['points']:.1f} by chance); all are kept."
        )
    return [budget_table(summary), *([Points(lines)] if lines else [])]


def budget_table(summary: dict[str, Any]) -> Table:
    """A summary of :func:`~instrument.quality.budget_report.budget_summary` as a table."""
    rows = [
        [row["name"], *_percent(row["percent"]), row["correlation"], _freedom(row["degrees_of_freedom"])]
        for row in summary["components"]
    ]
    rows.append(
        ["combined (k = 1)", *_percent(summary["combined"]), "", _freedom(summary["effective_degrees_of_freedom"])]
    )
    low, _, high = summary["coverage_factor"]
    factor = f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} to {high:.2f}"
    expanded = f"expanded (k = {factor}, {100 * summary['coverage_probability']:.4g} %)"
    rows.append([expanded, *_percent(summary["expanded"]), "", ""])
    header = ["source of uncertainty", "least / %", "median / %", "greatest / %", "correlation", "degrees of freedom"]
    caption = f"Uncertainty budget of the measured reflectance factor, per cent of it, over {summary['points']} points."
    return Table("table_02_budget", caption, header, rows, (1, 2, 3, 5), "Table II")


def prediction_budget(prediction: xr.Dataset) -> Block:
    """What contributes to the uncertainty of the simulation, where the prediction says so."""
    what = "uncertainty budget of the simulation"
    if "variance_share" not in prediction or "source" not in prediction.variables:
        return LeftOut(
            what, "the prediction has no shares of the variance (goniotwin predict --uncertainty writes them)"
        )
    brf, total = (np.asarray(prediction[name].values) for name in ("brf", "u_brf"))
    whole = float(np.mean((total / brf) ** 2))
    rows = []
    for source in map(str, prediction["source"].values):
        own = np.asarray(prediction["variance_share"].sel(source=source).values) * (total / brf) ** 2
        mean = max(0.0, float(np.mean(own)))
        rows.append([source, fixed(100 * np.sqrt(mean), 2), fixed(100 * mean / whole, 1)])
    rows.append(["combined", fixed(100 * np.sqrt(whole), 2), "100.0"])
    header = ["source", "root mean square in BRF / %", "share of variance / %"]
    caption = "Uncertainty budget of the simulation (k = 1) over its points; small negative estimates count as nothing."
    return Table("prediction_budget", caption, header, rows, (1, 2))


def _percent(values: list[float]) -> list[str]:
    return [f"{value:.2f}" if value >= _LEAST or value == 0 else "<0.01" for value in values]


def _freedom(values: list[float | None]) -> str:
    low, _, high = ("∞" if value is None else f"{value:.0f}" for value in values)
    return low if low == high else f"{low} to {high}"
