"""How a measurement went: reference history with drift, interruptions, flags, what people said and confirmed."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import FigureBase

from instrument.angles import FloatArray
from instrument.calibration import photocurrent
from instrument.drift import CORRECTION
from instrument.journal import JournalContent
from instrument.monitor import normalised
from instrument.plan import describe
from instrument.records import SkippedRecord
from instrument.run_axes import channels
from instrument.run_record import history
from instrument.run_schema import FLAG_MASKS
from instrument.states import State
from twin.figures import BLACK, BLUE, GREEN, ORANGE, VERMILION
from twin.report.document import Block, Columns, LeftOut, Plot, Points, Table, Words
from twin.report.words import moment

_FLAGS = dict(zip(("saturated", "overload", "shadowed", "repeated"), FLAG_MASKS, strict=True))
#: States that a scan comes to rest or to an end in before its last point.
_STOPS = (State.PAUSED, State.SUSPENDED, State.ABORTED, State.HALTED, State.FAULTED)
_SERIES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (VERMILION, "v"))
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
#: Rows of tables of records; a report is no journal.
_MOST = 60
_READINGS = {"reference_signal", "reference_dark", "reference_gain", "reference_time", "reference_sensor_azimuth"}


def reference_blocks(run: xr.Dataset) -> list[Block]:
    """Level of the reference in the course of the run, and the correction of its drift."""
    missing = sorted(_READINGS - set(map(str, run.variables)))
    if missing:
        return [LeftOut("reference history", f"the run file has no {', '.join(missing)}")]
    data, names = reference_columns(run)
    drift = (
        {"time": run["time"].values, "drift_correction": run[CORRECTION].values}
        if CORRECTION in run and "time" in run.variables
        else {}
    )
    caption = (
        "Photocurrent of the reference over its mean in the same light. Bars: standard error of the samples."
        + (" Line: level that the points are scaled with, relative to that of their calibration." if drift else "")
        + (" The readings belong to several calibrations." if len(set(data["set"].tolist())) > 1 else "")
    )
    draw = partial(_draw_reference, data=data, names=names, drift=drift)
    blocks: list[Block] = [
        _reference_table(data, names),
        Plot("reference_history", caption, 2.7, draw, _with_drift(data, drift)),
    ]
    if not drift:
        blocks.append(
            Words(
                "The reference was not repeated on schedule: no drift was corrected, and none could be seen.", "faint"
            )
        )
    return blocks


def reference_columns(run: xr.Dataset) -> tuple[dict[str, np.ndarray], list[str]]:
    """Readings of the reference in order of time, and the names of their lights."""
    dark = run["reference_dark_signal"].values if "reference_dark_signal" in run else None
    volts, zero, gain = (run[f"reference_{name}"].values for name in ("signal", "dark", "gain"))
    reading = normalised(
        photocurrent(volts, zero, gain, dark), run["reference_monitor"].values if "reference_monitor" in run else None
    )
    sizes = run.sizes["reference"]
    light, names = np.zeros(sizes, dtype=int), [""]
    if "reference_wavelength" in run:
        _, light, names = channels(run)
    mean = np.array([reading.current[light == one].mean() for one in light])
    columns = {
        "time": run["reference_time"].values,
        "set": run["reference_set"].values if "reference_set" in run else np.zeros(sizes, dtype=int),
        "light": light,
        "sensor_azimuth": run["reference_sensor_azimuth"].values,
        "photocurrent": reading.current,
        "u_photocurrent": reading.standard_error,
        "level": reading.current / mean,
        "u_level": reading.standard_error / mean,
    }
    order = np.argsort(columns["time"], kind="stable")
    return {name: values[order] for name, values in columns.items()}, names


def _with_drift(data: Columns, drift: Columns) -> dict[str, np.ndarray]:
    """Readings, and below them the points with the level at their time."""
    if not drift:
        return dict(data)
    points, readings = len(drift["time"]), len(data["time"])
    columns = {
        name: np.concatenate([values, _missing(values, points)]) for name, values in data.items() if name != "time"
    }
    return {
        "time": np.concatenate([data["time"], drift["time"]]),
        **columns,
        "drift_correction": np.concatenate([np.full(readings, np.nan), drift["drift_correction"]]),
    }


def _missing(values: np.ndarray, count: int) -> np.ndarray:
    return np.full(count, np.nan)


def _reference_table(data: Columns, names: list[str]) -> Table:
    rows = []
    keys = list(zip(data["set"].tolist(), data["light"].tolist(), strict=True))
    first: dict[int, float] = {}
    for one in dict.fromkeys(keys):
        chosen = np.array([key == one for key in keys])
        level = float(np.mean(data["photocurrent"][chosen]))
        first.setdefault(one[1], level)
        values = data["photocurrent"][chosen]
        scatter = f"{100 * np.std(values, ddof=1) / level:.3f}" if chosen.sum() > 1 else "-"
        begun = np.datetime_as_string(data["time"][chosen].min(), unit="s").replace("T", " ")
        change = f"{100 * (level / first[one[1]] - 1):+.3f}"
        rows.append([str(one[0] + 1), names[one[1]], begun, str(chosen.sum()), f"{level:.5g}", scatter, change])
    header = ["calibration", "light", "begun (UTC)", "readings", "mean photocurrent / A", "scatter / %", "change / %"]
    caption = (
        "Readings of the reference. Scatter: standard deviation between sensor azimuths; change: from the first one."
    )
    return Table("reference_readings", caption, header, rows, (0, 3, 4, 5, 6))


def _draw_reference(figure: FigureBase, data: Columns, names: list[str], drift: Columns) -> None:
    axis = figure.add_axes((0.105, 0.16, 0.88, 0.7))
    for number in np.unique(data["light"]):
        chosen = data["light"] == number
        colour, marker = _SERIES[int(number) % len(_SERIES)]
        u = np.nan_to_num(data["u_level"][chosen])
        axis.errorbar(
            data["time"][chosen],
            100 * (data["level"][chosen] - 1),
            yerr=100 * u,
            fmt=marker,
            color=colour,
            ms=4,
            elinewidth=0.8,
            capsize=1.6,
            label=f"reference {names[int(number)]}".strip(),
        )
    if drift:
        axis.plot(
            drift["time"], 100 * (drift["drift_correction"] - 1), color=BLACK, lw=0.9, label="level at the points"
        )
    axis.set_ylabel("change / %", fontsize=8)
    axis.set_xlabel("time (UTC)", fontsize=8)
    axis.tick_params(labelsize=7)
    locator = AutoDateLocator(minticks=3, maxticks=8)  # with 5 a range of four minutes, or hours, has no step
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    axis.xaxis.get_offset_text().set_fontsize(7)
    axis.grid(True, lw=0.4, alpha=0.5)
    axis.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, fontsize=7.5, frameon=False, borderaxespad=0.2)


def flag_blocks(run: xr.Dataset) -> list[Block]:
    """How many points carry which flag."""
    if "quality_flag" not in run:
        return [LeftOut("flags", "the run file has no quality_flag")]
    flags = np.nan_to_num(run["quality_flag"].values).astype(int)
    found = {name: np.flatnonzero(flags & mask) for name, mask in _FLAGS.items()}
    rows = [
        [name, str(len(rows)), ", ".join(map(str, rows[:20])) + (" ..." if len(rows) > 20 else "")]
        for name, rows in found.items()
    ]
    caption = f"Flags of the {len(flags)} points; rows are those of the run file, from 0."
    return [Table("flags", caption, ["flag", "points", "rows"], rows, (1,))]


def journal_blocks(content: JournalContent) -> list[Block]:
    """Interruptions, points that are missing, remarks, confirmations and amendments."""
    blocks: list[Block] = [*_interruptions(content), *_missing_points(content)]
    said = alike([str(record["text"]) for record in content.others if record["kind"] == "note"])
    if said:
        rest = [f"... and {len(said) - _MOST} more, in the journal"] if len(said) > _MOST else []
        blocks += [Words("Notes of the program:"), Points([*said[:_MOST], *rest])]
    confirmed = [_confirmation(record) for record in content.others if record["kind"] == "confirmation"]
    if confirmed:
        blocks.append(
            Table(
                "confirmations", "What people confirmed.", ["time (UTC)", "who", "about", "answer"], confirmed[:_MOST]
            )
        )
    return blocks


def alike(texts: Sequence[str]) -> list[str]:
    """Texts in order, those that differ in their numbers alone told once, with how many there are."""
    kinds = Counter(_NUMBER.sub("#", text) for text in texts)
    first = {_NUMBER.sub("#", text): text for text in reversed(texts)}
    return [
        first[kind] if count == 1 else f"{first[kind]} (the first of {count} that differ in numbers at most)"
        for kind, count in kinds.items()
    ]


def amendment_blocks(content: JournalContent) -> list[Block]:
    """Every word that was amended."""
    rows = [
        [moment(c["time"]), c["by"], c["field"].replace("_", " "), c["before"] or "-", c["after"] or "-", c["reason"]]
        for c in history(content)
    ]
    if not rows:
        return [Words("Nothing that was said of this run was amended.")]
    header = ["time (UTC)", "by", "what", "was", "is", "because"]
    return [Table("amendments", "Amendments; what was said before stays in the journal.", header, rows)]


def _interruptions(content: JournalContent) -> list[Block]:
    rows = interruptions(content)
    if not rows:
        return [Words("The run was not interrupted.")]
    header = ["time (UTC)", "what", "reason", "until (UTC)"]
    rest = [Words(f"{len(rows) - _MOST} more are in the journal.", "faint")] if len(rows) > _MOST else []
    return [Table("interruptions", "Interruptions and resumptions.", header, rows[:_MOST]), *rest]


def interruptions(content: JournalContent) -> list[list[str]]:
    """Every rest, early end and resumption: when, what, why, until when.

    A scan whose program died leaves no record: it is seen where the next one connects.
    """
    rows: list[list[str]] = []
    states = [record for record in content.others if record["kind"] == "state"]
    for number, record in enumerate(states):
        new = record["new"]
        if new in _STOPS:
            after = states[number + 1]["time"] if number + 1 < len(states) else ""
            resting = new in (State.PAUSED, State.SUSPENDED)
            rows.append([moment(record["time"]), new, record.get("reason", ""), moment(after) if resting else ""])
        if new == State.CONNECTING and number:
            before = states[number - 1]
            died = before["new"] not in (*_STOPS, State.FINISHED)
            last = _last_before(content, record["time"])
            if died:
                rows.append([moment(last), "program ended", f"without a word, while {before['new']}", ""])
            rows.append([moment(record["time"]), "resumed", "", ""])
    if states and states[-1]["new"] not in (*_STOPS, State.FINISHED):
        rows.append([moment(str(content.latest)), "no end recorded", "still running, or the program died", ""])
    return rows


def _last_before(content: JournalContent, stamp: str) -> str:
    """Laboratory time of the last record before another one."""
    known = [*content.points.values(), *content.references, *content.others, *content.skipped.values()]
    limit = datetime.fromisoformat(stamp)
    times = [record["time"] for record in known if isinstance(record.get("time"), str)]
    return max((time for time in times if datetime.fromisoformat(time) < limit), default=stamp)


def _missing_points(content: JournalContent) -> list[Block]:
    planned = int(content.header["points"])
    waiting = planned - len(content.points) - len(content.skipped)
    blocks: list[Block] = []
    if content.skipped:
        rows = []
        for record in list(content.skipped.values())[:_MOST]:
            skipped = SkippedRecord.model_validate(record)
            rows.append([str(skipped.index), describe(skipped.geometry), skipped.reason])
        caption = f"{len(content.skipped)} points that could not be measured."
        blocks.append(Table("skipped_points", caption, ["point", "geometry", "reason"], rows, (0,)))
    if waiting:
        blocks.append(Words(f"{waiting} of {planned} points of the plan were not reached."))
    return blocks


def _confirmation(record: Mapping[str, Any]) -> list[str]:
    value = record.get("value")
    return [
        moment(str(record.get("time", ""))),
        str(record.get("who", "")),
        str(record.get("key", "")),
        f"{value if value is not None else 'confirmed'}",
    ]


def environment(run: xr.Dataset) -> list[list[str]]:
    """Rows of a table: surroundings, power and read-backs by name: least, median, greatest, unit."""
    rows = []
    for name in map(str, run.data_vars):
        if not name.startswith(("environment_", "source_power", "wavelength_readback")):
            continue
        values: FloatArray = np.asarray(run[name].values, dtype=float)
        spread = (f"{value:.5g}" for value in np.nanpercentile(values, [0, 50, 100]))
        said = name.removeprefix("environment_").replace("_", " ")
        rows.append([said, *spread, str(run[name].attrs.get("units", ""))])
    return rows
