"""Propagation of uncertainties: what it costs, and whether its ways agree.

Prints the tables of docs/uncertainty.md::

    .venv/bin/python benchmarks/bench_propagation.py              # all of Table IV, 500 draws
    .venv/bin/python benchmarks/bench_propagation.py --write      # and puts them into docs/uncertainty.md
    .venv/bin/python benchmarks/bench_propagation.py --every 6 --draws 100 --only cost coverage

Cost and agreement of the whole are measured on the whole plan, what goes into detail on every ``--part``-th point. CPU
seconds are those of this process; with ``--workers`` those of others are not counted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from report import machine

from instrument.angles import FloatArray
from instrument.plan import read_plan
from twin.optics import geometry_columns
from twin.propagation import Propagation, by_draws, by_sensitivities, evaluate
from twin.propagation_designs import STEP
from twin.propagation_render import PlanRenderer
from twin.state_vector import StateVector, state_vector_from_files

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES, DOCUMENT = ROOT / "sim_fixtures" / "examples", ROOT / "docs" / "uncertainty.md"
BEGIN, END = "<!-- results: written by benchmarks/bench_propagation.py -->", "<!-- end of results -->"
T = TypeVar("T")
#: What was printed, for the document.
_lines: list[str] = []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, help="use every so many points of Table IV")
    parser.add_argument("--part", type=int, default=8, help="for sources, columns and coverage")
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--tolerance", type=float, default=0.1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=["cost", "sources", "columns", "coverage"])
    parser.add_argument("--write", action="store_true", help=f"put the tables into {DOCUMENT.name}")
    options = parser.parse_args()
    state = state_vector_from_files(*(EXAMPLES / name for name in ("facility.toml", "artifact.toml", "material.nc")))
    points = read_plan(EXAMPLES / "table_iv.toml", state.facility).points
    every, part = (geometry_columns(points[::step]) for step in (options.every, options.part))
    PlanRenderer(state, every, seed=1).render([state.nominal], 64)  # compiled before the clock starts
    say(f"{machine()}; {len(state)} inputs from {len(state.sources)} sources.")
    if "cost" in options.only:
        cost_and_agreement(state, every, options.draws, options.tolerance, options.workers)
    if "coverage" in options.only:
        coverage(state, part, options.tolerance, options.workers)
    if "sources" in options.only:
        agreement_by_source(state, part, options.tolerance)
    if "columns" in options.only:
        columns_by_other_steps(state, part)
    if options.write:
        head, rest = DOCUMENT.read_text().split(BEGIN)
        DOCUMENT.write_text(head + "\n".join([BEGIN, "", *_lines, "", END]) + rest.split(END)[1])


def say(text: str) -> None:
    """Print a line, and keep it for the document."""
    print(text, flush=True)
    _lines.append(text)


def timed(what: str, work: Callable[[], T]) -> T:
    """Run something and print what it cost."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    say(f"- {what}: {time.process_time() - cpu:.0f} CPU s, {time.perf_counter() - wall:.0f} s")
    return result


def cost_and_agreement(
    state: StateVector, columns: dict[str, FloatArray], draws: int, tolerance: float, workers: int
) -> None:
    """Combined uncertainty and correlation between points, by sensitivities and by draws."""
    say(f"\n**Cost and agreement**, {len(columns['wavelength'])} points:\n")
    renderer = PlanRenderer(state, columns, seed=1)
    slopes = timed("sensitivities", lambda: by_sensitivities(renderer, tolerance=tolerance))
    other = PlanRenderer(state, columns, seed=2)
    drawn = timed(f"{draws} draws of the whole vector", lambda: by_draws(other, draws=draws, seed=7, workers=workers))
    say(f"- evaluations of the plan: {slopes.evaluations} and {drawn.evaluations}")
    a, b = (100 * float(np.sqrt(np.mean(r.u**2 / r.brf**2))) for r in (slopes, drawn))
    say(f"- u, root mean square over the points: {a:.3f} % and {b:.3f} %")
    one, two = (100 * float(np.median(r.u_error)) for r in (slopes, drawn))
    say(f"- relative standard error of u, median: {one:.1f} % and {two:.1f} %")
    score = np.log(np.maximum(slopes.u, 1e-9) / np.maximum(drawn.u, 1e-9)) / np.hypot(slopes.u_error, drawn.u_error)
    within = [100 * float(np.mean(np.abs(score) < k)) for k in (1, 2)]
    say(
        f"- ratio of u, median over the points: {np.median(slopes.u / np.maximum(drawn.u, 1e-9)):.3f}; within one"
        f" combined standard error of 1 at {within[0]:.0f} %, within two at {within[1]:.0f} % of the points"
    )
    _compare_correlations(slopes, drawn, draws)


def _compare_correlations(slopes: Propagation, drawn: Propagation, draws: int) -> None:
    upper = np.triu_indices(len(slopes.noise), 1)
    one, two = slopes.correlation()[upper], drawn.correlation()[upper]
    expected = np.sqrt(np.mean((1 - one**2) ** 2) / draws)
    say(
        f"- correlation between points: mean {one.mean():.3f} and {two.mean():.3f}, difference"
        f" {np.sqrt(np.mean((one - two) ** 2)):.3f} (root mean square; {expected:.3f} from the number of draws alone)"
    )


