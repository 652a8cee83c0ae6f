"""From a run over the flat witness coupon to the quasi-diffuse table.

The plan of the paper's Table III scans signed sensor zenith angles in a few azimuth planes. Folding the negative ones
and mirroring the azimuth difference (an isotropic surface has no handedness) covers the circle. Three methods make a
table of it (:data:`Method`); what each gets wrong where it was not measured is found by leaving readings out
(:mod:`twin.coupon_heldout`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
import xarray as xr

from instrument.angles import FloatArray, fold
from instrument.errors import InputError
from twin.coupon_layout import CosineTable, Layout, lay_out, paper_table
from twin.material import Material
from twin.material_changes import retro_angle_rad
from twin.reflection_models.compiled import Grid, interpolate, zenith_grid
from twin.reflection_models.smooth import Directions, left_out, smooth

#: ``linear``: the paper's, linear between the readings and across the gap at retro-reflection, the nearest value beyond
#: the last zenith. ``filled``: linear between the readings, a smooth reciprocal fit where there are none. ``smooth``:
#: that fit everywhere. ``auto``: smooth or linear, whichever predicts left-out readings better.
Method = Literal["auto", "linear", "filled", "smooth"]

_USELESS = 1 | 2 | 4  # saturated, overload, shadowed
_COORDINATES = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
_STEP_DEG = 5.0
_RETRO, _EMERGENCE, _INCIDENCE = "retroreflection", "grazing emergence", "grazing incidence"


@dataclass(frozen=True)
class Readings:
    """Usable readings of one wavelength: folded angles in degree (``phi`` 0 to 180), reflectance factors."""

    theta_i: FloatArray
    theta_o: FloatArray
    phi: FloatArray
    brf: FloatArray

    def directions(self) -> Directions:
        """For the smooth fit."""
        return Directions(*(np.deg2rad(a) for a in (self.theta_i, self.theta_o, self.phi)))

    def take(self, chosen: np.ndarray) -> Readings:
        """Some of the readings."""
        return Readings(self.theta_i[chosen], self.theta_o[chosen], self.phi[chosen], self.brf[chosen])


def from_coupon(run: xr.Dataset, name: str, method: Method = "auto") -> Material:
    """Make the quasi-diffuse table of a coupon run.

    Parameters
    ----------
    run
        A run file's content: coordinates along ``point`` and ``brf``; flagged readings are left out.
    name
        Names the file in errors.
    method
        How.

    Returns
    -------
    Material
        ``filled`` counts by rule the entries that no reading supports: ``retroreflection`` (hidden by the sensor
        head), ``grazing emergence`` and ``grazing incidence`` (beyond the last zenith measured). ``method`` is the one
        chosen.

    Raises
    ------
    InputError
        If points are missing elsewhere than at retro-reflection, or the plan is no grid.
    """
    if method not in get_args(Method):
        raise InputError(f"{name}: method: found {method!r}; expected {', '.join(get_args(Method))}")
    by_wavelength = coupon_readings(run, name)
    layouts = [lay_out(r.theta_i, r.theta_o, r.phi, name) for r in by_wavelength.values()]
    if any(layout.grid_key != layouts[0].grid_key for layout in layouts[1:]):
        raise InputError(f"{name}: the wavelengths were measured in different geometries; expected one grid")
    nodes = [layout.nodes(r.brf, name) for layout, r in zip(layouts, by_wavelength.values(), strict=True)]
    chosen = choose(list(by_wavelength.values()), layouts) if method == "auto" else method
    if chosen == "linear":
        made = [paper_table(layout, table) for layout, table in zip(layouts, nodes, strict=True)]
    else:
        made = [
            smooth_table(readings, layout, table if chosen == "filled" else None)
            for readings, layout, table in zip(by_wavelength.values(), layouts, nodes, strict=True)
        ]
    filled: dict[str, int] = {}
    for table in made:
        filled |= {rule: filled.get(rule, 0) + count for rule, count in table.filled.items()}
    first = made[0]
    return Material(
        first.cos_o,
        first.phi_rad,
        first.cos_i,
        np.stack([table.brf for table in made]) / np.pi,
        wavelengths=np.array(list(by_wavelength)),
        filled=filled,
        name=name,
        entries=sum(table.entries for table in made),
        method=chosen,
        notes=tuple(dict.fromkeys(note for table in made for note in table.notes)),
    )


def coupon_readings(run: xr.Dataset, name: str) -> dict[float, Readings]:
    """Usable readings by wavelength in nm, ascending."""
    brf = np.asarray(run["brf"].values, dtype=float)
    keep = np.ones(len(brf), dtype=bool)
    if "quality_flag" in run:
        keep = (np.asarray(run["quality_flag"].values).astype(int) & _USELESS) == 0
    keep &= np.isfinite(brf)
    if not np.any(keep):
        raise InputError(f"{name}: brf: no usable reading; expected a run over the witness coupon")
    columns = {key: np.asarray(run[key].values, dtype=float)[keep] for key in _COORDINATES}
    theta_i, phi_i = fold(columns["illumination_zenith"], columns["illumination_azimuth"])
    theta_o, phi_o = fold(columns["sensor_zenith"], columns["sensor_azimuth"])
    phi = np.mod(phi_o - phi_i, 360.0)
    everything = Readings(theta_i, theta_o, np.where(phi > 180.0, 360.0 - phi, phi), brf[keep])  # mirror symmetry
    wavelength = np.round(columns["wavelength"], 6)
    return {float(w): everything.take(np.flatnonzero(wavelength == w)) for w in np.unique(wavelength)}


def choose(readings: list[Readings], layouts: list[Layout]) -> Literal["linear", "smooth"]:
    """The method that predicts left-out readings better."""
    linear, fitted = (float(np.sum(errors**2)) for errors in left_out_errors(readings, layouts))
    return "smooth" if fitted < linear else "linear"


def left_out_errors(readings: list[Readings], layouts: list[Layout]) -> tuple[FloatArray, FloatArray]:
    """Relative errors at readings predicted from the others: linear between their neighbours in zenith, and smooth.

    Only where both neighbours exist, the same readings for both methods.
    """
    linear, fitted = [], []
    for r, layout in zip(readings, layouts, strict=True):
        guess = layout.from_neighbours(r.brf)
        inside = np.isfinite(guess)
        linear.append(guess[inside] / r.brf[inside] - 1)
        fitted.append(left_out(r.directions(), r.brf)[inside] / r.brf[inside] - 1)
    return np.concatenate(linear), np.concatenate(fitted)


def smooth_table(readings: Readings, layout: Layout, nodes: FloatArray | None) -> CosineTable:
    """A smooth fit on a regular grid; with ``nodes``, on the readings' own grid and only where that has none."""
    key = None if nodes is None else layout.zeniths
    grid, wanted, lacks = _smooth_grid(layout.last, layout.azimuths, key)
    half = len(grid.phi_rad) // 2 + 1
    values = smooth(readings.directions(), readings.brf, wanted).reshape(len(grid.cos_o), half, len(grid.cos_i))
    notes = []
    if np.any(values < 0):
        notes.append(f"{int(np.sum(values < 0))} entries of the smooth fit were below zero and set to zero")
        values = np.maximum(values, 0.0)
    if nodes is not None:
        measured = layout.measured[::-1, :, ::-1]
        inner = np.ix_(*(np.arange(size - n, size) for size, n in zip(values.shape, measured.shape, strict=True)))
        values[inner] = np.where(measured, nodes[::-1, :, ::-1], values[inner])
    whole = np.concatenate([values, values[:, half - 2 :: -1]], axis=1)
    filled = {rule: int(np.sum(where)) for rule, where in lacks.items()}
    return CosineTable(grid.cos_o, grid.phi_rad, grid.cos_i, whole, filled, values.size, tuple(notes))


