"""What a judge prints: one JSON object with the package, its version and every check.

A judge runs in the judges' environment, imports nothing of this project, and gets the endpoints as JSON in its first
argument. Its standard output holds the verdict in the last line; what other programs print before does not count.
"""

from __future__ import annotations

import json
import sys
import time
import traceback
from collections.abc import Callable
from importlib.metadata import version
from typing import Any


class Judge:
    """Collects checks; a failure of one leaves the others to be tried.

    Parameters
    ----------
    package
        Distribution whose code judges.
    what
        Class or module of it, and what it speaks to.
    """

    def __init__(self, package: str, what: str) -> None:
        self.package, self.what = package, what
        self.checks: list[dict[str, Any]] = []
        self.endpoints: dict[str, Any] = json.loads(sys.argv[1])

    def check(self, what: str, found: Callable[[], Any], good: Callable[[Any], bool]) -> None:
        """Ask for a value and judge it; an exception is a failure and is quoted."""
        try:
            value = found()
            ok = bool(good(value))
        except Exception as error:  # noqa: BLE001
            traceback.print_exc()
            value, ok = f"{type(error).__name__}: {error}", False
        self.checks.append({"what": what, "ok": ok, "found": str(value)[:200]})

    def refused(self, what: str, call: Callable[[], Any], words: str) -> None:
        """A call that has to fail, with an error whose text or type holds some words."""
        try:
            value, ok = call(), False
        except Exception as error:  # noqa: BLE001
            value = f"{type(error).__name__}: {error}"
            ok = words.lower() in value.lower()
        self.checks.append({"what": what, "ok": ok, "found": str(value)[:200]})

    def done(self) -> None:
        """Print the verdict."""
        sys.stdout.flush()
        verdict = {"package": self.package, "version": version(self.package), "what": self.what, "checks": self.checks}
        print("\n" + json.dumps(verdict), flush=True)


def close_to(wanted: float, tolerance: float = 0.02) -> Callable[[Any], bool]:
    """True for a number near ``wanted``."""
    return lambda value: abs(float(value) - wanted) <= tolerance


def until(condition: Callable[[], bool], seconds: float = 60.0) -> bool:
    """Wait until a condition holds; False where it does not within so many seconds."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False
