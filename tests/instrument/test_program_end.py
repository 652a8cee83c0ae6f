"""The program ends, whatever hangs, and leaves nothing temporary behind."""

from __future__ import annotations

import os
import signal
import tempfile
import threading
from pathlib import Path

import pytest
from scan_stage import QUICK, stage

from instrument.events import Event, Message
from instrument.request import ScanRequest
from instrument.scan_run import Interrupts
from instrument.session import ScanSession


def test_a_device_that_never_returns_does_not_keep_the_program_from_ending(tmp_path: Path) -> None:
    s = stage(tmp_path)
    returned = threading.Event()
    s.bench.detector.on_read = lambda: returned.wait(60.0)  # type: ignore[assignment]
    session = ScanSession(ScanRequest(simulate=True), settings=QUICK.model_copy(update={"close_limit_wall": 0.2}))
    session._engine, session.bus = s.engine, s.bus
    heard: list[Event] = []
    s.bus.subscribe(heard.append)
    session.start()
    assert not s.engine.wait(0.5)
    session.close()
    assert any(isinstance(event, Message) and "it hangs in state" in event.text for event in heard)
    returned.set()
    assert s.engine.wait(60.0)
    assert s.bench.safe


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_terminate_after_the_scan_leaves_no_temporary_folder(number: signal.Signals) -> None:
    """While the twin finishes nothing listens for a second Ctrl-C; the folder of the laboratory still has to go."""
    interrupts, kept = Interrupts(), []
    before = signal.getsignal(number)

    def finishes() -> None:
        with interrupts.ending(), tempfile.TemporaryDirectory() as folder:
            kept.append(Path(folder))
            with interrupts.caught():
                os.kill(os.getpid(), number)
            os.kill(os.getpid(), number)

    with pytest.raises(SystemExit) as ended:
        finishes()
    assert interrupts.count == 1
    assert ended.value.code == 128 + number
    assert not kept[0].exists()
    assert signal.getsignal(number) is before
