"""How well effects of the diagnosis could be told apart in a scan of a candidate artifact.

The signature of an effect is the change of the reflectance factors with its parameter, found by finite differences
with common random numbers. A scan is a linear model: readings = signatures x sizes + errors. Random components of the
budget are independent from point to point. A systematic component is an unknown factor of standard deviation 1 on its
own profile, common to all points. Instability, whose correlation nobody states, is a factor for each plane and an
independent part of equal variance. The inverse covariance says what a scan knows of each effect when all others are
unknown, too; it adds up over planes, so planes can be chosen one after the other (determinant criterion).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from instrument.angles import FloatArray, angle_between, direction
from instrument.artifact import ArtifactDimensions
from instrument.budget import point_budget
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux
from twin.artifact import Surface, build_mesh
from twin.material import Material
from twin.optics import Setup, lay_out, reference_change
from twin.tracer import RANDOMISATIONS, Tracer

#: Components of the budget that differ from point to point, and the one that is half so, half common to a plane.
_RANDOM, _PLANE = ("u_brf_noise",), "u_brf_stability"
#: Information that stands for knowing nothing: standard uncertainty in units of an effect's size.
_UNKNOWN = 100.0
_INSIDE = (Surface.FLOOR, Surface.UNDERSIDE, Surface.SPACER)


@dataclass(frozen=True)
class Effect:
    """One parameter of an effect of the data contract, and the size at which a laboratory wants to notice it.

    Attributes
    ----------
    setup
        Field of :class:`~twin.optics.Setup` that it changes; empty for effects of the sample itself.
    """

    name: str
    size: float
    unit: str
    setup: str = ""


EFFECTS = (
    Effect("sample_tilt x", 0.25, "degree", "tilt_x_deg"),
    Effect("sample_tilt y", 0.25, "degree", "tilt_y_deg"),
    Effect("sample_height", 0.1, "mm", "height_mm"),
    Effect("beam_offset x", 0.25, "mm", "beam_x_mm"),
    Effect("beam_offset y", 0.25, "mm", "beam_y_mm"),
    Effect("sensor_zenith_offset", 0.25, "degree", "sensor_zenith_deg"),
    Effect("hole_diameter", 0.02, "mm"),
    Effect("cavity_depth", 0.02, "mm"),
    Effect("cavity_reflectance", 0.05, "ratio"),
)


@dataclass(frozen=True)
class Signatures:
    """Reflectance factors of points and their changes with one size of every effect.

    Attributes
    ----------
    columns
        Commanded geometries, arrays of shape (point,).
    plane, shape (point,)
        Number of the plane (illumination, sensor azimuth) of each point.
    brf, shape (point,)
    change, shape (effect, point, randomisation)
    effects
        In the order of ``change``.
    """

    columns: dict[str, FloatArray]
    plane: np.ndarray
    brf: FloatArray
    change: FloatArray
    effects: tuple[Effect, ...]

    @property
    def planes(self) -> list[tuple[float, float]]:
        """Illumination zenith and sensor azimuth of each plane."""
        first = np.unique(self.plane, return_index=True)[1]
        names = ("illumination_zenith", "sensor_azimuth")
        return [(float(self.columns[names[0]][i]), float(self.columns[names[1]][i])) for i in first]


def candidate_points(
    facility: Facility, illumination_zenith: FloatArray, wavelength: float, zenith_step: float, azimuth_step: float
) -> tuple[dict[str, FloatArray], np.ndarray]:
    """Measurable points on planes that a plan may choose from: columns and the plane of each point."""
    arms = facility.arms
    low, high = max(arms.sensor_zenith[0], -80.0), min(arms.sensor_zenith[1], 80.0)
    steps = np.arange(np.ceil(low / zenith_step), np.floor(high / zenith_step) + 1) * zenith_step
    first, last = arms.sensor_azimuth
    azimuths = np.arange(np.ceil(first / azimuth_step), np.floor(last / azimuth_step) + 1) * azimuth_step
    azimuths = azimuths[azimuths - azimuths[0] < 180.0] if len(azimuths) else azimuths
    axes = (np.asarray(illumination_zenith, dtype=float), azimuths, steps)
    numbers = np.meshgrid(*(np.arange(len(axis)) for axis in axes), indexing="ij")
    plane = (numbers[0] * len(azimuths) + numbers[1]).ravel()
    light, azimuth, zenith = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    away = angle_between(direction(light, np.zeros(len(light))), direction(zenith, azimuth))
    keep = away >= arms.shadow_half_angle
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    zero = np.zeros(len(light))
    columns = dict(zip(names, (zero + wavelength, light, zero, zenith, azimuth), strict=True))
    plane = np.unique(plane[keep], return_inverse=True)[1]
    return {name: column[keep] for name, column in columns.items()}, plane


def signatures(
    facility: Facility,
    artifact: ArtifactDimensions,
    material: Material,
    columns: dict[str, FloatArray],
    plane: np.ndarray,
    *,
    samples: int = 64,
    seed: int = 1,
) -> Signatures:
    """Find the signature of every effect by central differences over twice its size.

    Parameters
    ----------
    samples
        Sight lines of a point in each randomisation, a power of two.
    """
    flux = lambertian_flux(
        facility,
        columns["illumination_zenith"],
        columns["sensor_zenith"],
        columns["sensor_azimuth"],
        illumination_azimuth=columns["illumination_azimuth"],
    )
    render = _Renderer(facility, columns, material.table_index(columns["wavelength"]), flux, samples, seed)
    nominal = Tracer(build_mesh(artifact), material)
    effects = EFFECTS if len(artifact.holes) and artifact.mesh is None else tuple(e for e in EFFECTS if e.setup)
    placed = [effect for effect in effects if effect.setup]
    setups = [Setup(**_field(effect.setup, sign * effect.size)) for effect in placed for sign in (1, -1)]
    brf, *moved = render(nominal, [Setup(), *setups])
    change: dict[str, FloatArray] = {
        effect.name: (moved[2 * number] - moved[2 * number + 1]) / 2 for number, effect in enumerate(placed)
    }
    for effect in effects:
        if not effect.setup:
            up, down = (render(_changed(artifact, material, effect, sign), [Setup()])[0] for sign in (1, -1))
            change[effect.name] = (up - down) / 2
    stacked = np.stack([change[effect.name] for effect in effects])
    return Signatures(columns, plane, brf.mean(axis=-1), stacked, effects)


def _field(name: str, value: float) -> dict[str, Any]:
    return {name: value}


def _changed(artifact: ArtifactDimensions, material: Material, effect: Effect, sign: int) -> Tracer:
    """A tracer of the sample with one effect of its own."""
    step = sign * effect.size
    if effect.name == "cavity_reflectance":
        return Tracer(build_mesh(artifact), material, surface_factor=dict.fromkeys(_INSIDE, 1 + step))
    if effect.name == "hole_diameter":
        holes = replace(artifact.holes, diameter=artifact.holes.diameter + step)
        return Tracer(build_mesh(replace(artifact, holes=holes)), material)
    form = artifact.form.model_copy(update={"cavity_depth": artifact.form.cavity_depth + step})
    return Tracer(build_mesh(replace(artifact, form=form)), material)


@dataclass(frozen=True)
class _Renderer:
    """Reflectance factors with the same random numbers whatever is off."""

    facility: Facility
    columns: dict[str, FloatArray]
    tables: np.ndarray
    flux: FloatArray
    samples: int
    seed: int

    def __call__(self, tracer: Tracer, setups: list[Setup]) -> FloatArray:
        """Shape (setup, point, randomisation), all setups in one launch."""
        points, count = len(self.flux), len(setups)
        together: dict[str, Any] = {
            field.name: np.repeat([float(getattr(setup, field.name)) for setup in setups], points)
            for field in fields(Setup)
            if any(getattr(setup, field.name) != getattr(Setup(), field.name) for setup in setups)
        }
        columns = {name: np.tile(column, count) for name, column in self.columns.items()}
        radiance = tracer.radiance(
            lay_out(self.facility, columns, Setup(**together)),
            np.tile(self.tables, count),
            self.samples,
            seed=self.seed,
            keys=np.tile(np.arange(points, dtype=np.uint32), count),
        )
        change = np.array([reference_change(self.facility, setup) for setup in setups])
        return np.asarray(
            radiance.reshape(count, points, RANDOMISATIONS) / (change[:, None, None] * self.flux[None, :, None])
        )


@dataclass(frozen=True)
class Information:
    """What planes know of effects and nuisances: their information matrices add up.

    Attributes
    ----------
    matrices, shape (plane, parameter, parameter)
        Effects first, in units of their sizes; then systematic components of the budget in standard deviations.
    effects
        Names.
    """

    matrices: FloatArray
    effects: tuple[str, ...]

    def posterior(self, planes: list[int]) -> FloatArray:
        """Covariance of the effects, in units of their sizes, after a scan of some planes."""
        known = _prior(len(self.effects), self.matrices.shape[1]) + self.matrices[planes].sum(axis=0)
        count = len(self.effects)
        return np.asarray(np.linalg.inv(known)[:count, :count])

    def choose(self, start: list[int], count: int) -> list[int]:
        """Planes that together tell most of the effects, added one by one to those given."""
        chosen = list(start)
        while len(chosen) < min(count, len(self.matrices)):
            others = [plane for plane in range(len(self.matrices)) if plane not in chosen]
            gains = [-np.linalg.slogdet(self.posterior([*chosen, plane]))[1] for plane in others]
            chosen.append(others[int(np.argmax(gains))])
        return chosen


def _prior(effects: int, parameters: int) -> FloatArray:
    prior = np.eye(parameters)
    prior[:effects, :effects] /= _UNKNOWN**2
    return prior


def information(signatures: Signatures, facility: Facility) -> Information:
    """Weigh signatures with the budget of a facility.

    Products of signatures are taken between different randomisations only, so that noise does not pass for signal.
    """
    components = point_budget(
        facility.budget, signatures.columns["illumination_zenith"], signatures.columns["sensor_zenith"], signatures.brf
    )
    plane_part = components.pop(_PLANE) / np.sqrt(2)
    variance = plane_part**2 + sum(components.pop(name) ** 2 for name in _RANDOM)
    # Readings without any budgeted noise would tell everything.
    deviation = np.sqrt(np.maximum(variance, (1e-5 * signatures.brf) ** 2))
    systematic = np.stack([*components.values()]) / deviation
    change = signatures.change / deviation[:, None]
    effects, _, count = change.shape
    planes = int(signatures.plane.max()) + 1
    size = effects + len(systematic)
    matrices = np.zeros((planes, size, size))
    for plane in range(planes):
        here = signatures.plane == plane
        profile = (plane_part / deviation)[here]
        common = profile / np.sqrt(1 + profile @ profile)  # takes off what a factor of the plane explains
        total = change[:, here].sum(axis=2)
        mean = total / count
        matrices[plane, :effects, :effects] = _gram(change[:, here], common)
        cross = _product(mean, systematic[:, here], common)
        matrices[plane, :effects, effects:] = cross
        matrices[plane, effects:, :effects] = cross.T
        matrices[plane, effects:, effects:] = _product(systematic[:, here], systematic[:, here], common)
    return Information(_positive(matrices), tuple(effect.name for effect in signatures.effects))


def _product(a: FloatArray, b: FloatArray, common: FloatArray) -> FloatArray:
    """a (1 + p p^T)^-1 b^T with p the profile of a plane's own factor, ``common`` = p / sqrt(1 + p^T p)."""
    return np.asarray(a @ b.T - np.outer(a @ common, b @ common))


