"""Are the ray tracer's error bars honest? Many predictions with other seeds against a much finer one.

    python benchmarks/coverage_tracer.py --facility facility.toml --artifact artifact.toml --material material.nc

prints, for wanted errors and for a fixed number of sight lines, the share of deviations within one and two stated
errors (68.3 and 95.4 % are right), their root mean square, and the mean offset with its own uncertainty. Exit status 1
if anything is off by more than four standard deviations. Takes some minutes.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.optics import COORDINATES
from twin.prediction import Twin

#: Table IV of the paper: illumination zenith, azimuth differences; sensor zenith from 80 to -80 degrees.
_TABLE_IV = ((0, (0, 45, 90, 135)), (15, (0, 50, 75, 105, 130)), (30, (0, 60, 120)))
_REQUESTS: tuple[tuple[str, dict[str, Any], int], ...] = (
    ("wanted 1 %", {"standard_error": 0.01}, 40),
    ("wanted 0.2 %", {"standard_error": 0.002}, 20),
    ("wanted 0.1 %", {"standard_error": 0.001}, 12),
    ("4096 sight lines", {"samples": 4096}, 30),
)


@dataclass(frozen=True)
class Coverage:
    """How deviations compare with stated errors."""

    within_one: float
    within_two: float
    rms: float
    stated: float
    largest_stated: float
    offset: float
    u_offset: float
    u_share: float

    def line(self) -> str:
        """For people."""
        return (
            f"within 1 u {100 * self.within_one:.1f} %, within 2 u {100 * self.within_two:.1f} %"
            f" (+-{100 * self.u_share:.1f} %), rms {self.rms:.3f} u; stated {100 * self.stated:.4f} % (largest"
            f" {100 * self.largest_stated:.4f} %), offset {100 * self.offset:+.4f} +- {100 * self.u_offset:.4f} %"
        )

    def honest(self) -> bool:
        """Whether nothing is off by more than four standard deviations."""
        return (
            self.within_one > 0.683 - 4 * self.u_share
            and self.within_two > 0.954 - 2 * self.u_share
            and abs(self.offset) < 4 * self.u_offset
        )


def coverage(values: NDArray[np.float64], errors: NDArray[np.float64], truth: Any, truth_error: Any) -> Coverage:
    """Compare runs, shape (run, point), with a truth, shape (point,)."""
    z = (values - truth) / np.hypot(errors, truth_error)
    relative = values / truth - 1
    offset = relative.mean(axis=0)
    u_offset = relative.std(axis=0, ddof=1) / np.sqrt(len(values))
    u_offset = np.hypot(u_offset, truth_error / truth)
    return Coverage(
        within_one=float(np.mean(np.abs(z) < 1)),
        within_two=float(np.mean(np.abs(z) < 2)),
        rms=float(np.sqrt(np.mean(z**2))),
        stated=float(np.sqrt(np.mean((errors / truth) ** 2))),
        largest_stated=float(np.max(errors / values)),
        offset=float(offset.mean()),
        u_offset=float(np.sqrt(np.sum(u_offset**2)) / len(offset)),
        u_share=float(np.sqrt(0.683 * 0.317 / z.size)),
    )


def some_geometries(number: int, seed: int = 5) -> dict[str, NDArray[np.float64]]:
    """Geometries of Table IV, chosen at random."""
    rows = [(500.0, i, 0.0, s, p) for i, ps in _TABLE_IV for p in ps for s in range(80, -81, -5) if (s, p) != (i, 0)]
    chosen = np.sort(np.random.default_rng(seed).permutation(len(rows))[:number])
    return dict(zip(COORDINATES, np.array(rows, dtype=float)[chosen].T, strict=True))


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Are the ray tracer's error bars honest?")
    parser.add_argument("--facility", type=Path, required=True)
    parser.add_argument("--artifact", type=Path, required=True)
    parser.add_argument("--material", type=Path, required=True)
    parser.add_argument(
        "--points", type=int, default=56, help="geometries of Table IV; from 40 on the pilot's variances count"
    )
    parser.add_argument("--truth", type=float, default=2e-4, help="relative standard error of the finer prediction")
    parser.add_argument("--runs", type=float, default=1.0, help="so many times the usual number of runs")
    given = parser.parse_args()
    twin = Twin.from_files(given.facility, given.artifact, given.material)
    columns = some_geometries(given.points)
    truth = twin.estimate(columns, standard_error=given.truth, seed=999)
    honest = True
    for label, request, runs in _REQUESTS:
        some = [twin.estimate(columns, seed=100 + k, **request) for k in range(max(2, round(runs * given.runs)))]
        found = coverage(
            np.array([e.brf for e in some]),
            np.array([e.standard_error for e in some]),
            truth.brf,
            truth.standard_error,
        )
        honest &= found.honest()
        print(f"{label}, {len(some)} runs: {found.line()}", flush=True)
    return 0 if honest else 1


if __name__ == "__main__":
    sys.exit(main())
