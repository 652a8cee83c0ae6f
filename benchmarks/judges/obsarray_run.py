"""obsarray on a run file: components, their correlation, and what they add up to."""

from __future__ import annotations

import sys
import warnings

import numpy as np
import obsarray  # noqa: F401
import xarray as xr
from protocol import Judge


def main() -> None:
    # Its own warnings of future xarray are not about the file.
    warnings.simplefilter("ignore")
    judge = Judge("obsarray", "reads a run file's uncertainty")
    with xr.open_dataset(sys.argv[2], engine="h5netcdf") as opened:
        trial(judge, opened.load())
    judge.done()


def trial(judge: Judge, run: xr.Dataset) -> None:
    """What obsarray makes of the file, against what the variables and attributes say when read by hand."""
    brf = run.unc["brf"]
    names = list(run["brf"].attrs["unc_comps"])
    judge.check("variables with uncertainty", lambda: list(run.unc.keys()), lambda found: found == ["brf"])
    judge.check("components", lambda: sorted(brf.comps), lambda found: found == sorted(names))
    judge.check("combined", lambda: brf.total_unc().values, lambda found: np.allclose(found, run["u_brf"].values))
    judge.check("random ones", lambda: list(brf.random_comps), lambda found: found == ["u_brf_noise"])
    judge.check("noise", lambda: matrix(brf, "u_brf_noise"), lambda found: np.array_equal(found, np.eye(len(found))))
    judge.check("reference", lambda: matrix(brf, "u_brf_reference"), lambda found: bool(np.all(found == 1)))
    for name in ("u_brf_sensor_zenith", "u_brf_illumination_zenith"):
        form = run[name].attrs["err_corr_1_form"]
        judge.check(f"form of {name}", lambda form=form: form, lambda found: found == "err_corr_matrix")
        expected = run[f"err_corr_{name}"].values
        judge.check(
            f"matrix of {name}",
            lambda name=name: matrix(brf, name),
            lambda found, expected=expected: np.array_equal(found, expected) and bool(np.any(found < 0)),
        )
    judge.check(
        "whole covariance",
        lambda: brf.total_err_cov_matrix().values,
        lambda found: np.allclose(found, covariance(run, names), rtol=1e-9, atol=1e-18),
    )


def matrix(brf: xr.Dataset, name: str) -> np.ndarray:
    return brf[name].err_corr_matrix().values


def covariance(run: xr.Dataset, names: list[str]) -> np.ndarray:
    """By hand; obsarray takes a component without a stated correlation for independent from point to point."""
    total = np.zeros((run.sizes["point"],) * 2)
    for name in names:
        attributes, u = run[name].attrs, run[name].values
        form = attributes.get("err_corr_1_form", "random")
        if form == "random":
            total += np.diag(u**2)
        elif form == "systematic":
            total += np.outer(u, u)
        else:
            total += np.outer(u, u) * run[str(np.atleast_1d(attributes["err_corr_1_params"])[0])].values
    return total


if __name__ == "__main__":
    main()
