"""``docs/reliability.md`` from what the trials found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_HEAD = """# Reliability

What happens to a scan when programs die, disks fill up, cables come out and drives fail. Every number here was found by
a trial that anyone can repeat:

```sh
make reliability                                   # all trials
.venv/bin/python benchmarks/reliability.py kill    # one of: kill cut disk wires faults soak
.venv/bin/python benchmarks/reliability.py faults wires --missing    # go on where a trial was cut short
```

`tests/instrument/test_reliability.py` runs a reduced number of the same trials with every test run. Results are kept in
`benchmarks/reliability.json`; this page is written from them.
"""


def write_report(results: dict[str, Any], page: Path) -> None:
    """Write the page.

    Parameters
    ----------
    results
        By trial; those that were never run are said to be missing.
    page
        The file.
    """
    parts = [_HEAD, _interruptions(results)]
    parts.append(_faults(results["faults"]) if "faults" in results else "## Faults of devices\n\nNot run yet.\n")
    parts.append(_soak(results["soak"]) if "soak" in results else "## A long scan\n\nNot run yet.\n")
    page.write_text("\n".join(parts), encoding="utf-8")


def _interruptions(results: dict[str, Any]) -> str:
    lines = [
        "## Interrupted scans",
        "",
        "A scan of six points, on devices in memory whose noise depends on seed and geometry alone, is interrupted and",
        "resumed until it is complete. A trial counts as right when every point stands in the journal exactly once and",
        "equals, to the last digit, that of the uninterrupted run (times and the flag of a repeated reading apart), no",
        "arm moved with the shutter open or before it was homed, and the end was safe.",
        "",
        "| trial | interruptions | wrong | date |",
        "|---|---|---|---|",
    ]
    rows = {
        "kill": (
            "`kill -9` at random moments, up to three times a run",
            lambda r: f"{r['kills']} kills, {r['trials']} runs",
        ),
        "cut": ("journal cut within its last two lines", lambda r: f"{r['trials']} cuts"),
        "disk": ("disk full at a random byte, then room again", lambda r: f"{r['trials']} runs"),
        "wires": (
            "`kill -9` on real wires, at random moments and in mid-move",
            lambda r: f"{r['kills']} kills, {r['trials']} runs",
        ),
    }
    for name, (what, count) in rows.items():
        result = results.get(name)
        found = f"{count(result)} | {len(result['wrong'])} | {result['date']}" if result else "not run yet | | "
        lines.append(f"| {what} | {found} |")
    if "wires" in results:
        lines += ["", *_wires(results["wires"])]
    return "\n".join(lines) + "\n"


def _wires(result: dict[str, Any]) -> list[str]:
    return [
        "The last row is a scan of eight points of the simulated laboratory, which lives in a process of its own and",
        "is left alone by the kill: nobody stops its arms or closes its shutter. Of the kills",
        f"{result['emitting']} met the source emitting and {result['moving']} an arm under way. Its own watchdog",
        f"({result['watchdog_s']:g} s here) had the source dark {result['dark_after_s']:g} s after the kill at the",
        "latest, and an arm ends the one move that it was given. Resumed, every point stands there once and was",
        "measured with the arms where the record says.",
        "",
        f"What a point reads is compared with the mean of {result['whole']} uninterrupted scans, whose own readings",
        f"scatter {result['scatter']:.2f} times as the facility states ({result['freedom']} degrees of freedom). In",
        f"units of the standard deviation of such a difference the {len(result['off'])} readings of resumed scans lie",
        f"{_mean(result['off']):+.2f} off on the whole (root mean square {_rms(result['off']):.2f}), and the farthest",
        f"{max(map(abs, result['off'])):.2f}, where {result['allowed']:.2f} is allowed: sound scans exceed that once",
        "in a hundred trials (`benchmarks/reliability_alike.py`).",
        *(("", result["remark"]) if "remark" in result else ()),
    ]


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(_mean([value**2 for value in values]))


def _faults(result: dict[str, Any]) -> str:
    rows = result["rows"]
    wrong = sum(bool(row["wrong"]) for row in rows)
    lines = [
        "## Faults of devices",
        "",
        "Eight points on the simulated laboratory, its devices in a process of their own, reached by the drivers over",
        "pseudo-terminals and TCP. The fault strikes after the second point has begun: as the device is next used, or",
        "once the arm moves. At every point the record is compared with where the arms truly stand; motion commands",
        "are counted where the devices receive them, against those that the scan gave to the drivers; at the end",
        "emission, shutter and arms are looked at. A point may be lost only to an arm that stalls or is misled, and to",
        "a device that says that it has failed; a drive's alarm or limit switch ends the scan, and the run is resumed.",
        "",
        f"{len(rows)} faults of the {result.get('of', len(rows))} in the list, {wrong} with anything wrong",
        f"({result['date']}; {result['machine']}).",
        "",
        "| device | family | fault | end | points lost | rests | moves on the wire / intended | told first |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        verdict = f" **wrong: {'; '.join(row['wrong'])}**" if row["wrong"] else ""
        told = str(row.get("told", "")).replace("|", "/")
        lines.append(
            f"| {row['device']} | {row.get('family', '')} | {row['fault']} | {row['outcome']}{verdict} |"
            f" {row.get('lost', '')} |"
            f" {row.get('suspended', '')} | {row.get('on_the_wire', '')} / {row.get('intended', '')} | {told} |"
        )
    return "\n".join(lines) + "\n"


def _soak(result: dict[str, Any]) -> str:
    return f"""## A long scan

{result["points"]} points on devices in memory and a clock a million times faster; processor time is that of all
threads, the devices' own share included ({result["date"]}; {result["machine"]}).

| | |
|---|---|
| end | {result["outcome"]}, {result["done"]} points, {result["readable"]} in the journal |
| processor time a point | {result["cpu_ms_per_point"]:.2f} ms; first half {result["cpu_ms_first_half"]:.2f}, \
second half {result["cpu_ms_second_half"]:.2f} |
| journal a point | {result["journal_bytes_per_point"]:.0f} bytes |
| memory, first and last look | {result["memory_at_start_mb"]:.0f} and {result["memory_at_end_mb"]:.0f} MB |
| growth in the second half | {result["memory_growth_bytes_per_point"]:.0f} bytes a point |
"""
