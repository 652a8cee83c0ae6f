"""Windows of these tests are drawn into memory; no screen is needed. The variable names another platform of Qt."""

from __future__ import annotations

import atexit
import gc
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from window_stage import RecordingController, Stage

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication
    from pytestqt.qtbot import QtBot

_SCREEN = {"name": "test", "x": 0, "y": 0, "width": 1920, "height": 1200, "logicalDpi": 96, "dpr": 1.0}
_screens = Path(tempfile.mkdtemp(prefix="goniotwin-screen-")) / "screens.json"
_screens.write_text(json.dumps({"screens": [_SCREEN]}))
atexit.register(shutil.rmtree, _screens.parent, ignore_errors=True)
os.environ["QT_QPA_PLATFORM"] = os.environ.get("GONIOTWIN_TEST_PLATFORM", f"offscreen:configfile={_screens}")


@pytest.fixture(autouse=True)
def collected_in_the_qt_thread() -> Iterator[None]:
    """As in the program (:mod:`gui.collecting`): no other thread destroys the widgets of a window that is gone."""
    gc.disable()
    yield
    gc.collect()
    gc.enable()


@pytest.fixture(scope="session")
def qapp() -> QApplication:
    """The application as the command makes it, in place of pytest-qt's plain one."""
    from gui.application import start_application

    return start_application()


@pytest.fixture
def make_stage(qtbot: QtBot, tmp_path: Path) -> Callable[..., Stage]:
    """Makes windows driven by hand."""
    from PySide6.QtCore import QSettings

    from gui.window import MainWindow

    def make(**more: object) -> Stage:
        controller, plans = RecordingController(), []

        def factory(listener: object, plan: Path | None) -> RecordingController:
            plans.append(plan)
            return controller

        settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)
        window = MainWindow(factory, settings, **more)  # type: ignore[arg-type]
        qtbot.addWidget(window, before_close_func=lambda w: setattr(w.model, "connected", False))
        with qtbot.waitActive(window):
            window.show()
            window.activateWindow()
        return Stage(window, controller, plans)

    return make


@pytest.fixture
def stage(make_stage: Callable[..., Stage]) -> Stage:
    """A window driven by hand."""
    return make_stage()
