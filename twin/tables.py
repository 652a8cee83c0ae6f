"""The comparison as tables for a terminal: by azimuth plane, and beside the paper's Table VI."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rich import box
from rich.console import Group as Stack
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from twin.comparison import Comparison, Group, Shares


@dataclass(frozen=True)
class Published:
    """One study's column of Table VI: level of agreement and relative RMSE, in-plane, out-of-plane, global."""

    study: str
    level_of_agreement: tuple[float, float, float]
    relative_rmse: tuple[float, float, float]


#: Table VI of Leroy et al. (2025), DOI 10.1109/TGRS.2025.3547305.
TABLE_VI = (
    Published("Leroy et al.", (0.84, 0.86, 0.86), (0.026, 0.022, 0.023)),
    Published("Jaanson et al.", (0.72, 0.45, 0.60), (0.19, 0.64, 0.45)),
)

_METRICS = {"relative_difference": "|dR*|", "t": "|t'|", "level_of_agreement": "n'"}


def comparison_tables(comparison: Comparison) -> list[RenderableType]:
    """Everything a person should see of a comparison, top to bottom."""
    return [plane_table(comparison), aggregate_table(comparison), remarks(comparison)]


def plane_table(comparison: Comparison) -> Table:
    """One row per azimuth plane: points, averages, and the shares of the categories of Table V."""
    table = Table(
        title="By azimuth plane (illumination zenith, sensor azimuth)",
        caption="g/a/p: good, acceptable, poor, in % of the points. |dR*| good to 2 %, acceptable to 4 %; |t'| to 1,"
        " to 2; n' from 95 %, from 50 %.",
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    several = len({plane.wavelength for plane in comparison.planes}) > 1
    table.add_column("plane", no_wrap=True)
    for heading in ("points", "mean\n|dR*|", "rel.\nRMSE", "rms\nt'", "mean\nn'"):
        table.add_column(heading, justify="right", no_wrap=True)
    for symbol in _METRICS.values():
        table.add_column(f"{symbol}\ng/a/p", justify="right", no_wrap=True)
    for plane in comparison.planes:
        wavelength = f"{plane.wavelength:g} nm, " if several else ""
        table.add_row(f"{wavelength}{plane.illumination_zenith:g}°, {plane.sensor_azimuth:g}°", *_cells(plane.group))
    table.add_section()
    table.add_row("in-plane", *_cells(comparison.in_plane))
    table.add_row("out-of-plane", *_cells(comparison.out_of_plane))
    table.add_row("global", *_cells(comparison.overall), style="bold")
    return table


def aggregate_table(comparison: Comparison) -> Table:
    """The figures of Table VI beside the published ones."""
    table = Table(title="Beside the paper's Table VI", title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("metric")
    table.add_column("this run", justify="right", style="bold")
    for published in TABLE_VI:
        table.add_column(published.study, justify="right")
    groups = {"in-plane": comparison.in_plane, "out-of-plane": comparison.out_of_plane, "global": comparison.overall}
    for row, (name, group) in enumerate(groups.items()):
        level = [f"{published.level_of_agreement[row]:.2f}" for published in TABLE_VI]
        table.add_row(f"level of agreement ({name})", _fixed(group.level_of_agreement, 2), *level)
    for row, (name, group) in enumerate(groups.items()):
        rmse = [_significant(published.relative_rmse[row]) for published in TABLE_VI]
        table.add_row(f"relative RMSE ({name})", _fixed(group.relative_rmse, 3), *rmse)
    return table


def remarks(comparison: Comparison) -> RenderableType:
    """How exact the simulation is, and what has to be known to read the tables."""
    median = 100 * comparison.median_relative_standard_error
    lines = [f"Ray tracer's relative standard error: {median:.2f} % (median of the points).", *comparison.notes]
    return Stack(*(Text(line) for line in lines))


def _cells(group: Group) -> list[str]:
    return [
        str(group.points),
        _percent(group.mean_absolute_relative_difference),
        _fixed(group.relative_rmse, 4),
        _fixed(group.rms_t, 2),
        _fixed(group.level_of_agreement, 2),
        *(_shares(group.shares[metric]) for metric in _METRICS),
    ]


def _shares(shares: Shares) -> str:
    values = (shares.good, shares.acceptable, shares.poor)
    return "/".join("-" if math.isnan(value) else f"{100 * value:.0f}" for value in values)


def _percent(fraction: float) -> str:
    return "-" if math.isnan(fraction) else f"{100 * fraction:.2f} %"


def _fixed(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _significant(value: float) -> str:
    return f"{value:.3f}" if value < 0.1 else f"{value:.2f}"
