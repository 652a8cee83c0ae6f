"""What the instrument should read: the expected reflectance factor of every geometry, with its uncertainty."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, read_artifact
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Facility, read_facility
from instrument.lambertian import lambertian_flux
from twin.artifact import Surface, SurfaceMesh, build_mesh
from twin.material import Material, read_material
from twin.optics import (
    COORDINATES,
    Setup,
    geometry_columns,
    lay_out,
    reference_change,
    sample_columns,
    sample_rotation,
)
from twin.pooled_variance import expected, nothing_expected
from twin.prepared import Prepared
from twin.repetitions import no_repetitions, repetitions
from twin.sampling_plan import (
    Block,
    Tally,
    fixed,
    pilot,
    planned,
    power_of_two,
)
from twin.sequence import mix_numpy
from twin.tracer import RANDOMISATIONS, SHARE, Mixture, Part, Tracer

#: Relative error of geometry and tables in single precision: what is left where nothing scatters.
_SINGLE_PRECISION = 1e-6
#: Below this cosine of the sensor zenith the reflectance factor of a flat target is not defined.
_GRAZING = 1e-3
#: Number of the pilot among the runs that a seed's repetitions are told apart by.
_PILOT = 0x71107
_UNITS = {"wavelength": "nm"} | dict.fromkeys(COORDINATES[1:], "degree")


@dataclass(frozen=True)
class Estimate:
    """Reflectance factors by ray tracing, arrays of shape (point,).

    Attributes
    ----------
    brf, standard_error
        Mean and standard error over independent randomisations.
    samples
        Sight lines traced.
    """

    brf: FloatArray
    standard_error: FloatArray
    samples: NDArray[np.int64]


class Twin:
    """Digital twin of one facility with one artifact of one material.

    Parameters
    ----------
    facility, artifact, material
        What is known of the instrument, the sample's dimensions, and how its surfaces reflect.
    seed
        Of every prediction that names none. A prediction depends on seed and geometry only: alone or within a
        plan, a geometry gets the same value at the same number of samples.
    surface_factor
        Reflectance of each surface over the material's.
    mesh
        Surfaces of the sample; by default made from ``artifact``.
    """

    def __init__(
        self,
        facility: Facility,
        artifact: ArtifactDimensions,
        material: Material,
        *,
        seed: int = 1,
        surface_factor: dict[Surface, float] | None = None,
        mesh: SurfaceMesh | None = None,
    ) -> None:
        self.facility, self.artifact, self.material, self.seed = facility, artifact, material, seed
        self.mesh = build_mesh(artifact) if mesh is None else mesh
        self._tracer = Tracer(self.mesh, material, surface_factor=surface_factor)

    @classmethod
    def from_files(cls, facility: Path, artifact: Path, material: Path, *, seed: int = 1) -> Twin:
        """Build the twin from its three files; an :class:`~instrument.errors.InputError` names what is wrong."""
        return cls(read_facility(facility), read_artifact(artifact), read_material(material), seed=seed)

    def predict(
        self,
        geometries: Sequence[Geometry] | xr.Dataset,
        *,
        standard_error: float | None = 0.001,
        samples: int | None = None,
        seed: int | None = None,
        setup: Setup | None = None,
    ) -> xr.Dataset:
        """Predict reflectance factors.

        Parameters
        ----------
        geometries
            Commanded geometries; of a dataset its coordinates along ``point`` are kept.
        standard_error
            Relative Monte Carlo error to reach at every point; the number of sight lines follows from it.
        samples
            Sight lines of every point instead (rounded up to a power of two in each randomisation).
        setup
            What is off in the instrument or in the sample's place: the flux is that of the true geometry, divided by
            that of the commanded one.

        Returns
        -------
        Dataset
            In the prediction form of the data contract: ``brf``, ``u_brf``, ``u_brf_monte_carlo`` along ``point``.

        Raises
        ------
        InputError
            For a geometry that cannot be predicted: grazing view, wavelength the material was not measured at.
        """
        columns = geometry_columns(geometries)
        seed = self.seed if seed is None else seed
        seen = self._columns(geometries)
        if setup is not None and np.any(sample_rotation(geometries)):
            raise InputError(
                "sample_rotation: found a turned sample; expected none where the set-up is not the nominal one"
            )
        estimate = self.estimate(seen, standard_error=standard_error, samples=samples, seed=seed, setup=setup)
        return _dataset(geometries, columns, estimate, seed).assign_attrs(material=self.material.describe())

    def _columns(self, geometries: Sequence[Geometry] | xr.Dataset) -> dict[str, FloatArray]:
        """What :meth:`estimate` takes of the geometries: angles as the sample sees them, degree, shape (point,)."""
        return sample_columns(geometries)

    def estimate(
        self,
        columns: dict[str, FloatArray],
        *,
        standard_error: float | None = 0.001,
        samples: int | None = None,
        seed: int,
        setup: Setup | None = None,
        mixture: Mixture | None = None,
    ) -> Estimate:
        """:meth:`predict` on plain arrays."""
        if samples is None and (standard_error is None or not standard_error > 0):
            raise InputError(f"standard_error: found {standard_error}; expected a number > 0, or samples")
        scale = self._scale(columns, setup)
        layout = lay_out(self.facility, columns, setup)
        table = self.material.table_index(columns["wavelength"])
        keys = _keys(columns)
        prepared = self._tracer.prepare(layout, table, keys=keys, mixture=mixture)
        points = len(scale)
        if samples is not None:
            total = power_of_two(samples / RANDOMISATIONS)
            numbers = {part: max(1, total // SHARE[part]) for part in Part}
            main = self._trace(prepared, fixed(points, numbers), seed)
            repeats = no_repetitions(main, nothing_expected(points))
        else:
            assert standard_error is not None
            seen = self._trace(prepared, pilot(points, standard_error), _other_seed(seed, _PILOT))
            main = self._trace(prepared, planned(seen, standard_error), seed)
            repeats = repetitions(main, expected(seen, main), standard_error)
        again = self._trace(prepared, repeats.blocks(), _other_seed(seed, 1))
        radiance, spread = repeats.result(again)
        brf = radiance * scale
        traced = (main.done + again.done)[[Part.REFLECTED_ONCE, Part.SCATTERED]].sum(axis=0)
        return Estimate(brf, np.hypot(spread * scale, _SINGLE_PRECISION * brf), traced * RANDOMISATIONS)

    def _trace(self, prepared: Prepared, blocks: Iterable[Block], seed: int) -> Tally:
        tally = Tally(len(prepared))
        for block in blocks if len(prepared) else ():
            means = self._tracer.part(
                block.part, prepared, block.samples, seed=seed, first=block.first, chosen=block.chosen
            )
            tally.add(block, means)
        return tally

    def _scale(self, columns: dict[str, FloatArray], setup: Setup | None) -> FloatArray:
        """What turns radiances into reflectance factors, shape (point,)."""
        view = np.cos(np.deg2rad(columns["sensor_zenith"]))
        light = np.cos(np.deg2rad(columns["illumination_zenith"]))
        for name, cosine in (("sensor_zenith", view), ("illumination_zenith", light)):
            if np.any(cosine < _GRAZING):
                worst = float(columns[name][int(np.argmin(cosine))])
                raise InputError(f"{name}: found {worst:g} degrees; expected less than 90 either way")
        flux = lambertian_flux(
            self.facility,
            columns["illumination_zenith"],
            columns["sensor_zenith"],
            columns["sensor_azimuth"],
            illumination_azimuth=columns["illumination_azimuth"],
        )
        change = 1.0 if setup is None else reference_change(self.facility, setup)
        return np.asarray(1 / (flux * change))


def _other_seed(seed: int, run: int) -> int:
    """Seed of another independent run of the same prediction."""
    words = np.array([seed & 0xFFFFFFFF, run], dtype=np.uint32)
    return int(mix_numpy(mix_numpy(words[:1]) + np.uint32(0x9E3779B9) * words[1:])[0])


def _keys(columns: dict[str, FloatArray]) -> NDArray[np.uint32]:
    """Tell geometries apart by their angles, so that a geometry's random numbers do not depend on its company."""
    rows = np.round(np.stack([columns[name] for name in COORDINATES], axis=1), 6) + 0.0
    return np.array([zlib.crc32(row.tobytes()) for row in rows], dtype=np.uint32)


