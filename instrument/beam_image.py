"""The picture that a beam profiler took of the beam, as irradiance over the beam's cross-section.

Columns of the picture run along the direction of growing illumination zenith (u), rows against v: the first row is on
top, as the beam looks on the sample to someone at the source. A netCDF file says itself where its pixels are.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import InputError

#: Pixels a side, at most: more than any beam profiler needs, little enough for memory.
_LARGEST = 4096


@dataclass(frozen=True, eq=False)
class BeamImage:
    """Irradiance on a regular grid, 1 at its brightest, linear between the pixels' centres and 0 beyond them.

    Attributes
    ----------
    values, shape (v, u)
    pitch
        Of the pixels along u and v, mm.
    first
        Place (u, v) of the centre of ``values[0, 0]``, mm from the beam's axis.
    """

    values: FloatArray
    pitch: tuple[float, float]
    first: tuple[float, float]

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Irradiance at places, mm from the beam's axis."""
        rows, columns = self.values.shape
        x, y = (u - self.first[0]) / self.pitch[0], (v - self.first[1]) / self.pitch[1]
        inside = (x >= 0) & (y >= 0) & (x <= columns - 1) & (y <= rows - 1)
        x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        i, j = np.minimum(x.astype(np.int64), columns - 2), np.minimum(y.astype(np.int64), rows - 2)
        a, b = x - i, y - j
        flat, corner = self.values.ravel(), j * columns + i
        low = flat[corner] * (1 - a) + flat[corner + 1] * a
        high = flat[corner + columns] * (1 - a) + flat[corner + columns + 1] * a
        return np.where(inside, low * (1 - b) + high * b, 0.0)

    @property
    def reach(self) -> float:
        """Distance of the farthest pixel from the beam's axis, mm."""
        rows, columns = self.values.shape
        far = [
            max(abs(first), abs(first + (n - 1) * pitch))
            for first, n, pitch in zip(self.first, (columns, rows), self.pitch, strict=True)
        ]
        return float(np.hypot(*far))

    @cached_property
    def digest(self) -> str:
        """Of the content: equal images have equal digests."""
        frame = repr((self.values.shape, self.pitch, self.first))
        return hashlib.sha256(self.values.tobytes() + frame.encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BeamImage):
            return NotImplemented
        return (self.pitch, self.first) == (other.pitch, other.first) and np.array_equal(self.values, other.values)

    def __hash__(self) -> int:
        return hash((self.values.shape, self.pitch, self.first))


def read_beam_image(path: Path, pitch: float | None, *, about_centroid: bool) -> BeamImage:
    """Read a picture of the beam: PNG, NPY, CSV, or netCDF with ``irradiance(y, x)`` and x, y in mm.

    Parameters
    ----------
    pitch
        Of the pixels in mm; None for netCDF, which says it itself.
    about_centroid
        Whether the beam's axis goes through the centroid of the light, or through the middle of the picture (of a
        netCDF file: through x = y = 0).

    Raises
    ------
    InputError
        Naming the file and what is wrong with it.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file (the image of the beam)")
    kind = path.suffix.lower()
    if kind == ".nc":
        if pitch is not None:
            raise InputError(f"{path}: found a pixel_pitch too; expected none, netCDF holds x and y")
        values, x, y = _from_netcdf(path)
    elif kind in _READERS:
        if pitch is None:
            raise InputError(f"{path}: found no pixel_pitch; expected the distance of its pixels in mm")
        values = _checked(path, _READERS[kind](path))[::-1]
        x, y = (pitch * (np.arange(n) - (n - 1) / 2) for n in values.shape[::-1])
    else:
        raise InputError(f"{path}: found {path.suffix or 'no suffix'}; expected .png, .npy, .csv or .nc")
    if about_centroid:
        total = values.sum()
        x, y = x - (values.sum(axis=0) @ x) / total, y - (values.sum(axis=1) @ y) / total
    steps = (float(x[1] - x[0]), float(y[1] - y[0]))
    return BeamImage(np.ascontiguousarray(values / values.max()), steps, (float(x[0]), float(y[0])))


def _png(path: Path) -> FloatArray:
    from matplotlib.image import imread

    try:
        picture = np.asarray(imread(path), dtype=float)
    except (OSError, SyntaxError) as error:
        raise InputError(f"{path}: cannot be read as a picture: {error}") from None
    if picture.ndim == 3:
        colours = picture[..., :3] if picture.shape[2] > 2 else picture[..., :1]
        if np.ptp(colours, axis=2).max() > 0:
            raise InputError(f"{path}: found a picture in colours; expected shades of grey")
        picture = colours[..., 0]
    return picture


def _npy(path: Path) -> FloatArray:
    try:
        return np.asarray(np.load(path, allow_pickle=False), dtype=float)
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: not an array of numbers in NumPy's form: {error}") from None


def _csv(path: Path) -> FloatArray:
    try:
        return np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError as error:
        raise InputError(f"{path}: not a table of numbers: {error}") from None


_READERS: dict[str, Callable[[Path], FloatArray]] = {".png": _png, ".npy": _npy, ".csv": _csv}


def _from_netcdf(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    import xarray as xr

    try:
        with xr.open_dataset(path, engine="h5netcdf") as file:
            if "irradiance" not in file or file["irradiance"].dims != ("y", "x"):
                found = ", ".join(f"{name}{values.dims}" for name, values in file.data_vars.items())
                raise InputError(f"{path}: found {found or 'nothing'}; expected irradiance(y, x)")
            image = file["irradiance"].load()
    except OSError as error:
        raise InputError(f"{path}: cannot be read as netCDF-4: {error}") from None
    axes = []
    for name in ("x", "y"):
        unit = image[name].attrs.get("units") if name in image.coords else None
        if unit not in ("mm", "millimeter", "millimetre"):
            raise InputError(f"{path}: {name}: found unit {unit!r}; expected a coordinate in mm")
        axis = np.asarray(image[name].values, dtype=float)
        steps = np.diff(axis)
        if len(axis) < 2 or np.ptp(steps) > 1e-6 * np.abs(steps).max():
            raise InputError(f"{path}: {name}: expected at least two equidistant values in mm")
        axes.append(axis)
    x, y = axes
    values = _checked(path, np.asarray(image.values, dtype=float))
    values, x = (values[:, ::-1], x[::-1]) if x[0] > x[-1] else (values, x)
    values, y = (values[::-1], y[::-1]) if y[0] > y[-1] else (values, y)
    return values, x, y


def _checked(path: Path, values: FloatArray) -> FloatArray:
    if values.ndim != 2 or min(values.shape) < 2 or max(values.shape) > _LARGEST:
        raise InputError(f"{path}: found shape {values.shape}; expected rows and columns, 2 to {_LARGEST} of each")
    if not np.all(np.isfinite(values)) or values.min() < 0:
        raise InputError(
            f"{path}: found a pixel of {values.min():g}; expected finite numbers from 0 on: subtract the dark"
            " picture and cut what is left below 0"
        )
    if values.max() <= 0:
        raise InputError(f"{path}: found a dark picture; expected some light")
    return values
