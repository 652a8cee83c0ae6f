"""A scan on the screen: one line a point, and a bar with the time left where there is a terminal."""

from __future__ import annotations

import math
from collections import deque
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from instrument.events import (
    Event,
    Geometry,
    Message,
    PointAnnotated,
    PointMeasured,
    PointSkipped,
    ReferenceMeasured,
    ScanStarted,
    StateChanged,
)

#: Lines that may wait for their prediction; the oldest is printed without it when there are more.
_WAITING = 8
_TWIN = "twin"
#: States that a person should read about.
_TOLD = {"connecting", "homing", "mounting", "referencing", "paused", "suspended", "aborting"}


def score(measured: PointMeasured, prediction: dict[str, float]) -> float:
    """t' = (prediction - measurement)/sqrt(u_prediction^2 + u_measurement^2)."""
    return (prediction["brf"] - measured.brf) / math.hypot(prediction.get("u_brf", 0.0), measured.u_brf)


def point_line(measured: PointMeasured, prediction: dict[str, float] | None, total: int) -> str:
    """One measured point in plain text."""
    width = len(str(total))
    line = (
        f"{measured.index + 1:{width}d}/{total}  {_where(measured.geometry)}"
        f"   BRF {measured.brf:7.4f} ± {measured.u_brf:.4f}"
    )
    if prediction is not None:
        line += f"   twin {prediction['brf']:7.4f} ± {prediction.get('u_brf', 0.0):.4f}"
        line += f"   t' {score(measured, prediction):+5.2f}"
    return line + (f"   flag {measured.quality_flag}" if measured.quality_flag else "")


def _where(geometry: Geometry) -> str:
    turned = f"  turned {geometry.sample_rotation:+6.1f}" if geometry.sample_rotation else ""
    polarised = f"  {geometry.polarization}" if geometry.polarization else ""
    return (
        f"{geometry.wavelength:6.1f} nm  ill {geometry.illumination_zenith:+5.1f}"
        f"  azimuth {geometry.sensor_azimuth:5.1f}  zenith {geometry.sensor_zenith:+6.1f}{turned}{polarised}"
    )


def duration(seconds: float) -> str:
    """Hours, minutes and seconds as ``h:mm:ss`` or ``m:ss``."""
    minutes, second = divmod(round(max(seconds, 0.0)), 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour}:{minute:02d}:{second:02d}" if hour else f"{minute}:{second:02d}"


class ScanDisplay:
    """Shows events as they come; a context manager.

    Parameters
    ----------
    console
        Where to.

    Attributes
    ----------
    predicted
        Whether predictions may come: then a line waits a little for its own.
    """

    def __init__(self, console: Console, *, predicted: bool = False) -> None:
        self._console, self.predicted = console, predicted
        self._predictions: dict[int, dict[str, float]] = {}
        self._waiting: deque[PointMeasured] = deque()
        self._total = 0
        self._task: TaskID | None = None
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
            disable=not console.is_terminal,
        )

    def __enter__(self) -> ScanDisplay:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Print what is still waiting and take the bar away. May be repeated."""
        self._flush(0)
        self._bar.stop()

    def show(self, event: Event) -> None:
        """Show one event."""
        match event:
            case ScanStarted():
                self._started(event)
            case StateChanged() if event.new in _TOLD:
                self._print(f"{event.new}" + (f": {event.reason}" if event.reason else ""), "dim")
            case ReferenceMeasured():
                error = f" ± {100 * event.relative_standard_error:.3f} %"
                self._print(f"reference  azimuth {event.sensor_azimuth:5.1f}   {event.current:.5g} A{error}")
            case PointMeasured():
                self._measured(event)
            case PointSkipped():
                self._flush(0)
                self._print(
                    f"{event.index + 1}/{self._total}  {_where(event.geometry)}   not measured: {event.reason}", "red"
                )
            case PointAnnotated(source=source) if source == _TWIN and "brf" in event.values:
                self._predictions[event.index] = event.values
                self._flush(_WAITING)
            case Message():
                style = {"info": "", "warning": "yellow", "error": "bold red"}[event.level]
                self._print(event.text + (f" ({event.advice})" if event.advice else ""), style)
            case _:
                pass

    def _started(self, event: ScanStarted) -> None:
        self._total = len(event.points)
        left = duration(event.duration_s / event.clock_speed)
        done = f", {len(event.done)} of them measured before" if event.done else ""
        self._print(f"{event.title or 'scan'}: {self._total} points{done}, about {left}", "bold")
        self._task = self._bar.add_task("points", total=self._total, completed=len(event.done), left=f"{left} left")

    def _measured(self, event: PointMeasured) -> None:
        self._waiting.append(event)
        self._flush(_WAITING if self.predicted else 0)
        if self._task is not None:
            self._bar.update(self._task, completed=event.done, left=f"{duration(event.time_left_s)} left")

    def _flush(self, keep: int) -> None:
        """Print waiting lines in order: those with a prediction, and those for which there is no more room."""
        while self._waiting and (self._waiting[0].index in self._predictions or len(self._waiting) > keep):
            measured = self._waiting.popleft()
            prediction = self._predictions.pop(measured.index, None)
            style = "yellow" if prediction is not None and abs(score(measured, prediction)) > 2 else ""
            self._print(point_line(measured, prediction, self._total), style)

    def _print(self, text: str, style: str = "") -> None:
        self._console.print(escape(text), style=style or None, soft_wrap=True)
