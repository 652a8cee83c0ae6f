"""The command says clearly what it needs, and answers at once."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gui.application import DEBIAN_PACKAGES, NoWindow, load_qt
from instrument.errors import InputError


def goniotwin(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``goniotwin gui`` without any screen."""
    blocked = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    env = {key: value for key, value in os.environ.items() if key not in blocked} | environment
    command = [sys.executable, "-m", "instrument", "gui", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, env=env, check=False)


def test_without_a_screen_it_says_so() -> None:
    done = goniotwin("--simulate")
    assert done.returncode == 2
    assert "no window can be opened: there is no screen" in done.stderr
    assert DEBIAN_PACKAGES in done.stderr
    assert "goniotwin scan" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_screen_that_does_not_answer_is_named() -> None:
    done = goniotwin("--simulate", DISPLAY=":987")
    assert done.returncode == 2
    assert "the screen ':987' cannot be opened" in done.stderr


@pytest.mark.parametrize("missing", ["PySide6.QtWidgets", "pyqtgraph"])
def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(NoWindow, match=f"Python package {missing}") as caught:
        load_qt()
    assert "goniotwin[gui]" in str(caught.value)


def test_a_missing_system_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    reason = "libEGL.so.1: cannot open shared object file: No such file or directory"

    def fail(name: str) -> None:
        raise ImportError(reason)

    monkeypatch.setattr("gui.application.import_module", fail)
    with pytest.raises(NoWindow) as caught:
        load_qt()
    assert reason in str(caught.value)
    assert f"apt-get install {DEBIAN_PACKAGES}" in str(caught.value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"simulate": False}, "give --simulate, or --devices"),
        ({"devices": Path(__file__)}, "exclude each other"),
        ({"simulate": False, "devices": Path(__file__)}, "--facility: missing"),
        ({"speed": 0.0}, "--speed: found 0"),
        ({"plan": Path("nowhere.toml")}, "plan: nowhere.toml: no such file"),
    ],
)
def test_wrong_options_are_refused_before_a_window_opens(given: dict[str, Any], words: str) -> None:
    from gui.run import Options

    fine = Options(None, True, 60.0, 1, None, None, None, None, None, True)
    fine.check()
    with pytest.raises(InputError, match=re.escape(words)):
        replace(fine, **given).check()


def test_help_does_not_load_qt() -> None:
    code = (
        "import sys; from instrument.__main__ import main\ntry: main(['gui', '--help'])\nfinally: print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert "operator's window" in done.stdout
    assert "PySide6" not in done.stdout
    assert "numpy" not in done.stdout.split()


def test_only_the_room_of_the_window_names_qt() -> None:
    root = Path(__file__).parents[2]
    named = re.compile(r"^\s*(?:from|import) (?:PySide6|pyqtgraph|gui)\b", re.MULTILINE)
    rooms = ("drivers", "instrument", "twin", "sim_fixtures")
    guilty = [path for room in rooms for path in (root / room).rglob("*.py") if named.search(path.read_text("utf-8"))]
    assert guilty == []
    assert named.search((root / "gui" / "window.py").read_text("utf-8"))  # the search finds what it looks for


def test_what_runs_a_scan_and_asks_devices_loads_no_qt() -> None:
    code = "import sys, gui.host, gui.device_check, instrument.session, instrument.scan_run; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert "numpy" in loaded
    assert not loaded & {"PySide6", "shiboken6", "pyqtgraph", "vtkmodules"}
