"""Fixtures of the driver tests."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from scripted_peer import Peer, Step

from sim_fixtures.laboratory import SimulatedLaboratory, start_simulated

#: Of the simulated room: laboratory seconds a wall-clock second, and the longest wait for a reply.
SPEED, TIMEOUT = 40.0, 0.4


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


@pytest.fixture(scope="module")
def simulation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedLaboratory]:
    """One simulated room for all tests."""
    with start_simulated(tmp_path_factory.mktemp("room"), speed=SPEED, flux="lambertian") as room:
        yield room


@pytest.fixture(scope="module")
def devices(simulation: SimulatedLaboratory) -> Path:
    """Its connections, with shorter time-outs: many replies are lost here on purpose."""
    file = simulation.inputs.devices.with_name("impatient.toml")
    text = simulation.inputs.devices.read_text()
    file.write_text(re.sub(r"^timeout = .*$", f"timeout = {TIMEOUT}", text, flags=re.MULTILINE))
    return file
