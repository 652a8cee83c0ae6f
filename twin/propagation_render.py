"""The plan, rendered for many values of the inputs with the same random numbers.

Whatever differs in instrument, sample placement or material goes into one launch; only other dimensions need another
scene. With common random numbers the ray tracer's error nearly cancels from differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from instrument.angles import FloatArray
from instrument.lambertian import lambertian_flux
from twin.common_sampling import CommonShares, prepare_alike
from twin.material import Material
from twin.mould import Mould
from twin.optics import Setup, lay_out, reference_change
from twin.state_vector import Inputs, StateVector
from twin.surface_mesh import Surface, SurfaceMesh
from twin.tracer import RANDOMISATIONS, SHARE, Part, Tracer

IntArray = NDArray[np.int64]
#: Below so many sight lines a mesh, a scene that is ready sooner and slower to trace is the better one.
_FEW_RAYS = 1_000_000
#: Of each part of a reading so many times the sight lines asked for: light from the top of a plate costs the least.
_MORE = {Part.PLATE_TOP: 2, Part.REFLECTED_ONCE: 1, Part.SCATTERED: 1}


class PlanRenderer:
    """Renders one plan at values of the state vector.

    Parameters
    ----------
    state
        Nominal inputs, and how a coupon's errors change the material.
    columns
        Commanded geometries, from :func:`~twin.optics.geometry_columns`.
    seed
        Of the random numbers, the same for every evaluation.
    surface_factor
        As for :class:`~twin.prediction.Twin`.
    """

    #: Evaluations of one scene that share a launch.
    batch = 16

    def __init__(
        self,
        state: StateVector,
        columns: dict[str, FloatArray],
        *,
        seed: int,
        surface_factor: dict[Surface, float] | None = None,
    ) -> None:
        self.state, self.columns, self.seed = state, columns, seed
        self._surface_factor = surface_factor
        self._mould = Mould(state.nominal_inputs.artifact)
        nominal_mesh = self._mould.mesh(state.nominal_inputs.artifact)
        self._tables = state.nominal_material.table_index(columns["wavelength"])
        self._shares: CommonShares | None = None
        if nominal_mesh.plate is not None:
            layout = lay_out(state.facility, columns, state.nominal_inputs.setup)
            self._shares = CommonShares.of(nominal_mesh.plate, layout)
        self._flux = lambertian_flux(
            state.facility,
            columns["illumination_zenith"],
            columns["sensor_zenith"],
            columns["sensor_azimuth"],
            illumination_azimuth=columns["illumination_azimuth"],
        )

    @property
    def points(self) -> int:
        """Number of geometries."""
        return len(self._flux)

    def take(self, chosen: IntArray, *, seed: int) -> PlanRenderer:
        """For some points of the plan, with other random numbers."""
        columns = {name: column[chosen] for name, column in self.columns.items()}
        return PlanRenderer(self.state, columns, seed=seed, surface_factor=self._surface_factor)

    def alike(self, values: Sequence[FloatArray]) -> tuple[list[int], list[int]]:
        """Numbers of the evaluations with the nominal sample, which can share a launch, and of the others."""
        nominal = self.state.nominal
        shape = np.zeros(len(nominal), dtype=bool)
        for block, place in self.state.slices():
            shape[place] = block.changes_shape
        own = [bool(np.any(np.asarray(value)[shape] != nominal[shape])) for value in values]
        return [n for n, other in enumerate(own) if not other], [n for n, other in enumerate(own) if other]

    def render(self, values: Sequence[FloatArray] | FloatArray, samples: int) -> FloatArray:
        """Reflectance factors at values of the whole vector.

        Parameters
        ----------
        values
            One array of shape (parameter,) an evaluation.
        samples
            Sight lines of a point, in all; rounded up to a power of two in each randomisation. Evaluations with the
            same number have the same random numbers.

        Returns
        -------
        array, shape (evaluation, point, RANDOMISATIONS)
        """
        each = 1 << max(0, int(np.ceil(np.log2(samples / RANDOMISATIONS))))
        result = np.empty((len(values), self.points, RANDOMISATIONS))
        for start in range(0, len(values), self.batch):
            some = [self.state.inputs(np.asarray(v, dtype=float)) for v in values[start : start + self.batch]]
            result[start : start + len(some)] = self._render(some, each)
        return result

    def _render(self, members: list[Inputs], samples: int) -> FloatArray:
        """Evaluate inputs, shape (member, point, RANDOMISATIONS): those that share an artifact in one launch."""
        material, first_table = self._together(members)
        result = np.empty((len(members), self.points, RANDOMISATIONS))
        groups: dict[int, list[int]] = {}
        for number, member in enumerate(members):
            groups.setdefault(id(member.artifact), []).append(number)
        # The nominal plate says where light is looked for, whatever is traced: the same random numbers would choose
        # other joints with a map of the openings for each plate, and an evaluation depend on its company.
        mould = copy(self._mould)  # one that has to be made anew serves these evaluations only
        mesh = mould.mesh(self.state.nominal_inputs.artifact)
        quick = samples * RANDOMISATIONS * self.points < _FEW_RAYS
        tracer = Tracer(mesh, material, surface_factor=self._surface_factor, quick=quick)
        for chosen in groups.values():
            mesh = mould.mesh(members[chosen[0]].artifact)
            tracer.move(mesh)
            result[chosen] = self._launch(tracer, mesh, [members[k] for k in chosen], first_table[chosen], samples)
        return result

    def _launch(
        self, tracer: Tracer, mesh: SurfaceMesh, members: list[Inputs], first_table: IntArray, samples: int
    ) -> FloatArray:
        count, points = len(members), self.points
        columns = {name: np.tile(column, count) for name, column in self.columns.items()}
        layout = lay_out(self.state.facility, columns, _side_by_side([m.setup for m in members], points))
        tables = (first_table[:, None] + self._tables).ravel()
        keys = np.tile(np.arange(points, dtype=np.uint32), count)
        if self._shares is None or mesh.plate is None:
            prepared = tracer.prepare(layout, tables, keys=keys)
        else:
            prepared = prepare_alike(self._shares, mesh.plate, layout, tables, keys)
        radiance = np.zeros((len(keys), RANDOMISATIONS))
        for part in Part:
            radiance += tracer.part(part, prepared, max(1, samples * _MORE[part] // SHARE[part]), seed=self.seed)
        change = np.array([reference_change(self.state.facility, member.setup) for member in members])
        return radiance.reshape(count, points, RANDOMISATIONS) / (change[:, None] * self._flux)[..., None]

    def _together(self, members: list[Inputs]) -> tuple[Material, IntArray]:
        """Every member's material in one, and where each member's tables begin."""
        materials: dict[int, Material] = {}
        for member in members:
            if id(member.coupon_error) not in materials:
                materials[id(member.coupon_error)] = self.state.material(member.coupon_error)
        place = {key: number for number, key in enumerate(materials)}
        first = np.array([place[id(member.coupon_error)] for member in members], dtype=np.int64)
        axes = next(iter(materials.values()))
        # Each surface's tables stay together: (surface material, evaluation and wavelength).
        tables = [m.brdf.reshape(axes.materials, -1, *axes.brdf.shape[1:]) for m in materials.values()]
        stack = np.concatenate(tables, axis=1)
        each, total = tables[0].shape[1], stack.shape[1]
        together = replace(
            axes, brdf=stack.reshape(-1, *axes.brdf.shape[1:]), wavelengths=np.arange(total, dtype=float)
        )
        return together, first * each


@dataclass(frozen=True)
class Evaluation:
    """:meth:`PlanRenderer.render` with a number of sight lines, in a form that can be sent to another process."""

    renderer: PlanRenderer
    samples: int

    def __call__(self, values: Sequence[FloatArray]) -> FloatArray:
        return self.renderer.render(values, self.samples)


def measurement_function(renderer: PlanRenderer, samples: int) -> Callable[..., FloatArray]:
    """The twin as a function ``f(*inputs) -> brf``, the form that punpy propagates through.

    The inputs are the blocks of the state vector in their order, one array of shape (parameter,) each, and the result
    has shape (point,). With punpy::

        f = measurement_function(renderer, samples=2**14)
        nominal, u = punpy_inputs(renderer.state)
        u_brf = punpy.MCPropagation(500).propagate_random(f, nominal, u)

    Parameters of a block are independent, which punpy calls random; correlated errors of the coupon are blocks of
    independent ones already. The result holds the ray tracer's noise, which :func:`~twin.propagation.by_draws` removes:
    choose ``samples`` accordingly.
    """

    def f(*inputs: ArrayLike) -> FloatArray:
        sizes = [len(block) for block in renderer.state.blocks]
        arrays = [np.atleast_1d(np.asarray(values, dtype=float)) for values in inputs]
        if [array.shape for array in arrays] != [(size,) for size in sizes]:
            raise ValueError(f"inputs: found shapes {[a.shape for a in arrays]}; expected {[(n,) for n in sizes]}")
        return np.asarray(renderer.render([np.concatenate(arrays)], samples)[0].mean(axis=-1))

    return f


def punpy_inputs(state: StateVector) -> tuple[list[FloatArray], list[FloatArray]]:
    """Nominal values and standard uncertainties of the blocks, for :func:`measurement_function`."""
    return [block.nominal for block in state.blocks], [block.standard_uncertainty for block in state.blocks]


def _side_by_side(setups: list[Setup], points: int) -> Setup:
    """One setup for all: each field with a value a point, one evaluation after the other."""
    values = {
        field.name: np.repeat([float(getattr(setup, field.name)) for setup in setups], points)
        for field in fields(Setup)
        if field.name != "square_target"
    }
    return Setup(**values, square_target=setups[0].square_target)
