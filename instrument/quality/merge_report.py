"""What a merge found, for people and for programs."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from scipy import special

from instrument.quality.merge import run_factors


def merge_summary(merged: xr.Dataset) -> dict[str, Any]:
    """The content of ``goniotwin runs merge --json``."""
    brf, u = merged["brf"].values, merged["u_brf"].values
    attributes = merged.attrs
    q, expected = float(attributes["between_run_q"]), int(attributes["between_run_q_expected"])
    factors = run_factors(merged)
    counts = np.sum(np.isfinite(merged["run_brf"].values), axis=1)
    return {
        "points": int(merged.sizes["point"]),
        "points_in_every_run": int(np.sum(merged["run_count"].values == len(factors))),
        "points_left_out": int(attributes["points_left_out"]),
        "runs": [
            {"run": str(name), "points": int(count), "factor": float(factor)}
            for name, count, factor in zip(attributes["merged_runs"], counts, factors, strict=True)
        ],
        "method": str(attributes["between_run_method"]),
        "stability": str(attributes["between_run_stability"]),
        "between_run_standard_deviation": float(attributes["between_run_standard_deviation"]),
        "q": q,
        "q_expected": expected,
        "p_value": float(special.chdtrc(expected, q)),
        "relative_u_brf": [float(value) for value in np.percentile(u / np.abs(brf), [0, 50, 100])],
        "coverage_factor": [
            float(value) for value in np.percentile(merged["brf_coverage_factor"].values, [0, 50, 100])
        ],
    }


def print_merge(summary: dict[str, Any], console: Console) -> None:
    """Write a summary of :func:`merge_summary` for people."""
    table = Table("run", "points", "over the mean / %")
    for row in summary["runs"]:
        table.add_row(escape(row["run"]), str(row["points"]), f"{100 * (row['factor'] - 1):+.2f}")
    console.print(table)
    console.print(f"{summary['points_in_every_run']} of {summary['points']} points are in every run")
    if summary["points_left_out"]:
        console.print(f"{summary['points_left_out']} readings left out: saturated, overloaded or shadowed")
    console.print(
        f"between the runs {100 * summary['between_run_standard_deviation']:.2f} % (k = 1, {summary['method']});"
        f" Q = {summary['q']:.1f} where noise alone leaves {summary['q_expected']}, p = {summary['p_value']:.2g}"
    )
    if float(special.chdtr(summary["q_expected"], summary["q"])) < _TOO_GOOD:
        console.print("they agree better than their noise lets them: are these measurements of their own?")
    console.print(f"uncertainty of remounting: {_MEANING[summary['stability']]}")
    low, median, high = (100 * value for value in summary["relative_u_brf"])
    console.print(
        f"combined standard uncertainty {low:.2f} to {high:.2f} %, median {median:.2f} %;"
        f" median coverage factor {summary['coverage_factor'][1]:.2f}"
    )


#: Runs that agree this well or better by chance are looked at again.
_TOO_GOOD = 1e-3
_MEANING = {
    "found": "as the runs scatter, with one degree of freedom less than runs",
    "stated": "as the budget of the runs states, over the root of their number",
    "larger": "as the runs scatter or as their budget states, whichever is more",
}
