"""From a run over the flat witness coupon to the quasi-diffuse table: the paper's filling rules.

The plan of the paper's Table III scans signed sensor zenith angles in a few azimuth planes. Folding the
negative ones and mirroring the azimuth difference (an isotropic surface has no handedness) covers the circle.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from instrument.angles import FloatArray, fold
from instrument.errors import InputError
from twin.material import Material

#: Directions this close to retro-reflection cannot be measured; only there may points be missing. Degree.
RETRO_GAP = 5.0 + 1e-6
_USELESS = 1 | 2 | 4  # saturated, overload, shadowed
_GRID = 1e-6


def from_coupon(run: xr.Dataset, name: str) -> Material:
    """Make the quasi-diffuse table of a coupon run.

    Parameters
    ----------
    run
        A run file's content: coordinates along ``point`` and ``brf``; flagged readings are left out.
    name
        Names the file in errors.

    Returns
    -------
    Material
        ``filled`` counts the entries by rule: ``retroreflection`` (linear between the neighbours in zenith),
        ``grazing emergence`` and ``grazing incidence`` (beyond the last measured angle: the nearest value).

    Raises
    ------
    InputError
        If points are missing elsewhere than at retro-reflection, or the plan is no grid.
    """
    brf = np.asarray(run["brf"].values, dtype=float)
    keep = np.ones(len(brf), dtype=bool)
    if "quality_flag" in run:
        keep = (np.asarray(run["quality_flag"].values).astype(int) & _USELESS) == 0
    keep &= np.isfinite(brf)
    columns = {key: np.asarray(run[key].values, dtype=float)[keep] for key in _COORDINATES}
    brf = brf[keep]
    if len(brf) == 0:
        raise InputError(f"{name}: brf: no usable reading; expected a run over the witness coupon")
    wavelengths = np.unique(np.round(columns["wavelength"], 6))
    tables = []
    for wavelength in wavelengths:
        chosen = np.abs(columns["wavelength"] - wavelength) < _GRID
        tables.append(_one_table({key: value[chosen] for key, value in columns.items()}, brf[chosen], name))
    first = tables[0]
    for table in tables[1:]:
        if any(len(a) != len(b) or np.any(a != b) for a, b in zip(table.axes, first.axes, strict=True)):
            raise InputError(f"{name}: the wavelengths were measured in different geometries; expected one grid")
    values = np.stack([table.brf for table in tables]) / np.pi
    return Material(
        *first.axes, values, wavelengths=wavelengths, filled=dict(sum_counts(t.filled for t in tables)), name=name
    )


_COORDINATES = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")


class _Table:
    """One wavelength's table: its axes (cos_o, phi_rad, cos_i), values (o, phi, i) and what was filled."""

    def __init__(self, axes: tuple[FloatArray, FloatArray, FloatArray], brf: FloatArray, filled: dict[str, int]):
        self.axes, self.brf, self.filled = axes, brf, filled


def sum_counts(counts: object) -> dict[str, int]:
    """Add dictionaries of counts."""
    total: dict[str, int] = {}
    for count in counts:  # type: ignore[attr-defined]
        for key, value in count.items():
            total[key] = total.get(key, 0) + value
    return total


def _one_table(columns: dict[str, FloatArray], brf: FloatArray, name: str) -> _Table:
    theta_i, phi_i = fold(columns["illumination_zenith"], columns["illumination_azimuth"])
    theta_o, phi_o = fold(columns["sensor_zenith"], columns["sensor_azimuth"])
    phi = np.mod(phi_o - phi_i, 360.0)
    phi = np.where(phi > 180.0, 360.0 - phi, phi)  # mirror symmetry
    grid_i, grid_o = np.unique(np.round(theta_i, 6)), np.unique(np.round(theta_o, 6))
    grid_phi = _plane_azimuths(phi, theta_i, theta_o, name)
    total = np.zeros((len(grid_o), len(grid_phi), len(grid_i)))
    count = np.zeros_like(total)
    for row in range(len(brf)):
        o = int(np.argmin(np.abs(grid_o - theta_o[row])))
        i = int(np.argmin(np.abs(grid_i - theta_i[row])))
        # Along a normal the azimuth has no meaning: such a reading belongs to all of them.
        free = theta_o[row] < _GRID or theta_i[row] < _GRID
        planes = np.arange(len(grid_phi)) if free else [int(np.argmin(np.abs(grid_phi - phi[row])))]
        total[o, planes, i] += brf[row]
        count[o, planes, i] += 1
    with np.errstate(invalid="ignore"):
        table = total / count
    filled = _fill_retroreflection(table, grid_o, grid_phi, grid_i)
    _refuse_gaps(table, grid_o, grid_phi, grid_i, name)
    return _close(table, grid_o, grid_phi, grid_i, filled)


