"""Two effects of like form: each alone fits the sum of both badly, and far from where it fits beside the other."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_runs import SCALE, grid, observed, structure

from instrument.angles import FloatArray
from twin.diagnosis.acquisition import Acquisition, travel_direction
from twin.diagnosis.couples import pairs
from twin.diagnosis.effects import effect
from twin.diagnosis.fit import Component, fit_single
from twin.diagnosis.likelihood import normals
from twin.diagnosis.response import ComputedResponse

COLUMNS = grid({0.0: (0.0, 45.0, 90.0), 30.0: (0.0, 60.0)}, 10.0)
COUNT = len(COLUMNS["wavelength"])
TRUE = {"anisotropy": [0.072, 121.0, 2.0, 1.0], "polarization": [0.1, 1.0]}


def response(name: str) -> ComputedResponse:
    order = np.arange(COUNT)
    corners = np.array([0.0, 45.0, 90.0, 135.0])
    travel = travel_direction(COLUMNS, order)
    run = Acquisition(COLUMNS, np.ones(COUNT), 15.0, corners, np.maximum(order - 1, 0), travel)
    found = effect(name)
    return ComputedResponse(found, found.parameters, run, np.full(COUNT, 0.5))


@pytest.mark.parametrize("seed", [1, 2])
def test_two_effects_of_like_form_are_found_where_they_fit_best_together(seed: int):
    library = {name: response(name) for name in TRUE}
    change: FloatArray = sum((library[name].log_ratio(np.array([v]))[0] for name, v in TRUE.items()), np.zeros(COUNT))
    members = normals(
        [structure(COLUMNS, "independent, 1 times the budget")], np.full((COUNT, 1), SCALE), np.full(COUNT, 1e-3)
    )
    residual = change + 0.002 * np.random.default_rng(seed).standard_normal(COUNT)
    parts = [Component.of(one, observed(COLUMNS).relative_u) for one in library.values()]
    singles = [(part, fit) for part in parts if (fit := fit_single(part, residual, members)) is not None]
    (best,) = pairs(residual, singles, members)
    found = dict(zip(best.names, np.split(best.values, np.cumsum(best.sizes)[:-1]), strict=True))
    assert found["anisotropy"][0] == pytest.approx(0.072, abs=0.01)
    assert found["anisotropy"][1] == pytest.approx(121, abs=5)
    assert found["polarization"][0] == pytest.approx(0.1, abs=0.02)
    assert np.sqrt(np.mean((best.table - change) ** 2)) < 0.002
