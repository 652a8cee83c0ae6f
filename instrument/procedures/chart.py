"""Control chart of a long series: middle, warning and action limits, and rules (ISO 7870-2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import EXIT_DONE, EXIT_INCOMPLETE, InputError
from instrument.facility import Budget, read_facility
from instrument.output import check_new
from instrument.procedures.reading import worst
from instrument.procedures.results import CalibrationResult, read_results

#: So many first results make the limits.
BASELINE = 10
#: With fewer the middle is not known yet either.
FEWEST = 2

Level = Literal["in control", "warn", "act"]


@dataclass(frozen=True)
class Chart:
    """One series.

    Attributes
    ----------
    times, values
        Oldest first.
    middle, sigma
        Of the baseline: its mean and standard deviation. While it is short, sigma is the facility's
        ``instrument_stability``, and ``middle`` the mean of what is there; nan with fewer than two results.
    baseline
        How many of the values made the limits.
    """

    name: str
    times: tuple[datetime, ...]
    values: FloatArray
    middle: float
    sigma: float
    baseline: int

    @property
    def deviations(self) -> FloatArray:
        """Distances from the middle over sigma."""
        return np.asarray((self.values - self.middle) / self.sigma)


@dataclass(frozen=True)
class Judgement:
    """What a chart says of its last value."""

    level: Level
    reason: str = ""


def chart_of(
    results: Sequence[CalibrationResult], name: str, budget: Budget, new: tuple[datetime, float] | None = None
) -> Chart:
    """The chart of one value of a procedure's results.

    Parameters
    ----------
    results
        Oldest first; those without the value are left out.
    budget
        Its ``instrument_stability`` is sigma while the series is short.
    new
        A value that is not stored yet. It never counts for the limits.
    """
    pairs = [(result.taken, result.values[name].value) for result in results if name in result.values]
    baseline = np.array([value for _, value in pairs[:BASELINE]])
    middle = float(baseline.mean()) if baseline.size >= FEWEST else float("nan")
    sigma = float(baseline.std(ddof=1)) if baseline.size == BASELINE else middle * worst(budget.instrument_stability)
    if new is not None:
        pairs.append(new)
    return Chart(
        name,
        tuple(time for time, _ in pairs),
        np.array([value for _, value in pairs]),
        middle,
        sigma if sigma > 0 else float("nan"),
        baseline.size,
    )


def judge(chart: Chart) -> Judgement:
    """Rules for the last value: one beyond 3 sigma, or two of three beyond 2 on one side, asks to act; one beyond 2,
    or eight in a row on one side, warns.

    A series without limits yet is in control: it has to begin somewhere.
    """
    if not np.isfinite(chart.middle) or not np.isfinite(chart.sigma) or not chart.values.size:
        return Judgement("in control", "no limits yet")
    z = chart.deviations
    last = float(z[-1])
    told = f"{100 * (chart.values[-1] / chart.middle - 1):+.2f} % from the mean ({last:+.1f} sigma)"
    if abs(last) > 3:
        return Judgement("act", told)
    side = np.sign(last)
    if abs(last) > 2 and np.count_nonzero(side * z[-3:] > 2) >= 2:
        return Judgement("act", f"{told}; two of the last three beyond 2 sigma")
    if abs(last) > 2:
        return Judgement("warn", told)
    if z.size >= 8 and np.all(side * z[-8:] > 0):
        return Judgement("warn", f"{told}; the last eight lie on one side of the mean")
    return Judgement("in control", told)


def draw(charts: Sequence[Chart], path: Path, title: str) -> None:
    """Write the picture of charts, one panel each."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.dates as dates
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        len(charts), 1, figsize=(9, 1.0 + 1.9 * len(charts)), squeeze=False, sharex=True, layout="constrained"
    )
    for axis, chart in zip(axes[:, 0], charts, strict=True):
        moments = dates.date2num(list(chart.times))
        if np.isfinite(chart.middle):
            axis.axhline(chart.middle, color="0.3", linewidth=1)
            for factor, colour, label in ((2, "tab:orange", "warn"), (3, "tab:red", "act")):
                for sign in (-1, 1):
                    axis.axhline(chart.middle + sign * factor * chart.sigma, color=colour, linewidth=1, linestyle="--")
                axis.annotate(
                    label,
                    (1.005, chart.middle + factor * chart.sigma),
                    xycoords=("axes fraction", "data"),
                    fontsize=7,
                    color=colour,
                    va="center",
                )
        axis.plot(moments, chart.values, color="tab:blue", linewidth=0.8, alpha=0.6)
        made = chart.baseline
        axis.plot(moments[:made], chart.values[:made], "o", markersize=4, mfc="white", color="tab:blue")
        axis.plot(moments[made:], chart.values[made:], "o", markersize=4, color="tab:blue")
        axis.set_title(chart.name, fontsize=8, loc="left")
        axis.tick_params(labelsize=7)
    axes[-1, 0].xaxis.set_major_formatter(dates.DateFormatter("%Y-%m-%d"))
    axes[-1, 0].tick_params(axis="x", rotation=20)
    figure.suptitle(f"{title} (open: results that made the limits)", fontsize=9)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def run_chart(subject: str, facility: Path | None, results: Path, out: Path, force: bool = False) -> int:
    """Draw and judge the series of a control sample; returns the exit status, 1 where it is out of control.

    Parameters
    ----------
    facility
        Its ``instrument_stability`` stands for sigma while the series is short; 0.82 % (the paper's) where not given.

    Raises
    ------
    InputError
        If there are no results of this sample, or the picture cannot be written, or is there already
        and ``force`` is not set.
    """
    from rich.console import Console

    known = read_facility(facility) if facility is not None else None
    series = read_results(results, "control-sample", subject)
    if not series:
        names = sorted({result.subject for result in read_results(results, "control-sample")})
        raise InputError(f"{results}: no results of {subject!r}; found: {', '.join(names) or 'none'}")
    check_new(out, force)
    names = list(dict.fromkeys(name for result in series for name in result.values))
    stability = known.budget if known is not None else Budget(instrument_stability=0.0082)
    charts = [chart_of(series[:-1], name, stability, _last(series, name)) for name in names]
    draw(charts, out, f"control sample {subject}")
    console = Console(highlight=False)
    judgements = [judge(chart) for chart in charts]
    for chart, judgement in zip(charts, judgements, strict=True):
        console.print(f"{chart.name}: {judgement.level}: {judgement.reason}", markup=False, soft_wrap=True)
    console.print(f"{len(series)} results; picture: {out}", soft_wrap=True, markup=False)
    return EXIT_INCOMPLETE if any(judgement.level == "act" for judgement in judgements) else EXIT_DONE


def _last(series: Sequence[CalibrationResult], name: str) -> tuple[datetime, float] | None:
    last = series[-1]
    return (last.taken, last.values[name].value) if name in last.values else None
