"""Pictures of a design study: polar maps of the hemispherical pattern (paper, Fig. 4) and scores along a sweep.

The radius of a map is the zenith. A line below the maps says what the marks are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from instrument.facility import Arms
from instrument.plan import Plan
from twin.design.pattern import measurable
from twin.design.study import Judgement
from twin.figures import BLACK, BLUE, GREEN, ORANGE, VERMILION

_DPI = 130
_COLOURS = "viridis"
_LINES = 8


def draw_pattern(found: Judgement, arms: Arms, path: Path, plan: Plan | None = None) -> Path:
    """Polar maps of one candidate, one for each illumination."""
    lights = found.pattern["illumination_zenith"].values
    figure = Figure(figsize=(3.6 * len(lights) + 0.9, 4.5))
    norm = _norm([found])
    for number, light in enumerate(lights):
        axis: Any = figure.add_subplot(1, len(lights), number + 1, projection="polar")
        mapped = _map(axis, found, number, norm, arms)
        if plan is not None:
            _mark_points(axis, plan, float(light))
        rho = float(found.pattern["hemispherical_reflectance"].values[number])
        axis.set_title(f"illumination zenith {light:g}°\nhemispherical reflectance {rho:.3f}", fontsize=10)
    figure.suptitle(found.candidate.name, fontsize=11, y=0.975)
    left, right = 0.4 / figure.get_figwidth(), 1 - 1.35 / figure.get_figwidth()
    figure.subplots_adjust(left=left, right=right, bottom=0.1, top=0.79, wspace=0.22)
    _explain(figure, plan is not None)
    bar = figure.add_axes((1 - 0.8 / figure.get_figwidth(), 0.17, 0.13 / figure.get_figwidth(), 0.5))
    _scale(figure, mapped, bar)
    return _save(figure, path)


def draw_candidates(judgements: list[Judgement], arms: Arms, path: Path) -> Path:
    """Small maps of all candidates with common colours: a row a candidate, a column an illumination."""
    lights = judgements[0].pattern["illumination_zenith"].values
    height = 2.3 * len(judgements) + 0.8
    figure = Figure(figsize=(2.4 * len(lights) + 1.9, height))
    norm = _norm(judgements)
    for row, found in enumerate(judgements):
        for column, light in enumerate(lights):
            place = row * len(lights) + column + 1
            axis: Any = figure.add_subplot(len(judgements), len(lights), place, projection="polar")
            mapped = _map(axis, found, column, norm, arms, small=True)
            if row == 0:
                axis.set_title(f"illumination {light:g}°", fontsize=9)
            if column == 0:
                text = found.candidate.name.replace(", ", "\n")
                axis.text(-0.12, 0.5, text, transform=axis.transAxes, rotation=90, va="center", ha="right", fontsize=9)
    width = figure.get_figwidth()
    figure.subplots_adjust(
        left=0.75 / width, right=1 - 1.1 / width, bottom=0.4 / height, top=1 - 0.5 / height, wspace=0.1, hspace=0.12
    )
    _explain(figure, False)
    size = min(0.8, 4.0 / height)
    bar = figure.add_axes((1 - 0.8 / width, 0.5 - size / 2, 0.13 / width, size))
    _scale(figure, mapped, bar)
    return _save(figure, path)


def draw_sweep(judgements: list[Judgement], path: Path) -> Path:
    """Scores of the candidates: what can be seen above, what can be told apart below."""
    numeric = _axis_values(judgements)
    places = np.arange(len(judgements), dtype=float) if numeric is None else numeric
    apart = judgements[0].separation is not None
    figure = Figure(figsize=(9.2 if apart else 7.4, 7.2 if apart else 3.6), layout="constrained")
    upper: Any = figure.add_subplot(2 if apart else 1, 1, 1)
    lower: Any = figure.add_subplot(2, 1, 2, sharex=upper) if apart else upper
    _draw_signal(upper, places, judgements)
    if apart:
        _draw_distinct(lower, places, judgements)
    if numeric is None:
        lower.set_xticks(places, [found.candidate.name.replace(", ", "\n") for found in judgements], fontsize=8)
    else:
        name = next(iter(judgements[0].candidate.changes))
        lower.set_xlabel(f"{name.replace('_', ' ')} / mm")
    return _save(figure, path)


def _axis_values(judgements: list[Judgement]) -> np.ndarray | None:
    """Values of the swept length; None where several parameters or shapes were swept."""
    changes = [found.candidate.changes for found in judgements]
    if any(len(change) != 1 or any(isinstance(value, str) for value in change.values()) for change in changes):
        return None
    return np.array([float(next(iter(change.values()))) for change in changes])


def _draw_signal(axis: Axes, places: np.ndarray, judgements: list[Judgement]) -> None:
    """Two quantities of very different size: each has an axis of its own in its colour."""
    structure, share = (
        100 * np.array([getattr(f.signal, name) for f in judgements]) for name in ("structure", "share")
    )
    other = axis.twinx()
    for own, label, marker, colour, values in (
        (axis, "structure of the pattern\non measurable directions / %", "o-", BLUE, structure),
        (other, "part of all structure that is on\nmeasurable directions / %", "s--", ORANGE, share),
    ):
        own.plot(places, values, marker, color=colour, ms=5, lw=1.2)
        own.set_ylabel(label, color=colour)
        own.tick_params(axis="y", colors=colour)
    axis.set_ylim(0, 1.1 * max(float(structure.max()), 1e-3))
    other.set_ylim(0, 105)
    axis.grid(True, lw=0.4, alpha=0.5)


def _draw_distinct(axis: Axes, places: np.ndarray, judgements: list[Judgement]) -> None:
    found = [judgement.separation for judgement in judgements if judgement.separation is not None]
    effects = list(dict.fromkeys(name for one in found for name in one.effects))
    styles = [(c, m) for m in ("o-", "s--", "^:") for c in (BLUE, ORANGE, GREEN, VERMILION)]
    for number, effect in enumerate(effects):
        values = [one.distinct[one.effects.index(effect)] if effect in one.effects else np.nan for one in found]
        colour, style = styles[number % len(styles)]
        axis.plot(places, values, style, color=colour, ms=4, lw=1.1, label=effect.replace("_", " "))
    axis.plot(places, [one.score for one in found], "D-", color=BLACK, ms=5, lw=2, label="geometric mean")
    axis.set_yscale("log")
    for every in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
        every(FuncFormatter(_plain_number))
    axis.set_ylabel("standard deviations at which an effect\nof its usual size stands out from the others")
    axis.grid(True, which="both", lw=0.4, alpha=0.4)
    axis.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _plain_number(value: float, _: int | None = None) -> str:
    """Labels 1, 2 and 5 of each decade, not as powers."""
    digit = round(value / 10.0 ** np.floor(np.log10(value)))
    return f"{value:g}" if digit in (1, 2, 5) else ""


def _norm(judgements: list[Judgement]) -> Normalize:
    values = np.concatenate([found.pattern["brf"].values.ravel() for found in judgements])
    low, high = float(values.min()), float(values.max())
    if high - low < 0.02 * high:  # a flat sample: noise is not to look like a pattern
        low, high = 0.9 * low, 1.1 * high
    return Normalize(low, high)


def _map(axis: Any, found: Judgement, number: int, norm: Normalize, arms: Arms, *, small: bool = False) -> Any:
    pattern = found.pattern
    zenith, azimuth = pattern["zenith"].values, pattern["azimuth"].values
    step = zenith[1] - zenith[0]
    brf = pattern["brf"].values[number]
    # The pole is the mean of the innermost ring, the circle is closed, and the last ring reaches the horizon.
    rings = np.concatenate([[0.0], zenith, [zenith[-1] + step / 2]])
    values = np.concatenate([np.full((1, brf.shape[1]), brf[0].mean()), brf, brf[-1:]])
    values = np.concatenate([values, values[:, :1]], axis=1)
    around = np.deg2rad(np.concatenate([azimuth, [azimuth[0] + 360.0]]))
    levels = np.linspace(norm.vmin or 0.0, norm.vmax or 1.0, 40)
    mapped = axis.contourf(around, rings, values, levels=levels, cmap=_COLOURS, norm=norm, extend="both")
    if not small and np.ptp(values) > 0.02 * values.max():
        axis.contour(around, rings, values, levels=levels[2 :: len(levels) // _LINES], colors="white", linewidths=0.35,
                     alpha=0.6)  # fmt: skip
    light = float(pattern["illumination_zenith"].values[number])
    _hatch(axis, arms, light)
    axis.plot([0.0], [light], "*", ms=6 if small else 10, color=ORANGE, mec=BLACK, mew=0.5)
    axis.set_rlim(0, 90)
    axis.set_rticks([30, 60] if small else [30, 60, 90])
    axis.set_rlabel_position(112)
    axis.set_thetagrids(range(0, 360, 90), labels=[] if small else [f"{a}°" for a in range(0, 360, 90)])
    axis.tick_params(labelsize=6 if small else 8, pad=1)
    axis.grid(lw=0.4, alpha=0.5, color="white")
    for label in axis.get_yticklabels():
        label.set_color("white")
    return mapped


def _scale(figure: Figure, mapped: Any, place: Axes) -> None:
    low, high = mapped.norm.vmin, mapped.norm.vmax
    ticks = [tick for tick in MaxNLocator(6).tick_values(low, high) if low <= tick <= high]
    bar = figure.colorbar(mapped, cax=place, ticks=ticks, format="%.2f", extendfrac=0.0)
    bar.set_label("reflectance factor", fontsize=9)
    place.tick_params(labelsize=8)


def _explain(figure: Figure, with_plan: bool) -> None:
    """A line below the maps that says what the marks are."""
    marks = [
        Line2D([], [], ls="", marker="*", ms=9, color=ORANGE, mec=BLACK, mew=0.5, label="illumination"),
        Patch(facecolor="none", edgecolor=BLACK, lw=0.6, hatch="//////", label="cannot be measured"),
    ]
    if with_plan:
        marks.append(
            Line2D([], [], ls="", marker="o", ms=4, color="white", mec=BLACK, mew=0.5, label="points of the plan")
        )
    figure.legend(handles=marks, loc="lower center", ncols=len(marks), fontsize=8, frameon=False)


def _hatch(axis: Any, arms: Arms, light: float) -> None:
    """Directions that cannot be measured."""
    azimuth, zenith = np.arange(0.0, 360.5, 1.0), np.arange(0.0, 90.5, 0.5)
    seen = measurable(arms, light, zenith[:, None], azimuth[None, :]).astype(float)
    if seen.all():
        return
    axis.contourf(
        np.deg2rad(azimuth), zenith, seen, levels=[-0.5, 0.5], colors=["none"], hatches=["//////"], extend="neither"
    )
    if seen.any():
        axis.contour(np.deg2rad(azimuth), zenith, seen, levels=[0.5], colors=[BLACK], linewidths=0.6)


def _mark_points(axis: Any, plan: Plan, light: float) -> None:
    points = [point for point in plan.points if point.illumination_zenith == light]
    zenith = np.array([point.sensor_zenith for point in points])
    azimuth = np.deg2rad([point.sensor_azimuth for point in points]) + np.where(zenith < 0, np.pi, 0.0)
    axis.plot(azimuth, np.abs(zenith), "o", ms=2.4, color="white", mec=BLACK, mew=0.3)


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=_DPI)
    return path
