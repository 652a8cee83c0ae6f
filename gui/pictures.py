"""Pictures of every page at 100 % and 200 %, light and dark, for the guide: ``goniotwin gui --screenshots DIR``.

One run is shown everywhere: a run folder that is named, or a small scan of the simulated laboratory. Each scaling has
a process of its own, as Qt reads it once.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from gui.past_runs import DIAGNOSIS_NAME, REPORT_NAME, TWIN_NAME
from gui.solid import VARIABLE
from instrument.errors import EXIT_DONE, EXIT_INCOMPLETE

SCALES = (1, 2)
SIZE = (1360, 900)
_SHARE = 0.7  # of the run that is shown as measured
_PATIENCE_WALL = 60.0
_COLOURS = 128  # beside those of signs
_PLAN = """
version = 1
title = "three planes"
[[grid]]
wavelength = [500.0]
illumination_zenith = [15.0]
sensor_azimuth = [0.0, 50.0, 105.0]
sensor_zenith = { start = -75.0, stop = 75.0, step = 15.0 }
"""


def take_all(folder: Path, run: Path | None, diagnosed: Path | None = None) -> int:
    """Take every picture; returns the exit status.

    Parameters
    ----------
    run
        Folder of the run to show; None measures a small plan first.
    diagnosed
        Folder of a run with a diagnosis, for the page Understand; None diagnoses the run that is shown.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="goniotwin-pictures-") as name:
        home = Path(name)
        run = _measure(home) if run is None else Path(shutil.copytree(run, home / "runs" / run.resolve().name))
        understood = home / "understood" if diagnosed is not None else run
        if diagnosed is not None:
            shutil.copytree(diagnosed, understood)
        elif not (run / DIAGNOSIS_NAME).is_file():
            _diagnose(run)
        for scale in SCALES:
            environment = os.environ | {"QT_SCALE_FACTOR": str(scale), "QT_QPA_PLATFORM": "offscreen"}
            environment[VARIABLE] = "solid"
            where = [str(run.relative_to(home)), str(understood.relative_to(home)), str(folder.absolute()), str(scale)]
            command = [sys.executable, "-m", "gui.pictures", *where]
            if subprocess.run(command, env=environment, cwd=home, check=False).returncode != 0:
                return EXIT_INCOMPLETE
    for path in sorted(folder.glob("*.png")):
        _shrink(path)
        print(f"written: {path}")
    return EXIT_DONE


def _shrink(path: Path) -> None:
    """Few colours are enough for a window, and a third of the bytes; those of small signs stay as they are."""
    from PIL import Image

    with Image.open(path) as picture:
        whole = picture.convert("RGB")
    palette = Image.new("P", (1, 1))
    palette.putpalette((whole.quantize(_COLOURS).getpalette() or [])[: 3 * _COLOURS] + _sign_colours())
    whole.quantize(palette=palette, dither=Image.Dither.NONE).save(path, optimize=True)


def _sign_colours() -> list[int]:
    """Red, green and blue of every colour of both palettes and of the sample's surfaces."""
    from gui.solid.geometry import SURFACES
    from gui.theme import DARK, LIGHT

    names = {colour for theme in (LIGHT, DARK) for colour in vars(theme).values() if isinstance(colour, str)}
    names |= {colour for colour, _ in SURFACES.values()}
    return [part for name in sorted(names) for part in bytes.fromhex(name.removeprefix("#"))]


