"""Fixtures of the driver tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from scripted_peer import Peer, Step


@pytest.fixture
def converse() -> Iterator[Callable[..., Peer]]:
    """Make peers; at the end of the test every one must have been asked everything."""
    peers: list[Peer] = []

    def make(*script: Step) -> Peer:
        peers.append(Peer(script))
        return peers[-1]

    yield make
    for peer in peers:
        peer.hang_up() if peer.surprises else peer.finish()
        assert not peer.surprises, peer.surprises
