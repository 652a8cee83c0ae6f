"""Hemispherical pattern of a sample under ideal light, and how much of it an instrument can measure (paper, Fig. 4).

Ideal light is parallel and unbounded; the sensor is parallel and sees a horizontal disc of the instrument's target
diameter. The hemisphere is divided into cells of equal zenith and azimuth steps, each represented by its centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from instrument.angles import FloatArray, angle_between, direction
from instrument.artifact import ArtifactDimensions
from instrument.budget import combined, point_budget
from instrument.facility import Arms, Beam, Budget, Facility, Sensor
from twin.material import Material
from twin.optics import COORDINATES
from twin.prediction import Twin

#: Squared relative departure below which a pattern has no structure to share out.
_NO_STRUCTURE = 1e-5


def ideal(facility: Facility) -> Facility:
    """The facility with the light and the sensor of the design phase."""
    beam = Beam(diameter="unbounded", profile="tophat")
    sensor = Sensor(target_diameter=facility.sensor.target_diameter, target_shape="horizontal_disc")
    return facility.model_copy(update={"beam": beam, "sensor": sensor})


@dataclass(frozen=True)
class Cells:
    """A division of the hemisphere.

    Attributes
    ----------
    zenith, shape (zenith,), azimuth, shape (azimuth,)
        Centres of the cells in degree; zenith 0 to 90, azimuth 0 to 360.
    """

    zenith: FloatArray
    azimuth: FloatArray

    @classmethod
    def of(cls, zenith_step: float = 5.0, azimuth_step: float = 10.0) -> Cells:
        """Cells of about these sizes in degree."""
        rings, sectors = round(90 / zenith_step), round(360 / azimuth_step)
        zenith, azimuth = (np.arange(rings) + 0.5) * (90 / rings), np.arange(sectors) * (360 / sectors)
        return cls(np.asarray(zenith, dtype=float), np.asarray(azimuth, dtype=float))

    def weights(self) -> FloatArray:
        """Integral of cos(zenith)/pi over each cell, shape (zenith, azimuth); they add up to 1."""
        half = 45.0 / len(self.zenith)
        upper, lower = (np.sin(np.deg2rad(self.zenith + sign * half)) ** 2 for sign in (1, -1))
        return np.asarray(np.repeat((upper - lower)[:, None] / len(self.azimuth), len(self.azimuth), axis=1))


def hemispherical_pattern(
    facility: Facility,
    artifact: ArtifactDimensions,
    material: Material,
    illumination_zenith: FloatArray,
    *,
    wavelength: float = 500.0,
    cells: Cells | None = None,
    standard_error: float = 0.01,
    samples: int | None = None,
    seed: int = 1,
) -> xr.Dataset:
    """Reflectance factors of every cell of the hemisphere under ideal light.

    Parameters
    ----------
    illumination_zenith, shape (illumination_zenith,)
        Degree; the light comes from azimuth 0.
    standard_error
        Relative Monte Carlo error of each cell.
    samples
        Sight lines of each cell, whatever the error.

    Returns
    -------
    Dataset
        ``brf`` and ``u_brf_monte_carlo`` (illumination_zenith, zenith, azimuth), the cells' ``weight`` (zenith,
        azimuth) and ``hemispherical_reflectance`` (illumination_zenith).
    """
    cells = Cells.of() if cells is None else cells
    axes = (np.asarray(illumination_zenith, dtype=float), cells.zenith, cells.azimuth)
    light, zenith, azimuth = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    columns = (np.full(len(light), wavelength), light, np.zeros(len(light)), zenith, azimuth)
    points = xr.Dataset(coords={name: ("point", values) for name, values in zip(COORDINATES, columns, strict=True)})
    predicted = Twin(ideal(facility), artifact, material).predict(
        points, standard_error=None if samples else standard_error, samples=samples, seed=seed
    )
    dims = ("illumination_zenith", "zenith", "azimuth")
    shape = tuple(len(axis) for axis in axes)
    brf = predicted["brf"].values.reshape(shape)
    weight = cells.weights()
    return xr.Dataset(
        {
            "brf": (dims, brf),
            "u_brf_monte_carlo": (dims, predicted["u_brf_monte_carlo"].values.reshape(shape)),
            "weight": (dims[1:], weight),
            "hemispherical_reflectance": (dims[:1], np.sum(brf * weight, axis=(1, 2))),
        },
        coords=dict(zip(dims, axes, strict=True)),
    )


def measurable(arms: Arms, illumination_zenith: float, zenith: FloatArray, azimuth: FloatArray) -> np.ndarray:
    """Directions that the arms reach outside the shadow cone; arguments broadcast.

    Parameters
    ----------
    zenith, azimuth
        Degree, of 0 to 90 and 0 to 360. A direction is reached with a positive sensor zenith, or from the opposite
        azimuth with a negative one.
    """
    zenith, azimuth = np.broadcast_arrays(np.asarray(zenith, dtype=float), np.asarray(azimuth, dtype=float))
    (low, high), (first, last) = arms.sensor_zenith, arms.sensor_azimuth

    def reached(signed: FloatArray, turned: FloatArray) -> np.ndarray:
        turned = first + np.mod(turned - first + 1e-9, 360.0)
        return (signed >= low) & (signed <= high) & (turned <= last + 1e-6)

    away = angle_between(
        direction(np.full(zenith.shape, illumination_zenith), np.zeros(zenith.shape)), direction(zenith, azimuth)
    )
    lower, upper = arms.illumination_zenith
    lit = lower <= illumination_zenith <= upper
    within = reached(zenith, azimuth) | reached(-zenith, azimuth + 180.0)
    return np.asarray(within & (away >= arms.shadow_half_angle) & lit)


@dataclass(frozen=True)
class Signal:
    """How much a pattern offers to an instrument.

    The structure of a pattern is its departure from its own hemispherical mean, the pattern of a matt sample that
    reflects as much; it is weighted with the projected solid angle.

    Attributes
    ----------
    structure
        Root mean square of the relative departure over measurable directions.
    share
        Of the squared structure of the hemisphere, what falls on measurable directions.
    directions
        Of the projected solid angle, what is measurable.
    over_budget
        Root mean square of the departure over the standard uncertainty of a reading; None without a budget.
    """

    structure: float
    share: float
    directions: float
    over_budget: float | None


def signal(pattern: xr.Dataset, facility: Facility) -> Signal:
    """Judge a pattern for an instrument; the mean over the illuminations of the pattern.

    Monte Carlo noise is taken off the squares.
    """
    weight = pattern["weight"].values
    zenith, azimuth = (pattern[name].values for name in ("zenith", "azimuth"))
    inside, whole, size, relative = 0.0, 0.0, 0.0, 0.0
    count = pattern.sizes["illumination_zenith"]
    for number, light in enumerate(pattern["illumination_zenith"].values):
        brf, noise = (pattern[name].values[number] for name in ("brf", "u_brf_monte_carlo"))
        mean = float(pattern["hemispherical_reflectance"].values[number])
        square = weight * ((brf - mean) ** 2 - noise**2) / mean**2
        seen = measurable(facility.arms, float(light), zenith[:, None], azimuth[None, :])
        whole += float(square.sum())
        inside += float(square[seen].sum())
        size += float(weight[seen].sum())
        if facility.budget != Budget():
            budget = combined(point_budget(facility.budget, float(light), zenith[:, None], brf))
            relative += float((square * (mean / budget) ** 2)[seen].sum())
    return Signal(
        structure=float(np.sqrt(max(inside, 0.0) / size)) if size else 0.0,
        share=float(np.clip(inside / whole, 0.0, 1.0)) if whole > _NO_STRUCTURE * count else 0.0,
        directions=size / count,
        over_budget=float(np.sqrt(max(relative, 0.0) / size)) if facility.budget != Budget() and size else None,
    )
