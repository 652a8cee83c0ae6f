"""The uncertainty budget of a prediction as a table for people, like Table II of the paper."""

from __future__ import annotations

import numpy as np
import xarray as xr
from rich.table import Table

from instrument.angles import FloatArray
from twin.propagation_dataset import RAY_TRACER
from twin.state_vector import StateVector

#: Smaller effects, in per cent of the BRF, are shown as less than this.
_LEAST = 0.01


def budget_table(prediction: xr.Dataset, state: StateVector) -> Table:
    """Sources, their standard uncertainty, and what they do to the BRF.

    Parameters
    ----------
    prediction
        From :func:`~twin.propagation_dataset.with_input_uncertainty`.

    Notes
    -----
    "In BRF" is relative: root mean square over the points, whose squares the shares are of, and the range that holds
    nine points of ten. Small effects are uncertain by the ray tracer's noise; a negative estimate counts as nothing.
    """
    table = Table(title="Uncertainty budget of the prediction (k = 1)", title_justify="left")
    table.add_column("source")
    table.add_column("standard uncertainty", justify="right")
    table.add_column("in BRF / %", justify="right")
    table.add_column("5 % to 95 % of points", justify="right")
    table.add_column("share of variance / %", justify="right")
    brf, total = (np.asarray(prediction[name].values) for name in ("brf", "u_brf"))
    share, whole = prediction["variance_share"], float(np.mean((total / brf) ** 2))
    for source in map(str, prediction["source"].values):
        own = np.asarray(share.sel(source=source).values) * total**2
        part = 100 * max(0.0, float(np.mean(own / brf**2))) / whole
        table.add_row(source, _input(state, source), *_effect(own, brf), f"{part:.1f}")
    table.add_section()
    table.add_row("combined", "", *_effect(total**2, brf), "100.0")
    return table


def _input(state: StateVector, source: str) -> str:
    """Standard uncertainty of a source's parameters; of a coupon's component there is one a point."""
    blocks = [block for block in state.blocks if block.source == source]
    if source == RAY_TRACER or not blocks:
        return ""
    if source.startswith("material "):
        name = "u_brf_" + source.removeprefix("material ").replace(" ", "_")
        if state.coupon is None or name not in state.coupon:
            name = "u_brf"
        relative = (
            100 * np.asarray(state.coupon[name] / state.coupon["brf"]) if state.coupon is not None else np.zeros(1)
        )
        return _range(relative, "%")
    return _range(np.concatenate([block.standard_uncertainty for block in blocks]), blocks[0].unit)


def _range(values: FloatArray, unit: str) -> str:
    low, high = (f"{value:.2g}" for value in (values.min(), values.max()))
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _effect(variance: FloatArray, brf: FloatArray) -> tuple[str, str]:
    relative = variance / brf**2
    low, high = np.percentile(relative, [5, 95])
    return _percent(float(np.mean(relative))), f"{_percent(float(low))} to {_percent(float(high))}"


def _percent(variance: float) -> str:
    value = 100 * float(np.sqrt(max(variance, 0.0)))
    return f"{value:.2f}" if value >= _LEAST else f"<{_LEAST}"
