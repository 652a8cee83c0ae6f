"""What every room's tests share."""

from __future__ import annotations

import signal

# A shell that runs the tests in the background has Ctrl-C ignored, and every program started from here would inherit
# that: the tests that send Ctrl-C to a program would wait in vain.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
