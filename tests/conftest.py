"""What every room's tests share."""

from __future__ import annotations

import os
import signal
import tempfile

from hypothesis import HealthCheck, settings

# A shell that runs the tests in the background has Ctrl-C ignored, and every program started from here would inherit
# that: the tests that send Ctrl-C to a program would wait in vain.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What a test keeps for later must not help another one, nor stay with the user.
_CACHE = tempfile.TemporaryDirectory(prefix="goniotwin-tests-")
os.environ["XDG_CACHE_HOME"] = _CACHE.name

# A change is judged by examples that repeat; elsewhere every run looks for new ones.
# A busy machine is no fault of either.
settings.register_profile("ci", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("here", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "here")
