"""A run of the flat witness coupon beside those of the sample: the same instrument and coating, but no holes.

The twin's material comes from a coupon, so by definition the coupon reflects as the twin says: what the sample's own
coating, dimensions and placement do wrong is not seen on it, while beam, arms, sensor, electronics and acquisition are.
Errors of the earlier coupon run, from which the material was made, are in both predictions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.diagnosis.acquisition import acquisition_of
from twin.diagnosis.effects import AzimuthEffect, Effect, Parameter, ReadingEffect, SceneEffect, ZenithEffect
from twin.diagnosis.nuisance import budget_columns
from twin.diagnosis.observation import Observation
from twin.diagnosis.plausible import flat_reflectance
from twin.diagnosis.problem import Problem
from twin.diagnosis.response import AnyResponse, Response, no_response
from twin.diagnosis.responses import Responses, responses
from twin.diagnosis.variation import Variation
from twin.input_uncertainty import SEED
from twin.propagation_designs import designs

if TYPE_CHECKING:
    from twin.diagnosis.preparation import Bench, Prepared

#: Effects on the reading that come from the sample's coating, not from the instrument.
OF_THE_SAMPLE = ("anisotropy",)
#: Logarithm of the median reading over the prediction beyond which this is no coupon of this material.
_FARTHEST = 0.3


def prepare_coupon(bench: Bench, run: Observation, sample: Iterable[Response]) -> Prepared:
    """A run of the coupon made ready, beside those of the sample.

    Parameters
    ----------
    bench
        Of the flat sample (:meth:`~twin.diagnosis.preparation.Bench.flat`).
    sample
        Effects on a run of the sample. Those of the sample alone do nothing here; the coupon's placement has errors of
        its own.

    Raises
    ------
    InputError
        If the readings are not those of the coupon.
    """
    from twin.diagnosis.preparation import Prepared

    _check_coupon(bench, run)
    known = {response.name: response for response in sample}
    acting = {name for name, response in known.items() if acts_without_sample(response.effect, response.parameters)}
    used = acting | {name for name, response in known.items() if only_places(response.effect, response.parameters)}
    nominal, u_nominal = bench.nominal(run)
    effects = [known[name].effect for name in known if name in used]
    seen = responses(acquisition_of(run, bench.facility), nominal, bench.store, effects=effects)
    found: dict[str, AnyResponse] = {}
    for name, response in known.items():
        if name not in acting:
            found[name] = no_response(response.effect, response.parameters, len(run))
        elif name in seen.found:
            found[name] = seen.found[name]
    ruled_out = {name: reason for name, reason in seen.ruled_out.items() if name in acting}
    columns = {_label(label): column for label, column in budget_columns(seen.found, run).items()}
    budget = np.stack(list(columns.values()), axis=1)
    problem = Problem.of(run, nominal, u_nominal, budget, list(found.values()))
    return Prepared(problem, Responses(found, ruled_out), columns, bench.inputs, bench.facility)


def acts_without_sample(effect: Effect, parameters: Sequence[Parameter]) -> bool:
    """Whether an effect is one of instrument, electronics or acquisition, whatever sample is looked at."""
    if isinstance(effect, ReadingEffect):
        return effect.name not in OF_THE_SAMPLE
    if isinstance(effect, ZenithEffect | AzimuthEffect):
        return True
    return isinstance(effect, SceneEffect) and not any(
        _changes_sample(variation) or _moves_sample(variation) for variation in _at_caps(effect, parameters)
    )


def only_places(effect: Effect, parameters: Sequence[Parameter]) -> bool:
    """Whether an effect is one of how a sample, whichever, lies on its mount."""
    if not isinstance(effect, SceneEffect):
        return False
    found = _at_caps(effect, parameters)
    return any(map(_moves_sample, found)) and not any(map(_changes_sample, found))


def _at_caps(effect: SceneEffect, parameters: Sequence[Parameter]) -> list[Variation]:
    return [effect.variation(np.array(values)) for values in product(*(p.cap for p in parameters))]


def _changes_sample(variation: Variation) -> bool:
    return bool(variation.artifact or variation.material or variation.surface_factor or variation.transport[1])


def _moves_sample(variation: Variation) -> bool:
    return variation.setup != variation.setup.without_sample()


def _check_coupon(bench: Bench, run: Observation) -> None:
    middle = float(np.median(run.brf / flat_reflectance(bench.material, run)))
    if not abs(np.log(middle)) <= _FARTHEST:
        raise InputError(
            f"{run.name}: brf: found {middle:.3g} times what a flat coupon of {bench.inputs.material.name} reflects"
            " (median); expected a run of that coupon"
        )


def _label(label: str) -> str:
    """Errors of placement are the coupon's, not the sample's."""
    return f"coupon {label}" if label.startswith("sample_") else label


def shared_errors(bench: Bench, sample: Observation, coupon: Observation) -> FloatArray:
    """Relative changes by independent errors of coupon and holes, shape (points of sample and coupon, component).

    The errors of the coupon run that the material was made from are the same in both predictions. Of a flat sample they
    are those of the table, so nothing is traced.
    """
    errors = bench.input_errors(sample)
    if errors is None:
        return np.zeros((len(sample) + len(coupon), 0))
    numbered = _numbered(errors.component_sources)
    result = np.zeros((len(sample) + len(coupon), len(numbered)))
    result[: len(sample)] = errors.factor / errors.brf[:, None]
    for key, change in table_errors(bench, coupon):
        # A quadratic change that the sample does not show is a small one of the coupon, too.
        if key in numbered:
            result[len(sample) :, numbered[key]] = change
    return result


def table_errors(bench: Bench, run: Observation) -> Iterator[tuple[tuple[str, int], FloatArray]]:
    """Source and number of each error of the material, and what it does to a flat sample, shape (point,)."""
    from twin.diagnosis.preparation import COATING

    state = bench.state()
    nominal = flat_reflectance(bench.material, run)
    for design in designs(state, SEED):
        if not design.source.startswith(COATING):
            continue
        materials = (state.material(state.inputs(value).coupon_error) for value in design.values)
        changes = np.stack([flat_reflectance(material, run) / nominal - 1 for material in materials])[..., None]
        quadratic = design.curved(changes)
        effects = [design.effects(changes), *([] if quadratic is None else [quadratic])]
        for number, change in enumerate(np.concatenate(effects)[..., 0]):
            yield (design.source, number), change


def _numbered(sources: tuple[str, ...]) -> dict[tuple[str, int], int]:
    """Place of the n-th component of each source."""
    found: dict[tuple[str, int], int] = {}
    counts: Counter[str] = Counter()
    for place, source in enumerate(sources):
        found[source, counts[source]] = place
        counts[source] += 1
    return found
