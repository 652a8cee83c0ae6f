"""The budget of a run as a table, for people and for programs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from instrument.budget import COMPONENTS
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.plan import describe
from instrument.quality.coverage import PROBABILITY
from instrument.run_budget import COVERAGE, EXPANDED, FREEDOM, add_coverage, component_freedom
from instrument.run_check import component_names

#: Smaller parts, in per cent of the BRF, are shown as less than this.
_LEAST = 0.005
_ROWS = {name: row.replace("_", " ") for row, name in COMPONENTS.items()}


def budget_summary(run: xr.Dataset, source: str, point: int | None = None) -> dict[str, Any]:
    """The content of ``goniotwin budget --json``.

    Parameters
    ----------
    point
        Row of one point; over all points where it is None.

    Returns
    -------
    dict
        ``components`` in the order of the file; every part in per cent of brf, as least, median and greatest over the
        points; degrees of freedom None where they are infinite.

    Raises
    ------
    InputError
        If the run has no components, or no such point.
    """
    names = component_names(run)
    if not names:
        raise InputError(f"{source}: no uncertainty components; u_brf alone makes no budget")
    data = _with_coverage(run, names)
    count = data.sizes["point"]
    if point is not None and not 0 <= point < count:
        raise InputError(f"--point: found {point}; expected 0 to {count - 1}")
    rows = np.arange(count) if point is None else np.array([point])
    brf = np.abs(data["brf"].values[rows])
    summary: dict[str, Any] = {"source": source, "points": len(rows), "point": point}
    if point is not None:
        names_of = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
        summary["geometry"] = {name: float(data[name].values[point]) for name in names_of}
        summary["brf"] = float(data["brf"].values[point])
    summary["components"] = [_component(data, name, rows, brf) for name in names]
    summary["combined"] = _percent(data["u_brf"].values[rows] / brf)
    summary["effective_degrees_of_freedom"] = _freedom(data[FREEDOM].values[rows])
    summary["coverage_probability"] = float(data[EXPANDED].attrs.get("coverage_probability", PROBABILITY))
    summary["coverage_factor"] = _spread(data[COVERAGE].values[rows])
    summary["expanded"] = _percent(data[EXPANDED].values[rows] / brf)
    summary |= _bursts(data, rows)
    return summary


def print_budget(summary: dict[str, Any], console: Console) -> None:
    """Write a summary of :func:`budget_summary` for people."""
    console.print(f"[bold]{escape(summary['source'])}[/bold]: {_of(summary)}", soft_wrap=True)
    table = Table("source of uncertainty", title_justify="left")
    one = summary["point"] is not None
    table.add_column("in BRF / %", justify="right")
    if not one:
        table.add_column("median", justify="right")
    table.add_column("correlation of points")
    table.add_column("degrees of freedom", justify="right")
    for row in summary["components"]:
        table.add_row(row["name"], *_shown(row["percent"], one), row["correlation"], _many(row["degrees_of_freedom"]))
    table.add_section()
    freedom = summary["effective_degrees_of_freedom"]
    table.add_row("combined (k = 1)", *_shown(summary["combined"], one), "", _many(freedom))
    percent = f"{100 * summary['coverage_probability']:.4g} %"
    table.add_row(f"expanded ({_factor(summary['coverage_factor'])}, {percent})", *_shown(summary["expanded"], one))
    console.print(table)
    for row in summary["components"]:
        if row["source"]:
            console.print(f"{row['name']}: {escape(row['source'])}", soft_wrap=True)
    _print_slopes(summary.get("slopes", []), console)
    _print_bursts(summary, console)


def _print_slopes(rows: list[dict[str, Any]], console: Console) -> None:
    for row in rows:
        low, median, high = row["slope"]
        if high > 1.5 * row["stated"][2]:
            console.print(
                f"{row['angle'].replace('_', ' ')}: by the slope of what was measured {row['u_degree']:g} degrees make"
                f" {low:.2f} to {high:.2f} %, median {median:.2f} %; the budget states {row['stated'][0]:.2f} to"
                f" {row['stated'][2]:.2f} % (goniotwin budget RUN --slopes)",
                soft_wrap=True,
            )


def _print_bursts(summary: dict[str, Any], console: Console) -> None:
    if "scatter" in summary:
        low, median, high = summary["scatter"]
        console.print(
            f"standard error of the samples themselves: {low:.2f} to {high:.2f} %, median {median:.2f} %",
            soft_wrap=True,
        )
    if "outliers" in summary:
        console.print(
            f"outliers among the samples: in {summary['outliers']} of {summary['points']} points"
            f" (about {0.014 * summary['points']:.1f} by chance); all are kept",
            soft_wrap=True,
        )


def _with_coverage(run: xr.Dataset, names: list[str]) -> xr.Dataset:
    if {EXPANDED, COVERAGE, FREEDOM} <= set(map(str, run.variables)):
        return run
    data = run.copy()
    data["brf"].attrs["unc_comps"] = names
    add_coverage(data)
    return data


def _component(data: xr.Dataset, name: str, rows: np.ndarray, brf: np.ndarray) -> dict[str, Any]:
    attributes = data[name].attrs
    form = attributes.get("err_corr_1_form")
    freedom = np.broadcast_to(component_freedom(data, name), data["brf"].shape)[rows]
    return {
        "variable": name,
        "name": _ROWS.get(name, name.removeprefix("u_brf_").replace("_", " ")),
        "percent": _percent(data[name].values[rows] / brf),
        "correlation": _FORMS.get(str(form), str(form)) if form is not None else "not stated",
        "degrees_of_freedom": _freedom(freedom),
        "source": str(attributes.get("source", "")),
    }


_FORMS = {"random": "random", "systematic": "systematic", "err_corr_matrix": "matrix in the file"}


def _bursts(data: xr.Dataset, rows: np.ndarray) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if "brf_standard_error" in data:
        found["scatter"] = _percent(data["brf_standard_error"].values[rows] / np.abs(data["brf"].values[rows]))
    if "outliers" in data:
        found["outliers"] = int(np.sum(data["outliers"].values[rows] > 0))
    return found


def _spread(values: ArrayLike) -> list[float]:
    return [float(value) for value in np.percentile(np.asarray(values, dtype=float), [0, 50, 100])]


def _percent(relative: ArrayLike) -> list[float]:
    return _spread(100 * np.asarray(relative, dtype=float))


def _freedom(values: ArrayLike) -> list[float | None]:
    """Least, median and greatest; None for infinite."""
    ordered = np.sort(np.asarray(values, dtype=float))
    picked = (ordered[0], ordered[(len(ordered) - 1) // 2], ordered[-1])
    return [float(value) if math.isfinite(value) else None for value in picked]


def _of(summary: dict[str, Any]) -> str:
    if summary["point"] is None:
        return f"uncertainty budget of {summary['points']} points"
    where = describe(Geometry(**summary["geometry"]))
    return f"uncertainty budget of point {summary['point']}, {where}: brf {summary['brf']:.5g}"


def _shown(percent: list[float], one: bool) -> tuple[str, ...]:
    low, median, high = (_number(value) for value in percent)
    if one:
        return (median,)
    return (low if low == high else f"{low} to {high}", median)


def _number(percent: float) -> str:
    return f"{percent:.2f}" if percent >= _LEAST or percent == 0 else "<0.01"


def _many(freedom: list[float | None]) -> str:
    low, _, high = ("\N{INFINITY}" if value is None else f"{value:.0f}" for value in freedom)
    return low if low == high else f"{low} to {high}"


def _factor(factors: list[float]) -> str:
    low, high = (f"{value:.2f}" for value in (factors[0], factors[2]))
    return f"k = {low}" if low == high else f"k = {low} to {high}"
