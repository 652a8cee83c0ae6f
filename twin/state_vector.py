"""The state vector: every input of a prediction that has an uncertainty (paper, section II-H).

A block declares parameters of one kind: names, unit, nominal values, standard uncertainties, the row of the budget they
belong to, and how their values change what the twin is made from. Parameters are independent and normal; what the
coupon run says about correlated errors is written with independent ones (:mod:`twin.coupon_errors`). A new parameter is
one more line in :func:`_instrument`, or one more block in :func:`state_vector`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions, check_dimensions, read_artifact
from instrument.errors import InputError
from instrument.facility import Facility, read_facility
from twin.coupon import from_coupon
from twin.coupon_errors import Unstated, coupon_components
from twin.material import Material, open_netcdf, read_material
from twin.optics import Setup
from twin.reflection_models import file_kind


@dataclass(frozen=True)
class Inputs:
    """What one evaluation of the twin is made from.

    Attributes
    ----------
    setup
        What is off in the instrument or in the sample's place.
    artifact
        Dimensions.
    coupon_error, shape (coupon point,)
        Error of the coupon's reflectance factors; None for none.
    """

    setup: Setup
    artifact: ArtifactDimensions
    coupon_error: FloatArray | None = None


@dataclass(frozen=True)
class Block:
    """Independent parameters of one kind; arrays have shape (parameter,).

    Attributes
    ----------
    name, labels
        Of the block and of its parameters.
    source
        Row of the uncertainty budget.
    unit
        Of values and uncertainties.
    nominal, standard_uncertainty
        k = 1.
    apply
        Returns inputs with these values, shape (parameter,), in place of the nominal ones.
    """

    name: str
    labels: tuple[str, ...]
    source: str
    unit: str
    nominal: FloatArray
    standard_uncertainty: FloatArray
    apply: Callable[[Inputs, FloatArray], Inputs]

    def __len__(self) -> int:
        return len(self.nominal)

    @property
    def changes_shape(self) -> bool:
        """Whether the parameters belong to the sample's dimensions, so that each value needs its own mesh."""
        return isinstance(self.apply, (_SetDimension, _SetHoles, _SetChamfers))


@dataclass(frozen=True)
class StateVector:
    """All uncertain inputs of a prediction.

    Attributes
    ----------
    facility, nominal_inputs, nominal_material
        The twin at the nominal values.
    blocks
        In the order of the vector; blocks without uncertainty are left out.
    coupon
        The run that the material was made from; None for a ready table, which states no uncertainty.
    notes
        What was assumed, and what is not propagated.
    """

    facility: Facility
    nominal_inputs: Inputs
    nominal_material: Material
    blocks: tuple[Block, ...]
    coupon: xr.Dataset | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return sum(len(block) for block in self.blocks)

    @property
    def nominal(self) -> FloatArray:
        """Nominal values, shape (parameter,)."""
        return _joined([block.nominal for block in self.blocks])

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Standard uncertainties (k = 1), shape (parameter,)."""
        return _joined([block.standard_uncertainty for block in self.blocks])

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(label for block in self.blocks for label in block.labels)

    @property
    def sources(self) -> tuple[str, ...]:
        """Rows of the budget, in order."""
        return tuple(dict.fromkeys(block.source for block in self.blocks))

    def slices(self) -> Iterator[tuple[Block, slice]]:
        """Every block and its place in the vector."""
        start = 0
        for block in self.blocks:
            yield block, slice(start, start + len(block))
            start += len(block)

    def of_source(self, source: str) -> np.ndarray:
        """Indices of the parameters of one row of the budget."""
        return np.concatenate([np.arange(s.start, s.stop) for block, s in self.slices() if block.source == source])

    def draw(self, seed: int, count: int) -> FloatArray:
        """Draw values of the whole vector, shape (count, parameter)."""
        z = np.random.default_rng(seed).standard_normal((count, len(self)))
        return np.asarray(self.nominal + self.standard_uncertainty * z)

    def inputs(self, values: FloatArray) -> Inputs:
        """What the twin is made from at these values, shape (parameter,); nominal parts are shared, not copied.

        Raises
        ------
        InputError
            For dimensions that no artifact can have, because an uncertainty is too large.
        """
        inputs = self.nominal_inputs
        for block, place in self.slices():
            if np.any(values[place] != block.nominal):
                inputs = block.apply(inputs, values[place])
        if inputs.artifact is not self.nominal_inputs.artifact:
            _check_artifact(inputs.artifact)
        return inputs

    def material(self, coupon_error: FloatArray | None) -> Material:
        """The material as the coupon run would give it with these errors, shape (coupon point,)."""
        if coupon_error is None or self.coupon is None:
            return self.nominal_material
        brf = self.coupon["brf"]
        # In the way that the nominal table was made: another one might suit these values better.
        method = getattr(self.nominal_material, "method", "")
        options: dict[str, Any] = {"method": method} if method else {}
        return from_coupon(self.coupon.assign(brf=brf + coupon_error), self.nominal_material.name, **options)


def state_vector(
    facility: Facility,
    artifact: ArtifactDimensions,
    material: Material,
    coupon: xr.Dataset | None = None,
    *,
    setup: Setup | None = None,
    unstated: Unstated = "slice",
    by_direction: bool = False,
) -> StateVector:
    """Collect every input that has an uncertainty.

    Parameters
    ----------
    facility, artifact, material
        The nominal twin, as for :class:`~twin.prediction.Twin`.
    coupon
        The run that ``material`` was made from. None: the material is taken as known.
    setup
        Nominal place of instrument and sample, single numbers.
    unstated
        Correlation of components of the coupon run that state none.
    by_direction
        Whether systematic errors of the coupon run change their sign with the direction, as their physics does
        (:func:`~twin.coupon_errors.coupon_components`).
    """
    notes = []
    blocks = _instrument(facility, setup or Setup())
    if artifact.mesh is not None:
        notes.append("the sample is a mesh: its dimensions have no stated uncertainty")
    elif len(artifact.holes):
        blocks += _artifact(artifact)
    if coupon is None:
        notes.append("the material is a table: its uncertainty is not stated and not propagated")
    else:
        if by_direction:
            notes.append("material: systematic errors of angles change their sign with the direction")
        for component in coupon_components(coupon, material.name, unstated, by_direction=by_direction):
            blocks.append(_material(component.name, component.modes))
            if component.assumed:
                notes.append(f"material {component.assumed}")
    kept = tuple(block for block in blocks if np.any(block.standard_uncertainty > 0))
    return StateVector(facility, Inputs(setup or Setup(), artifact), material, kept, coupon, tuple(notes))


def state_vector_from_files(
    facility: Path, artifact: Path, material: Path, *, unstated: Unstated = "slice"
) -> StateVector:
    """:func:`state_vector` of a twin's three files; an :class:`~instrument.errors.InputError` names what is wrong."""
    surface = read_material(material)
    return state_vector(
        read_facility(facility), read_artifact(artifact), surface, coupon_of(material), unstated=unstated
    )


