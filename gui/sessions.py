"""Where the processes that run scans are found: one folder each, with a socket, the request and what was said so far.

The folders lie in the user's run-time directory. A folder whose process is gone is removed by whoever finds it.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SOCKET, REQUEST, SPOOL, ABOUT, LOG = "socket", "request.json", "events.jsonl", "about.json", "log.txt"
#: Names another folder for sessions, for tests.
VARIABLE = "GONIOTWIN_SESSIONS"


@dataclass(frozen=True)
class LiveSession:
    """A scan that a process of its own runs."""

    folder: Path
    pid: int
    about: dict[str, Any]


def sessions_folder() -> Path:
    """The folder of all sessions of this user; private to them, its name short enough for a socket."""
    named = os.environ.get(VARIABLE)
    if named:
        folder = Path(named)
    elif os.environ.get("XDG_RUNTIME_DIR"):
        folder = Path(os.environ["XDG_RUNTIME_DIR"]) / "goniotwin"
    else:
        folder = Path(tempfile.gettempdir()) / f"goniotwin-{os.getuid()}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = folder.stat()
    if status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise PermissionError(f"{folder}: belongs to others or can be written by them; remove it and start again")
    return folder


def launch(content: dict[str, Any]) -> tuple[Path, subprocess.Popen[bytes]]:
    """Start the process of a scan; it outlives this one.

    Parameters
    ----------
    content
        What :func:`gui.host.main` reads: the request.
    """
    folder = Path(tempfile.mkdtemp(prefix="s", dir=sessions_folder()))
    (folder / REQUEST).write_text(json.dumps(content), encoding="utf-8")
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "gui.host", str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,  # neither Ctrl-C nor the end of the terminal is for the scan
        )
    return folder, process


def live_sessions() -> list[LiveSession]:
    """Every scan that runs now, oldest first."""
    found = []
    for folder in sorted(sessions_folder().iterdir(), key=lambda path: path.stat().st_mtime):
        try:
            about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue  # it is just being started
        if answers(folder):
            found.append(LiveSession(folder, about["pid"], about))
        elif not _alive(about["pid"]):
            shutil.rmtree(folder, ignore_errors=True)
    return found


def connect(folder: Path, timeout: float = 2.0) -> socket.socket:
    """Connect to a session; OSError where nobody answers."""
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    line.settimeout(timeout)
    try:
        line.connect(str(folder / SOCKET))
    except OSError:
        line.close()
        raise
    line.settimeout(None)
    return line


def answers(folder: Path) -> bool:
    """Whether a session can be joined."""
    try:
        connect(folder).close()
    except OSError:
        return False
    return True


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
