"""Trials of reliability: ``python benchmarks/reliability.py TRIAL ...``; ``make reliability`` runs all of them.

Writes what was found to ``benchmarks/reliability.json`` and ``docs/reliability.md``; ends with status 1 where anything
was wrong. ``tests/instrument/test_reliability.py`` runs a reduced number of the same trials.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from reliability_crash import cut_trial, disk_trial, kill_trial
from reliability_faults import fault_trial, faults
from reliability_report import write_report
from reliability_soak import soak_trial
from reliability_wires import wire_trial

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "reliability.json"
TRIALS = ("kill", "cut", "disk", "wires", "faults", "soak")


def main() -> int:
    """Run the trials that are asked for and keep what they found beside earlier results of the others."""
    options = _parser().parse_args()
    results = _results()
    with tempfile.TemporaryDirectory(prefix="goniotwin-trials-", dir=options.folder) as folder:
        os.environ["GONIOTWIN_LOCK_DIR"] = str(Path(folder) / "locks")
        for name, trial in _chosen(options, Path(folder)).items():
            found = _dated(trial)
            results = _results() | {name: found}  # another trial may have ended meanwhile
            RESULTS.write_text(json.dumps(results, indent=1) + "\n")
            write_report(results, ROOT / "docs" / "reliability.md")
            print(f"{name}: {'as it should be' if right(results[name]) else 'WRONG'}", flush=True)
    return 0 if all(right(result) for result in results.values()) else 1


def right(result: dict[str, Any]) -> bool:
    """Whether a trial found nothing wrong."""
    return not result["wrong"] and not any(row["wrong"] for row in result.get("rows", ()))


def _chosen(options: argparse.Namespace, folder: Path) -> dict[str, Callable[[], dict[str, Any]]]:
    known: dict[str, Callable[[], dict[str, Any]]] = {
        "kill": lambda: kill_trial(folder, options.trials),
        "cut": lambda: cut_trial(folder, options.every),
        "disk": lambda: disk_trial(folder, max(options.trials // 5, 1)),
        "wires": lambda: _wires(options, folder / "wires"),
        "faults": lambda: _faults(options, folder / "faults"),
        "soak": lambda: soak_trial(_made(folder / "soak"), options.points),
    }
    return {name: known[name] for name in TRIALS if name in (options.trial or TRIALS)}


def _wires(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Kill scans on wires, or go on where an earlier trial ended."""
    before = _results().get("wires") if options.missing else None
    runs = max(options.trials // 12, 1) - (before["trials"] if before else 0)

    def keep(found: dict[str, Any]) -> None:
        RESULTS.write_text(json.dumps(_results() | {"wires": found | _today()}, indent=1) + "\n")

    return wire_trial(folder, runs, before, keep)


def _faults(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Run the list, or what is missing of it; every result is kept at once."""
    kept = {_key(row): row for row in _results().get("faults", {}).get("rows", ())}
    if not options.missing and not options.only:
        kept = {}
    listed = [fault for fault in faults() if not options.only or options.only in f"{fault.device}: {fault.name}"]
    old = [key for key, row in kept.items() if options.missing and not row["wrong"]]
    chosen = [fault for fault in listed if (fault.device, fault.family, fault.name) not in old]

    def keep(row: dict[str, Any]) -> None:
        kept[_key(row)] = row
        if options.verbose:
            print(row, flush=True)
        results = _results()
        results.setdefault("faults", {"wrong": []})["rows"] = _in_order(kept)
        RESULTS.write_text(json.dumps(results, indent=1) + "\n")

    fault_trial(folder, chosen, keep)
    return {"wrong": [], "of": len(faults()), "rows": _in_order(kept)}


def _results() -> dict[str, Any]:
    return dict(json.loads(RESULTS.read_text())) if RESULTS.exists() else {}


def _in_order(kept: dict[tuple[str, ...], dict[str, Any]]) -> list[dict[str, Any]]:
    keys = [(fault.device, fault.family, fault.name) for fault in faults()]
    return [kept[key] for key in keys if key in kept]


def _key(row: dict[str, Any]) -> tuple[str, ...]:
    return row["device"], row.get("family", ""), row["fault"]


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _dated(trial: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    began, cpu = time.monotonic(), os.times()
    result = trial()
    now = os.times()
    spent = sum(now[:4]) - sum(cpu[:4])
    return (
        result
        | _today()
        | {
            "wall_s": round(time.monotonic() - began, 1),
            "cpu_s": round(spent, 1),
        }
    )


def _today() -> dict[str, str]:
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trial", nargs="*", choices=[*TRIALS, []], help="all of them by default")
    scans = "scans to kill; a fifth of it starves of disk, a twelfth is killed on wires"
    parser.add_argument("--trials", type=int, default=500, help=scans)
    parser.add_argument("--every", type=int, default=1, help="bytes between the cuts of the journal")
    parser.add_argument("--points", type=int, default=100_000, help="of the long scan")
    parser.add_argument("--folder", type=Path, default=None, help="where the runs go meanwhile")
    parser.add_argument("--missing", action="store_true", help="go on: faults without a right result, scans on wires")
    parser.add_argument("--only", default="", help="faults: only those whose 'device: name' contains this")
    parser.add_argument("--verbose", action="store_true", help="print every fault's outcome")
    return parser


if __name__ == "__main__":
    sys.exit(main())