def _gram(change: FloatArray, common: FloatArray) -> FloatArray:
    """Products of effects without their noise, from different randomisations, shape (effect, effect)."""
    count = change.shape[2]
    total = change.sum(axis=2)
    own = sum(_product(change[:, :, r], change[:, :, r], common) for r in range(count))
    return np.asarray((_product(total, total, common) - own) / (count * (count - 1)))


def _positive(matrices: FloatArray) -> FloatArray:
    """What noise made negative is no information."""
    values, vectors = np.linalg.eigh(matrices)
    return np.asarray(np.einsum("pij,pj,pkj->pik", vectors, np.maximum(values, 0.0), vectors))


@dataclass(frozen=True)
class Separation:
    """How well a scan tells effects apart.

    Attributes
    ----------
    detectable
        By effect: standard deviations that its size stands out when nothing else is unknown but the budget.
    distinct
        By effect: the same when all other effects are unknown, too.
    angle
        Matrix of angles in degree between whitened signatures; 0 is the same, 90 unlike.
    """

    effects: tuple[str, ...]
    detectable: FloatArray
    distinct: FloatArray
    angle: FloatArray

    @property
    def score(self) -> float:
        """Geometric mean of ``distinct``."""
        return float(np.exp(np.mean(np.log(np.maximum(self.distinct, 1e-6)))))


def separation(known: Information, planes: list[int]) -> Separation:
    """Judge a scan over some planes."""
    covariance = known.posterior(planes)
    precision = np.linalg.inv(covariance)
    norm = np.sqrt(np.diag(precision))
    cosine = np.clip(np.abs(precision) / np.outer(norm, norm), 0.0, 1.0)
    angle = np.rad2deg(np.arccos(cosine))
    np.fill_diagonal(angle, 0.0)
    return Separation(known.effects, norm, 1 / np.sqrt(np.diag(covariance)), angle)
