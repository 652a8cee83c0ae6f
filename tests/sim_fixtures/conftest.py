"""What the tests of the simulated laboratory share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from instrument.facility import Facility, read_facility
from sim_fixtures.bench import Bench, BenchClock, lambertian_flux
from sim_fixtures.examples import example_files
from sim_fixtures.room import Room

#: Laboratory seconds a wall-clock second in tests that use real wires.
SPEED = 200.0


@pytest.fixture(scope="session")
def facility() -> Facility:
    """The example facility."""
    return read_facility(example_files().facility)


@pytest.fixture
def room(facility: Facility, tmp_path: Path) -> Iterator[Room]:
    """Every device on its wire, a Lambertian sample behind them."""
    room = Room(Bench(facility, lambertian_flux, BenchClock(SPEED), seed=1), tmp_path)
    yield room
    room.close()
