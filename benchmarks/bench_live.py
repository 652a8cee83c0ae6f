"""How long a live point takes, from the request to the answer of the worker process, once that is warm.

::

    .venv/bin/python benchmarks/bench_live.py                    # prints
    .venv/bin/python benchmarks/bench_live.py --write            # and puts the table into docs/performance.md

A point is asked for as the live twin asks for it (:mod:`twin.live`): one geometry of Table IV in the example
laboratory, in random order, without others. Its uncertainty is complete: that of the inputs has been worked out
before and is looked up. Then the plan is predicted again with another value of one uncertain input after the
other, and the kernels that had to be compiled for that are counted.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from report import machine

from instrument.events import Geometry
from instrument.facility import read_facility
from instrument.plan import read_plan
from sim_fixtures.examples import ExampleFiles, example_files
from twin.input_uncertainty import find_input_uncertainty
from twin.live import LOOK
from twin.optics import geometry_columns
from twin.propagation_render import PlanRenderer
from twin.state_vector import StateVector, state_vector_from_files
from twin.worker import PredictionWorker

DOCUMENT = Path(__file__).parents[1] / "docs" / "performance.md"
BEGIN, END = "<!-- live: written by benchmarks/bench_live.py -->", "<!-- end of live -->"
#: What is asked for: words, relative standard error, sight lines.
WAYS: tuple[tuple[str, float, int | None], ...] = (
    (f"first look, {LOOK} sight lines", 0.004, LOOK),
    ("refined to 0.1 %", 0.001, None),
)
_WARM_UP = 3
PRIORITY = "nice level while points are timed: a negative one keeps others' work out of the wall time (needs the right)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=40)
    parser.add_argument("--every", type=int, default=8, help="of the plan that is predicted again, so many points")
    parser.add_argument("--priority", type=int, default=0, help=PRIORITY)
    parser.add_argument("--write", action="store_true", help=f"put the tables into {DOCUMENT.name}")
    options = parser.parse_args()
    files = example_files()
    points = read_plan(files.plan, read_facility(files.facility)).points
    state = state_vector_from_files(files.facility, files.artifact, files.material)
    chosen = np.random.default_rng(3).permutation(len(points))[: options.points]
    asked = [points[number] for number in chosen]
    known = find_input_uncertainty(state, asked)  # some CPU seconds, unless the user's cache has it
    text = latency_table(files, points, asked, known.u, options.priority)
    text += kernel_table(state, points[:: options.every])
    busy = os.getloadavg()[0]
    text = (
        f"{machine()}; while this ran, {busy:.0f} threads wanted a core on average, its own included; points timed at"
        f" nice level {options.priority}.\n\n{text}"
    )
    print(text)
    if options.write:
        write(text, DOCUMENT)


def latency_table(
    files: ExampleFiles,
    plan: Sequence[Geometry],
    asked: Sequence[Geometry],
    u_inputs: NDArray[np.float64],
    priority: int,
) -> str:
    """Wall and processor time of single points, by way of asking."""
    header = ("a live point", "wall, median / ms", "wall, 90 % / ms", "processor / ms",
              "Monte Carlo error, median / %", "largest / %", "with that of the inputs, median / %")  # fmt: skip
    lines = [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
    with PredictionWorker(files.facility, files.artifact, files.material, niceness=0) as worker:
        for words, error, sight_lines in WAYS:
            wall, cpu, found = ask(worker, plan, asked, error, sight_lines, u_inputs, priority)
            tracer, combined = 100 * found[:, 1] / found[:, 0], 100 * found[:, 2] / found[:, 0]
            lines.append(
                f"| {words} | {1e3 * np.median(wall):.0f} | {1e3 * np.percentile(wall, 90):.0f} | {1e3 * cpu:.0f}"
                f" | {np.median(tracer):.2f} | {tracer.max():.2f} | {np.median(combined):.2f} |"
            )
    return "\n".join(lines) + "\n\n"


def ask(
    worker: PredictionWorker,
    plan: Sequence[Geometry],
    asked: Sequence[Geometry],
    error: float,
    sight_lines: int | None,
    u_inputs: NDArray[np.float64],
    priority: int,
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """Ask for points one by one.

    Returns
    -------
    wall, shape (point,)
        Seconds from request to answer.
    cpu
        Processor seconds of the worker process, mean over the points.
    found, shape (point, 3)
        Reflectance factor, standard error of the ray tracer, combined standard uncertainty.
    """
    worker.predict(range(len(plan)), plan, error, sight_lines).result()  # the scan has seen its plan before
    for point in asked[:_WARM_UP]:
        worker.predict([0], [point], error, sight_lines).result()
    wall, found = [], []
    assert worker.pid is not None
    set_priority(worker.pid, priority)
    before = processor_seconds(worker.pid)
    for number, point in enumerate(asked):
        began = time.perf_counter()
        answer = worker.predict([number], [point], error, sight_lines).result()
        tracer = answer.u_brf_monte_carlo[0]
        combined = math.hypot(u_inputs[number], tracer)
        wall.append(time.perf_counter() - began)
        found.append((answer.brf[0], tracer, combined))
    cpu = (processor_seconds(worker.pid) - before) / len(asked)
    set_priority(worker.pid, 0)
    return np.array(wall), cpu, np.array(found)


def set_priority(pid: int, level: int) -> None:
    """Of all threads of the worker and of this process."""
    for process in (pid, os.getpid()):
        for thread in Path(f"/proc/{process}/task").iterdir():
            with suppress(ProcessLookupError):  # it has ended since
                if os.getpriority(os.PRIO_PROCESS, int(thread.name)) != level:
                    os.setpriority(os.PRIO_PROCESS, int(thread.name), level)


def processor_seconds(pid: int) -> float:
    """Of all threads of a process, from Linux's process table."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def kernel_table(state: StateVector, points: Sequence[Geometry]) -> str:
    """Kernels compiled when one uncertain input after the other has another value."""
    import drjit as dr

    renderer = PlanRenderer(state, geometry_columns(points), seed=1)
    renderer.render([state.nominal], 64)
    counts: dict[str, list[int]] = {}
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for block, place in state.slices():
            dr.kernel_history_clear()
            value = state.nominal.copy()
            value[place] += block.standard_uncertainty
            renderer.render([value], 64)
            kernels: list[Any] = list(dr.kernel_history([dr.KernelType.JIT]))
            found = counts.setdefault(block.source, [0, 0, 0])
            found[0] += len(block)
            found[1] += len(kernels)
            found[2] += sum(not kernel["cache_hit"] for kernel in kernels)
    lines = ["| input changed | parameters | kernels launched | compiled |", "|---|---|---|---|"]
    lines += [f"| {name} | {size} | {launched} | {fresh} |" for name, (size, launched, fresh) in counts.items()]
    return "\n".join(lines) + "\n"


def write(text: str, path: Path) -> None:
    """Replace what stands between the markers."""
    document = path.read_text()
    head, _, rest = document.partition(BEGIN)
    _, _, tail = rest.partition(END)
    path.write_text(f"{head}{BEGIN}\n\n{text}\n{END}{tail}")


if __name__ == "__main__":
    main()
