"""The estimated duration of scans against what the simulated laboratory takes: ``python benchmarks/forecast_trial.py``.

Every device is on its wire; the clock jumps wherever somebody would wait, so that the duration is that of moves,
readings and pauses and not of the computer. Writes ``benchmarks/forecast.json`` and prints the table of
``docs/plan.md``.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "tests" / "instrument")]

from scan_stage import FACILITY  # noqa: E402
from test_forecast import durations, facility  # noqa: E402

from instrument.settings import ScanSettings  # noqa: E402

#: Readings follow each other at once.
AT_ONCE = 0.0
PLANES = {
    "sensor_azimuth": [0.0, 45.0],
    "sensor_zenith": {"start": 80.0, "stop": -80.0, "step": -10.0},
    "illumination_zenith": [15.0],
}
COLOURS = {
    "wavelength": [450.0, 500.0, 550.0, 600.0],
    "sensor_zenith": [60.0, 40.0, 20.0],
    "order": ["illumination_zenith", "sensor_azimuth", "sensor_zenith", "wavelength"],
}
SWEEPS = {"sensor_azimuth": [30.0, 60.0, 90.0], "sensor_zenith": [60.0, 30.0]}
ONE_SIDED = {
    "sensor_zenith": {"approach": "rising", "backlash": 3.0},
    "illumination_zenith": {"approach": "falling", "backlash": 1.0},
}
TURNED = {"sample_rotation": [0.0, 60.0, 120.0], "polarization": ["s", "mean"]}
BY_HAND = [
    {"illumination_zenith": [20.0], "illumination_azimuth": azimuth, "sensor_zenith": [60.0, 30.0]}
    for azimuth in (-45.0, 0.0, 45.0)
]
TURNABLE = facility(illumination_azimuth=(-90.0, 90.0))
LONG = {"sensor_zenith": [60.0, 50.0, 40.0, 30.0, 20.0, -20.0, -40.0, -60.0]}
EQUIPPED = facility(sample_rotation=(-180.0, 180.0), polarizer=(0.0, 90.0))
REPEATING = FACILITY.model_copy(update={"reference": FACILITY.reference.model_copy(update={"repeat_minutes": 2.0})})
#: Name, part of the plan or several, seconds a point, further arguments.
PLANS: list[tuple[str, dict[str, Any] | list[dict[str, Any]], float, dict[str, Any]]] = [
    ("two planes of the paper's artifact scan", PLANES, 20.0, {}),
    ("the same, as fast as it goes", PLANES, AT_ONCE, {}),
    ("four wavelengths at each geometry", COLOURS, AT_ONCE, {}),
    ("steps of 1 degree", {"sensor_zenith": {"start": 40.0, "stop": 20.0, "step": -1.0}}, AT_ONCE, {}),
    ("100 samples a reading", {}, AT_ONCE, {"samples": 100}),
    ("serpentine, measured twice", SWEEPS, 5.0, {"direction": "serpentine", "repeats": 2}),
    ("approach from one side", SWEEPS, AT_ONCE, {"edit": ONE_SIDED}),
    ("rotation and polarisation", TURNED, 5.0, {"at": EQUIPPED}),
    ("reference every 2 minutes", LONG, 20.0, {"at": REPEATING}),
    ("reference every 2 minutes, by hands that take one", LONG, 20.0, {"at": REPEATING, "hands": 60.0}),
    ("three azimuths, set by hands in two minutes", BY_HAND, 5.0, {"at": TURNABLE, "hands": 120.0}),
]


def main() -> None:
    """Run every plan."""
    rows = []
    print("| plan | estimated / s | simulated / s | difference |\n|---|---|---|---|")
    for name, part, dwell, further in PLANS:
        hands = further.pop("hands", 0.0)
        with tempfile.TemporaryDirectory() as folder:
            settings = ScanSettings(dwell=dwell, hands=hands, disk_reserve=0.0)
            estimated, simulated = durations(
                Path(folder), part if isinstance(part, list) else [part], settings, **further
            )
        rows.append({"plan": name, "estimated_s": round(estimated, 1), "simulated_s": round(simulated, 1)})
        print(
            f"| {name} | {estimated:.1f} | {simulated:.1f} | {100 * (estimated / simulated - 1):+.2f} % |", flush=True
        )
    (HERE / "forecast.json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