def coupon_of(material: Path) -> xr.Dataset | None:
    """The coupon run that a material file holds; None where it holds a ready table or names other materials."""
    kind = file_kind(material)
    if kind not in ("csv", "netcdf") or (kind == "netcdf" and "brdf" in open_netcdf(material)):
        return None
    from instrument.dataset import read_run

    return read_run(material)


def _instrument(facility: Facility, setup: Setup) -> list[Block]:
    """Instrument and sample placement: one line a parameter, (name, unit, standard uncertainty, field of the setup)."""
    arms, sample, beam, sensor = facility.arms, facility.sample, facility.beam, facility.sensor
    rows = [
        ("illumination zenith", "degree", arms.u_illumination_zenith, "illumination_zenith_deg"),
        ("sensor zenith", "degree", arms.u_sensor_zenith, "sensor_zenith_deg"),
        ("sensor azimuth", "degree", arms.u_sensor_azimuth, "sensor_azimuth_deg"),
        ("sample azimuth", "degree", sample.u_azimuth, "sample_azimuth_deg"),
        ("sample tilt x", "degree", sample.u_tilt, "tilt_x_deg"),
        ("sample tilt y", "degree", sample.u_tilt, "tilt_y_deg"),
        ("sample height", "mm", sample.u_height, "height_mm"),
        ("sample offset x", "mm", sample.u_offset, "offset_x_mm"),
        ("sample offset y", "mm", sample.u_offset, "offset_y_mm"),
        ("beam radius", "mm", beam.u_diameter / 2, "beam_radius_mm"),
        ("target radius", "mm", sensor.u_target_diameter / 2, "target_radius_mm"),
    ]
    blocks = [_single(name, unit, float(getattr(setup, field)), u, _SetField(field)) for name, unit, u, field in rows]
    divergence = beam.divergence + float(setup.divergence_deg)
    return [*blocks, _single("beam divergence", "degree", divergence, beam.u_divergence, _Diverge(beam.divergence))]


# What follows changes inputs; classes, so that a state vector can be sent to another process.
@dataclass(frozen=True)
class _SetField:
    field: str

    def __call__(self, inputs: Inputs, values: FloatArray) -> Inputs:
        change: dict[str, float] = {self.field: float(values[0])}
        return replace(inputs, setup=replace(inputs.setup, **change))  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Diverge:
    nominal: float

    def __call__(self, inputs: Inputs, values: FloatArray) -> Inputs:
        # A spread has no sign: values beyond zero fold back.
        setup = replace(inputs.setup, divergence_deg=abs(float(values[0])) - self.nominal)
        return replace(inputs, setup=setup)


@dataclass(frozen=True)
class _SetDimension:
    key: str

    def __call__(self, inputs: Inputs, values: FloatArray) -> Inputs:
        form = inputs.artifact.form.model_copy(update={self.key: float(values[0])})
        return replace(inputs, artifact=replace(inputs.artifact, form=form))


