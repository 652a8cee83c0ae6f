"""A laboratory whose clock jumps: the simulated devices on their wires, and nobody waits for anything.

Laboratory time passes only where somebody would wait for it, so that a scan takes exactly as long as its moves,
readings and pauses, whatever the computer does meanwhile.
"""

from __future__ import annotations

import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

from drivers.clock import Clock
from drivers.configuration import connect
from drivers.interfaces import Laboratory
from instrument.facility import Facility
from sim_fixtures.bench import Bench, lambertian_flux
from sim_fixtures.connections import write_devices
from sim_fixtures.room import Room


class JumpingClock(Clock):
    """Time that stands still until somebody waits, and then jumps."""

    def __init__(self) -> None:
        super().__init__(1.0, datetime(2026, 3, 2, tzinfo=UTC))
        self._lock, self._elapsed = threading.Lock(), 0.0

    def monotonic(self) -> float:
        return self._elapsed

    def now(self) -> datetime:
        return self._start + timedelta(seconds=self._elapsed)

    def sleep(self, seconds: float) -> None:
        with self._lock:
            self._elapsed += max(seconds, 0.0)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        if not event.is_set():
            self.sleep(seconds)
        return event.is_set()

    def reach(self, moment: float) -> None:
        with self._lock:
            self._elapsed = max(self._elapsed, moment)


class BenchTime:
    """The same time as the bench needs it."""

    speed = 1.0

    def __init__(self, clock: JumpingClock) -> None:
        self._clock = clock

    def now(self) -> float:
        return self._clock.monotonic()

    def wait_until(self, moment: float, cancelled: threading.Event | None = None) -> None:
        self._clock.reach(moment)


class VirtualLaboratory:
    """Stands in for the bench of :func:`scan_stage.stage`."""

    def __init__(self, folder: Path, facility: Facility, edit: dict[str, dict[str, object]] | None = None) -> None:
        self.clock = JumpingClock()
        self.bench = Bench(facility, lambertian_flux, BenchTime(self.clock), seed=3)
        self.room = Room(self.bench, folder)
        ports = {name: str(path) for name, path in self.room.endpoints.ports.items()}
        self.devices = folder / "devices.toml"
        write_devices(self.devices, ports, self.room.endpoints.meter, 1.0, facility)
        if edit:
            _edit(self.devices, edit)
        self.mount = self.bench.mount

    def laboratory(self) -> Laboratory:
        return connect(self.devices, self.clock)

    def close(self) -> None:
        self.room.close()


def _edit(path: Path, edit: dict[str, dict[str, object]]) -> None:
    import tomllib

    import tomli_w

    form = tomllib.loads(path.read_text())
    for role, changes in edit.items():
        form["devices"][role] |= changes
    path.write_text(tomli_w.dumps(form))