def _plane_azimuths(phi: FloatArray, theta_i: FloatArray, theta_o: FloatArray, name: str) -> FloatArray:
    """Azimuth differences of the grid, 0 to 180 degrees."""
    meaningful = (theta_i > _GRID) & (theta_o > _GRID)
    grid = np.unique(np.round(phi[meaningful] if np.any(meaningful) else np.array([0.0, 180.0]), 4))
    if grid[0] > _GRID or abs(grid[-1] - 180.0) > _GRID:
        raise InputError(
            f"{name}: sensor_azimuth: the azimuth differences run from {grid[0]:g} to {grid[-1]:g} degrees;"
            " expected 0 to 180 (sensor_azimuth 0 with negative and positive sensor_zenith)"
        )
    return grid


def _fill_retroreflection(table: FloatArray, grid_o: FloatArray, grid_phi: FloatArray, grid_i: FloatArray) -> int:
    """Interpolate linearly in zenith where the sensor head hides the sample; returns the number of entries."""
    before = int(np.isnan(table).sum())
    for i, theta_i in enumerate(grid_i):
        for p, phi in enumerate(grid_phi):
            opposite = int(np.argmin(np.abs(grid_phi - (180.0 - phi))))
            if abs(grid_phi[opposite] - (180.0 - phi)) > _GRID and np.isnan(table[0, p, i]):
                continue
            zenith = np.concatenate([-grid_o[::-1], grid_o])
            line = np.concatenate([table[::-1, opposite, i], table[:, p, i]])
            for o, theta_o in enumerate(grid_o):
                if np.isnan(table[o, p, i]) and _from_retro(theta_i, theta_o, phi) < RETRO_GAP:
                    known = np.isfinite(line)
                    if known.sum() >= 2:
                        table[o, p, i] = _between(zenith[known], line[known], theta_o)
    return before - int(np.isnan(table).sum())


def _between(zenith: FloatArray, values: FloatArray, at: float) -> float:
    return float(np.interp(at, zenith, values))


def _from_retro(theta_i: float, theta_o: float, phi: float) -> float:
    """Angle between emergence and retro-reflection, degree."""
    i, o, p = np.deg2rad([theta_i, theta_o, phi])
    cosine = np.cos(i) * np.cos(o) + np.sin(i) * np.sin(o) * np.cos(p)
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _refuse_gaps(table: FloatArray, grid_o: FloatArray, grid_phi: FloatArray, grid_i: FloatArray, name: str) -> None:
    gaps = np.argwhere(np.isnan(table))
    if len(gaps):
        o, p, i = gaps[0]
        raise InputError(
            f"{name}: the table has {len(gaps)} gaps of {table.size} entries that are not at retro-reflection, the"
            f" first at illumination_zenith {grid_i[i]:g}, sensor_zenith {grid_o[o]:g}, azimuth difference"
            f" {grid_phi[p]:g} degrees; expected every combination (the plan of the paper's Table III)"
        )


def _close(table: FloatArray, grid_o: FloatArray, grid_phi: FloatArray, grid_i: FloatArray, retro: int) -> _Table:
    """Order by cosine, mirror to the whole circle, count what the nearest value stands for."""
    phi = np.concatenate([grid_phi, 360.0 - grid_phi[-2::-1]])
    values = np.concatenate([table, table[:, -2::-1]], axis=1)[::-1, :, ::-1]
    cos_o, cos_i = np.cos(np.deg2rad(grid_o[::-1])), np.cos(np.deg2rad(grid_i[::-1]))
    filled = {"retroreflection": retro}
    # Nodes at grazing and normal angles that were not measured carry the nearest value.
    if cos_o[0] > _GRID:
        cos_o, values = np.concatenate([[0.0], cos_o]), np.concatenate([values[:1], values])
        filled["grazing emergence"] = len(grid_phi) * len(grid_i)
    if cos_i[0] > _GRID:
        cos_i, values = np.concatenate([[0.0], cos_i]), np.concatenate([values[:, :, :1], values], axis=2)
        filled["grazing incidence"] = len(grid_phi) * len(cos_o)
    if cos_i[-1] < 1 - _GRID:
        cos_i, values = np.concatenate([cos_i, [1.0]]), np.concatenate([values, values[:, :, -1:]], axis=2)
    if cos_o[-1] < 1 - _GRID:
        cos_o, values = np.concatenate([cos_o, [1.0]]), np.concatenate([values, values[-1:]])
    return _Table((cos_o, np.deg2rad(phi), cos_i), values, filled)
