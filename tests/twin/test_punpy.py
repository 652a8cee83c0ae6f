"""The twin as a measurement function of punpy; needs ``pip install punpy``, which is no part of the environment."""

from __future__ import annotations

import numpy as np
import pytest
from test_state_vector import SYSTEMATIC, coupon, uncertain
from traced_samples import columns, facility, flat

from twin.coupon import from_coupon
from twin.propagation import by_sensitivities
from twin.propagation_render import PlanRenderer, measurement_function, punpy_inputs
from twin.state_vector import state_vector

DRAWS = 200


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_punpy_finds_the_same_uncertainty() -> None:
    punpy = pytest.importorskip("punpy", reason="needs pip install punpy")
    run = coupon(reference=(0.005, SYSTEMATIC))
    known = uncertain(facility(2.0, target=30.0), arms={"u_sensor_zenith": 0.2}, sample={"u_tilt": 0.3})
    state = state_vector(known, flat(), from_coupon(run, "coupon"), run)
    renderer = PlanRenderer(state, columns(0.0, [30.0, -60.0], 45.0), seed=3)
    nominal, u = punpy_inputs(state)
    np.random.seed(5)  # noqa: NPY002 - punpy draws from the global generator
    found = punpy.MCPropagation(DRAWS, dtype=np.float64).propagate_random(
        measurement_function(renderer, 512), nominal, u
    )
    expected = by_sensitivities(renderer).u
    # 200 draws know a standard uncertainty to 5 %.
    np.testing.assert_allclose(found, expected, rtol=0.2)
