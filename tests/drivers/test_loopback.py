"""Servers bind to loopback: nobody on the network can drive a laboratory or change a sample by accident."""

from __future__ import annotations

import os
from pathlib import Path

from sim_fixtures.laboratory import SimulatedLaboratory

_LISTEN = "0A"
#: 127.0.0.1 and ::1 as /proc/net writes them.
_LOOPBACK = {"0100007F", "00000000000000000000000001000000"}


def listening(pid: int) -> dict[int, str]:
    """Port and address (as /proc/net writes it) of every TCP socket that a process listens on."""
    own = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            own.add(os.readlink(descriptor))
        except FileNotFoundError:  # closed meanwhile
            continue
    found = {}
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            address, _, port = fields[1].partition(":")
            if fields[3] == _LISTEN and f"socket:[{fields[9]}]" in own:
                found[int(port, 16)] = address
    return found


def test_the_simulated_laboratory_listens_to_this_machine_only(simulation: SimulatedLaboratory) -> None:
    sockets = listening(simulation.pid)
    assert {simulation.endpoints["meter"], simulation.endpoints["control"]} <= sockets.keys()
    assert set(sockets.values()) <= _LOOPBACK, sockets
