"""What the twin leaves behind after a scan: ``prediction.nc``, ``comparison.json``, ``figures/`` and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.dataset import read_run, write_prediction
from instrument.events import Geometry
from instrument.output import write_json
from twin.comparison import compare
from twin.figures import draw_planes
from twin.matching import GEOMETRY, find_points
from twin.tables import comparison_tables

PREDICTED = ("brf", "u_brf", "u_brf_monte_carlo")
#: Written where every point has it.
OPTIONAL = ("u_brf_inputs",)


class NothingToCompare(RuntimeError):
    """No measured point with a prediction."""


def summarise(
    run_file: Path,
    points: Sequence[Geometry],
    values: Mapping[int, Mapping[str, float]],
    attributes: Mapping[str, Any],
    run_dir: Path,
) -> list[Any]:
    """Compare a run with the values that were predicted while it was measured.

    Parameters
    ----------
    run_file
        The measured run; rows without prediction are left out of the comparison, which says so.
    points
        All points of the plan.
    values
        By index in the plan: ``brf``, ``u_brf``, ``u_brf_monte_carlo``, and ``u_brf_inputs`` once it is known.
    attributes
        Of the prediction.
    run_dir
        Where the files go.

    Raises
    ------
    NothingToCompare
        If there is no run file, or no row of it has a prediction.
    """
    if not run_file.exists():
        raise NothingToCompare(f"{run_file}: no such file")
    run = read_run(run_file)
    prediction = prediction_dataset(points, values, attributes)
    rows = find_points(run, prediction)
    if not np.any(rows >= 0):
        raise NothingToCompare(f"none of the {len(rows)} measured points has a prediction")
    run = run.isel(point=np.flatnonzero(rows >= 0))
    predicted = prediction.isel(point=rows[rows >= 0])
    write_prediction(predicted, run_dir / "prediction.nc")
    unpredicted = int(np.count_nonzero(rows < 0))
    extra = (f"{unpredicted} measured points have no prediction and are left out.",) if unpredicted else ()
    comparison = compare(run, predicted, notes=extra)
    write_json(run_dir / "comparison.json", comparison.to_dict(), force=True)
    draw_planes(comparison, run_dir / "figures")
    return comparison_tables(comparison)


def prediction_dataset(
    points: Sequence[Geometry], values: Mapping[int, Mapping[str, float]], attributes: Mapping[str, Any]
) -> xr.Dataset:
    """Predicted values in the prediction form, in the order of the plan."""
    order = sorted(values)
    coordinates = {
        name: ("point", np.array([getattr(points[i], name) for i in order], dtype=float)) for name in GEOMETRY
    }
    if any(points[i].sample_rotation for i in order):
        turned = np.array([points[i].sample_rotation for i in order])
        coordinates["sample_rotation"] = ("point", turned)
    names = [*PREDICTED, *(name for name in OPTIONAL if all(name in values[i] for i in order))]
    columns = {name: ("point", np.array([values[i][name] for i in order], dtype=float)) for name in names}
    dataset = xr.Dataset(columns, coords=coordinates, attrs=dict(attributes))
    for name in OPTIONAL:
        if name in dataset:
            dataset[name].attrs = {"units": "1", "long_name": "standard uncertainty (k=1) of brf from all inputs"}
    return dataset
