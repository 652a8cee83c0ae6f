"""What another sample costs: a mesh from scratch and in a mould, and the ray tracer's scene of it.

Every parameter of the holes changes each time. Run as ``python benchmarks/bench_artifact.py``; times are CPU and wall
milliseconds a sample.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from instrument.artifact import ArtifactDimensions, read_artifact
from twin.artifact import SurfaceMesh, build_mesh
from twin.material import lambertian
from twin.mould import Mould
from twin.tracer import Tracer

EXAMPLE = Path(__file__).resolve().parents[1] / "sim_fixtures" / "examples" / "artifact.toml"


def draws(dimensions: ArtifactDimensions, count: int, seed: int) -> list[ArtifactDimensions]:
    """Samples with every hole's position and diameter drawn from its uncertainty."""
    random, holes = np.random.default_rng(seed), dimensions.holes
    return [
        replace(
            dimensions,
            holes=replace(
                holes,
                x=random.normal(holes.x, holes.u_x),
                y=random.normal(holes.y, holes.u_y),
                diameter=random.normal(holes.diameter, holes.u_diameter),
            ),
        )
        for _ in range(count)
    ]


def timed(what: str, act: Callable[[int], object], count: int) -> float:
    """Run ``act(0)`` to ``act(count - 1)``, print and return CPU milliseconds of one."""
    cpu, wall = time.process_time(), time.perf_counter()
    for number in range(count):
        act(number)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    print(f"{what:46s} {1e3 * cpu / count:7.1f} CPU {1e3 * wall / count:7.1f} wall")
    return 1e3 * cpu / count


def measure(sides: int, count: int, seed: int) -> None:
    """Measure polygons of so many sides."""
    nominal = read_artifact(EXAMPLE)
    samples = draws(nominal, count, seed)
    material, mould = lambertian(0.9), Mould(nominal, sides)
    meshes: list[SurfaceMesh] = [mould.mesh(sample) for sample in samples]
    made = mould.made
    print(f"{sides} sides, {len(meshes[0].faces)} faces, {made} mould(s) for {count} samples")
    scratch = timed("mesh from scratch", lambda k: build_mesh(samples[k], sides), min(count, 5))
    scratch += timed("tracer from scratch", lambda k: Tracer(meshes[k], material), min(count, 5))
    poured = timed("mesh in a mould", lambda k: mould.mesh(samples[k]), count)
    for quick in (False, True):
        moved = poured + _moving(mould, nominal, samples, quick=quick)
        print(f"{'in all' + (' (quick)' if quick else ''):46s} {moved:7.1f} CPU, against {scratch:.1f} from scratch")


def _moving(mould: Mould, nominal: ArtifactDimensions, samples: list[ArtifactDimensions], *, quick: bool) -> float:
    """CPU milliseconds for a tracer to go on with another mesh."""
    tracer = Tracer(mould.mesh(nominal), lambertian(0.9), quick=quick)
    meshes = [mould.mesh(sample) for sample in samples]  # without normals known from before
    return timed(f"tracer moved{' (quick)' if quick else ''}", lambda k: tracer.move(meshes[k]), len(samples))


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="samples")
    parser.add_argument("--sides", type=int, nargs="+", default=[64, 32], help="sides of the polygons")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    for sides in options.sides:
        measure(sides, options.count, options.seed)


if __name__ == "__main__":
    main()
