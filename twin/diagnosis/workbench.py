"""The twin on the bench: one plan, rendered for many scenes that differ a little, with the same random numbers.

A reading is the light reflected once and the scattered light. Of a pierced plate the first is a quadrature
(:mod:`twin.diagnosis.direct_light`), which follows small changes smoothly; the second, some per cent of a reading, is
ray traced. Any other sample, and an instrument that the quadrature does not know, is ray traced altogether.

Scenes that differ in instrument, sample placement or material share a launch; another mesh, or another reflectance of
some surfaces, needs a tracer of its own. With common random numbers most of the ray tracer's error cancels from
ratios.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux
from twin.artifact import SurfaceMesh, build_mesh
from twin.content import content_digest
from twin.diagnosis.direct_light import once_reflected, pierced_plate, served
from twin.diagnosis.effects.base import Known
from twin.diagnosis.transport import transported
from twin.diagnosis.variation import Variation
from twin.material import Material
from twin.optics import COORDINATES, Setup, lay_out, reference_change
from twin.tracer import RANDOMISATIONS, SHARE, Part, Tracer

#: Raised whenever the same variation would give other numbers, as it does when what a change does is changed.
VERSION = 6
#: Sight lines of a geometry in each randomisation, a power of two: for scattered light alone, and for all of it.
SAMPLES, _ALL_SAMPLES = 64, 256
#: Geometries in one launch at most: bounds the memory.
_TOGETHER = 4096
Progress = Callable[[int], None]


@dataclass(frozen=True)
class _Scene:
    """Variations that one tracer serves, and the table of each in its material."""

    mesh: SurfaceMesh
    dimensions: ArtifactDimensions
    material: Material
    surface_factor: dict[Any, float]
    members: list[int]
    first_table: list[int]
    nominal: bool


@dataclass(frozen=True)
class Light:
    """Light reflected once and scattered light as reflectance factors, shape (variation, point, RANDOMISATIONS)."""

    once: FloatArray
    scattered: FloatArray


class Workbench:
    """Renders a twin's plan with variations.

    Parameters
    ----------
    facility, artifact, material
        The nominal twin.
    samples
        Sight lines of a geometry in each randomisation; a power of two.
    seed
        Of the random numbers, the same for every variation.
    """

    def __init__(
        self,
        facility: Facility,
        artifact: ArtifactDimensions,
        material: Material,
        *,
        samples: int = SAMPLES,
        seed: int = 20_231,
    ) -> None:
        self.known = Known(facility, artifact, material)
        self.samples, self.seed = samples, seed
        self._mesh: SurfaceMesh | None = None
        self._nominal_tracer: Tracer | None = None
        self._flux: dict[bytes, FloatArray] = {}

    @property
    def mesh(self) -> SurfaceMesh:
        """The nominal sample."""
        if self._mesh is None:
            self._mesh = build_mesh(self.known.artifact)
        return self._mesh

    def digest(self) -> str:
        """Tells apart all that changes a rendering but geometries and variation."""
        artifact, material = self.known.artifact, self.known.material
        holes, form = artifact.holes, artifact.form.model_dump(exclude={"holes", "mesh"})
        return content_digest(
            VERSION,
            self.samples,
            self.seed,
            self.known.facility.beam,
            self.known.facility.sensor,
            {name: value for name, value in form.items() if not name.startswith("u_")},
            (holes.x, holes.y, holes.diameter, artifact.chamfers),
            artifact.mesh,
            (material.cos_o, material.phi_rad, material.cos_i, material.brdf, material.wavelengths, material.surfaces),
        )

    def render(
        self,
        variations: Sequence[Variation],
        columns: dict[str, FloatArray],
        progress: Progress | None = None,
        *,
        traced: bool = False,
    ) -> Light:
        """Detected flux over the Lambertian flux at the commanded geometry; the reference reading is not divided out.

        Parameters
        ----------
        columns
            Commanded geometries, from :func:`~twin.optics.geometry_columns`.
        progress
            Told the number of variations just done.
        traced
            Ray trace all light. Values by the two ways differ by more than those of like scenes: compare none with
            the other; without this, every variation must be one for :meth:`by_quadrature`.
        """
        points = len(columns["sensor_zenith"])
        once, scattered = (np.empty((len(variations), points, RANDOMISATIONS)) for _ in range(2))
        tables = self.known.material.table_index(columns["wavelength"])
        keys = geometry_keys(columns)
        each = max(1, _TOGETHER // max(points, 1))
        for scene in self._scenes(variations):
            tracer = self._tracer(scene)
            plate = None if traced else pierced_plate(scene.dimensions)
            for start in range(0, len(scene.members), each):
                members = scene.members[start : start + each]
                first = np.array(scene.first_table[start : start + each])
                many = {name: np.tile(column, len(members)) for name, column in columns.items()}
                setup = side_by_side([variations[m].setup for m in members], points)
                layout = lay_out(self.known.facility, many, setup)
                table = (first[:, None] + tables).ravel()
                shape = (len(members), points, -1)
                prepared = tracer.prepare(layout, table, keys=np.tile(keys, len(members)))
                samples = self.samples if plate is not None else max(self.samples, _ALL_SAMPLES)
                if plate is not None:
                    direct = once_reflected(plate, scene.material, layout, table, scene.surface_factor)
                    for place, member in enumerate(members):
                        length, share = variations[member].transport
                        if share:
                            rows = np.arange(place * points, (place + 1) * points)
                            moved = transported(plate, scene.material, layout.take(rows), table[rows], length)
                            direct[rows] += share * moved
                else:
                    direct = tracer.part(Part.PLATE_TOP, prepared, samples, seed=self.seed)
                    direct += tracer.part(Part.REFLECTED_ONCE, prepared, samples, seed=self.seed)
                once[members] = direct.reshape(shape)
                rest = tracer.part(Part.SCATTERED, prepared, max(1, samples // SHARE[Part.SCATTERED]), seed=self.seed)
                scattered[members] = rest.reshape(shape)
                if progress is not None:
                    progress(len(members))
        flux = self._commanded_flux(columns)
        return Light(once / flux[:, None], scattered / flux[:, None])

    def by_quadrature(self, variation: Variation) -> bool:
        """Whether the quadrature of light reflected once knows this instrument and sample."""
        dimensions = self._changed(variation)
        zero = np.zeros(1)
        names = ("illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
        layout = lay_out(self.known.facility, dict.fromkeys(names, zero), variation.setup)
        return pierced_plate(dimensions) is not None and served(layout)

    def _commanded_flux(self, columns: dict[str, FloatArray]) -> FloatArray:
        key = b"".join(columns[name].tobytes() for name in COORDINATES)
        if key not in self._flux:
            self._flux[key] = lambertian_flux(
                self.known.facility,
                columns["illumination_zenith"],
                columns["sensor_zenith"],
                columns["sensor_azimuth"],
                illumination_azimuth=columns["illumination_azimuth"],
            )
        return self._flux[key]

    def reference_change(self, setup: Setup) -> float:
        """Reference reading with an instrument that is off, over that of the nominal one."""
        return reference_change(self.known.facility, setup)

    def _scenes(self, variations: Sequence[Variation]) -> Iterator[_Scene]:
        """Group variations by what a tracer holds, one scene at a time."""
        groups: dict[str, list[int]] = {}
        for number, variation in enumerate(variations):
            groups.setdefault(variation.scene_key(), []).append(number)
        for members in groups.values():
            first = variations[members[0]]
            dimensions = self._changed(first)
            mesh = self.mesh if dimensions is self.known.artifact else build_mesh(dimensions)
            by_grid: dict[tuple[bytes, ...], list[tuple[int, Material]]] = {}
            for number in members:
                material = self.known.material
                for change in variations[number].material:
                    material = change.apply(material)
                grid = tuple(axis.tobytes() for axis in (material.cos_o, material.phi_rad, material.cos_i))
                by_grid.setdefault(grid, []).append((number, material))
            for some in by_grid.values():
                material, starts = _stack(some)
                members = [number for number, _ in some]
                nominal = not (first.artifact or first.material or first.surface_factor)
                yield _Scene(mesh, dimensions, material, dict(first.surface_factor), members, starts, nominal)

    def _changed(self, variation: Variation) -> ArtifactDimensions:
        dimensions = self.known.artifact
        for change in variation.artifact:
            dimensions = change.dimensions(dimensions)
        return dimensions

    def _tracer(self, scene: _Scene) -> Tracer:
        if scene.nominal:
            if self._nominal_tracer is None:
                self._nominal_tracer = Tracer(scene.mesh, scene.material)
            return self._nominal_tracer
        return Tracer(scene.mesh, scene.material, surface_factor=scene.surface_factor or None)


def _stack(some: list[tuple[int, Material]]) -> tuple[Material, list[int]]:
    """One material that holds the tables of all, equal ones once, and where each one's begin."""
    different: dict[int, Material] = {id(material): material for _, material in some}
    starts, total = {}, 0
    for key, material in different.items():
        starts[key] = total
        total += len(material.brdf)
    one = next(iter(different.values()))
    brdf = np.concatenate([material.brdf for material in different.values()])
    together = Material(one.cos_o, one.phi_rad, one.cos_i, brdf, np.arange(total, dtype=float), name="varied")
    return together, [starts[id(material)] for _, material in some]


def side_by_side(setups: Sequence[Setup], points: int) -> Setup:
    """One setup for all: each field with a value a point, one variation after the other."""
    names = [field.name for field in fields(Setup) if field.name != "square_target"]
    values = {name: np.repeat([float(getattr(setup, name)) for setup in setups], points) for name in names}
    return Setup(**values, square_target=setups[0].square_target)


def geometry_keys(columns: dict[str, FloatArray]) -> NDArray[np.uint32]:
    """Tell geometries apart by their angles: a geometry's random numbers do not depend on its company."""
    rows = np.round(np.stack([columns[name] for name in COORDINATES], axis=1), 6) + 0.0
    return np.array([zlib.crc32(row.tobytes()) for row in rows], dtype=np.uint32)
