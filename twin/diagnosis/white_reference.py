"""A scan of the white reference: the light and the instrument alone, in closed form; no sample can be blamed.

The reference counts as Lambertian, flat and in place, as it does when its reading scales a run. What effects of beam,
arms, sensor, electronics and acquisition do to it is known without a ray; effects of the sample do nothing.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import InputError
from instrument.facility import Facility
from instrument.plane_flux import plane_flux
from twin.diagnosis.acquisition import Acquisition, acquisition_of
from twin.diagnosis.coupon_run import OF_THE_SAMPLE
from twin.diagnosis.effects import AzimuthEffect, Effect, Known, ReadingEffect, SceneEffect, ZenithEffect, library
from twin.diagnosis.nuisance import budget_columns
from twin.diagnosis.observation import Observation
from twin.diagnosis.problem import Problem
from twin.diagnosis.response import (
    AZIMUTH_NODES,
    ZENITH_NODES,
    AnyResponse,
    AzimuthResponse,
    ComputedResponse,
    TabulatedResponse,
    ZenithResponse,
    no_response,
)
from twin.diagnosis.responses import Responses
from twin.diagnosis.variation import Variation
from twin.optics import Setup, lay_out, reference_change

if TYPE_CHECKING:
    from collections.abc import Iterable

    from twin.diagnosis.preparation import Bench, Prepared

#: Median reading over the reference's reflectance factor beyond which this is another sample.
_FARTHEST = 0.3


def prepare_white(bench: Bench, run: Observation, effects: Iterable[Effect] | None = None) -> Prepared:
    """A scan of the white reference made ready, beside those of the sample.

    Raises
    ------
    InputError
        If the readings are not those of the reference.
    """
    from twin.diagnosis.preparation import Prepared

    factor = bench.facility.reference.reflectance_factor
    middle = float(np.median(run.brf)) / factor
    if abs(np.log(middle)) > _FARTHEST:
        raise InputError(
            f"{run.name}: brf: found a median of {middle * factor:.3g}; expected the white reference, whose reflectance"
            f" factor is {factor:g}"
        )
    nominal = np.full(len(run), factor)
    acquisition = acquisition_of(run, bench.facility)
    chosen = list(library().values() if effects is None else effects)
    found, ruled_out = white_responses(bench.workbench.known, acquisition, nominal, chosen)
    # The plate has errors of placement of its own, which are no effect of the sample.
    placed = white_responses(bench.workbench.known, acquisition, nominal, chosen, placement=True)[0]
    columns = {_label(label): column for label, column in budget_columns(placed, run).items()}
    budget = np.stack(list(columns.values()), axis=1)
    problem = Problem.of(run, nominal, np.full(len(run), 1e-5), budget, list(found.values()))
    return Prepared(problem, Responses(found, ruled_out), columns, bench.inputs, bench.facility)


def _label(label: str) -> str:
    """Errors of placement are the plate's, not the sample's."""
    return f"white {label}" if label.startswith("sample_") else label


def white_responses(
    known: Known,
    run: Acquisition,
    nominal: FloatArray,
    effects: Iterable[Effect],
    *,
    placement: bool = False,
) -> tuple[dict[str, AnyResponse], dict[str, str]]:
    """Responses of the white reference's points to effects, and why others have none.

    Parameters
    ----------
    nominal, shape (point,)
        Reflectance factor of the reference.
    placement
        Whether effects of the sample's placement move the reference's plate as well.
    """
    found: dict[str, AnyResponse] = {}
    ruled_out: dict[str, str] = {}
    flux = _Flux(known.facility, run.columns, placement)
    for effect in effects:
        missing = effect.missing(run)
        reason = effect.not_applicable(known) or (f"the run says nothing of {', '.join(missing)}" if missing else "")
        if reason:
            ruled_out[effect.name] = reason
        else:
            found[effect.name] = _response(effect, known, run, nominal, flux)
    return found, ruled_out


def _response(effect: Effect, known: Known, run: Acquisition, nominal: FloatArray, flux: _Flux) -> AnyResponse:
    parameters = effect.resolve(known, run)
    if isinstance(effect, ReadingEffect) and effect.name not in OF_THE_SAMPLE:
        return ComputedResponse(effect, parameters, run, nominal)
    if isinstance(effect, ZenithEffect):
        table = np.stack([flux.log_ratio(Setup(sensor_zenith_deg=float(node))) for node in ZENITH_NODES])

        def change(setup: Setup) -> float:
            return reference_change(known.facility, setup)

        return ZenithResponse(effect, parameters, run, table, np.zeros_like(table), change)
    if isinstance(effect, AzimuthEffect):
        table = np.stack([flux.log_ratio(Setup(sensor_azimuth_deg=float(node))) for node in AZIMUTH_NODES])
        return AzimuthResponse(effect, parameters, run, table, np.zeros_like(table))
    if not isinstance(effect, SceneEffect):
        return no_response(effect, parameters, len(run))
    axes = effect.axes(parameters)
    variations = [effect.variation(np.array(row)) for row in product(*axes)]
    table = np.stack([flux.of(variation) for variation in variations])
    table = table.reshape(*(len(axis) for axis in axes), -1)
    return TabulatedResponse(effect, parameters, axes, table, np.zeros_like(table))


class _Flux:
    """Flux of the plate at a run's geometries with an instrument that is off, over that of the nominal one."""

    def __init__(self, facility: Facility, columns: dict[str, FloatArray], placement: bool) -> None:
        self._facility, self._columns, self._placement = facility, columns, placement
        self._nominal = plane_flux(lay_out(facility, columns))
        self._known: dict[str, FloatArray] = {}

    def log_ratio(self, setup: Setup) -> FloatArray:
        """Logarithm, shape (point,); nothing for an error of the sample's placement."""
        seen = setup if self._placement else setup.without_sample()
        key = repr(seen)
        if key not in self._known:
            changed = plane_flux(lay_out(self._facility, self._columns, seen))
            self._known[key] = np.log(np.maximum(changed, 1e-9 * self._nominal) / self._nominal)
        return self._known[key]

    def of(self, variation: Variation) -> FloatArray:
        """The same as a reading: divided by the reference's reading with the instrument off in the same way."""
        change = reference_change(self._facility, variation.reference_setup())
        return np.asarray(self.log_ratio(variation.setup) - np.log(change))