def agreement_by_source(state: StateVector, columns: dict[str, FloatArray], tolerance: float, draws: int = 48) -> None:
    """Each source alone: its uncertainty by sensitivities and by draws."""
    say("\n**Each source alone**, root mean square over every part-th point:\n")
    say("| source | sensitivities / % | draws / % | standard error / % |\n|---|---|---|---|")
    for source in state.sources:
        alone = replace(state, blocks=tuple(block for block in state.blocks if block.source == source))
        slopes = by_sensitivities(PlanRenderer(alone, columns, seed=3), tolerance=tolerance)
        drawn = by_draws(PlanRenderer(alone, columns, seed=4), draws=draws, seed=9)
        (a, u_a), (b, u_b) = (_root_mean_square(result) for result in (slopes, drawn))
        say(f"| {source} | {a:.3f} | {b:.3f} | {np.hypot(u_a, u_b):.3f} |")


def _root_mean_square(result: Propagation) -> tuple[float, float]:
    """Relative uncertainty, root mean square over the points, and its standard error; per cent.

    As if the errors of all points were one: too large for what is independent between points.
    """
    relative = sum(result.variance.values(), np.zeros(len(result.noise))) / result.brf**2
    known = np.where(np.isfinite(result.u_error), result.u_error, 0.0)
    mean, error = float(np.mean(relative)), float(np.mean(2 * known * np.abs(relative)))
    root = float(np.sqrt(max(mean, 0.0)))
    return 100 * root, 100 * (error / (2 * root) if root > 0 else np.sqrt(error))


def columns_by_other_steps(state: StateVector, columns: dict[str, FloatArray]) -> None:
    """Every derivative column against one with half the step and independent random numbers."""
    results = [
        by_sensitivities(PlanRenderer(state, columns, seed=seed), tolerance=0.05, step=step)
        for seed, step in ((11, STEP), (12, STEP / 2))
    ]
    say("\n**Every derivative column against one of half the step** and other random numbers:\n")
    say("| column | effect / % | stated error / % | difference over its error, rms | mean |\n|---|---|---|---|---|")
    for label in results[0].sensitivity:
        block = next(b for b in state.blocks if label in b.labels)
        u = float(block.standard_uncertainty[block.labels.index(label)])
        if label.startswith("material stability") and not label.endswith(" 0"):
            continue
        one, two = (100 * u * r.sensitivity[label] / r.brf for r in results)
        errors = [100 * u * r.sensitivity_error[label] / r.brf for r in results]
        # Errors are themselves known from 16 randomisations each: Student's t of 30 degrees of freedom.
        score = (one - two) / np.maximum(np.hypot(*errors), 1e-9) / np.sqrt(30 / 28)
        effect, error = np.sqrt(np.mean(one**2)), np.sqrt(np.mean(np.square(errors[0])))
        mean = float(np.mean(score) * np.sqrt(len(score)))
        say(f"| {label} | {effect:.3f} | {error:.3f} | {np.sqrt(np.mean(score**2)):.2f} | {mean:.1f} |")


def coverage(
    state: StateVector, columns: dict[str, FloatArray], tolerance: float, workers: int, truths: int = 200
) -> None:
    """Truths drawn from the state vector, rendered apart, against the stated uncertainty and correlation."""
    say(f"\n**Coverage**, {truths} truths drawn from all inputs, {len(columns['wavelength'])} points:\n")
    stated = by_sensitivities(PlanRenderer(state, columns, seed=21), tolerance=tolerance)
    world = PlanRenderer(state, columns, seed=22)
    values = [state.nominal, *state.draw(31, truths)]
    rendered = timed("truths", lambda: evaluate(world, values, 4096, workers=workers))
    difference = rendered[1:] - rendered[0]
    noise = difference.var(axis=-1, ddof=1) / difference.shape[-1]
    error = difference.mean(axis=-1)
    say(f"- ray tracer's noise in a truth over u, root mean square: {np.sqrt(np.mean(noise / stated.u**2)):.2f}")
    score = np.abs(error) / np.sqrt(stated.u**2 + noise)
    # Points of a truth go together: what the truths scatter by says how well a share is known.
    for k, expected in ((1, 68.3), (2, 95.4)):
        by_truth = 100 * np.mean(score < k, axis=1)
        known = by_truth.std(ddof=1) / np.sqrt(truths)
        say(f"- within {k} u: {by_truth.mean():.1f} % ± {known:.1f} % ({expected} % expected)")
    modes, vectors = np.linalg.eigh(stated.covariance())
    strongest = np.argsort(modes)[::-1][:8]
    along = (error @ vectors[:, strongest]) ** 2 / (modes[strongest] + noise.mean(axis=0).mean())
    ratios = ", ".join(f"{ratio:.2f}" for ratio in along.mean(axis=0))
    say(f"- squared error over its variance along the 8 strongest modes: {ratios} (1 ± {np.sqrt(2 / truths):.2f})")


if __name__ == "__main__":
    main()