def _dataset(
    geometries: Sequence[Geometry] | xr.Dataset, columns: dict[str, FloatArray], estimate: Estimate, seed: int
) -> xr.Dataset:
    if isinstance(geometries, xr.Dataset):
        coords: dict[str, Any] = {str(name): c for name, c in geometries.coords.items() if c.dims == ("point",)}
    else:
        coords = {}
    for name in COORDINATES:
        coords.setdefault(name, ("point", columns[name], {"units": _UNITS[name]}))
    if np.any(turned := sample_rotation(geometries)):
        coords.setdefault("sample_rotation", ("point", turned, {"units": "degree"}))
    error = estimate.standard_error
    return xr.Dataset(
        {
            "brf": ("point", estimate.brf, {"units": "1", "long_name": "bidirectional reflectance factor"}),
            "u_brf": ("point", error, {"units": "1", "long_name": "combined standard uncertainty (k=1) of brf"}),
            "u_brf_monte_carlo": (
                "point",
                error.copy(),
                {"units": "1", "long_name": "standard error of the ray tracer (k=1)"},
            ),
        },
        coords=coords,
        attrs={
            "Conventions": "CF-1.11",
            "title": "predicted reflectance factors",
            "u_brf_contains": "the ray tracer's standard error alone; no uncertainty of the inputs is propagated",
            "seed": seed,
            "sight_lines": int(estimate.samples.sum()),
        },
    )