@dataclass(frozen=True)
class _SetHoles:
    key: str

    def __call__(self, inputs: Inputs, values: FloatArray) -> Inputs:
        change: dict[str, Any] = {self.key: np.asarray(values, dtype=float)}
        return replace(inputs, artifact=replace(inputs.artifact, holes=replace(inputs.artifact.holes, **change)))


@dataclass(frozen=True)
class _SetChamfers:
    """Chamfers of some holes, each its own or all the same; the others keep theirs."""

    holes: tuple[int, ...]

    def __call__(self, inputs: Inputs, values: FloatArray) -> Inputs:
        chamfers = inputs.artifact.chamfers
        # A width has no sign: values beyond zero fold back.
        chamfers[list(self.holes)] = np.abs(values)
        return replace(
            inputs, artifact=replace(inputs.artifact, holes=replace(inputs.artifact.holes, chamfer=chamfers))
        )


@dataclass(frozen=True)
class _AddErrors:
    """Errors of one component of the coupon run, in units of their standard uncertainty."""

    modes: FloatArray

    def __call__(self, inputs: Inputs, values: FloatArray) -> Inputs:
        error = np.asarray(self.modes @ values)
        return replace(inputs, coupon_error=error if inputs.coupon_error is None else inputs.coupon_error + error)


def _single(name: str, unit: str, nominal: float, u: float, apply: Callable[[Inputs, FloatArray], Inputs]) -> Block:
    both = ("sample tilt", "sample offset", "block tilt")
    source = name[:-2] if name[:-2] in both else name
    return Block(name, (name,), source, unit, np.array([nominal]), np.array([u]), apply)


#: Keys of the artifact's form that are parameters, and their units.
_DIMENSIONS = {"plate_thickness": "mm", "cavity_depth": "mm", "block_tilt_x": "degree", "block_tilt_y": "degree"}


def _artifact(artifact: ArtifactDimensions) -> list[Block]:
    form, holes = artifact.form, artifact.holes
    blocks = []
    for key, unit in _DIMENSIONS.items():
        u = getattr(form, f"u_{key}")
        blocks.append(_single(key.replace("_", " "), unit, getattr(form, key), u, _SetDimension(key)))
    for key in ("x", "y", "diameter"):
        labels = tuple(f"hole {number} {key}" for number in range(len(holes)))
        nominal, u_holes = getattr(holes, key), getattr(holes, f"u_{key}")
        blocks.append(Block(f"hole {key}", labels, "hole dimensions", "mm", nominal, u_holes, _SetHoles(key)))
    return blocks + _chamfers(artifact)


def _chamfers(artifact: ArtifactDimensions) -> list[Block]:
    """The chamfer that holes have in common, and those of the holes whose own row says something of theirs."""
    holes, none = artifact.holes, np.full(len(artifact.holes), np.nan)
    said = [none if column is None else column for column in (holes.chamfer, holes.u_chamfer)]
    alone = ~np.isnan(said[0]) | ~np.isnan(said[1])
    own, common = (tuple(map(int, np.flatnonzero(mask))) for mask in (alone, ~alone))
    blocks = []
    if common:
        nominal, u = artifact.form.edge_chamfer, artifact.form.u_edge_chamfer
        blocks.append(_single("edge chamfer", "mm", nominal, u, _SetChamfers(common)))
    if own:
        labels = tuple(f"hole {number} chamfer" for number in own)
        nominal_own, u_own = artifact.chamfers[alone], artifact.u_chamfers[alone]
        blocks.append(Block("hole chamfer", labels, "hole dimensions", "mm", nominal_own, u_own, _SetChamfers(own)))
    return blocks


def _material(name: str, modes: FloatArray) -> Block:
    count = modes.shape[1]
    title = f"material {name.replace('_', ' ')}"
    labels = (title,) if count == 1 else tuple(f"{title} {number}" for number in range(count))
    return Block(title, labels, title, "1", np.zeros(count), np.ones(count), _AddErrors(modes))


def _check_artifact(artifact: ArtifactDimensions) -> None:
    form, holes = artifact.form, artifact.holes
    if not 0 < form.plate_thickness < form.cavity_depth:
        raise InputError(
            f"{artifact.source}: within its uncertainty, plate_thickness ({form.plate_thickness:.4g} mm) would not lie"
            f" between 0 and cavity_depth ({form.cavity_depth:.4g} mm); expected smaller uncertainties"
        )
    if np.any(holes.diameter <= 0):
        raise InputError(f"{artifact.source}: within its uncertainty, a hole's diameter would not be positive")
    try:
        check_dimensions(artifact)
    except InputError as error:
        raise InputError(f"{error} (within the stated uncertainties; expected smaller ones)") from None


def _joined(arrays: list[FloatArray]) -> FloatArray:
    return np.concatenate(arrays) if arrays else np.zeros(0)
