"""Propagation of uncertainties: what it costs, and whether its ways agree.

Prints the tables of docs/uncertainty.md::

    .venv/bin/python -m benchmarks.bench_propagation                     # the whole plan of Table IV, 500 draws
    .venv/bin/python -m benchmarks.bench_propagation --every 4 --draws 200

CPU seconds are those of this process; with ``--workers`` those of others are not counted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from instrument.angles import FloatArray
from instrument.plan import read_plan
from twin.optics import geometry_columns
from twin.propagation import Propagation, by_draws, by_sensitivities, evaluate
from twin.propagation_designs import STEP
from twin.propagation_render import PlanRenderer
from twin.state_vector import StateVector, state_vector_from_files

EXAMPLES = Path(__file__).parents[1] / "sim_fixtures" / "examples"
T = TypeVar("T")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, help="use every so many points of Table IV")
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--tolerance", type=float, default=0.1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=["cost", "sources", "columns", "coverage"])
    options = parser.parse_args()
    state = state_vector_from_files(*(EXAMPLES / name for name in ("facility.toml", "artifact.toml", "material.nc")))
    points = read_plan(EXAMPLES / "table_iv.toml", state.facility).points[:: options.every]
    columns = geometry_columns(points)
    print(f"{len(points)} points, {len(state)} inputs from {len(state.sources)} sources")
    PlanRenderer(state, columns, seed=1).render([state.nominal], 64)  # compiled before the clock starts
    if "cost" in options.only:
        cost_and_agreement(state, columns, options.draws, options.tolerance, options.workers)
    if "sources" in options.only:
        agreement_by_source(state, columns, options.tolerance)
    if "columns" in options.only:
        columns_by_other_steps(state, columns)
    if "coverage" in options.only:
        coverage(state, columns, options.tolerance, options.workers)


def timed(what: str, work: Callable[[], T]) -> T:
    """Run something and print what it cost."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    print(f"{what}: {time.process_time() - cpu:.1f} CPU s, {time.perf_counter() - wall:.1f} s", flush=True)
    return result


def cost_and_agreement(
    state: StateVector, columns: dict[str, FloatArray], draws: int, tolerance: float, workers: int
) -> None:
    """Combined uncertainty and correlation between points, by sensitivities and by draws."""
    renderer = PlanRenderer(state, columns, seed=1)
    slopes = timed("sensitivities", lambda: by_sensitivities(renderer, tolerance=tolerance))
    other = PlanRenderer(state, columns, seed=2)
    drawn = timed(f"{draws} draws", lambda: by_draws(other, draws=draws, seed=7, workers=workers))
    print(f"evaluations: {slopes.evaluations} and {drawn.evaluations}")
    a, b = (100 * float(np.sqrt(np.mean((r.u / r.brf) ** 2))) for r in (slopes, drawn))
    print(f"u, root mean square over the points: {a:.3f} % and {b:.3f} %")
    error = np.hypot(slopes.u_error, drawn.u_error)
    score = (slopes.u / drawn.u - 1) / error
    print(f"ratio, median over the points: {np.median(slopes.u / drawn.u):.3f}")
    print(f"ratio less 1 over its standard error, root mean square: {np.sqrt(np.mean(score**2)):.2f}")
    _compare_correlations(slopes, drawn, draws)


def _compare_correlations(slopes: Propagation, drawn: Propagation, draws: int) -> None:
    upper = np.triu_indices(len(slopes.noise), 1)
    one, two = slopes.correlation()[upper], drawn.correlation()[upper]
    expected = np.sqrt(np.mean((1 - one**2) ** 2) / draws)
    print(
        f"correlation between points: difference {np.sqrt(np.mean((one - two) ** 2)):.3f} (root mean square), from so"
        f" many draws {expected:.3f} is expected; mean {one.mean():.3f} and {two.mean():.3f}"
    )


def agreement_by_source(state: StateVector, columns: dict[str, FloatArray], tolerance: float, draws: int = 48) -> None:
    """Each source alone: its uncertainty by sensitivities and by draws."""
    print("\n| source | sensitivities / % | draws / % | standard error / % |\n|---|---|---|---|")
    for source in state.sources:
        alone = replace(state, blocks=tuple(block for block in state.blocks if block.source == source))
        slopes = by_sensitivities(PlanRenderer(alone, columns, seed=3), tolerance=tolerance)
        drawn = by_draws(PlanRenderer(alone, columns, seed=4), draws=draws, seed=9)
        (a, u_a), (b, u_b) = (_root_mean_square(result) for result in (slopes, drawn))
        print(f"| {source} | {a:.3f} | {b:.3f} | {np.hypot(u_a, u_b):.3f} |", flush=True)


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
    print("\n| column | effect / % | stated error / % | difference over its error, rms | mean |\n|---|---|---|---|---|")
    for label in results[0].sensitivity:
        block = next(b for b in state.blocks if label in b.labels)
        u = float(block.standard_uncertainty[block.labels.index(label)])
        if label.startswith("material stability") and not label.endswith(" 0"):
            continue
        one, two = (100 * u * r.sensitivity[label] / r.brf for r in results)
        errors = [100 * u * r.sensitivity_error[label] / r.brf for r in results]
        # Errors are themselves known from 8 randomisations each: Student's t of 14 degrees of freedom.
        score = (one - two) / np.maximum(np.hypot(*errors), 1e-9) / np.sqrt(14 / 12)
        effect, error = np.sqrt(np.mean(one**2)), np.sqrt(np.mean(np.square(errors[0])))
        mean = float(np.mean(score) * np.sqrt(len(score)))
        print(f"| {label} | {effect:.3f} | {error:.3f} | {np.sqrt(np.mean(score**2)):.2f} | {mean:.1f} |")


def coverage(
    state: StateVector, columns: dict[str, FloatArray], tolerance: float, workers: int, truths: int = 100
) -> None:
    """Truths drawn from the state vector, rendered apart, against the stated uncertainty and correlation."""
    stated = by_sensitivities(PlanRenderer(state, columns, seed=21), tolerance=tolerance)
    world = PlanRenderer(state, columns, seed=22)
    values = [state.nominal, *state.draw(31, truths)]
    rendered = evaluate(world, values, 4096, workers=workers)
    difference = rendered[1:] - rendered[0]
    noise = difference.var(axis=-1, ddof=1) / difference.shape[-1]
    error = difference.mean(axis=-1)
    score = np.abs(error) / np.sqrt(stated.u**2 + noise)
    print(f"\nwithin u: {100 * np.mean(score < 1):.1f} % (68.3 expected)")
    print(f"within 2 u: {100 * np.mean(score < 2):.1f} % (95.4 expected)")
    by_truth = np.mean(score < 1, axis=1)
    print(f"scatter of the share within u from truth to truth: {100 * by_truth.std():.0f} %")
    covariance = stated.covariance()
    modes, vectors = np.linalg.eigh(covariance)
    strongest = np.argsort(modes)[::-1][:8]
    along = (error @ vectors[:, strongest]) ** 2 / (modes[strongest] + noise.mean(axis=0).mean())
    ratios = ", ".join(f"{ratio:.2f}" for ratio in along.mean(axis=0))
    print(f"squared error over its variance along the strongest modes: {ratios} (1 +- {np.sqrt(2 / truths):.2f})")


if __name__ == "__main__":
    main()
