"""A very long scan on an accelerated clock: memory, journal and the engine's own work per point stay what they are."""

from __future__ import annotations

import math
import resource
import time
from pathlib import Path
from typing import Any

from reliability_bench import FACILITY, FAST, Bench, FakeAxis, Stage, plan_of, seeded_bench, stage

from instrument.events import Event, PointMeasured
from instrument.facility import Arms
from instrument.journal import read_journal


def soak_trial(folder: Path, points: int, stops: int = 20) -> dict[str, Any]:
    """Scan so many points; look at memory, journal and processor time every ``points / stops``.

    Devices in memory answer at once, so what is measured is the engine's own work: the sum of all threads, the
    devices' and the clock's share included.
    """
    scan = _long_scan(folder, points)
    looks: list[dict[str, float]] = []
    publish, every = scan.bus.publish, max(points // stops, 1)

    def watched(event: Event) -> None:
        publish(event)
        if isinstance(event, PointMeasured) and (event.done % every == 0 or event.done == 1):
            looks.append(
                {
                    "points": event.done,
                    "memory_mb": _memory(),
                    "journal_bytes": (folder / "journal.jsonl").stat().st_size,
                    "cpu_s": time.process_time(),
                }
            )

    scan.bus.publish = watched  # type: ignore[method-assign]
    end = scan.run(100_000.0)
    begin, last = looks[1] if len(looks) > 2 else looks[0], looks[-1]
    between = max(last["points"] - begin["points"], 1)
    half = looks[len(looks) // 2]
    return {
        "points": points,
        "outcome": end.outcome,
        "done": end.done,
        "wrong": list(scan.bench.wrong),
        "readable": len(read_journal(folder).points),
        "cpu_ms_per_point": 1000 * (last["cpu_s"] - begin["cpu_s"]) / between,
        "cpu_ms_first_half": _cost(begin, half),
        "cpu_ms_second_half": _cost(half, last),
        "journal_bytes_per_point": (last["journal_bytes"] - begin["journal_bytes"]) / between,
        "memory_at_start_mb": begin["memory_mb"],
        "memory_at_end_mb": last["memory_mb"],
        "memory_growth_bytes_per_point": 1e6
        * (last["memory_mb"] - half["memory_mb"])
        / max(last["points"] - half["points"], 1),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "looks": looks,
    }


def _cost(first: dict[str, float], last: dict[str, float]) -> float:
    return 1000 * (last["cpu_s"] - first["cpu_s"]) / max(last["points"] - first["points"], 1)


def _long_scan(folder: Path, points: int) -> Stage:
    # Short moves in one plane and its neighbours; the illumination stands far away, so that no way leads around.
    zenith = tuple(round(10.0 + 0.02 * number, 4) for number in range(1000))
    planes = math.ceil(points / len(zenith))
    azimuth = tuple(round(30.0 + 120.0 * number / max(planes, 1), 6) for number in range(planes))
    per_plane = zenith if points >= len(zenith) else zenith[:points]
    bench: Bench = seeded_bench(speed=1e6)
    for axis in bench.axes.values():
        assert isinstance(axis, FakeAxis)
        axis.commands = _Nothing()
    facility = FACILITY.model_copy(update={"arms": Arms(shadow_half_angle=5.0)})
    return stage(folder, plan_of((0.0,), azimuth, per_plane), bench, FAST, facility)


class _Nothing(list[float]):
    """A log of commands that keeps none: the devices' memory is not the engine's."""

    def append(self, _: float) -> None: ...


def _memory() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6
