"""From the command's options to a window on a session."""

from __future__ import annotations

import gc
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from PySide6.QtCore import QSettings, QTimer

from gui.application import start_application
from gui.collecting import Collector
from gui.control import Controller, Listener
from gui.remote import RemoteController
from gui.sessions import live_sessions
from gui.setup import Setup
from gui.window import MainWindow
from instrument.errors import EXIT_DONE, EXIT_INCOMPLETE, InputError

_TURN_S = 0.0005  # of Python's 5 ms


@dataclass(frozen=True)
class Options:
    """What the command line says; fields as in :class:`instrument.session.ScanRequest`."""

    plan: Path | None
    simulate: bool
    speed: float
    seed: int
    devices: Path | None
    facility: Path | None
    artifact: Path | None
    material: Path | None
    out: Path | None
    twin: bool

    def setup(self) -> Setup:
        """What a start asks for until a person changes it."""
        return Setup(**{name: getattr(self, name) for name in self.__dataclass_fields__})

    def check(self) -> None:
        """Refuse what no session could use, before a window opens.

        Raises
        ------
        InputError
            Naming the option.
        """
        if self.simulate and self.devices is not None:
            raise InputError("--simulate and --devices exclude each other: give one of them")
        if not self.simulate and self.devices is None:
            raise InputError("which laboratory? give --simulate, or --devices with the file devices.toml of yours")
        if not self.simulate and self.facility is None:
            raise InputError("--facility: missing; expected the file facility.toml that describes the instrument")
        if not self.speed > 0:
            raise InputError(f"--speed: found {self.speed:g}; expected more than 0")
        for name in ("plan", "devices", "facility", "artifact", "material"):
            path = getattr(self, name)
            if path is not None and not path.is_file():
                raise InputError(f"{name}: {path}: no such file")


def run(options: Options) -> int:
    """Open the window and stay until it is closed.

    Returns
    -------
    int
        Exit status: 1 where the screen was lost; a scan that was running goes on, and a new window joins it.
    """
    options.check()
    application = start_application()
    settings = QSettings("goniotwin", "window")
    setup = options.setup()
    setup.use_examples()
    controllers: list[RemoteController] = []

    def controller(listener: Listener, plan: Path | None) -> Controller:
        setup.plan = plan
        controllers.append(RemoteController(listener, setup.content()))
        return controllers[-1]

    window = MainWindow(controller, settings, plan_needed=not options.simulate, setup=setup)
    keep_passes_short(window)
    heart = obey_signals(window)
    if running := live_sessions():
        window.join(RemoteController(window.bridge, folder=running[-1].folder))
    window.show()
    window.prepare()
    status = application.exec()
    heart.stop()
    for each in controllers:  # a scan that runs goes on in its own process
        each.leave()
    return EXIT_DONE if status == 0 else EXIT_INCOMPLETE


def keep_passes_short(window: MainWindow) -> None:
    """Let neither the garbage collector nor another thread hold the Qt thread up.

    A round of the collector over everything that Qt's and the plot's modules hold takes a tenth of a second, in the
    middle of a scan: what lives as long as the window, and the points of a plan, are left out of it. A thread that
    computes in Python gives way after :data:`_TURN_S`; the Qt thread asks for its turn many times in a pass.
    """

    def freeze() -> None:
        gc.collect()
        gc.freeze()

    window.bridge.changed.connect(lambda changes: gc.freeze() if changes.scan else None)
    window.laid_out.connect(freeze)
    Collector(window)
    sys.setswitchinterval(_TURN_S)


def obey_signals(window: MainWindow) -> QTimer:
    """Let signals end the program without ever leaving the instrument as it is.

    Ctrl-C closes the window as a click does, and so asks where a scan runs; a second one means yes. A request to
    terminate and a terminal that went away ask nobody: the scan goes on in its own process, or ends in an orderly way
    where it has none. The timer returned gives Python a chance to see the signals.
    """

    def obey(number: int, _: FrameType | None) -> None:
        if number == signal.SIGINT and not window.asking:
            window.close()
        else:
            window.leave()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup means it
            signal.signal(number, obey)
    timer = QTimer(window)
    timer.start(250)
    timer.timeout.connect(lambda: None)
    return timer
