"""What the trials scan: a small plan on devices in memory whose readings depend on the geometry alone.

So a run that was interrupted, wherever that was, has to equal the uninterrupted one to the last digit.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "instrument"))

from fake_bench import Bench, FakeAxis, FakeDetector
from scan_stage import FACILITY, QUICK, Stage, plan_of, stage

from drivers.clock import Clock
from drivers.interfaces import Reading
from instrument.journal import read_journal
from instrument.settings import AcquisitionSettings, MotionSettings, ScanSettings

__all__ = ["FACILITY", "FAST", "Bench", "FakeAxis", "Stage", "plan_of", "seeded_bench", "small_scan", "stage"]
#: Bit of ``quality_flag`` that says that a reading was repeated: the only thing that an interruption may leave behind.
REPEATED = 8
PLAN = {"illumination": (0.0, 15.0), "azimuth": (90.0,), "zenith": (30.0, 20.0, 10.0)}
FAST = QUICK.model_copy(
    update={
        "dwell": 0.0,
        "motion": MotionSettings(wire_wall=5.0, poll=0.0, poll_wall=0.0),
        "acquisition": AcquisitionSettings(settling=0.0),
        "heartbeat_wall": 600.0,
        "keep_alive_wall": 600.0,
    }
)


class SeededDetector(FakeDetector):
    """Noise by seed and by what is read, not by how often anything was read before."""

    def read(self, samples: int) -> Reading:
        bench = self.bench
        places = tuple(round(axis.place(), 6) for axis in bench.axes.values())
        key = repr((bench.mounted, places, bench.shutter.opened, bench.selector.nm, samples))
        self._random = np.random.default_rng(
            int.from_bytes(hashlib.blake2b(key.encode(), digest_size=8).digest(), "big")
        )
        return super().read(samples)


def seeded_bench(speed: float = 1e5) -> Bench:
    """Devices in memory on a fast clock."""
    bench = Bench(clock=Clock(speed))
    bench.detector = SeededDetector(bench)
    return bench


def small_scan(folder: Path, settings: ScanSettings = FAST) -> Stage:
    """A scan of six points, or the rest of it where the folder holds a journal."""
    return stage(folder, plan_of(**PLAN), seeded_bench(), settings)


def measured(folder: Path) -> dict[int, Any]:
    """Every point of a journal without what an interruption may change: times, and the flag of a repeated reading."""
    kept = {}
    for index, record in read_journal(folder).points.items():
        point = {key: value for key, value in record.items() if key not in ("time", "kind", "index")}
        point["quality_flag"] &= ~REPEATED
        kept[index] = point
    return kept


def problems_of(folder: Path, expected: dict[int, Any]) -> list[str]:
    """What is wrong with a run that was resumed until it was complete."""
    found = measured(folder)  # reading refuses a point that stands twice
    wrong = [f"point {index} is missing" for index in expected.keys() - found.keys()]
    wrong += [f"point {index} differs" for index in expected.keys() & found.keys() if found[index] != expected[index]]
    lines = (folder / "journal.jsonl").read_bytes().splitlines()
    indices = [record["index"] for record in map(json.loads, lines) if record["kind"] == "point"]
    wrong += [f"point {index} stands {indices.count(index)} times" for index in expected if indices.count(index) > 1]
    return wrong
