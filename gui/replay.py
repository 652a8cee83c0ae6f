"""A finished or interrupted run as the events that its scan would have sent: what shows a scan shows a run."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from instrument.errors import InputError
from instrument.events import (
    Event,
    Geometry,
    Message,
    PointAnnotated,
    PointMeasured,
    PointSkipped,
    ReferenceMeasured,
    ScanEnded,
    ScanStarted,
    StateChanged,
)
from instrument.journal import JOURNAL_NAME, JournalContent, read_journal
from instrument.run_build import run_of_journal
from instrument.run_folder import RUN_NAME
from instrument.run_read import read_prediction, read_run

PREDICTION_NAME = "prediction.nc"
_OUTCOMES = ("finished", "aborted", "halted", "faulted")
_GEOMETRY = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")


def read_values(path: Path) -> Any:
    """The run of a folder or a file: from ``run.nc``, else made of the journal.

    Raises
    ------
    InputError
        If there is no run, or no point was measured.
    """
    if path.is_file():
        return read_run(path)
    if (path / RUN_NAME).is_file():
        return read_run(path / RUN_NAME)
    content = read_journal(path)
    if not content.points:
        raise InputError(f"{path}: no point was measured")
    return run_of_journal(content)


def events_of(path: Path) -> list[Event]:
    """Every event of a run, in order; predictions of ``prediction.nc`` are in it where there is one.

    Parameters
    ----------
    path
        A run folder, or a run file.

    Raises
    ------
    InputError
        If it is no run.
    """
    run = read_values(path)
    content = read_journal(path) if path.is_dir() and (path / JOURNAL_NAME).exists() else None
    geometries = _geometries(run)
    skipped = _skipped(content)
    times = _times(run)
    start = min([*times, *(event.time for event in _references(run, times[0]))])
    title = str(run.attrs.get("title", "")) or path.name
    everything = (*geometries, *(geometry for geometry, _ in skipped))
    events: list[Event] = [
        ScanStarted(
            time=start,
            run_dir=str(path if path.is_dir() else path.parent),
            title=title,
            points=everything,
            duration_s=0.0,
        )
    ]
    events += _references(run, start)
    events += _points(run, geometries, times, len(everything))
    for number, (geometry, reason) in enumerate(skipped):
        events.append(PointSkipped(time=times[-1], index=len(geometries) + number, geometry=geometry, reason=reason))
    folder = path if path.is_dir() else path.parent
    if (folder / PREDICTION_NAME).is_file():
        events += beside(run, read_prediction(folder / PREDICTION_NAME), times[-1])
    return events + _ending(content, len(geometries), len(everything), times[-1])


def beside(run: Any, prediction: Any, time: datetime, source: str = "twin") -> list[Event]:
    """Predictions (or another run) at the points of a run."""
    from twin.matching import find_points

    brf, u_brf = prediction["brf"].values, prediction["u_brf"].values
    return [
        PointAnnotated(
            time=time, index=index, source=source, values={"brf": float(brf[row]), "u_brf": float(u_brf[row])}
        )
        for index, row in enumerate(find_points(run, prediction))
        if row >= 0
    ]


def compared_events(path: Path, other: Path) -> list[Event]:
    """A run beside another one, which takes the place of the prediction."""
    events = [event for event in events_of(path) if not isinstance(event, PointAnnotated)]
    run = read_values(path)
    return [*events, *beside(run, read_values(other), events[-1].time)]


def _geometries(run: Any) -> tuple[Geometry, ...]:
    columns = {name: np.asarray(run[name].values, dtype=float) for name in _GEOMETRY if name in run.variables}
    if "sample_rotation" in run.variables:
        columns["sample_rotation"] = np.asarray(run["sample_rotation"].values, dtype=float)
    return tuple(
        Geometry.model_validate({name: float(values[i]) for name, values in columns.items()})
        for i in range(run.sizes["point"])
    )


def _times(run: Any) -> list[datetime]:
    count = run.sizes["point"]
    if "time" not in run.variables:
        return [datetime.now(UTC)] * count
    seconds = run["time"].values.astype("datetime64[us]").astype(np.int64) / 1e6
    return [datetime.fromtimestamp(float(s), UTC) for s in seconds]


def _skipped(content: JournalContent | None) -> list[tuple[Geometry, str]]:
    if content is None:
        return []
    return [
        (Geometry.model_validate(record["geometry"]), str(record.get("reason", "")))
        for _, record in sorted(content.skipped.items())
    ]


def _references(run: Any, start: datetime) -> list[Event]:
    names = ("reference_signal", "reference_dark", "reference_gain", "reference_sensor_azimuth")
    if any(name not in run.variables for name in names):
        return []
    signal, dark, gain, azimuth = (np.asarray(run[name].values, dtype=float) for name in names)
    current = (signal.mean(axis=1) - dark) / gain
    scatter = signal.std(axis=1, ddof=1) / np.sqrt(signal.shape[1]) / np.abs(signal.mean(axis=1) - dark)
    times = [start] * len(current)
    if "reference_time" in run.variables:
        seconds = run["reference_time"].values.astype("datetime64[us]").astype(np.int64) / 1e6
        times = [datetime.fromtimestamp(float(s), UTC) for s in seconds]
    return [
        ReferenceMeasured(
            time=times[i],
            index=i,
            sensor_azimuth=float(azimuth[i]),
            current=float(current[i]),
            relative_standard_error=float(scatter[i]),
        )
        for i in range(len(current))
    ]


def _points(run: Any, geometries: tuple[Geometry, ...], times: list[datetime], total: int) -> list[Event]:
    count = len(geometries)
    signal = np.asarray(run["signal"].values, dtype=float) if "signal" in run.variables else np.zeros((count, 0))
    dark = np.asarray(run["dark"].values, dtype=float) if "dark" in run.variables else np.zeros(count)
    gain = np.asarray(run["gain"].values, dtype=float) if "gain" in run.variables else np.ones(count)
    flags = run["quality_flag"].values if "quality_flag" in run.variables else np.zeros(count, dtype=int)
    brf, u_brf = run["brf"].values, run["u_brf"].values
    return [
        PointMeasured(
            time=times[i],
            index=i,
            geometry=geometries[i],
            brf=float(brf[i]),
            u_brf=float(u_brf[i]),
            signal=tuple(map(float, signal[i])),
            dark=float(dark[i]),
            gain=float(gain[i]),
            quality_flag=int(flags[i]),
            done=i + 1,
            total=total,
            time_left_s=0.0,
        )
        for i in range(count)
    ]


def _ending(content: JournalContent | None, done: int, total: int, time: datetime) -> list[Event]:
    ended = [record for record in content.others if record["kind"] == "ended"] if content else []
    outcome = str(ended[-1].get("outcome", "")) if ended else "finished" if content is None else ""
    if outcome in _OUTCOMES:
        reason = str(ended[-1].get("reason", "")) if ended else ""
        fields = {"time": time, "outcome": outcome, "done": done, "total": total, "reason": reason}
        return [ScanEnded.model_validate(fields)]
    return [
        StateChanged(time=time, old="idle", new="idle", reason="this run was interrupted"),
        Message(
            time=time,
            level="warning",
            text="This run was interrupted before its end",
            advice="Go on with it from the page Start.",
        ),
    ]