def _measure(folder: Path) -> Path:
    plan, run = folder / "plan.toml", folder / "runs" / "three-planes"
    plan.write_text(_PLAN, encoding="utf-8")
    command = [sys.executable, "-m", "instrument", "scan", str(plan), "--simulate", "--speed", "200", "--out", str(run)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return run


def _diagnose(run: Path) -> None:
    command = [sys.executable, "-m", "instrument", "diagnose", str(run), "--json", str(run / DIAGNOSIS_NAME)]
    command += ["--report", str(run / REPORT_NAME), "--save-twin", str(run / TWIN_NAME), "--force"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def take(run: Path, understood: Path, folder: Path, scale: int) -> None:
    """Take the pictures at one scaling."""
    from PySide6.QtCore import QSettings

    from gui.application import start_application
    from gui.setup import Setup
    from gui.window import MainWindow

    application = start_application()
    # In this process's own folder, a file for each scale. (Of a device's name, /dev/null say, Qt makes a file.)
    settings = QSettings(str(Path(f"settings-{scale}.ini").absolute()), QSettings.Format.IniFormat)
    setup = Setup(simulate=True, speed=60.0, runs=run.parent, operator="A. Operator", sample="artifact no. 1")
    setup.use_examples()
    window = MainWindow(_nothing, settings, setup=setup)
    window.use_palette("light")
    window.resize(*SIZE)
    window.show()

    def wait(done: Any = lambda: False, at_most: float = 0.6) -> None:
        end = time.monotonic() + at_most
        while not done() and time.monotonic() < end:
            application.processEvents()
            time.sleep(0.01)

    def shoot(name: str) -> None:
        """In both palettes."""
        for palette, mark in (("dark", "-dark"), ("light", "")):
            window.use_palette(palette)  # type: ignore[arg-type]
            wait()
            wait(lambda: arms.solid.settled, _PATIENCE_WALL)
            window.settle()
            window.grab().save(str(folder / f"{name}{mark}-{100 * scale}.png"))

    pages: dict[str, Any] = {page.name: page for page in window.pages}
    arms: Any = window.panel("ArmsPanel")
    window.show_page("start")
    wait(lambda: bool(pages["start"]._rows), _PATIENCE_WALL)
    shoot("1-start")
    window.show_page("instrument")
    pages["instrument"].ask_devices()
    wait(pages["instrument"].ask.isEnabled, _PATIENCE_WALL)
    window.show_page("setup")
    wait(lambda: pages["setup"].checked is not None, _PATIENCE_WALL)
    shoot("3-setup")
    _play(window, run, wait)
    window.show_page("instrument")
    wait(lambda: pages["instrument"].checks.rowCount() > 0, 10.0)
    shoot("2-instrument")
    window.show_page("calibration")
    wait(lambda: pages["calibration"].table.rowCount() > 0, _PATIENCE_WALL)
    shoot("4-calibration")
    window.show_page("acquire")
    wait(at_most=1.0)
    shoot("5-acquire")
    window.show_page("watch")
    for number, name in enumerate(("planes", "polar", "time")):
        pages["watch"].tabs.setCurrentIndex(number)
        wait(at_most=1.0)
        shoot(f"6-watch-{name}")
    pages["understand"].hear(f"run:{understood}")
    window.show_page("understand")
    shoot("7-understand")
    window.show_page("runs")
    wait(lambda: pages["runs"].table.rowCount() > 0, _PATIENCE_WALL)
    names = [each.folder.name for each in pages["runs"].table.runs]
    pages["runs"].table.selectRow(names.index(run.name))
    shoot("8-runs")
    _ask(window)
    window.show_page("calibration")
    shoot("9-question")


def _ask(window: Any) -> None:
    """A question of a procedure, as it stands above every page."""
    from gui.notices import ControllerClosed, OperatorAsked, ProcedureStarted
    from instrument.prompts import Prompt

    window.bridge.on_event(ControllerClosed())
    window.bridge.on_event(ProcedureStarted("Alignment"))
    text = "Turn the micrometer of the sample holder until the laser grazes the surface. Read the micrometer."
    title = "Bring the sample's surface into the laser's plane"
    prompt = Prompt(key="align:level", title=title, text=text, kind="number", unit="mm", lower=0.0, upper=50.0)
    window.bridge.on_event(OperatorAsked(prompt))
    window.settle()


def _nothing(listener: object, plan: Path | None) -> Any:
    raise AssertionError("no scan is started for pictures")


def _play(window: Any, run: Path, wait: Any) -> None:
    """Show a part of the run as if its scan were under way."""
    from gui.notices import ControllerStarting
    from gui.replay import events_of
    from instrument.events import Message, PointAnnotated, PointMeasured, PointStarted, ScanStarted, StateChanged

    events = events_of(run)
    measured = [event for event in events if isinstance(event, PointMeasured)]
    shown = measured[: max(round(_SHARE * len(measured)), 1)]
    last = shown[-1]
    window.bridge.on_event(ControllerStarting())
    for event in events:
        if isinstance(event, ScanStarted):
            window.bridge.on_event(event.model_copy(update={"duration_s": 22.0 * len(event.points)}))
            window.bridge.on_event(Message(time=event.time, level="info", text="All 9 devices answer."))
        elif isinstance(event, PointMeasured):
            left = 22.0 * (len(measured) - event.done)
            if event.index <= last.index:
                window.bridge.on_event(event.model_copy(update={"time_left_s": left, "total": len(measured)}))
        elif isinstance(event, PointAnnotated):
            if event.index <= last.index + 3:
                window.bridge.on_event(event)
        elif type(event).__name__ == "ReferenceMeasured":
            window.bridge.on_event(event)
    window.bridge.on_event(StateChanged(time=last.time, old="moving", new="measuring"))
    nxt = measured[min(last.index + 1, len(measured) - 1)]
    window.bridge.on_event(PointStarted(time=last.time, index=nxt.index, geometry=nxt.geometry))
    window.settle()
    wait()


if __name__ == "__main__":
    shown_run, understood_run, into = (Path(word) for word in sys.argv[1:4])
    take(shown_run, understood_run, into, int(sys.argv[4]))
    sys.stdout.flush()
    os._exit(0)