@lru_cache(maxsize=8)
def _smooth_grid(
    last: tuple[float, float], azimuths: tuple[float, ...], zeniths: tuple[tuple[float, ...], tuple[float, ...]] | None
) -> tuple[Grid, Directions, dict[str, np.ndarray]]:
    """Grid of a smooth table, its entries up to 180 degrees as directions, and where readings are lacking, by rule."""
    regular = zenith_grid(np.arange(0, 90 + _STEP_DEG / 2, _STEP_DEG), np.arange(0, 181, 10.0))
    grid = regular
    if zeniths is not None:
        incident, emergent = (
            zenith_grid([*known, *np.arange(known[-1] + _STEP_DEG, 89, _STEP_DEG), 90.0], azimuths) for known in zeniths
        )
        grid = Grid(emergent.cos_o, emergent.phi_rad, incident.cos_i)
    half = len(grid.phi_rad) // 2 + 1
    o, phi, i = np.meshgrid(grid.cos_o, grid.phi_rad[:half], grid.cos_i, indexing="ij")
    wanted = Directions(*(np.ascontiguousarray(a.ravel()) for a in (np.arccos(i), np.arccos(o), phi)))
    last_i, last_o = (np.cos(np.deg2rad(angle + 1e-6)) for angle in last)
    beyond_i, beyond_o = i < last_i, o < last_o
    hidden = np.rad2deg(retro_angle_rad(o, phi, i)) < 5.0 - 1e-6
    lacks = {_RETRO: hidden & ~beyond_i & ~beyond_o, _EMERGENCE: beyond_o & ~beyond_i, _INCIDENCE: beyond_i}
    return grid, wanted, lacks


def smooth_gridding_error(readings: Readings, layout: Layout, seed: int = 0) -> float:
    """Relative root mean square difference between the smooth fit and its table, within the zeniths measured."""
    table = smooth_table(readings, layout, None)
    random = np.random.default_rng(seed)
    low_i, low_o = np.cos(np.deg2rad(layout.last))
    cos_i, cos_o = (np.sqrt(random.uniform(low**2, 1, 400)) for low in (low_i, low_o))
    phi = random.uniform(0, np.pi, 400)
    exact = smooth(readings.directions(), readings.brf, Directions(np.arccos(cos_i), np.arccos(cos_o), phi))
    grid = Grid(table.cos_o, table.phi_rad, table.cos_i)
    return float(np.sqrt(np.mean((interpolate(grid, table.brf, cos_o, phi, cos_i) / exact - 1) ** 2)))
