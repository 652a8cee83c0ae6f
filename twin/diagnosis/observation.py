"""A measured run as the diagnosis sees it: what was commanded, what was read, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.dataset import capabilities, read_run
from instrument.errors import InputError
from instrument.run_check import component_names
from twin.diagnosis.turned import ROTATION, arm_columns
from twin.optics import geometry_columns

#: Fewer points than this tell no effect from chance.
LEAST_POINTS = 20
#: The same of a scan that follows another run and is diagnosed with it.
LEAST_FOLLOWING = 5
#: Points of one plane at most so far apart in azimuth and illumination zenith, degree.
_SAME_PLANE = 0.01
_SHADOWED = 4


@dataclass(frozen=True)
class Observation:
    """One run; arrays of shape (point,) in the order of the file, None where the file says nothing.

    Attributes
    ----------
    name
        File the run came from.
    rows
        Index along ``point`` of the file: points that are not usable are left out.
    columns
        Commanded geometry, as from :func:`~twin.diagnosis.turned.arm_columns`: what the arms had in the laboratory,
        and how far the sample was turned.
    brf, u_brf
        Reflectance factor and combined standard uncertainty (k = 1).
    components
        Standard uncertainties by component, without ``u_brf_``.
    seconds
        Time since the first point.
    reading
        (signal - dark)/gain of the point over that of the reference, mean of the samples.
    signal_v, gain
        Mean reading less dark in V, and gain in V/A.
    reference_v, reference_gain
        The same of the reference, means over its readings.
    """

    name: str
    rows: NDArray[np.int64]
    columns: dict[str, FloatArray]
    brf: FloatArray
    u_brf: FloatArray
    components: dict[str, FloatArray]
    seconds: FloatArray | None = None
    reading: FloatArray | None = None
    signal_v: FloatArray | None = None
    gain: FloatArray | None = None
    reference_v: float | None = None
    reference_gain: float | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.brf)

    @property
    def relative_u(self) -> FloatArray:
        """Combined relative standard uncertainty."""
        return self.u_brf / self.brf

    @property
    def plane(self) -> NDArray[np.int64]:
        """Number of the plane each point lies in, in order of the file.

        A plane is that of a wavelength, an illumination, a sensor azimuth and a rotation of the sample.
        """
        names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_azimuth", ROTATION)
        table = np.round(np.stack([self.columns[n] for n in names if n in self.columns], axis=1) / _SAME_PLANE)
        return _numbered(np.nan_to_num(table, nan=-1.0))

    @property
    def illumination(self) -> NDArray[np.int64]:
        """Number of the illumination zenith of each point, in order of the file."""
        return _numbered(np.round(self.columns["illumination_zenith"][:, None] / _SAME_PLANE))

    @property
    def progress(self) -> FloatArray:
        """Share of the run done at each point, 0 to 1: from the times, or from the order where there are none."""
        order = np.arange(len(self), dtype=float) if self.seconds is None else self.seconds
        span = float(np.ptp(order))
        return (order - order.min()) / span if span > 0 else np.zeros(len(self))

    def take(self, chosen: NDArray[np.int64]) -> Observation:
        """Some of the points."""
        values: dict[str, Any] = {
            name: value[chosen] if isinstance(value, np.ndarray) else value for name, value in vars(self).items()
        }
        values["columns"] = {name: column[chosen] for name, column in self.columns.items()}
        values["components"] = {name: u[chosen] for name, u in self.components.items()}
        return Observation(**values)


def _numbered(table: FloatArray) -> NDArray[np.int64]:
    _, first, inverse = np.unique(table, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[np.ravel(inverse)]


def read_observation(path: Path, least: int = LEAST_POINTS) -> Observation:
    """Read a run file or run folder; arguments and errors as :func:`observe`."""
    file = path / "run.nc" if path.is_dir() else path
    return observe(read_run(file), str(path), least)


def observe(run: xr.Dataset, name: str, least: int = LEAST_POINTS, *, foreign: bool = False) -> Observation:
    """What the diagnosis takes from a run.

    Parameters
    ----------
    least
        Usable points below which a run is refused: fewer for a scan that only follows another.
    foreign
        Measured with another instrument, of whose arms nothing is known: its angles stay as they are.

    Raises
    ------
    InputError
        Too few usable points; uncertainties that are zero, missing or larger than the value; a reflectance factor in
        other units than 1.
    """
    usable = np.isfinite(run["brf"].values) & (run["brf"].values > 0)
    notes = list(capabilities(run))
    if "quality_flag" in run:
        shadowed = (run["quality_flag"].values.astype(int) & _SHADOWED) > 0
        usable &= ~shadowed
    rows = np.flatnonzero(usable)
    if len(rows) < least:
        raise InputError(f"{name}: found {len(rows)} usable points; expected at least {least} for a diagnosis")
    if len(rows) < run.sizes["point"]:
        notes.append(f"{run.sizes['point'] - len(rows)} points without a positive, unshadowed brf are left out")
    kept = run.isel(point=rows)
    brf = np.asarray(kept["brf"].values, dtype=float)
    u_brf = np.asarray(kept["u_brf"].values, dtype=float)
    _check_uncertainty(name, brf, u_brf)
    components = {
        n.removeprefix("u_brf_"): np.asarray(kept[n].values, dtype=float)
        for n in component_names(kept)
        if np.all(np.isfinite(kept[n].values))
    }
    seconds = None
    if "time" in kept.variables and not np.any(np.isnat(kept["time"].values)):
        time = kept["time"].values
        seconds = (time - time.min()) / np.timedelta64(1, "s")
    columns = geometry_columns(kept) if foreign else arm_columns(kept)
    return Observation(name, rows, columns, brf, u_brf, components, seconds, **_readings(kept), notes=tuple(notes))


def _readings(run: xr.Dataset) -> dict[str, Any]:
    if not {"signal", "dark", "gain"} <= set(run.variables):
        return {}
    signal = np.asarray(run["signal"].mean("sample") - run["dark"], dtype=float)
    gain = np.asarray(run["gain"], dtype=float)
    if not (np.all(np.isfinite(signal)) and np.all(gain > 0)):
        return {}
    found: dict[str, Any] = {"signal_v": signal, "gain": gain}
    if {"reference_signal", "reference_dark", "reference_gain"} <= set(run.variables):
        reference = np.asarray(run["reference_signal"].mean("sample") - run["reference_dark"], dtype=float)
        reference_gain = np.asarray(run["reference_gain"], dtype=float)
        current = reference / reference_gain
        if np.all(np.isfinite(current)) and np.mean(current) > 0:
            found["reference_v"], found["reference_gain"] = float(np.mean(reference)), float(np.mean(reference_gain))
            found["reading"] = signal / gain / float(np.mean(current))
    return found


def _check_uncertainty(name: str, brf: FloatArray, u_brf: FloatArray) -> None:
    wrong = np.flatnonzero(~(np.isfinite(u_brf) & (u_brf > 0)))
    if len(wrong):
        raise InputError(
            f"{name}: u_brf: found {u_brf[wrong[0]]:g} at usable point {wrong[0]} and {len(wrong) - 1} more;"
            " expected standard uncertainties above zero"
        )
    if np.median(u_brf / brf) > 0.5:
        raise InputError(
            f"{name}: u_brf: found a median of {np.median(u_brf / brf):.3g} of brf; expected an absolute standard"
            " uncertainty (k = 1) in the unit of brf, below half of it"
        )
    if np.median(brf) > 10:
        raise InputError(
            f"{name}: brf: found a median of {np.median(brf):.3g}; expected a reflectance factor near 1, not per cent"
        )
