"""punpy on a run file: what obsarray reads of it, propagated through two functions with a closed form."""

from __future__ import annotations

import sys
import warnings

import numpy as np
import obsarray  # noqa: F401
import punpy
import xarray as xr
from protocol import Judge

DRAWS = 4000


def main() -> None:
    # Its own warnings of future xarray are not about the file.
    warnings.simplefilter("ignore")
    judge = Judge("punpy", "propagates a run file's uncertainty")
    with xr.open_dataset(sys.argv[2], engine="h5netcdf") as opened:
        trial(judge, opened.load())
    judge.done()


def trial(judge: Judge, run: xr.Dataset) -> None:
    """The mean over all points, and each point over the first: linear, and as good as linear."""
    brf = run["brf"].values
    u = run.unc["brf"].total_unc().values
    correlation = run.unc["brf"].total_err_corr_matrix().values
    covariance = correlation * np.outer(u, u)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.mean(values, axis=0, keepdims=True)

    def ratio(values: np.ndarray) -> np.ndarray:
        return values / values[0]

    exact_mean = np.sqrt(covariance.sum()) / len(brf)
    slopes = np.diag(1 / np.full(len(brf), brf[0]))
    slopes[:, 0] -= brf / brf[0] ** 2
    exact_ratio = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
    law = punpy.LPUPropagation()
    judge.check(
        "mean of all points, law of propagation",
        lambda: float(np.ravel(law.propagate_standard(mean, [brf], [u], [correlation]))[0]),
        lambda found: abs(found / exact_mean - 1) < 1e-4,
    )
    judge.check(
        "every point over the first, law of propagation",
        lambda: np.asarray(law.propagate_standard(ratio, [brf], [u], [correlation])),
        lambda found: np.allclose(found[1:], exact_ratio[1:], rtol=1e-4) and found[0] < 1e-6,
    )
    np.random.seed(7)  # noqa: NPY002 - punpy draws from the global generator
    draws = punpy.MCPropagation(DRAWS, dtype=np.float64)
    judge.check(
        "mean of all points, by draws",
        lambda: float(np.ravel(draws.propagate_standard(mean, [brf], [u], [correlation]))[0]),
        # So many draws know a standard uncertainty to 1.1 %.
        lambda found: abs(found / exact_mean - 1) < 4 / np.sqrt(2 * DRAWS),
    )
    independent = np.sqrt(np.sum(u**2)) / len(brf)
    judge.check(
        "what the correlation adds to the mean",
        lambda: exact_mean / independent,
        # Fully correlated components do not average out over the points: without the attributes they would.
        lambda found: found > 2,
    )


if __name__ == "__main__":
    main()
