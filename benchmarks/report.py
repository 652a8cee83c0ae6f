"""The benchmark's results as the tables of ``docs/performance.md``."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

import numpy as np

Json = dict[str, Any]
BEGIN, END = "<!-- results: written by make bench -->", "<!-- end of results -->"


def machine() -> str:
    """Processor, cores and memory in words; nothing that names the machine or its folders."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    return f"{model} ({platform.machine()}), {cores} cores, {memory:.0f} GiB, {platform.system()}"


def write_report(results: Json, path: Path) -> None:
    """Replace what stands between the markers of a file, or make the file."""
    text = path.read_text() if path.exists() else f"# Performance\n\n{BEGIN}\n{END}\n"
    head, rest = text.split(BEGIN)
    tail = rest.split(END)[1]
    path.write_text(f"{head}{BEGIN}\n\n{tables(results)}\n{END}{tail}")


def tables(results: Json) -> str:
    """All tables as Markdown."""
    parts = [f"Machine: {results['machine']}; Python {results['python']}. Size of the run: {results['size']}."]
    if "comparison" in results:
        parts += [_agreement(results["comparison"]), _efficiency(results)]
    parts += [_plan(results), _live(results), _change(results)]
    if "convergence" in results:
        parts.append(_convergence(results))
    parts += [_memory(results), _start(results)]
    return "\n\n".join(parts) + "\n"


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _agreement(comparison: Json) -> str:
    rows = []
    for name in ("twin", "peer"):
        if name in comparison:
            found = comparison[name]["agreement"]
            ratio = f"{found['ratio']:.5f} ± {found['ratio_error']:.5f}"
            rows.append([name, str(found["points"]), f"{found['chi_square']:.2f}", ratio])
    verdict = "both agree" if comparison["agrees"] else "**THEY DO NOT AGREE: no figure below counts**"
    title = f"### Agreement with the reference `artifact_qdfix_tophat_llvm` ({verdict})"
    return f"{title}\n\n" + _table(["program", "points", "chi-square a point", "mean ratio (k = 1)"], rows)


def _efficiency(results: Json) -> str:
    comparison = results["comparison"]
    header = ["", "median / %", "at ±80° / %", "processor seconds a geometry", "median error reached / %"]
    rows = []
    for name in ("peer", "twin"):
        if name in comparison:
            found = comparison[name]
            cells = [_with_range(found[key], found[f"{key}_spread"], 4) for key in ("median", "grazing")]
            rows.append([name, *cells, f"{found['cpu_per_geometry']:.4f}", f"{100 * found['median_error']:.3f}"])
    if "ratio" in comparison:
        ratio = comparison["ratio"]
        rows.append(
            ["**times less processor time**", f"**{ratio['median']:.0f}**", f"**{ratio['grazing']:.0f}**",
             f"by geometry {ratio['smallest']:.0f} to {ratio['largest']:.0f}", ""]
        )  # fmt: skip
    title = "### Relative standard error × √(processor seconds), a geometry; times less processor time at equal error"
    note = "± is half the range over repeats."
    if "peer" in results:
        peer = results["peer"]
        note += (
            f" The peer's {peer['samples']} paths a geometry in one launch an illumination; kernels compiled before."
            f" Whole processes: peer {peer['process']['cpu']:.0f} s,"
            f" twin {results['efficiency']['process']['cpu']:.0f} s of processor time."
        )
    return f"{title}\n\n{_table(header, rows)}\n\n{note}"


def _spread(values: list[float], digits: int = 2) -> str:
    return _with_range(float(np.median(values)), float(np.ptp(values) / 2), digits)


def _with_range(value: float, half_range: float, digits: int) -> str:
    """A value with half its range over the repeats; alone where there is no other."""
    return f"{value:.{digits}f}" + (f" ± {half_range:.{digits}f}" if half_range > 0 else "")


def _plan(results: Json) -> str:
    runs, points = results["plan"]["runs"], results["plan"]["points"]
    whole = results["plan"]["process"]["cpu"]
    rows = [
        ["processor seconds", _spread([run["cpu"] for run in runs])],
        ["wall seconds", _spread([run["wall"] for run in runs])],
        ["largest Monte Carlo error / %", _spread([100 * run["largest_error"] for run in runs], 3)],
        ["median Monte Carlo error / %", _spread([100 * run["median_error"] for run in runs], 3)],
        [f"whole process with {len(runs) + 1} predictions, processor seconds", f"{whole:.1f}"],
    ]
    return f"### The whole plan, {points} points, each to the requested error\n\n" + _table(["", "twin"], rows)


def _live(results: Json) -> str:
    wall, cpu = (1e3 * np.array(results["live"][name]) for name in ("wall", "cpu"))
    rows = [
        [name, *(f"{np.quantile(values, q):.0f}" for q in (0.5, 0.9, 1.0))]
        for name, values in (("wall", wall), ("processor", cpu))
    ]
    title = f"### A live point, warm ({len(wall)} points one by one)"
    return f"{title}\n\n" + _table(["ms", "median", "90 %", "largest"], rows)


def _change(results: Json) -> str:
    rows = [
        [name, str(found["compiled"]), str(found["launched"]), f"{found['cpu']:.2f}", f"{found['wall']:.2f}"]
        for name, found in results["change"].items()
        if name != "process"
    ]
    header = ["changed", "kernels compiled", "kernels launched", "processor s", "wall s"]
    return "### The plan predicted again after a change of one parameter\n\n" + _table(header, rows)


def _convergence(results: Json) -> str:
    found = results["convergence"]
    rows = [
        ["relative standard deviation / %", *(f"{100 * value:.3f}" for value in found["relative_spread"])],
    ]
    title = f"### Convergence: slope {found['slope']:.2f} (independent random points: −0.50)"
    return f"{title}\n\n" + _table(["sight lines a randomisation", *map(str, found["samples"])], rows)


def _memory(results: Json) -> str:
    rows = [[str(found["samples"]), f"{found['peak_mb']:.0f}"] for found in results["memory"]]
    return "### Peak memory of a process that predicts the plan\n\n" + _table(["sight lines a point", "MiB"], rows)


def _start(results: Json) -> str:
    rows = []
    for name, runs in results["start"].items():
        walls, cpus = ([run["process"][key] for run in runs] for key in ("wall", "cpu"))
        rows.append([name.replace("_", " "), _spread(walls), _spread(cpus)])
    title = "### From the start of the process to the end of the first prediction"
    note = "First ever: every kernel is compiled; later: they are read from Dr.Jit's cache on disk."
    return f"{title}\n\n{_table(['', 'wall s', 'processor s'], rows)}\n\n{note}"
