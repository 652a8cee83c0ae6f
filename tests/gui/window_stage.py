"""A window whose engine is a test."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from scan_script import geometries, preparation, readings

from gui.notices import ControllerStarting

if TYPE_CHECKING:
    from gui.window import MainWindow


POINTS = geometries({0.0: (0.0, 90.0), 15.0: (50.0,)}, step=10)


class RecordingController:
    """Stands where a session would: remembers what was asked of it and says nothing by itself."""

    detached = False

    def __init__(self) -> None:
        self.asked: list[str] = []

    def start(self) -> None:
        self.asked.append("start")

    def pause(self) -> None:
        self.asked.append("pause")

    def pause_now(self) -> None:
        self.asked.append("pause now")

    def resume(self) -> None:
        self.asked.append("resume")

    def abort(self) -> None:
        self.asked.append("abort")

    def halt(self) -> None:
        self.asked.append("halt")

    def answer(self, done: bool, value: float | str | None = None) -> None:
        self.asked.append(f"answer {done}" if value is None else f"answer {value!r}")


class Stage:
    """A window, the controller behind it, and the plans its controllers were made for."""

    def __init__(self, window: MainWindow, controller: RecordingController, plans: list[Path | None]) -> None:
        self.window, self.controller, self.plans = window, controller, plans

    def play(self, *events: object) -> None:
        """Let events arrive and be shown."""
        for event in events:
            self.window.bridge.on_event(event)  # type: ignore[arg-type]
        self.window.settle()


def running(stage: Stage, count: int = 5) -> None:
    """A scan of :data:`POINTS` is under way in the window."""
    stage.window.do("start")
    stage.window.show_page("watch")
    stage.play(ControllerStarting(), *preparation(POINTS), *readings(POINTS, count))
