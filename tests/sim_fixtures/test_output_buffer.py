"""Replies of one controller keep their order, however late one of them is."""

from __future__ import annotations

import threading
import time

from sim_fixtures.devices.faults import Faults, OutputBuffer


def _delivered(kind: str, *replies: bytes, delay: float = 0.05) -> list[bytes]:
    """What arrives of replies of which the first suffers, in its order."""
    arrived: list[bytes] = []
    whole = threading.Event()

    def send(piece: bytes) -> None:
        arrived.append(piece)
        if sum(map(len, arrived)) == sum(map(len, replies)):
            whole.set()

    buffer, faults = OutputBuffer(send), Faults()
    faults.set(kind, 1, delay)
    for reply in replies:
        buffer.deliver(reply, faults)
    assert whole.wait(10.0)
    return arrived


def test_a_late_reply_holds_up_the_next_ones() -> None:
    began = time.monotonic()
    assert _delivered("late", b"30\r\n", b"ESP301\r\n", b"0\r\n") == [b"30\r\n", b"ESP301\r\n", b"0\r\n"]
    assert time.monotonic() - began >= 0.05


def test_nothing_comes_between_the_pieces_of_a_reply() -> None:
    assert _delivered("split", b"12.5\r\n", b"0\r\n") == [b"12.", b"5\r\n", b"0\r\n"]


def test_replies_that_do_not_suffer_are_sent_at_once() -> None:
    arrived: list[bytes] = []
    buffer = OutputBuffer(arrived.append)
    buffer.deliver(b"", Faults())
    buffer.deliver(b"1\r\n", Faults())
    assert arrived == [b"1\r\n"]
