"""Tables of a comparison, as a person sees them."""

from __future__ import annotations

import io

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from twin.comparison import compare
from twin.tables import TABLE_VI, comparison_tables


def shown(width: int = 80, monte_carlo: float = 0.001, azimuths=(0.0, 105.0), wavelengths=(500.0, 500.0)) -> str:
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    table = np.array([(w, 15, 0, z, a) for w, a in zip(wavelengths, azimuths, strict=True) for z in (-40, 0, 20, 40)])
    coords = {name: ("point", table[:, i]) for i, name in enumerate(names)}
    brf, u = ("point", np.full(8, 0.5)), ("point", np.full(8, 0.005))
    simulated = ("point", 0.5 * (1 + np.array([0.0, 0.01, 0.03, 0.05, 0.0, 0.0, 0.0, 0.0])))
    run = xr.Dataset({"brf": brf, "u_brf": u}, coords=coords)
    u_mc = ("point", np.full(8, monte_carlo))
    twin = xr.Dataset({"brf": simulated, "u_brf": u, "u_brf_monte_carlo": u_mc}, coords=coords)
    console = Console(width=width, file=io.StringIO(), record=True)
    for part in comparison_tables(compare(run, twin)):
        console.print(part)
    return console.export_text()


def row_of(text: str, label: str) -> list[str]:
    return next(line for line in text.splitlines() if line.strip().startswith(label)).split()


def test_rows_of_planes_and_groups():
    text = shown()
    # dR* 0, 1, 3, 5 %: mean 2.25 %, RMSE sqrt(35/4) %; t' = 0, 1/sqrt 2, 3/sqrt 2, 5/sqrt 2
    assert row_of(text, "15°, 0°")[2:6] == ["4", "2.25", "%", "0.0296"]
    assert row_of(text, "15°, 0°")[6] == "2.09"
    assert row_of(text, "15°, 0°")[8:10] == ["50/25/25", "50/0/50"]
    assert row_of(text, "15°, 105°")[2:5] == ["4", "0.00", "%"]
    assert row_of(text, "in-plane")[1:] == row_of(text, "15°, 0°")[2:]
    assert row_of(text, "global")[1] == "8"


def test_nothing_is_cut_off_on_a_narrow_terminal():
    assert "…" not in shown(width=80)


def test_wavelengths_are_named_where_there_are_several():
    assert "632.8 nm, 15°, 0°" in shown(azimuths=(0.0, 0.0), wavelengths=(500.0, 632.8), width=100)
    assert "nm" not in shown()


@pytest.mark.parametrize(
    ("label", "published"),
    [
        ("level of agreement (in-plane)", ["0.84", "0.72"]),
        ("level of agreement (out-of-plane)", ["0.86", "0.45"]),
        ("level of agreement (global)", ["0.86", "0.60"]),
        ("relative RMSE (in-plane)", ["0.026", "0.19"]),
        ("relative RMSE (out-of-plane)", ["0.022", "0.64"]),
        ("relative RMSE (global)", ["0.023", "0.45"]),
    ],
)
def test_published_figures_stand_beside_the_run(label, published):
    assert [study.study for study in TABLE_VI] == ["Leroy et al.", "Jaanson et al."]
    assert row_of(shown(), label)[-2:] == published


def test_the_reader_learns_what_the_simulations_uncertainty_contains():
    assert "relative standard error: 0.20 %" in shown()
    assert "Monte Carlo error of the ray tracer alone" not in shown()
    assert "Monte Carlo error of the ray tracer alone" in shown(monte_carlo=0.005)
