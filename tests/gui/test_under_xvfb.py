"""The window on a real X server: the same tests as offscreen, a few of them, in a process of their own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(shutil.which("Xvfb") is None, reason="Xvfb is not installed; .ci/run installs it where it can"),
]
HERE = Path(__file__).parent
#: A whole scan with pause and diagnosis; fault, abort and recovery; the emergency stop under an open question; the
#: layout of last time.
CHOSEN = (
    "test_live_window.py::test_a_scan_is_started_paused_diagnosed_resumed_and_finished",
    "test_live_window.py::test_a_fault_is_shown_the_scan_aborted_and_gone_on_with_from_the_start_page",
    "test_window.py::test_abort_asks_first_and_halt_does_not",
    "test_window_looks.py::test_layout_and_palette_are_remembered",
)
SHOWN = """
import sys
from PySide6.QtCore import QSettings, QTimer
from gui.application import start_application
from gui.window import MainWindow
application = start_application()
window = MainWindow(None, QSettings(sys.argv[1], QSettings.Format.IniFormat))
window.show()
def look():
    print(application.platformName(), window.windowHandle().isExposed(), application.primaryScreen().size().width())
    print(application.primaryScreen().grabWindow(0).toImage().pixelColor(600, 400).name(), window.desk.theme.surface)
    application.exit(0)
QTimer.singleShot(1500, look)
application.exec()
"""
RENDERED = """
import sys, time
from datetime import UTC, datetime
from gui.application import start_application
from gui.comparison import score
from gui.model import ScanModel
from gui.panels.arms import ArmsPanel
from gui.theme import LIGHT
from instrument.events import AxesRead, Geometry, ScanStarted
application = start_application()
panel = ArmsPanel(ScanModel(score), LIGHT)
panel.resize(500, 440)
panel.show()
now = datetime.now(UTC)
at = Geometry(wavelength=500.0, illumination_zenith=30.0, sensor_zenith=45.0, sensor_azimuth=60.0)
def say(event):
    panel.model.apply(event)
    panel.refresh(panel.model.take_changes())
def picture(old=None):
    end = time.monotonic() + 120
    while (panel.solid.picture is old or panel.solid._clock.isActive()) and time.monotonic() < end:
        application.processEvents()
        time.sleep(0.01)
    return panel.solid.picture
say(ScanStarted(time=now, run_dir="", title="t", points=(at,), duration_s=9.0))
first = picture()
print(panel.stack.currentWidget() is panel.solid, panel.text.text())
def colours(image):
    return {image.pixelColor(x, y).name() for x in range(0, image.width(), 4) for y in range(0, image.height(), 4)}
print(len(colours(first)), first.pixelColor(2, 2).name(), LIGHT.surface)
say(AxesRead(time=now, positions={"illumination_zenith": -60.0, "sensor_zenith": 20.0, "sensor_azimuth": 0.0}))
second = picture(first)
print(sum(first.pixel(x, y) != second.pixel(x, y) for x in range(0, 400, 4) for y in range(0, 300, 4)))
panel.solid._renderer.close()
"""


@pytest.fixture
def display() -> Iterator[str]:
    """A screen of its own, of a number that is free."""
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1600x1100x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[writing], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as numbers:
        number = numbers.readline().strip()
    assert number, "Xvfb does not start"
    yield f":{number}"
    server.terminate()
    server.wait(30)


def on(display: str, *command: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb", "GONIOTWIN_TEST_PLATFORM": "xcb"}
    return subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, env=environment, cwd=HERE, timeout=570, check=False
    )


def test_the_window_stands_on_the_screen_and_is_steered_there(display: str, tmp_path: Path) -> None:
    shown = on(display, "-c", SHOWN, str(tmp_path / "settings.ini"))
    assert shown.returncode == 0, shown.stderr
    platform, pixel = shown.stdout.splitlines()
    assert platform == "xcb True 1600"
    assert pixel.split()[0] != "#000000"  # the X server's own ground
    done = on(display, "-m", "pytest", "-n0", "-q", "-m", "slow or not slow", "-p", "no:cacheprovider", *CHOSEN)
    assert done.returncode == 0, done.stdout[-4000:]
    assert re.search(rf"\b{len(CHOSEN)} passed", done.stdout)


def test_the_instrument_is_rendered_and_moves_as_the_drives_say(display: str) -> None:
    rendered = on(display, "-c", RENDERED)
    assert rendered.returncode == 0, rendered.stderr
    stands, colours, changed = rendered.stdout.splitlines()
    assert stands.startswith("True No axis has moved yet")
    many, corner, ground = colours.split()
    assert int(many) > 30  # shades of arms, sample and ground plate
    assert corner == ground
    assert int(changed) > 100  # arms and beams in other places
