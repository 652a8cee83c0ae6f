"""Starts Qt, or says in one message why it cannot be started."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING

from instrument.errors import EXIT_BAD_INPUT, InputError

if TYPE_CHECKING:
    from PySide6.QtCore import QMessageLogContext, QtMsgType
    from PySide6.QtWidgets import QApplication

#: Debian packages that Qt loads from the system: for any window, and for one on an X11 screen.
DEBIAN_PACKAGES = (
    "libegl1 libgl1 libglib2.0-0 libfontconfig1 libdbus-1-3 libxkbcommon0 libxkbcommon-x11-0 libxcb-cursor0"
    " libxcb-icccm4 libxcb-keysyms1 libxcb-shape0 fonts-dejavu-core"
)
#: What Qt keeps of small pictures at 100 %. Axes and signs take less than 2 MB; the rest are leftovers of earlier ones.
_PICTURES_KB = 4096
_HEADLESS = "a scan without a window runs with: goniotwin scan"


class NoWindow(InputError):
    """No window can be opened here; the message says what to do."""


def load_qt() -> None:
    """Import Qt and pyqtgraph.

    Raises
    ------
    NoWindow
        If the packages, or system libraries that they need, are missing.
    """
    try:
        for name in ("PySide6.QtWidgets", "pyqtgraph"):
            import_module(name)
    except ModuleNotFoundError as error:
        raise NoWindow(
            f"the window needs the Python package {error.name}: pip install 'goniotwin[gui]'; {_HEADLESS}"
        ) from None
    except ImportError as error:
        raise NoWindow(
            f"the window cannot load a system library: {error}; on Debian: apt-get install {DEBIAN_PACKAGES};"
            f" {_HEADLESS}"
        ) from None


def start_application() -> QApplication:
    """The Qt application with the program's name, style and fonts.

    Where Qt finds no screen it would abort the process; instead the process ends with exit status 2 and a message
    that says what to do.
    """
    from PySide6.QtCore import qInstallMessageHandler
    from PySide6.QtGui import QPixmapCache
    from PySide6.QtWidgets import QApplication

    from gui.theme import ensure_fonts

    application = QApplication.instance()
    if not isinstance(application, QApplication):
        qInstallMessageHandler(_explain_fatal)
        application = QApplication([sys.argv[0]])
        qInstallMessageHandler(None)
    application.setApplicationName("goniotwin")
    application.setOrganizationName("goniotwin")
    application.setStyle("Fusion")
    QPixmapCache.setCacheLimit(round(_PICTURES_KB * application.devicePixelRatio() ** 2))
    ensure_fonts()
    return application


_said: list[str] = []


def _explain_fatal(kind: QtMsgType, context: QMessageLogContext, text: str) -> None:
    """Qt's message handler while the application starts: a fatal message ends the process in our words."""
    from PySide6.QtCore import QtMsgType

    if kind is not QtMsgType.QtFatalMsg:
        _said.append(text)
        return
    screen = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    nowhere = "there is no screen (DISPLAY and WAYLAND_DISPLAY are not set)"
    what = f"the screen {screen!r} cannot be opened" if screen else nowhere
    reasons = "; ".join(line.strip() for line in _said if line.strip())
    print(
        f"goniotwin gui: no window can be opened: {what}.\nQt says: {reasons}\n"
        f"On Debian these packages are needed: apt-get install {DEBIAN_PACKAGES}\n{_HEADLESS.capitalize()}",
        file=sys.stderr,
        flush=True,
    )
    os._exit(EXIT_BAD_INPUT)
